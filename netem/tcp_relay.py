"""A TCP relay: carries any program's connections through a link, in both directions, for many clients at once.

    clients  <->  [listen]  == up link ==>    [one connection a client]  <->  target
                            <== down link ==

A stream must lose nothing, so the link's losses become delays, as over a real line: each direction of a connection is
cut into segments, which the other end acknowledges through the other link. A segment is sent again when three that
were sent after it are acknowledged, or when its timer ends (`netem.retransmission`). Early segments wait for missing
ones. There is no congestion control: a loss costs time, not rate.

Clients share the two links, as they would share a line. A rate counts the payload: ``rate 1mbit 40`` adds the headers
of TCP and IPv4, and lets acknowledgements take their part of the line.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Final

from numpy.random import SeedSequence

from netem.aio import AsyncLink
from netem.errors import NetemError, ProfileError
from netem.link import Link
from netem.profile import LinkProfile
from netem.relay import SocketAddress, format_address, resolve
from netem.retransmission import RoundTrips
from netem.stats import LinkStats
from netem.timeline import Cut

SEGMENT: Final = 1448
"""Most bytes of a stream in a segment: an Ethernet frame's, less the headers of IPv4 and TCP with time stamps."""

WINDOW: Final = 1 << 20
"""Bytes of a stream that may be in flight, or wait for a program that does not read; then its sender waits too."""

_LATER = 3  # acknowledgements of later segments that show the loss of a segment (RFC 5681)


@dataclass(frozen=True, slots=True)
class TcpRelayStats:
    """A snapshot of a relay.

    `up` and `down` are the links' statistics, in segments and acknowledgements. `clients` counts the connections now,
    `clients_seen` all so far, `refused` those above the limit, `unreachable` those that the target did not accept.
    `sent_again` counts segments.
    """

    up: LinkStats
    down: LinkStats
    clients: int
    clients_seen: int
    refused: int
    unreachable: int
    sent_again: int

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return asdict(self)


