"""A page on a viser server of its own, which opens no port: only `connect` reaches it.

viser's handles may be used from any thread, but each change wakes its loop's tasks at once, and waking tasks while the
loop itself changes their list raises. This cannot happen on the loop itself, so the page is created and drawn there,
and its callbacks are coroutines.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING

import rich

from hapnet.errors import HapnetError, MissingLibrary
from hapnet.ext.page.controls import Controls
from hapnet.ext.page.history import History
from hapnet.ext.page.inner_loop import InnerLoop, inner_loops

if TYPE_CHECKING:
    from viser import ViserServer

    from hapnet.ext.page.playback import Playback

FRAME_S = 1.0 / 60.0
FRAMES_A_PLOT = 15
"""Plots, numbers and controls are drawn at some 4 Hz, as they are the most work for a browser without a GPU."""

NICENESS = 10
"""The priority of the page's threads, as `nice` counts."""

IDLE_S, UNSEEN_S = 0.1, 1.0
"""While there is no browser: how often to check for one, and how often to draw, so that it first sees this pair [s]."""


class ViserPage:
    """The page that shows `history`, drawn until `end_drawing`. Arguments as of `hapnet.ext.page.server.serve`.

    Raises MissingLibrary: viser is not installed.
    """

    def __init__(
        self, history: History, controls: Controls | None, player: Playback | None = None, frame_s: float = FRAME_S
    ) -> None:
        self._frame_s = frame_s
        # a client that connects and sends nothing, such as a port scan, would print a traceback to standard error
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        try:
            import viser

            from hapnet.ext.page.page import Page
        except ImportError as error:
            raise MissingLibrary("the live page", error.name or "viser", "view") from None

        class Server(viser.ViserServer):
            def request_share_url(self, verbose: bool = True) -> str | None:
                """Refuse, as otherwise any open page could request a tunnel to a public server."""
                return None

        def make() -> tuple[ViserServer, InnerLoop]:
            yield_to_servos()  # the server's own threads inherit it
            with _quiet(), inner_loops() as loops:
                server = Server("127.0.0.1", 0, label="hapnet", verbose=False)
            if len(loops) != 1 or loops[0].inner is None:
                server.stop()
                raise HapnetError(f"viser {viser.__version__} opens an unguarded port of its own, so no page is served")
            return server, loops[0]

        self.version: str = viser.__version__
        with ThreadPoolExecutor(1) as thread:
            self._server, self.loop = thread.submit(make).result()

        async def begin() -> asyncio.Task[None]:
            self._page = Page(self._server, history, controls, player)
            return asyncio.create_task(self._draw())

        self._drawing = asyncio.run_coroutine_threadsafe(begin(), self.loop).result()

    @property
    def watched(self) -> bool:
        """Whether a browser shows the page now."""
        return bool(self._server.get_clients())

    async def connect(self) -> socket.socket:
        """Open a connection to the server, from any event loop, and return the client's end."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(self.loop.connect(), self.loop))

    def end_drawing(self) -> None:
        """Stop drawing; the server still runs."""
        asyncio.run_coroutine_threadsafe(_ended(self._drawing), self.loop).result()

    def stop(self) -> None:
        """Stop the server, once its drawing has ended."""
        with _quiet():
            self._server.stop()

    async def _draw(self) -> None:
        """Draw until cancelled; the page handles errors in a drawing (`PagePainter`)."""
        due, frame, unseen_due = time.monotonic(), 0, 0.0
        while True:
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            now = time.monotonic()
            if not self.watched:
                due = now + IDLE_S
                if now >= unseen_due:
                    unseen_due = now + UNSEEN_S
                    self._page.draw(now, rest=True)
                continue
            self._page.draw(now, rest=frame % FRAMES_A_PLOT == 0)
            frame += 1
            due = max(due + self._frame_s, now - self._frame_s)  # one late frame is drawn afterwards, more are skipped


async def _ended(task: asyncio.Task[None]) -> None:
    """Cancel a task, and wait until it has ended."""
    task.cancel()
    await asyncio.wait((task,))


def yield_to_servos() -> None:
    """Give this thread, and the threads that it starts, a lower priority than a servo on the same cores."""
    if sys.platform == "linux":  # elsewhere it would be the whole process
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)


@contextmanager
def _quiet() -> Iterator[None]:
    """A context in which viser prints nothing on the terminal, for its start and stop."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
