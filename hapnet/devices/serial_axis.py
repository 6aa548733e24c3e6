"""A home-made axis on a serial port, such as a Hapkit or a SimpleFOC knob. Its page is serial_axis.md beside it.

The device sends its state once a period, and so sets the servo's pace. Each state holds the impulse of the actuator
since its start. So the mean force between two readings is known exactly, whatever was lost between them, and however
long a command was on its way: the account counts that force.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib.util import find_spec

from hapnet.checks import Vector
from hapnet.devices import serial_line as wire
from hapnet.devices.driver import Driver
from hapnet.devices.serial_port import SerialPort
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter, MissingLibrary

_ANSWER_S = 2.0
"""An Arduino starts anew when its port is opened, which takes a second or two."""

_TRIES = 20
_MAX_MEAN_US = 500_000
"""The impulse of a longer time may have wrapped more than once."""


class SerialAxis(Driver):
    """One axis, made with its port: ``serial:/dev/ttyACM0``.

    port : of the axis. baud : bits a second (USB ignores it). home : count positions from where the handle is now.

    Raises
    ------
    InvalidParameter : not one axis, or there is no such port. MissingLibrary : pyserial is not installed.
    HapnetError : nothing that speaks this protocol answers there.
    """

    about = "a home-made axis on a serial port (Hapkit, SimpleFOC, Arduino)"
    tested = "emulator-tested"
    udev = 'SUBSYSTEM=="tty", KERNEL=="ttyACM*|ttyUSB*", TAG+="uaccess"'
    emulator = "hapnet.devices.serial_emulator:SerialEmulator"
    rate_hz: float = 1000.0
    blocking = True

    def __init__(self, dof: int, port: str = "", baud: int = 1_000_000, home: bool = False) -> None:
        if dof != 1:
            raise InvalidParameter("dof", dof, "1: the serial axis has one")
        if not port:
            raise InvalidParameter("port", port, "the axis's serial port, such as serial:/dev/ttyACM0")
        if self.missing():
            raise MissingLibrary("the serial axis", "pyserial", "serial")
        self.dof = 1
        self._asked_home = home
        self._port = SerialPort(port, baud)
        self._last: wire.State | None = None
        self._acted: Vector | None = None
        self._interval: float | None = None
        self._sequence = 0
        self.damaged: int = 0
        """How many lines were dropped, because they were damaged or too old to be used."""
        described = self._ask()
        if described.version != 1:
            self.close()
            raise HapnetError(f"the axis at {port} speaks version {described.version} of the protocol, not 1")
        self.rate_hz = float(described.rate_hz)
        self.force_limit: float = described.limit_mN * 1e-3
        self.continuous_force: float | None = described.continuous_mN * 1e-3 or None
        self.resolution: float = described.resolution_nm * 1e-9
        self.workspace: float = described.reach_um * 1e-6
        self.watchdog_s: float | None = described.watchdog_ms * 1e-3 or None
        self.dead_man: int | None = None if described.dead_man < 0 else described.dead_man
        self._homed, self._buttons = bool(described.homed), described.buttons
        self._patience_s = 2.0 / self.rate_hz

    @classmethod
    def missing(cls) -> str:
        return "pyserial, of the extra `serial`" if find_spec("serial") is None else ""

    @classmethod
    def found(cls) -> Sequence[str]:
        if cls.missing():
            return ()
        from serial.tools.list_ports import comports

        return tuple(sorted(port.device for port in comports() if port.vid is not None))

    def home(self) -> None:
        if self._asked_home:
            self._port.write(wire.line("H"))
            self._homed = bool(self._ask().homed)
        if not self._homed:
            raise HapnetError(
                f"the axis is not calibrated: centre its handle, and use serial:{self._port.path},home=yes"
            )

    def read(self) -> tuple[Vector, Vector]:
        """Wait for the next state; of several that wait already take the last.

        Raises
        ------
        DeviceSilent : no whole state came within two periods, or the port has gone.
        """
        if self._port.reopen(self._patience_s):
            self._last = None
        until = time.monotonic() + self._patience_s
        newest = None
        while newest is None:
            if (left := until - time.monotonic()) <= 0.0:
                raise DeviceSilent(f"no whole state for {self._patience_s * 1e3:g} ms at {self._port.path}")
            for raw in self._port.lines(left):
                found = wire.state(raw)
                self.damaged += found is None or newest is not None
                newest = found or newest
        elapsed_us = self._since_last(newest)
        self._acted = None if elapsed_us is None else self._mean_force(newest, elapsed_us)
        self._interval = None if elapsed_us is None else elapsed_us * 1e-6
        self._last = newest
        return (newest.position_nm * 1e-9,), (newest.velocity_um_s * 1e-6,)

    def acted(self) -> Vector | None:
        """The mean force between the last two readings [N]; None: not known."""
        return self._acted

    def interval(self) -> float | None:
        """The time between the last two readings by the board's clock [s]; None: not known."""
        return self._interval

    def apply(self, force: Vector) -> None:
        """Send the force; the device reports later when it acted."""
        self._sequence = (self._sequence + 1) % 2**16
        self._port.write(wire.line("F", self._sequence, round(force[0] * 1e6)))

    def buttons(self) -> tuple[bool, ...]:
        pressed = 0 if self._last is None else self._last.buttons
        return tuple(bool(pressed >> k & 1) for k in range(self._buttons))

    def close(self) -> None:
        self._port.close()

    def _since_last(self, newest: wire.State) -> int | None:
        """The board's time since the last reading [us]; None: there is none, or the impulse may have wrapped."""
        if self._last is None:
            return None
        elapsed_us = (newest.time_us - self._last.time_us) % wire.WRAP
        return elapsed_us if 0 < elapsed_us <= _MAX_MEAN_US else None

    def _mean_force(self, newest: wire.State, elapsed_us: int) -> Vector:
        assert self._last is not None
        return (wire.signed(newest.impulse_nNs - self._last.impulse_nNs) / elapsed_us * 1e-3,)

    def _ask(self) -> wire.About:
        """What the device says about itself."""
        for _ in range(_TRIES):
            self._port.write(wire.line("I"))
            until = time.monotonic() + _ANSWER_S / _TRIES
            while (left := until - time.monotonic()) > 0.0:
                for raw in self._port.lines(left):
                    if (described := wire.about(raw)) is not None:
                        return described
        self.close()
        raise HapnetError(f"nothing at {self._port.path} speaks the serial axis's protocol")