class TcpRelay:
    """Relays TCP connections between clients of the listening address and a target.

    listen, to : ``HOST:PORT`` or ``[IPV6]:PORT``; with port 0 it listens on any free port. Names are resolved once.
    up, down : the profiles from clients to target, and back.
    seed : the seed of both links, whose streams are independent.
    max_clients : most connections at one time; further ones are closed at once and counted.

    Must be made on a running loop, and used on its thread, by ``async with TcpRelay(...) as relay`` or `open`, `close`.

    Raises NetemError: an address is malformed or unknown, or both are the same; a profile corrupts, which TCP hides.
    """

    def __init__(
        self, listen: str, to: str, up: LinkProfile, down: LinkProfile, seed: int = 0, *, max_clients: int = 256
    ) -> None:
        for profile in (up, down):
            if profile.corrupt:
                raise ProfileError("corrupt", profile.corrupt, "'loss', as TCP drops what is corrupted")
        self._target, self._listen = resolve("to", to)[1][:2], resolve("listen", listen)[1][:2]
        if self._listen == self._target:
            raise NetemError(f"to: {to!r} is the address that is listened on; give another")
        up_seed, down_seed = SeedSequence(seed).spawn(2)
        self.up: AsyncLink[_Arrival] = AsyncLink(Link(up, up_seed), _arrive, cut=self.cut)
        self.down: AsyncLink[_Arrival] = AsyncLink(Link(down, down_seed), _arrive, cut=self.cut)
        self._max_clients = max_clients
        self._clients: dict[asyncio.Task[None], _Connection] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self._seen = self._refused = self._unreachable = self._sent_again = 0
        self._server: asyncio.Server | None = None
        self._address: SocketAddress = self._listen

    async def open(self) -> None:
        """Listen.

        Raises NetemError: the address is in use or not of this machine.
        """
        try:
            self._server = await asyncio.start_server(self._accept, *self._listen, limit=WINDOW)
        except OSError as error:
            where = format_address(self._listen)
            raise NetemError(f"listen: cannot listen on {where}: {os.strerror(error.errno or 0)}") from None
        self._address = self._server.sockets[0].getsockname()

    async def __aenter__(self) -> TcpRelay:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def address(self) -> SocketAddress:
        """The address where it listens."""
        return self._address

    @property
    def stats(self) -> TcpRelayStats:
        """A snapshot of the relay's statistics."""
        return TcpRelayStats(
            up=self.up.link.stats,
            down=self.down.link.stats,
            clients=len(self._clients),
            clients_seen=self._seen,
            refused=self._refused,
            unreachable=self._unreachable,
            sent_again=self._sent_again,
        )

    async def close(self) -> None:
        """Stop, and reset open connections. `stats` stays. May be called again."""
        if self._server is not None:
            self._server.close()
        tasks = [*self._clients, *self._ending]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self.up.close()
        self.down.close()

    def cut(self, how: Cut) -> None:
        """Cut all connections.

        ``"reset"``: both programs of each receive a reset at once, and data on the links are lost. ``"end"``: each
        program receives what the other has sent so far and then the end of the stream, after the link's delay. What a
        program sends later is lost.
        """
        for task, connection in list(self._clients.items()):
            if how == "reset":
                for writer in connection.writers:
                    _reset(writer)
            if how == "reset" or not connection.reading:
                task.cancel()
                continue
            for reading, stream in connection.reading:
                if not reading.done() and reading.cancel():
                    ending = asyncio.get_running_loop().create_task(stream.send(b""))
                    self._ending.add(ending)
                    ending.add_done_callback(self._ending.discard)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= self._max_clients:
            self._refused += 1
            _reset(writer)
            return
        self._seen += 1
        connection = _Connection([writer])
        client = asyncio.get_running_loop().create_task(self._serve(reader, connection))
        self._clients[client] = connection
        client.add_done_callback(self._clients.pop)

    async def _serve(self, near: asyncio.StreamReader, connection: _Connection) -> None:
        """Serve one client until both programs have ended."""
        [to_near] = writers = connection.writers
        up, down = _Stream(self.up, self.down, self._count_again), _Stream(self.down, self.up, self._count_again)
        try:
            await up.send(b"")  # the target is connected after the link's delay
            await up.receive()
            try:
                far, to_far = await asyncio.open_connection(*self._target, limit=WINDOW)
            except OSError:
                self._unreachable += 1
                await down.send(_RESET)
                await down.receive()
                _reset(to_near)
                return
            writers.append(to_far)
            async with asyncio.TaskGroup() as both:
                for reader, stream, writer in ((near, up, to_far), (far, down, to_near)):
                    connection.reading.append((both.create_task(_read(reader, stream)), stream))
                    both.create_task(_write(writer, stream))
        except* OSError:  # a program ended while data were written to it: its other side gets a reset too
            for writer in writers:
                _reset(writer)
        finally:
            up.close()
            down.close()
            for writer in writers:
                writer.close()

    def _count_again(self) -> None:
        self._sent_again += 1


@dataclass(slots=True)
class _Connection:
    """A client's connection: to whom it writes, and the tasks that read into its streams."""

    writers: list[asyncio.StreamWriter]
    reading: list[tuple[asyncio.Task[None], _Stream]] = field(default_factory=list)


_RESET: Final = None
"""The last item of a stream whose program ended without closing it; b"" is the orderly end."""


async def _read(reader: asyncio.StreamReader, stream: _Stream) -> None:
    """Pass a program's data into a stream, until their end."""
    try:
        while data := await reader.read(SEGMENT):
            await stream.send(data)
        await stream.send(b"")
    except ConnectionError:
        await stream.send(_RESET)


async def _write(writer: asyncio.StreamWriter, stream: _Stream) -> None:
    """Pass a stream's data to a program. If the program has ended, the connection is reset."""
    while data := await stream.receive():
        writer.write(data)
        await writer.drain()
    if data is _RESET:
        _reset(writer)
    elif not writer.is_closing():
        writer.write_eof()


def _reset(writer: asyncio.StreamWriter) -> None:
    """End a connection so that its program receives a reset, and no orderly end."""
    with suppress(OSError):
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


