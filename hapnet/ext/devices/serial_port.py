"""A serial port: it never blocks for longer than requested, and is opened again when it is plugged in again."""

from __future__ import annotations

import errno
import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.installing import install_command

if TYPE_CHECKING:
    from serial import Serial

_AGAIN_S = 0.1
_MOST_UNREAD = 4096
_ADAPTERS = Path("/sys/bus/usb-serial/devices")
_LONGEST_HELD_MS = 2


def missing() -> str:
    """Name the packages that a serial port needs and that are not installed; empty: none."""
    return f"pyserial: {install_command('pyserial')}" if find_spec("serial") is None else ""


def ports(is_one: Callable[[Any], bool]) -> tuple[str, ...]:
    """This machine's ports for which `is_one` is true, given pyserial's description."""
    if missing():
        return ()
    from serial.tools.list_ports import comports

    return tuple(sorted(port.device for port in comports() if is_one(port)))


class SerialPort:
    """The open port at `path`, in the low-latency mode of Linux if it has one.

    path : such as /dev/ttyACM0. baud : bits a second. adapters : the directory of USB adapters' latency timers.

    Raises InvalidParameter: it cannot be opened. HapnetError: its adapter delays bytes.
    """

    def __init__(self, path: str, baud: int, adapters: Path = _ADAPTERS) -> None:
        self.path: str = path
        self._baud, self._adapters = baud, adapters
        self._port: Serial | None = None
        self._next_try_s = 0.0
        self._open()

    def reopen(self, patience_s: float) -> bool:
        """Open the port again if it was unplugged; returns whether it was.

        Raises DeviceSilent: it is still unplugged, after a wait of at most `patience_s`.
        """
        if self._port is not None:
            return False
        now_s = time.monotonic()
        if now_s < self._next_try_s:
            time.sleep(min(patience_s, self._next_try_s - now_s))  # as the servo tries again and again
            raise DeviceSilent(f"{self.path} was disconnected")
        self._next_try_s = now_s + _AGAIN_S
        try:
            self._open()
        except InvalidParameter as error:
            raise DeviceSilent(f"{self.path} was disconnected") from error
        return True

    def read(self, seconds: float) -> bytes:
        """Return the bytes that come within `seconds`. Raises DeviceSilent: the port is unplugged."""
        if self._port is None or seconds <= 0.0:
            return b""
        try:
            readable, _, _ = select.select([self._port.fileno()], [], [], seconds)
            if not readable:
                return b""
            came = os.read(self._port.fileno(), _MOST_UNREAD)
        except (OSError, ValueError):
            came = b""
        if not came:
            self.close()
            raise DeviceSilent(f"{self.path} was disconnected")
        return came

    def write(self, data: bytes) -> None:
        """Send bytes now. Raises DeviceSilent: that is not possible, and they are dropped."""
        if self._port is None:
            raise DeviceSilent(f"{self.path} was disconnected")
        try:
            os.write(self._port.fileno(), data)
        except BlockingIOError:
            raise DeviceSilent(f"{self.path} accepts no commands") from None
        except OSError:
            self.close()
            raise DeviceSilent(f"{self.path} was disconnected") from None

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def remedy(self) -> str:
        """The remedy if bytes wait in the port's adapter, as text."""
        timer = self._timer()
        if timer.exists():
            return f"echo 1 | sudo tee {timer}"
        return "set the adapter's latency timer to 1 ms, or use a board with native USB"

    def _timer(self) -> Path:
        return self._adapters / Path(self.path).resolve().name / "latency_timer"

    def _open(self) -> None:
        from serial import Serial, SerialException

        try:
            self._port = Serial(self.path, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except (SerialException, OSError) as error:
            number = getattr(error, "errno", None)
            reason = "another program uses it" if number == errno.EAGAIN else os.strerror(number) if number else error
            raise InvalidParameter("port", self.path, f"a serial port that can be opened ({reason})") from None
        with suppress(ValueError, NotImplementedError):  # a port that has no such mode
            self._port.set_low_latency_mode(True)
        try:
            held_ms = int(self._timer().read_text("ascii"))
        except (OSError, ValueError):
            return  # no such adapter
        if held_ms > _LONGEST_HELD_MS:
            self.close()
            raise HapnetError(f"the adapter of {self.path} delays bytes by {held_ms} ms: {self.remedy()}")
