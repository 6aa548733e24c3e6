"""Frames between a servo's process and the process that owns its wire half, over a socket pair.

A frame is a msgpack array; its first element says what it is. To the servo: setup, pair, arrive, credit, stop. From
it: ready or refused, began, position, sample, note, failed, end. The socket keeps frames whole and in order
(SOCK_SEQPACKET).
"""

from __future__ import annotations

import socket
from typing import Any

import msgpack

LONGEST_FRAME = 1 << 17

_pack = msgpack.packb
_unpack = msgpack.unpackb


class PipeClosed(Exception):
    """The other process is gone."""


def available() -> bool:
    """Has this system the sockets that this takes?"""
    return hasattr(socket, "AF_UNIX") and hasattr(socket, "SOCK_SEQPACKET")


def socket_pair() -> tuple[socket.socket, socket.socket]:
    """Two connected ends."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


class Pipe:
    """One end. Neither `offer` nor `look` ever waits, so that a servo may call them."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def offer(self, *frame: Any) -> bool:
        """Send a frame; False if the other end has not read enough of the earlier ones, or either end is closed."""
        try:
            self._end.send(_pack(frame), socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True

    def look(self) -> Any | None:
        """The next frame, if there is one.

        Raises
        ------
        PipeClosed : the other process is gone.
        """
        try:
            return self._opened(self._end.recv(LONGEST_FRAME, socket.MSG_DONTWAIT))
        except BlockingIOError:
            return None
        except ConnectionError:
            raise PipeClosed from None

    def wait(self, timeout_s: float | None = None) -> Any | None:
        """The next frame; None if there was none for `timeout_s`. Raises `PipeClosed` too."""
        if timeout_s is not None:
            self._end.settimeout(timeout_s)
        try:
            return self._opened(self._end.recv(LONGEST_FRAME))
        except TimeoutError:
            return None
        except ConnectionError:
            raise PipeClosed from None
        finally:
            if timeout_s is not None:
                self._end.settimeout(None)  # with a timeout Python would wait in `offer` as well

    def close(self) -> None:
        self._end.close()

    @staticmethod
    def _opened(data: bytes) -> Any:
        if not data:
            raise PipeClosed
        return _unpack(data, use_list=False, strict_map_key=False)
