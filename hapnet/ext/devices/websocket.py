"""One end of a WebSocket that never waits for longer than requested.

It uses the protocol part of the `websockets` library, without input and output, and its own socket. So a servo gets its
message without a second thread, which the library's synchronous client would need.
"""

from __future__ import annotations

import select
import socket
import time
from contextlib import suppress
from typing import Any

from websockets.client import ClientProtocol
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.uri import parse_uri

from hapnet.errors import DeviceSilent, InvalidParameter

_AGAIN_S = 0.1
_MOST_READ = 65536
_MOST_MESSAGE = 2**20
_DATA = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)


class Gone(ConnectionError):
    """The connection has ended, or its bytes are no WebSocket."""


def dial(family: int, where: tuple[Any, ...]) -> WebSocket:
    """Begin to connect to the socket address `where`; `receive` completes it. Raises Gone: it is refused."""
    host = f"[{where[0]}]" if ":" in where[0] else where[0]
    protocol = ClientProtocol(parse_uri(f"ws://{host}:{where[1]}"), max_size=_MOST_MESSAGE)
    protocol.send_request(protocol.connect())
    connection = socket.socket(family, socket.SOCK_STREAM)
    connection.setblocking(False)
    try:
        connection.connect(where)
    except BlockingIOError:
        pass  # the connection completes later
    except OSError as error:
        connection.close()
        raise Gone(error.strerror) from error
    return WebSocket(connection, protocol)


def answer(connection: socket.socket) -> WebSocket:
    """The server's end of a new connection. A browser, which sends an origin, is refused."""
    connection.setblocking(False)
    return WebSocket(connection, ServerProtocol(origins=[None], max_size=_MOST_MESSAGE))


class Caller:
    """A client's WebSocket that reconnects whenever the connection is lost.

    host, port : of the service.

    Raises InvalidParameter: there is no such host.
    """

    def __init__(self, host: str, port: int) -> None:
        self.url: str = f"ws://{host}:{port}"
        try:
            known = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise InvalidParameter("address", f"{host}:{port}", f"a known host ({error.strerror})") from error
        self._known = [(family, where) for family, _, _, _, where in known]
        self._which = 0
        self._answered = True
        self._socket: WebSocket | None = None
        self._next_try_s = 0.0
        self.calls: int = 0
        """The number of attempts to connect."""

    @property
    def is_open(self) -> bool:
        """Whether a message can be sent."""
        return self._socket is not None and self._socket.is_open

    def receive(self, seconds: float) -> list[bytes]:
        """The messages that have come, waiting at most `seconds`; connects first if necessary.

        Raises DeviceSilent: the service is not connected.
        """
        if not self.is_open and (now_s := time.monotonic()) >= self._next_try_s:
            if self._socket is not None:
                self._lose()
            self._next_try_s = now_s + _AGAIN_S
            self._dial()
        if self._socket is None:
            raise DeviceSilent(f"nothing answers at {self.url}")
        try:
            messages = self._socket.receive(seconds)
            self._answered |= self._socket.is_open
            return messages
        except Gone as error:
            self._lose()
            raise DeviceSilent(f"the service at {self.url} closed the connection") from error

    def send(self, message: bytes) -> None:
        """Send a text. Raises DeviceSilent."""
        if self._socket is None:
            raise DeviceSilent(f"the service at {self.url} closed the connection")
        try:
            self._socket.send(message)
        except Gone as error:
            self._lose()
            raise DeviceSilent(f"the service at {self.url} closed the connection") from error

    def close(self) -> None:
        """Close the connection; `receive` connects again."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _dial(self) -> None:
        family, where = self._known[self._which]
        self._answered = False
        self.calls += 1
        try:
            self._socket = dial(family, where)
        except Gone:
            self._lose()

    def _lose(self) -> None:
        """Close the connection. If the host has several addresses and there was no answer, try the next one."""
        self.close()
        if not self._answered:
            self._which = (self._which + 1) % len(self._known)
            if self._which:
                self._next_try_s = 0.0  # try the next address at once, until all were tried


class WebSocket:
    """A connection whose bytes `protocol` reads and writes; see `dial` and `answer`."""

    def __init__(self, connection: socket.socket, protocol: ClientProtocol | ServerProtocol) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection, self._protocol = connection, protocol
        self._unsent = b""
        self._begun = b""  # the first frames of a message

    def fileno(self) -> int:
        return self._connection.fileno()

    @property
    def is_open(self) -> bool:
        """Whether the handshake is complete, and no end has begun to close."""
        return self._protocol.state is State.OPEN

    def send(self, message: bytes) -> None:
        """Send a text now, or as soon as the other end takes it. Raises Gone."""
        if not self.is_open:
            raise Gone("the connection is not open")
        self._protocol.send_text(message)
        self._flush()

    def receive(self, seconds: float) -> list[bytes]:
        """The messages that have come. If there are none, wait at most `seconds` for the next bytes.

        Raises Gone: the connection has ended.
        """
        if seconds > 0.0:
            self._collect()
            select.select([self._connection], [self._connection] if self._unsent else [], [], seconds)
        self._flush()
        try:
            came = self._connection.recv(_MOST_READ)
        except BlockingIOError:
            return []
        except OSError as error:
            raise Gone(error.strerror) from error
        if came:
            self._protocol.receive_data(came)
        else:
            self._protocol.receive_eof()
        messages = self._messages()
        with suppress(Gone):
            self._flush()
        if not messages and (not came or self._protocol.close_expected()):
            raise Gone("the other end has closed the connection")
        return messages

    def close(self) -> None:
        """Send a close frame, if that is possible now, and close the connection."""
        with suppress(Gone):
            if self.is_open:
                self._protocol.send_close(1000)
                self._flush()
        self._connection.close()

    def _messages(self) -> list[bytes]:
        found = []
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                if event.opcode in _DATA:
                    self._begun += event.data
                    if event.fin:
                        found.append(self._begun)
                        self._begun = b""
            elif isinstance(event, Request) and isinstance(self._protocol, ServerProtocol):
                self._protocol.send_response(self._protocol.accept(event))
        return found

    def _collect(self) -> None:
        self._unsent += b"".join(self._protocol.data_to_send())

    def _flush(self) -> None:
        self._collect()
        if not self._unsent:
            return
        try:
            self._unsent = self._unsent[self._connection.send(self._unsent) :]
        except BlockingIOError:
            return
        except OSError as error:
            raise Gone(error.strerror) from error
