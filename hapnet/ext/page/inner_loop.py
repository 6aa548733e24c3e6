"""Keeps viser off the network: on this event loop its server opens no port.

viser accepts every client that connects to its port, and has no hook for a check. So hapnet supplies its event loop,
by an event loop policy that is set while viser starts its thread. This loop keeps the server that viser creates, and
passes it only the gate's connections (gate.py). If viser starts without this loop, no page is served.
"""

from __future__ import annotations

import asyncio
import socket
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Factory = Callable[[], asyncio.BaseProtocol]


class InnerLoop(asyncio.SelectorEventLoop):
    """An event loop with a first server that opens no port; `connect` is the only way to reach it.

    inner : makes the protocol of a connection to that server; None: no server has been created yet.
    """

    inner: Factory | None = None

    async def create_server(self, protocol_factory: Any, *args: Any, **options: Any) -> Any:
        if self.inner is not None:
            return await super().create_server(protocol_factory, *args, **options)
        self.inner = protocol_factory
        return _Nowhere(self)

    async def connect(self) -> socket.socket:
        """Open a connection to the first server, and return the client's end."""
        assert self.inner is not None
        ours, its = socket.socketpair()
        ours.setblocking(False)
        await self.connect_accepted_socket(self.inner, its)
        return ours


class _Nowhere(asyncio.AbstractServer):
    """A server without sockets."""

    sockets = ()

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop, self._open = loop, True

    def close(self) -> None:
        self._open = False

    def get_loop(self) -> asyncio.AbstractEventLoop:
        return self._loop

    def is_serving(self) -> bool:
        return self._open

    async def start_serving(self) -> None:
        pass

    async def serve_forever(self) -> None:
        await asyncio.Event().wait()

    async def wait_closed(self) -> None:
        pass


_one_at_a_time = threading.Lock()


@contextmanager
def inner_loops() -> Iterator[list[InnerLoop]]:
    """A context in which new threads get an `InnerLoop` as their new loop; gives the list of these loops."""
    loops: list[InnerLoop] = []
    with _one_at_a_time, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of policies, from Python 3.14 on
        known, before = set(threading.enumerate()), asyncio.get_event_loop_policy()

        class Policy(asyncio.AbstractEventLoopPolicy):
            """The previous policy, except for new loops of new threads."""

            def get_event_loop(self) -> asyncio.AbstractEventLoop:
                return before.get_event_loop()

            def set_event_loop(self, loop: asyncio.AbstractEventLoop | None) -> None:
                before.set_event_loop(loop)

            def new_event_loop(self) -> asyncio.AbstractEventLoop:
                if threading.current_thread() in known:
                    return before.new_event_loop()
                loops.append(InnerLoop())
                return loops[-1]

            def get_child_watcher(self) -> Any:
                return before.get_child_watcher()

            def set_child_watcher(self, watcher: Any) -> None:
                before.set_child_watcher(watcher)

        asyncio.set_event_loop_policy(Policy())
        try:
            yield loops
        finally:
            asyncio.set_event_loop_policy(before)