_Arrival = Callable[[], None]
"""The function that is called with each item from a link."""


def _arrive(arrival: _Arrival) -> None:
    arrival()


@dataclass(slots=True)
class _Segment:
    """`data`, when it was sent, its place in the order of sending, and how often it was sent already."""

    data: bytes | None
    sent_ns: int
    place: int
    tries: int


class _Stream:
    """One direction of a connection: all data are received once and in order, whatever the link loses.

    `link` carries the segments, `back` their acknowledgements. `count_again` is called when a segment is sent again.
    """

    def __init__(self, link: AsyncLink[_Arrival], back: AsyncLink[_Arrival], count_again: Callable[[], None]) -> None:
        self._link, self._back, self._count_again = link, back, count_again
        self._in_transit: dict[int, _Segment] = {}  # not acknowledged, by number, in the order of sending
        self._bytes = self._number = self._place = 0
        self._room, self._there = asyncio.Event(), asyncio.Event()
        self._room.set()
        self._early: dict[int, bytes | None] = {}
        self._received: deque[bytes | None] = deque()
        self._next = 0
        self._trips = RoundTrips()
        self._timer: asyncio.TimerHandle | None = None

    async def send(self, data: bytes | None) -> None:
        """Send the next piece; wait while more than `WINDOW` bytes are in flight."""
        await self._room.wait()
        self._bytes += len(data or b"")
        self._look_at_room()
        number, self._number = self._number, self._number + 1
        self._send(number, _Segment(data, 0, 0, 0))

    async def receive(self) -> bytes | None:
        """The next piece in order."""
        while not self._received:
            self._there.clear()
            await self._there.wait()
        data = self._received.popleft()
        self._bytes -= len(data or b"")
        self._look_at_room()
        return data

    def close(self) -> None:
        """Stop sending."""
        self._in_transit.clear()
        self._set_timer()

    def _look_at_room(self) -> None:
        (self._room.set if self._bytes < WINDOW else self._room.clear)()

    def _send(self, number: int, segment: _Segment) -> None:
        self._place += 1
        segment.sent_ns, segment.place, segment.tries = time.monotonic_ns(), self._place, segment.tries + 1
        self._in_transit[number] = segment
        if self._timer is None:
            self._set_timer()
        data, place = segment.data, segment.place
        self._link.send(lambda: self._arrived(number, data, place), len(data or b""))

    def _arrived(self, number: int, data: bytes | None, place: int) -> None:
        if number >= self._next:
            self._early[number] = data
        while self._next in self._early:
            self._received.append(self._early.pop(self._next))
            self._next += 1
            self._there.set()
        through = self._next
        self._back.send(lambda: self._acknowledged(number, through, place), 0)

    def _acknowledged(self, number: int, through: int, place: int) -> None:
        """Enter that segment `number`, sent at `place` in the order, has arrived, and all below `through`."""
        segment = self._in_transit.get(number)
        if segment is not None and segment.place == place:
            self._trips.measure(1e-9 * (time.monotonic_ns() - segment.sent_ns), through, self._number)
        for arrived in [each for each in self._in_transit if each < through or each == number]:
            del self._in_transit[arrived]
        lost = [(each, sent) for each, sent in self._in_transit.items() if sent.place + _LATER <= place]
        for each, sent in lost:
            self._again(each, sent)
        self._set_timer()

    def _again(self, number: int, segment: _Segment) -> None:
        self._count_again()
        del self._in_transit[number]  # it moves to the end of the order
        self._send(number, segment)

    def _set_timer(self) -> None:
        """Set the timer for the segment in flight that was sent first."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._in_transit:
            first = next(iter(self._in_transit.values()))
            left_s = self._trips.timer_s(first.tries) - 1e-9 * (time.monotonic_ns() - first.sent_ns)
            self._timer = asyncio.get_running_loop().call_later(max(left_s, 0.0), self._ring)

    def _ring(self) -> None:
        self._timer = None
        self._again(*next(iter(self._in_transit.items())))
        self._set_timer()
