"""A serial port as lines: it never blocks for longer than it is told, and is opened again when it comes back."""

from __future__ import annotations

import os
import select
import time
from typing import TYPE_CHECKING

from hapnet.errors import DeviceSilent, InvalidParameter

if TYPE_CHECKING:
    from serial import Serial

_AGAIN_S = 0.1
_MOST_UNREAD = 4096


class SerialPort:
    """The port at `path`, open.

    path : such as /dev/ttyACM0. baud : bits a second.

    Raises
    ------
    InvalidParameter : it cannot be opened.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path: str = path
        self._baud = baud
        self._port: Serial | None = None
        self._unread = b""
        self._next_try_s = 0.0
        self._open()

    def reopen(self, patience_s: float) -> bool:
        """Open the port again if it has gone; returns whether it had.

        Raises
        ------
        DeviceSilent : it is still gone; at most `patience_s` were waited.
        """
        if self._port is not None:
            return False
        now_s = time.monotonic()
        if now_s < self._next_try_s:
            time.sleep(min(patience_s, self._next_try_s - now_s))  # the servo asks again and again
            raise DeviceSilent(f"{self.path} has gone")
        self._next_try_s = now_s + _AGAIN_S
        try:
            self._open()
        except InvalidParameter as error:
            raise DeviceSilent(f"{self.path} has gone") from error
        return True

    def lines(self, seconds: float) -> list[bytes]:
        """The whole lines that have come, without their newlines, waiting for bytes as long as `seconds`.

        Raises
        ------
        DeviceSilent : the port has gone.
        """
        if self._port is None or seconds <= 0.0:
            return []
        try:
            readable, _, _ = select.select([self._port.fileno()], [], [], seconds)
            if not readable:
                return []
            came = os.read(self._port.fileno(), _MOST_UNREAD)
        except (OSError, ValueError):
            came = b""
        if not came:
            self.close()
            raise DeviceSilent(f"{self.path} has gone")
        *lines, self._unread = (self._unread + came).split(b"\n")
        self._unread = self._unread[-_MOST_UNREAD:]
        return lines

    def write(self, data: bytes) -> None:
        """Send bytes now, or not at all. Raises DeviceSilent if that is not possible."""
        if self._port is None:
            raise DeviceSilent(f"{self.path} has gone")
        try:
            os.write(self._port.fileno(), data)
        except BlockingIOError:
            raise DeviceSilent(f"{self.path} takes no commands") from None
        except OSError:
            self.close()
            raise DeviceSilent(f"{self.path} has gone") from None

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _open(self) -> None:
        from serial import Serial, SerialException

        try:
            self._port = Serial(self.path, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except (SerialException, OSError) as error:
            number = getattr(error, "errno", None)
            reason = error if number is None else os.strerror(number)
            raise InvalidParameter("port", self.path, f"a serial port that can be opened ({reason})") from None
        self._unread = b""
