"""A UDP relay: sends any program's datagrams through a link, in both directions, for many clients at once.

    clients  <->  [listen]  == up link ==>    [one socket a client]  <->  target
                            <== down link ==

Clients share the two links, as they would share a line. Each client has its own socket towards the target, so that
answers can be returned to it. A rate counts the size of the datagram's payload: ``rate 1mbit 28`` adds the headers of
UDP and IPv4.
"""

from __future__ import annotations

import asyncio
import re
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from numpy.random import SeedSequence

from netem.aio import AsyncLink
from netem.errors import NetemError
from netem.link import Link
from netem.profile import LinkProfile
from netem.stats import LinkStats

SOCKET_BUFFER = 4 * 2**20
"""Requested size of each socket's buffers [bytes]; the kernel grants at most ``net.core.rmem_max`` and ``wmem_max``."""

_MAX_DATAGRAM = 65_536
_BATCH = 256  # most datagrams read in a row before the loop runs its timers
_SO_MEMINFO, _MEMINFO_DROPS = 55, 8  # linux/sock_diag.h: the ninth of nine 32-bit counters (since Linux 4.12)

SocketAddress = tuple[Any, ...]
"""An address of the socket module: (host, port) or, for IPv6, (host, port, flow, scope)."""


@dataclass(frozen=True, slots=True)
class RelayStats:
    """A snapshot of a relay.

    `up` and `down` are the links' statistics. `clients` counts the clients with a socket now, `clients_seen` all
    clients so far. `dropped` counts datagrams that the relay itself could not forward: the send buffer was full, the
    target unreachable, the client above the limit or closed meanwhile. `socket_drops` counts datagrams that the kernel
    dropped because a receive buffer was full (SO_MEMINFO's counter, over all sockets of the relay); None if unknown.
    """

    up: LinkStats
    down: LinkStats
    clients: int
    clients_seen: int
    dropped: int
    socket_drops: int | None

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return asdict(self)


