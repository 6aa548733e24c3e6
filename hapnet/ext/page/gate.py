"""Guards the page: only requests with its address, from the page itself, by a name of this machine, are answered.

The address ends in a token, which is new at each start. A browser sends which page a request comes from (`Origin`)
and which name it looked up (`Host`): a foreign page, or a foreign DNS name that points here, is refused even
with the token. Each message from a page is checked (offered.py) before it is passed on to viser.
"""

from __future__ import annotations

import asyncio
import hmac
import html
import ipaddress
import secrets
import socket
from collections.abc import Mapping
from contextlib import suppress
from http import HTTPStatus
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from hapnet.ext.page.entrance import Answered, Entrance, Visit
from hapnet.ext.page.offered import Offered

LARGEST_MESSAGE = 1 << 20
"""A larger message from a page is refused [bytes]; a file comes in parts of half this size."""

_ADDRESS = "open the whole address that hapnet printed at its start, with the part behind the port"


class Gate:
    """Forwards permitted requests and messages between browsers and viser, on the event loop that opens it.

    entrance : to the viser servers. token : the first part of each path. host : the address to listen on.
    version : of viser; a page of another version is refused.
    """

    def __init__(self, entrance: Entrance, token: str, host: str, version: str) -> None:
        self._entrance, self._token, self._host = entrance, token.encode(), host
        self._subprotocol = Subprotocol(f"viser-v{version}")
        self._server: Server | None = None
        self.refused: int = 0

    async def open(self, port: int) -> None:
        """Listen on this port. Raises OSError: this is not possible."""
        self._server = await serve(
            self._forward, self._host, port, process_request=self._answer, subprotocols=[self._subprotocol],
            compression=None, max_size=LARGEST_MESSAGE, server_header=None,
        )  # fmt: skip

    async def close(self) -> None:
        """Stop listening, and end all connections."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The answer to a request; None: a permitted page opens its WebSocket."""
        wants_socket = "websocket" in request.headers.get("Upgrade", "").lower()
        problem = self._problem(request, wants_socket)
        if wants_socket and not problem:
            problem = self._entrance.refusal(_visit(request))
        if problem:
            self.refused += 1
            return connection.respond(HTTPStatus.FORBIDDEN, f"refused: {problem}\n")
        return None if wants_socket else await self._file(request)

    def _problem(self, request: Request, wants_socket: bool) -> str:
        """The reason why this request is refused; empty: it is permitted."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not names_this_machine(hosts[0], self._host):
            return f"Host is {', '.join(hosts) or 'missing'}, which is no name of this machine"
        if len(origins) > 1 or ((origins or wants_socket) and not is_same_origin("".join(origins), hosts[0])):
            return f"Origin is {', '.join(origins) or 'missing'}, which is not this page"
        given = request.path.partition("?")[0].split("/")[1:2]
        if not hmac.compare_digest("".join(given).encode(errors="replace"), self._token):
            return _ADDRESS
        if wants_socket and self._subprotocol not in request.headers.get("Sec-WebSocket-Protocol", ""):
            return "this page is from another version of viser: reload it"
        return ""

    async def _file(self, request: Request) -> Response:
        """A file of the page, from viser, or the entrance's own answer."""
        found = await self._entrance.file(_visit(request))
        if isinstance(found, Answered):
            return self._answered(found)
        inner, path, cookie = found
        coding = "gzip" if "gzip" in request.headers.get("Accept-Encoding", "") else "identity"
        reader, writer = await asyncio.open_connection(sock=await inner())
        try:
            wanted = f"GET /{path} HTTP/1.1\r\nHost: viser\r\nAccept-Encoding: {coding}\r\n\r\n"
            writer.write(wanted.encode(errors="replace"))
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
            body = await reader.read()
        finally:
            writer.close()
        fields = dict(line.split(": ", 1) for line in head[1:] if ": " in line)
        kept: dict[str, str] = {name: fields[name] for name in ("Content-Type", "Content-Encoding") if name in fields}
        if cookie:
            kept["Set-Cookie"] = cookie
        return _response(HTTPStatus(int(head[0].split(" ")[1])), kept, body)

    def _answered(self, found: Answered) -> Response:
        fields = {"Content-Type": "text/html; charset=utf-8"}
        if found.location:
            fields["Location"] = f"/{self._token.decode()}/{found.location}"
        return _response(found.status, fields, _SENTENCE.format(html.escape(found.text)).encode())

    async def _forward(self, browser: ServerConnection) -> None:
        """Forward all messages from viser, and the permitted messages from the page."""
        offered = Offered()
        assert browser.request is not None
        async with self._entrance.room(_visit(browser.request)) as inner, connect(
            "ws://viser/", sock=await inner(), subprotocols=[self._subprotocol], compression=None, max_size=None,
            ping_interval=None, user_agent_header=None,
        ) as viser:  # fmt: skip
            tasks = [
                asyncio.create_task(_to_page(viser, browser, offered)),
                asyncio.create_task(self._to_viser(browser, viser, offered)),
            ]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _to_viser(self, browser: ServerConnection, viser: ClientConnection, offered: Offered) -> None:
        with suppress(ConnectionClosed):
            async for message in browser:
                if (checked := offered.checked(message)) is None:
                    self.refused += 1
                else:
                    await viser.send(checked)


async def _to_page(viser: ClientConnection, browser: ServerConnection, offered: Offered) -> None:
    with suppress(ConnectionClosed):
        async for frame in viser:
            assert isinstance(frame, bytes)
            offered.learn(frame)
            await browser.send(frame)


def _visit(request: Request) -> Visit:
    return Visit.of(request.path, request.headers.get_all("Cookie"))


def _response(status: HTTPStatus, fields: Mapping[str, str], body: bytes) -> Response:
    headers = Headers(
        **fields, **{"Content-Length": str(len(body)), "Connection": "close", "Cache-Control": "no-store",
        "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY", "X-Content-Type-Options": "nosniff"},
    )  # fmt: skip
    return Response(status.value, status.phrase, headers, body)


_SENTENCE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>hapnet</title></head>
<body style="font:18px/1.5 system-ui,sans-serif;max-width:36em;margin:20vh auto;padding:0 1em"><p>{}</p></body></html>
"""
"""A page with a sentence, in place of the page that cannot be had."""


def new_token() -> str:
    """128 random bits, as text for an address."""
    return secrets.token_urlsafe(16)


def names_this_machine(header: str, host: str) -> bool:
    """Whether this `Host` header is an address, this machine's name, or the name of the listening address.

    host : the listening address. If only this machine can reach it, outside addresses are refused too.
    Names that a foreign DNS could point here are refused.
    """
    try:
        name = (urlsplit(f"//{header}").hostname or "").rstrip(".")
    except ValueError:
        return False
    if name in ("localhost", host.lower()) and name:
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return not is_local(host) and name in (own, own.partition(".")[0], f"{own.partition('.')[0]}.local")
    return address.is_loopback or not is_local(host)


def is_local(host: str) -> bool:
    """Whether only this machine can reach a listener on this address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_same_origin(origin: str, host: str) -> bool:
    """Whether this `Origin` is the page that was loaded from `host`, also through a tunnel or behind TLS."""
    scheme, separator, where = origin.partition("://")
    return bool(separator) and scheme in ("http", "https") and where.lower() == host.lower()
