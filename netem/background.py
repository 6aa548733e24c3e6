"""A relay beside a program that has no asyncio loop, such as a test: it runs on a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Literal, TypeVar

from netem.errors import NetemError
from netem.profile import LinkProfile
from netem.relay import RelayStats, SocketAddress, UdpRelay
from netem.tcp_relay import TcpRelay, TcpRelayStats
from netem.timeline import Cut, Timeline

R = TypeVar("R")

_START_S = 10.0


class BackgroundRelay:
    """Relays UDP or TCP to a target through a link, from `__enter__` to `__exit__`.

    with BackgroundRelay("127.0.0.1:5000", "delay 40ms loss 5%") as relay:
        client.connect(relay.address)
        with relay.faults("at 0s: down; at 1s: up"):
            ...

    to : ``HOST:PORT`` or ``[IPV6]:PORT`` of the target.
    up, down : words or a profile's name, from clients to target and back; None: `down` is the same as `up`.
    protocol : the protocol to relay. listen : the address for clients; port 0: any free one.
    seed : the seed of both links, whose streams are independent.

    Its methods may be called from any thread while it runs.

    Raises NetemError: words, an address or the timeline is wrong, or it cannot listen.
    """

    def __init__(
        self,
        to: str,
        up: str = "",
        down: str | None = None,
        *,
        protocol: Literal["udp", "tcp"] = "udp",
        listen: str = "127.0.0.1:0",
        seed: int = 0,
    ) -> None:
        self._kind: type[UdpRelay | TcpRelay] = {"udp": UdpRelay, "tcp": TcpRelay}[protocol]
        profiles = LinkProfile.named(up), LinkProfile.named(up if down is None else down)
        self._arguments = (listen, to, *profiles, seed)
        self._relay: UdpRelay | TcpRelay
        self._loop: asyncio.AbstractEventLoop
        self._end: asyncio.Event
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="netem", daemon=True)
        self._ready = threading.Event()
        self._failure: Exception | None = None

    def __enter__(self) -> BackgroundRelay:
        self._thread.start()
        self._ready.wait(_START_S)
        if self._failure is not None:
            raise self._failure
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()

    @property
    def address(self) -> SocketAddress:
        """The address where it listens, in the form of the socket module."""
        return self._relay.address

    @property
    def stats(self) -> RelayStats | TcpRelayStats:
        """A snapshot of the relay's statistics."""
        return self._on_loop(lambda: self._relay.stats)

    def change(self, up: str | None = None, down: str | None = None) -> None:
        """Use other words from now on, without losing messages in flight; None: leave that direction unchanged."""
        pairs = [(self._relay.up, up), (self._relay.down, down)]
        changes = [(link, LinkProfile.named(words)) for link, words in pairs if words is not None]
        self._on_loop(lambda: [link.change(profile) for link, profile in changes])

    def cut(self, how: Cut) -> None:
        """Cut all TCP connections: ``"reset"`` or ``"end"``, see `TcpRelay.cut`. Raises NetemError: it relays UDP."""

        def cut() -> None:
            if not isinstance(self._relay, TcpRelay):
                raise NetemError(f"cut: {how!r} is for TCP connections, and this relay has UDP: use protocol='tcp'")
            self._relay.cut(how)

        self._on_loop(cut)

    @contextmanager
    def faults(self, timeline: Timeline | str) -> Iterator[None]:
        """Change both directions by a timeline that starts now; the end of the block restores their profiles."""
        if isinstance(timeline, str):
            timeline = Timeline.parse(timeline, connections=self._kind is TcpRelay)
        block = ExitStack()
        self._on_loop(
            lambda: [
                block.enter_context(direction.faults(timeline)) for direction in (self._relay.up, self._relay.down)
            ]
        )
        try:
            yield
        finally:
            self._on_loop(block.close)

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        try:
            async with self._kind(*self._arguments) as self._relay:
                self._ready.set()
                await self._end.wait()
        except Exception as error:  # raised in the thread that waits for the start
            self._failure = error
            self._ready.set()

    def _on_loop(self, call: Callable[[], R]) -> R:
        async def made() -> R:
            return call()

        return asyncio.run_coroutine_threadsafe(made(), self._loop).result()
