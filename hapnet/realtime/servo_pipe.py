"""Frames between a servo's process and the process that owns its wire half, over a socket pair.

A frame is a msgpack array; its first element is its kind. To the servo: setup, place, pair, arrive, credit, beat,
pause, lead. From it: ready or refused, began, position, samples, posture, note, failed, end. The socket keeps frames
whole and in order (SOCK_SEQPACKET). To stop the servo, its parent closes the direction to it (`hang_up`). This works
even if the pipe is full, and the servo detects it in the same way as a parent that has died.
"""

from __future__ import annotations

import select
import socket
from contextlib import suppress
from typing import Any

import msgpack

from hapnet.control.coupling import CouplingSample, MotionSample, PortSample, PositionSample, ProxySample, WaveSample
from hapnet.mechanics.plane import Plane

MAX_FRAME = 1 << 17
_TO_SERVO, _FROM_SERVO = 1 << 16, 1 << 21
"""Buffer sizes; a frame takes some 800 bytes. Frames that wait for a servo are soon out of date. Frames from it are
kept, even while its parent is stopped for some seconds."""

_KINDS: tuple[Any, ...] = (tuple, MotionSample, PortSample, WaveSample, ProxySample, PositionSample)

_DONT_WAIT: int = getattr(socket, "MSG_DONTWAIT", 0)
_FAMILY: int = getattr(socket, "AF_UNIX", -1)  # not on Windows: see `available`
_poll: Any = getattr(select, "poll", None)
_POLLIN: int = getattr(select, "POLLIN", 0)

_pack = msgpack.packb
_unpack = msgpack.unpackb


def kind_of(sample: CouplingSample) -> int:
    """The number that is sent through the pipe with a sample, since msgpack does not keep a named tuple's type."""
    kind: int = _KINDS.index(type(sample))
    return kind


def sample_of(kind: int, values: tuple[Any, ...]) -> CouplingSample:
    """The sample of this kind that came through a pipe."""
    sample: CouplingSample = _KINDS[kind](*values) if kind else values
    if isinstance(sample, ProxySample) and sample.planes is not None:
        return sample._replace(planes=tuple([Plane(*plane) for plane in sample.planes]))
    return sample


class PipeClosed(Exception):
    """The other process has ended, or has hung up."""


def available() -> bool:
    """Whether this system has the sockets that a pipe needs. macOS has the constants, but not the sockets."""
    try:
        pair = socket_pair()
    except (AttributeError, OSError, ValueError):
        return False
    for end in pair:
        end.close()
    return True


def socket_pair() -> tuple[socket.socket, socket.socket]:
    """Two connected ends: the parent's and the servo's."""
    ours, theirs = socket.socketpair(_FAMILY, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _TO_SERVO)
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _FROM_SERVO)
    return ours, theirs


class Pipe:
    """One end of the pipe. `offer` and `look` never wait, so a servo may call them."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def offer(self, *frame: Any) -> bool:
        """Send a frame; False if the other end has not read enough of the earlier ones, or either end is closed."""
        try:
            self._end.send(_pack(frame), _DONT_WAIT)
        except OSError:
            return False
        return True

    def send(self, timeout_s: float, *frame: Any) -> bool:
        """Send a frame and wait for room. Only for a single thread that calls neither `look` nor `wait` meanwhile."""
        self._end.settimeout(timeout_s)
        try:
            self._end.send(_pack(frame))
        except OSError:
            return False
        finally:
            self._end.settimeout(None)
        return True

    def look(self) -> Any | None:
        """Return the next frame, if there is one. Raises PipeClosed: no more frames will come."""
        try:
            return self._opened(self._end.recv(MAX_FRAME, _DONT_WAIT))
        except BlockingIOError:
            return None
        except ConnectionError:
            raise PipeClosed from None

    def wait(self, timeout_s: float | None = None) -> Any | None:
        """Return the next frame; None if none came within `timeout_s`. Raises `PipeClosed` as `look` does."""
        try:
            if timeout_s is not None:  # not the socket's own timeout, with which `offer` would wait as well
                ready = _poll()
                ready.register(self._end, _POLLIN)
                if not ready.poll(timeout_s * 1e3):
                    return None
            return self._opened(self._end.recv(MAX_FRAME))
        except OSError:
            raise PipeClosed from None

    def hang_up(self) -> None:
        """Close the direction to the other end, which can still be read."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self._end.close()

    @staticmethod
    def _opened(data: bytes) -> Any:
        if not data:
            raise PipeClosed
        return _unpack(data, use_list=False, strict_map_key=False)
