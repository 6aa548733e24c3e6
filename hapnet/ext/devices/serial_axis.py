"""A home-made axis on a serial port, such as a Hapkit or a SimpleFOC knob. Its page is serial_axis.md.

The board sends its state once a period, and so sets the servo's pace. Each state has the time by the board's clock,
and the impulse of the actuator since its start. So the mean force between two readings is known exactly, whatever was
lost between them, and for any delay of a command: the account counts that force.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence

from hapnet.checks import Vector
from hapnet.devices.driver import Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.devices import serial_frames as wire, serial_port
from hapnet.ext.devices.serial_frames import MICRO, Untimely, period_us
from hapnet.ext.devices.serial_port import SerialPort
from hapnet.ext.devices.timed_velocity import TimedVelocity

_ANSWER_S, _AGAIN_S = 3.0, 0.1
"""The longest wait for an answer, and the interval of requests [s]: an Arduino resets when its port is opened."""

_WATCHED_S, _TRIES = 0.3, 3
"""The time of a check for bursts [s], and its tries: a busy machine may look like a slow port, but hardly each time."""

_SLOW = 1.1
"""The factor over the promised period above which a board counts as too slow."""

_MAX_MEAN_US = 500_000
"""The longest time for a mean force [us]; beyond it the impulse may have wrapped more than once."""

_TEXT = re.compile(rb"[SI] [-0-9 ]+\*[0-9A-F]{4}\n")
"""A message of a sketch of version 1."""

_SKETCH = "flash the sketch of this version, examples/serial_axis"


class SerialAxis(Driver):
    """An axis at a port: ``serial:/dev/ttyACM0``.

    port : of the axis. baud : bits a second (USB ignores it). home : whether the handle's present place becomes 0.

    Raises InvalidParameter: not one axis, or there is no such port. MissingLibrary: pyserial is not installed.
    HapnetError: no answer in this protocol, its states come in bursts, or its clock is wrong.
    """

    about = "a home-made axis on a serial port (Teensy, RP2040, ESP32, SimpleFOC, Hapkit)"
    tested = "tested with an emulator"
    udev = 'SUBSYSTEM=="tty", KERNEL=="ttyACM*|ttyUSB*", TAG+="uaccess"'
    emulator = "hapnet.ext.devices.serial_emulator:SerialEmulator"
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
        self._frames = wire.FrameParser()
        self._last: wire.BoardState | None = None
        self._before: wire.BoardState | None = None  # the state of the reading before the last
        self._number = 0
        self._must_be_homed = False
        self._now_us, self._speed = 0, 0.0
        try:
            described = self._ask()
            made_us = self._watch(described.period_us)
        except HapnetError:
            self.close()
            raise
        is_slow = made_us > _SLOW * described.period_us
        if is_slow and 0 < described.made_us <= _SLOW * described.period_us:
            self.close()
            lost = f"a state each {described.made_us} us, but one each {made_us:.0f} us arrives"
            raise HapnetError(f"the board at {port} makes {lost}: is its baud rate too low?")
        self.rate_hz = 1e6 / (made_us if is_slow else described.period_us)
        self.force_limit: float = described.limit_uN * MICRO
        self.continuous_force: float | None = described.continuous_uN * MICRO or None
        self.resolution: float = described.count_nm * 1e-9
        self.workspace: float = described.reach_um * MICRO
        self.watchdog_s: float | None = described.watchdog_ms * 1e-3 or None
        self.dead_man: int | None = None if described.dead_man < 0 else described.dead_man
        self._button_count = described.buttons
        self._velocity = TimedVelocity(self.resolution, described.noise_nm * 1e-9)
        self._patience_s = 2.0 / self.rate_hz

    @classmethod
    def missing(cls) -> str:
        return serial_port.missing()

    @classmethod
    def found(cls) -> Sequence[str]:
        return serial_port.ports(lambda port: port.vid is not None)

    def home(self) -> None:
        until, is_homed = time.monotonic() + _ANSWER_S, False
        if self._asked_home:
            self._port.write(wire.command(wire.BoardCommand(b"H")))
        while not is_homed and time.monotonic() < until:
            states = self._states(_AGAIN_S)
            is_homed = any(state.homed for state in states)
            if states and not is_homed:
                if not self._asked_home:
                    break
                self._port.write(wire.command(wire.BoardCommand(b"H")))
        if not is_homed:
            raise HapnetError(
                f"the axis is not calibrated: centre its handle, and use serial:{self._port.path},home=yes"
            )
        self._must_be_homed = True

    def read(self) -> tuple[Vector, Vector]:
        """Wait for the next state; if several have arrived, take the last.

        Raises DeviceSilent: no complete state came within two periods, or the port is closed. HapnetError: the board
        was reset, and has lost its zero.
        """
        if self._port.reopen(self._patience_s):
            self._frames = wire.FrameParser()
            self._last = None
        states = self._states(self._patience_s)
        if not states:
            raise DeviceSilent(f"no complete state for {self._patience_s * 1e3:g} ms at {self._port.path}")
        self._before = self._last
        for state in states:
            if self._must_be_homed and not state.homed:
                lost = "was reset and has lost its zero: centre the handle, and start the run again"
                raise HapnetError(f"the board at {self._port.path} {lost}")
            self._follow(state)
        return (states[-1].position_nm * 1e-9,), (self._speed,)

    def acted(self) -> Vector | None:
        """The mean force between the last two readings [N]; None: not known."""
        before, last = self._before, self._last
        if before is None or last is None or (elapsed_us := _elapsed_us(before, last)) is None:
            return None
        impulse_us = wire.signed(last.impulse - before.impulse) * wire.IMPULSE_US
        return (impulse_us / elapsed_us * self.force_limit / wire.FULL,)

    def interval(self) -> float | None:
        """The time between the last two readings by the board's clock [s]; None: not known."""
        elapsed_us = None if self._last is None else _elapsed_us(self._before, self._last)
        return None if elapsed_us is None else elapsed_us * MICRO

    def apply(self, force: Vector) -> None:
        """Send the force; the board's later states show when it acted."""
        self._number = (self._number + 1) % 2**16
        parts = round(force[0] / self.force_limit * wire.FULL)
        parts = max(-wire.FULL, min(wire.FULL, parts))
        self._port.write(wire.command(wire.BoardCommand(b"F", self._number, parts)))

    def buttons(self) -> tuple[bool, ...]:
        pressed = 0 if self._last is None else self._last.buttons
        return tuple(bool(pressed >> k & 1) for k in range(self._button_count))

    def close(self) -> None:
        self._port.close()

    def _follow(self, state: wire.BoardState) -> None:
        """Update the velocity with this state."""
        elapsed_us = _elapsed_us(self._last, state)
        if elapsed_us is None:
            self._velocity.restart()
        self._now_us += elapsed_us or 0
        self._last = state
        at_us = self._now_us - state.age_us if state.age_us < wire.OLDEST_US else None
        x = state.position_nm * 1e-9 - 0.5 * state.counted * self.resolution  # a count lies between two positions
        at_s = None if at_us is None else at_us * MICRO
        self._speed = self._velocity.update(self._now_us * MICRO, at_s, x, counted=state.counted != 0)

    def _states(self, seconds: float) -> list[wire.BoardState]:
        """The next states, waiting for them at most `seconds`."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            came = self._frames.feed(self._port.read(left))
            if states := [frame for frame in came if isinstance(frame, wire.BoardState)]:
                return states
        return []

    def _ask(self) -> wire.About:
        """Request the board's description."""
        ask_s = time.monotonic()
        until, heard = ask_s + _ANSWER_S, b""
        while (now_s := time.monotonic()) < until:
            if now_s >= ask_s:
                self._port.write(wire.command(wire.BoardCommand(b"Q")))
                ask_s += _AGAIN_S
            came = self._port.read(_AGAIN_S)
            for frame in self._frames.feed(came):
                if isinstance(frame, wire.About):
                    if frame.version != wire.VERSION:
                        raise self._another(f"version {frame.version}")
                    return frame
            heard = (heard + came)[-1000:]
            if _TEXT.search(heard):
                raise self._another("version 1 (text)")
        raise HapnetError(f"nothing at {self._port.path} speaks the serial axis's protocol")

    def _another(self, version: str) -> HapnetError:
        return HapnetError(f"the axis at {self._port.path} speaks {version} of the protocol, not 2: {_SKETCH}")

    def _watch(self, promised_us: float) -> float:
        """The time between states [us]. Raises HapnetError: they come in bursts, or the board's clock is wrong."""
        fastest_us = math.inf
        for left in reversed(range(_TRIES)):
            arrivals = []
            until = time.monotonic() + _WATCHED_S
            while (left_s := until - time.monotonic()) > 0.0:
                if states := self._states(left_s):
                    arrivals.append((time.monotonic(), [state.time_us for state in states]))
            try:
                fastest_us = min(fastest_us, period_us(arrivals))
            except Untimely as error:
                if not left and fastest_us == math.inf:
                    remedy = f": {self._port.remedy()}" if error.bursts else ""
                    raise HapnetError(f"the states of {self._port.path} are not in time, {error}{remedy}") from error
            if fastest_us <= _SLOW * promised_us:
                break
        return fastest_us


def _elapsed_us(before: wire.BoardState | None, state: wire.BoardState) -> int | None:
    """The board's time between two states [us]; None: not known, or the impulse may have wrapped."""
    if before is None:
        return None
    elapsed_us = (state.time_us - before.time_us) % wire.WRAP
    return elapsed_us if 0 < elapsed_us <= _MAX_MEAN_US else None
