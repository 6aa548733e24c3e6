"""Serves the page: one viser server, and one thread that draws."""

from __future__ import annotations

import errno
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

import rich

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.view.controls import Controls
from hapnet.view.history import History

FRAME_S = 1.0 / 30.0
FRAMES_A_PLOT = 8
"""Plots, numbers and controls are drawn at some 4 Hz: for a browser without a GPU they are the most work."""

IDLE_S = 0.1
"""How often to check for a browser while there is none [s]."""

PORTS = 100
"""How many ports are tried, from the one asked for."""


class PageServer:
    """The page at `url`, until `close`. See `serve`."""

    def __init__(self, history: History, controls: Controls | None, host: str, port: int) -> None:
        try:
            import viser

            from hapnet.view.page import Page
        except ImportError as error:
            raise MissingLibrary("the live page", error.name or "viser", "view") from None

        class Server(viser.ViserServer):
            def request_share_url(self, verbose: bool = True) -> str | None:
                """Refuse: otherwise any open page could ask for a tunnel to a public server."""
                return None

        with _quiet():
            self._server = Server(host, _free_port(host, port), label="hapnet", verbose=False)
        self.port = self._server.get_port()
        shown = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(host, host)
        self.url = f"http://[{shown}]:{self.port}" if ":" in shown else f"http://{shown}:{self.port}"
        self._page = Page(self._server, history, controls)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="hapnet-page", daemon=True)
        self._thread.start()

    @property
    def watched(self) -> bool:
        """Does a browser show the page now?"""
        return bool(self._server.get_clients())

    def close(self) -> None:
        """Stop drawing and serving; calling it twice does no harm."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._thread.join()
        with _quiet():
            self._server.stop()

    def __enter__(self) -> PageServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _draw(self) -> None:
        due, frame = time.monotonic(), 0
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            now = time.monotonic()
            if not self.watched:
                due = now + IDLE_S
                continue
            self._page.draw_scene(now)
            if frame % FRAMES_A_PLOT == 0:
                self._page.draw_rest(now)
            frame += 1
            due = max(due + FRAME_S, now)  # a late frame is skipped


def serve(
    history: History, controls: Controls | None = None, *, host: str = "127.0.0.1", port: int = 8080
) -> PageServer:
    """Serve the page that shows `history`, from threads of its own, until the server is closed.

    Parameters
    ----------
    controls : what the page may change; None: it only watches.
    host : the address to listen on; by default only this machine reaches it. Anybody who reaches it may press every
        button.
    port : if it is taken, the next free one is used; 0: any.

    Raises
    ------
    MissingLibrary : viser is not installed.
    InvalidParameter : there is no such address here, or no port is free.
    """
    return PageServer(history, controls, host, port)


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
    raise InvalidParameter("port", port, f"a port such that one of the {PORTS} from it on is free")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress what viser prints on the terminal when it starts and stops."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