def parse_address(name: str, text: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT`` or ``[IPV6]:PORT``.

    Raises NetemError: `text` is not such an address; the message calls it `name`.
    """
    match = re.fullmatch(r"(?:\[([^\[\]]+)\]|([^\[\]:\s]+)):(\d{1,5})", text, re.ASCII)
    if match is None or int(match[3]) > 65_535:
        raise NetemError(f"{name}: {text!r} is not allowed; allowed: HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:5000")
    return match[1] or match[2], int(match[3])


def format_address(address: SocketAddress) -> str:
    """``HOST:PORT``, or ``[IPV6]:PORT``."""
    return f"[{address[0]}]:{address[1]}" if ":" in address[0] else f"{address[0]}:{address[1]}"


class UdpRelay:
    """Relays datagrams between clients of the listening address and a target.

    listen, to : ``HOST:PORT`` or ``[IPV6]:PORT``; with port 0 it listens on any free port. Names are resolved once.
    up, down : the profiles from clients to target, and back.
    seed : the seed of both links, whose streams are independent.
    max_clients : most clients at one time; datagrams of others are dropped and counted.
    idle_s : the socket of a client that sent and received nothing for this time is closed [s].

    Must be made on a running loop, and used on its thread. ``async with UdpRelay(...)`` closes it at the end.

    Raises NetemError: an address is malformed, unknown, in use or not of this machine, or both addresses are the same.
    """

    def __init__(
        self,
        listen: str,
        to: str,
        up: LinkProfile,
        down: LinkProfile,
        seed: int = 0,
        *,
        max_clients: int = 256,
        idle_s: float = 60.0,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._max_clients, self._idle_ns = max_clients, int(idle_s * 1e9)
        self._target_family, self._target = resolve("to", to)
        family, address = resolve("listen", listen)
        if address == self._target:
            raise NetemError(f"to: {to!r} is the address that is listened on; give another")
        self._clients: dict[SocketAddress, _Client] = {}
        self._clients_seen = self._dropped = self._closed_drops = 0
        self._buffer = bytearray(_MAX_DATAGRAM)
        self._view = memoryview(self._buffer)
        self._socket = _udp_socket(family)
        self._counts_drops = socket_drops(self._socket) is not None
        try:
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise NetemError(f"listen: cannot listen on {listen}: {error.strerror}") from None
        up_seed, down_seed = SeedSequence(seed).spawn(2)
        self.up: AsyncLink[_Datagram] = AsyncLink(Link(up, up_seed, flip=_flip), self._to_target)
        self.down: AsyncLink[_Datagram] = AsyncLink(Link(down, down_seed, flip=_flip), self._to_client)
        self._loop.add_reader(self._socket, self._from_clients)
        self._sweeper = self._loop.call_later(idle_s / 4, self._close_idle)

    @property
    def address(self) -> SocketAddress:
        """The address where it listens."""
        address: SocketAddress = self._socket.getsockname()
        return address

    @property
    def stats(self) -> RelayStats:
        """A snapshot of the relay's statistics."""
        drops = None
        if self._counts_drops:
            sockets = (self._socket, *(client.socket for client in self._clients.values()))
            drops = self._closed_drops + sum(socket_drops(s) or 0 for s in sockets)
        return RelayStats(
            up=self.up.link.stats,
            down=self.down.link.stats,
            clients=len(self._clients),
            clients_seen=self._clients_seen,
            dropped=self._dropped,
            socket_drops=drops,
        )

    async def __aenter__(self) -> UdpRelay:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop and close the sockets; datagrams in flight are not delivered. `stats` stays. May be called again."""
        self.up.close()
        self.down.close()
        self._sweeper.cancel()
        for client in list(self._clients.values()):
            self._close_client(client)
        if self._socket.fileno() >= 0:
            self._closed_drops += socket_drops(self._socket) or 0
            self._loop.remove_reader(self._socket)
            self._socket.close()

    def _from_clients(self) -> None:
        receive, view, clients, send = self._socket.recvfrom_into, self._view, self._clients, self.up.link.send
        now_ns = time.monotonic_ns()
        for _ in range(_BATCH):
            try:
                size, address = receive(view)
            except OSError:  # usually because nothing is left to read
                break
            client = clients.get(address) or self._new_client(address)
            if client is None:
                self._dropped += 1
                continue
            client.active_ns = now_ns
            send(now_ns, (bytes(view[:size]), client), size)
        self.up.release()

    def _from_target(self, client: _Client) -> None:
        receive, view, send = client.socket.recv_into, self._view, self.down.link.send
        now_ns = time.monotonic_ns()
        for _ in range(_BATCH):
            try:
                size = receive(view)
            except ConnectionRefusedError:  # caused by an earlier datagram: the target's port was closed
                self._dropped += 1
                continue
            except OSError:
                break
            client.active_ns = now_ns
            send(now_ns, (bytes(view[:size]), client), size)
        self.down.release()

    def _to_target(self, datagram: _Datagram) -> None:
        data, client = datagram
        try:
            client.socket.send(data)
        except ConnectionRefusedError:  # caused by an earlier datagram; this one is still to be sent
            self._dropped += 1
            self._try(client.socket.send, data)
        except OSError:
            self._dropped += 1

    def _to_client(self, datagram: _Datagram) -> None:
        data, client = datagram
        try:
            self._socket.sendto(data, client.address)
        except OSError:
            self._dropped += 1

    def _try(self, send: Callable[[bytes], int], data: bytes) -> None:
        try:
            send(data)
        except OSError:
            self._dropped += 1

    def _new_client(self, address: SocketAddress) -> _Client | None:
        if len(self._clients) >= self._max_clients:
            return None
        try:
            upstream = _udp_socket(self._target_family)
        except OSError:  # no file descriptor is left
            return None
        try:
            upstream.connect(self._target)
        except OSError:
            upstream.close()
            return None
        client = self._clients[address] = _Client(upstream, address)
        self._clients_seen += 1
        self._loop.add_reader(upstream, self._from_target, client)
        return client

    def _close_client(self, client: _Client) -> None:
        self._closed_drops += socket_drops(client.socket) or 0
        self._loop.remove_reader(client.socket)
        client.socket.close()
        del self._clients[client.address]

    def _close_idle(self) -> None:
        oldest_ns = time.monotonic_ns() - self._idle_ns
        for client in [c for c in self._clients.values() if c.active_ns < oldest_ns]:
            self._close_client(client)
        self._sweeper = self._loop.call_later(self._idle_ns * 0.25e-9, self._close_idle)


class _Client:
    __slots__ = ("active_ns", "address", "socket")

    def __init__(self, upstream: socket.socket, address: SocketAddress) -> None:
        self.socket, self.address, self.active_ns = upstream, address, 0


_Datagram = tuple[bytes, _Client]


def _flip(datagram: _Datagram, corrupted: Callable[[bytes], bytes]) -> _Datagram:
    data, client = datagram
    return corrupted(data), client


def _udp_socket(family: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_DGRAM)
    sock.setblocking(False)
    for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
        sock.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER)
    return sock


def resolve(name: str, text: str) -> tuple[int, SocketAddress]:
    """Family and address of ``HOST:PORT``; `name` is the option for messages.

    Raises NetemError: `text` is no address, or its host is not known.
    """
    host, port = parse_address(name, text)
    if name == "to" and port == 0:
        raise NetemError(f"to: {text!r} is not allowed; allowed: a port from 1 to 65535")
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "not a host's name"
        raise NetemError(f"{name}: cannot resolve {host!r}: {reason}") from None
    return addresses[0][0], addresses[0][4]


def socket_drops(of: socket.socket) -> int | None:
    """Number of datagrams that the kernel dropped because this socket's buffer was full; None if unknown or closed."""
    try:
        counters = of.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
    except OSError:
        return None
    drops: int = struct.unpack_from("=I", counters, 4 * _MEMINFO_DROPS)[0]
    return drops
