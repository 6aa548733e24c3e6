"""Serves the page: a viser server, and on its event loop the page, which is created and drawn there.

viser's handles may be used from any thread, but each change wakes its loop's tasks at once, and waking tasks while the
loop itself changes their list raises. This cannot happen on the loop itself, so the page's callbacks are coroutines.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING

import rich

from hapnet.errors import HapnetError, InvalidParameter, MissingLibrary
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

PORTS = 100
"""How many ports are tried, from the given port on."""


class PageServer:
    """The page at `url`, until `close`. See `serve`."""

    def __init__(
        self,
        history: History,
        controls: Controls | None,
        player: Playback | None,
        host: str,
        port: int,
        frame_s: float,
        token: str,
    ) -> None:
        self._frame_s = frame_s
        self._closed = False
        # a client that connects and sends nothing, such as a port scan, would print a traceback to standard error
        logging.getLogger("websockets").addHandler(logging.NullHandler())
        try:
            import viser

            from hapnet.ext.page.gate import ANY_HOST, Gate, new_token
            from hapnet.ext.page.page import Page
        except ImportError as error:
            raise MissingLibrary("the live page", error.name or "viser", "view") from None

        class Server(viser.ViserServer):
            def request_share_url(self, verbose: bool = True) -> str | None:
                """Refuse, as otherwise any open page could request a tunnel to a public server."""
                return None

        def make() -> tuple[ViserServer, InnerLoop]:
            _yield_to_servos()  # the server's own threads inherit it
            with _quiet(), inner_loops() as loops:
                server = Server("127.0.0.1", 0, label="hapnet", verbose=False)
            if len(loops) != 1 or loops[0].inner is None:
                server.stop()
                raise HapnetError(f"viser {viser.__version__} opens an unguarded port of its own, so no page is served")
            return server, loops[0]

        self.port: int = _free_port(host, port)
        with ThreadPoolExecutor(1) as thread:
            self._server, self._loop = thread.submit(make).result()
        token = token or new_token()
        self._gate = Gate(self._loop.connect, token, host, viser.__version__)
        asyncio.run_coroutine_threadsafe(self._gate.open(self.port), self._loop).result()
        shown = {"::": "::1"}.get(host, "127.0.0.1") if host in ANY_HOST else host
        self.url: str = f"http://{f'[{shown}]' if ':' in shown else shown}:{self.port}/{token}/"

        async def begin() -> asyncio.Task[None]:
            self._page = Page(self._server, history, controls, player)
            return asyncio.create_task(self._draw())

        self._drawing = asyncio.run_coroutine_threadsafe(begin(), self._loop).result()

    @property
    def watched(self) -> bool:
        """Whether a browser shows the page now."""
        return bool(self._server.get_clients())

    @property
    def refused(self) -> int:
        """How many requests and messages were refused."""
        return self._gate.refused

    def close(self) -> None:
        """Stop drawing and serving; calling it twice does no harm."""
        if self._closed:
            return
        self._closed = True
        asyncio.run_coroutine_threadsafe(_ended(self._drawing), self._loop).result()
        asyncio.run_coroutine_threadsafe(self._gate.close(), self._loop).result()
        with _quiet():
            self._server.stop()

    def __enter__(self) -> PageServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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


def serve(
    history: History,
    controls: Controls | None = None,
    *,
    player: Playback | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    frame_s: float = FRAME_S,
    token: str = "",
) -> PageServer:
    """Serve the page that shows `history`, from threads of its own, until the server is closed.

    controls : receives the user's changes; None: the page only watches. player : plays a recording, if there is one.
    host : the address to listen on; by default only this machine reaches it. Everybody who has the page's `url` may
        press every button, and nobody else: see gate.py.
    port : if it is taken, the next free one is used; 0: any.
    frame_s : time between two pictures of the scene [s]. token : the end of the address; "": a new token.

    Raises MissingLibrary: viser is not installed. InvalidParameter: this machine has no such address, or no free port.
    """
    return PageServer(history, controls, player, host, port, frame_s, token)


def _free_port(host: str, port: int) -> int:
    """The first free port from `port` on. viser would search by itself, but hangs if there is none."""
    if not 0 <= port <= 65535:
        raise InvalidParameter("port", port, "0 to 65535")
    for candidate in range(port, min(port + PORTS, 65536)):
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return int(probe.getsockname()[1])
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise InvalidParameter("host", host, f"an address of this machine ({error.strerror})") from None
    raise InvalidParameter("port", port, f"a port with a free one among the next {PORTS}")


async def _ended(task: asyncio.Task[None]) -> None:
    """Cancel a task, and wait until it has ended."""
    task.cancel()
    await asyncio.wait((task,))


def _yield_to_servos() -> None:
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
