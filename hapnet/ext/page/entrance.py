"""The way from the gate to a viser server: of a single page, or of one of several (`hapnet.ext.page.seating`)."""

from __future__ import annotations

import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from http import HTTPStatus
from typing import NamedTuple, Protocol
from urllib.parse import parse_qs

Inner = Callable[[], Awaitable[socket.socket]]
"""Opens a new connection to viser."""


class Visit(NamedTuple):
    """A permitted request. path : behind the token, without the query. name : of the query. cookie : the header."""

    path: str
    name: str
    cookie: str

    @classmethod
    def of(cls, path: str, cookies: Sequence[str]) -> Visit:
        """A request to this path, the token and the query included, with these headers."""
        path, _, query = path.partition("?")
        name = parse_qs(query).get("name", [""])[0]
        return cls(path.partition("/")[2].partition("/")[2], name, ";".join(cookies))


class Answered(NamedTuple):
    """An answer without a file of viser's: a sentence, or with `location` where to go on, a path behind the token."""

    status: HTTPStatus
    text: str
    location: str = ""


class Entrance(Protocol):
    """Decides which of several viser servers a browser gets; the gate calls it on its event loop."""

    async def file(self, visit: Visit) -> tuple[Inner, str, str] | Answered:
        """Where a file comes from, its path there, and a cookie to set (empty: none)."""

    def refusal(self, visit: Visit) -> str:
        """Why no WebSocket is opened there; empty: it is."""

    def room(self, visit: Visit) -> AbstractAsyncContextManager[Inner]:
        """A context for as long as a browser's WebSocket is open."""


class OnePage(Entrance):
    """The entrance of a single page."""

    def __init__(self, inner: Inner) -> None:
        self._inner = inner

    async def file(self, visit: Visit) -> tuple[Inner, str, str] | Answered:
        return self._inner, visit.path, ""

    def refusal(self, visit: Visit) -> str:
        return ""

    @asynccontextmanager
    async def room(self, visit: Visit) -> AsyncIterator[Inner]:
        yield self._inner
