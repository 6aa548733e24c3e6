"""Serves the page of one pair: the page on its viser server, behind a gate on the same event loop."""

from __future__ import annotations

import asyncio
import errno
import socket
from types import TracebackType
from typing import TYPE_CHECKING

from hapnet.errors import InvalidParameter
from hapnet.ext.page.controls import Controls
from hapnet.ext.page.entrance import OnePage
from hapnet.ext.page.history import History
from hapnet.ext.page.viser_page import FRAME_S, ViserPage

if TYPE_CHECKING:
    from hapnet.ext.page.playback import Playback

_ANY_HOST = ("", "0.0.0.0", "::")

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
        self._closed = False
        self.port: int = free_port(host, port)
        self._page = ViserPage(history, controls, player, frame_s)

        from hapnet.ext.page.gate import Gate, new_token

        token = token or new_token()
        self._gate = Gate(OnePage(self._page.connect), token, host, self._page.version)
        asyncio.run_coroutine_threadsafe(self._gate.open(self.port), self._page.loop).result()
        self.url: str = url_of(host, self.port, token)

    @property
    def watched(self) -> bool:
        """Whether a browser shows the page now."""
        return self._page.watched

    @property
    def refused(self) -> int:
        """How many requests and messages were refused."""
        return self._gate.refused

    def close(self) -> None:
        """Stop drawing and serving; calling it twice does no harm."""
        if self._closed:
            return
        self._closed = True
        self._page.end_drawing()
        asyncio.run_coroutine_threadsafe(self._gate.close(), self._page.loop).result()
        self._page.stop()

    def __enter__(self) -> PageServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


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


def url_of(host: str, port: int, token: str) -> str:
    """The address at which this machine opens a page."""
    shown = {"::": "::1"}.get(host, "127.0.0.1") if host in _ANY_HOST else host
    return f"http://{f'[{shown}]' if ':' in shown else shown}:{port}/{token}/"


def free_port(host: str, port: int) -> int:
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
