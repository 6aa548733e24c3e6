"""The frames of a Touch: the exchange of state and force in the library's own thread, 1,000 times a second.

In each frame the device's state is read and a force is set, which acts until the next frame. The servo takes the frames
that came (`wait`) and leaves a force for the next one (`command`). So a force begins one frame after the position that
it was computed from, and which force acted between two positions is known.

In a frame without a new force the last one would continue, according to the maker's examples. So each frame sets a
force, and it is zero if the servo has left none for `WATCHDOG_S`. If the interpreter itself stalls, no frame comes, and
only the device's own safety remains.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from ctypes import byref, c_double, c_int
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.ext.devices import open_haptics as oh

WATCHDOG_S = 0.01
"""The time without a new force from the servo after which the force is zero [s]; one per millisecond is normal."""

AMPLIFIERS_S = 1.0
"""The time without force for the amplifiers' ramp after an error [s]; its true length is not documented."""

COOLING_S, COOL = 10.0, 0.8
"""After warm motors there is no force for this time [s], and until all motors are below this temperature (0 to 1)."""

_TEMPERATURE_EVERY = 100
_KEPT = 1000
_CLOSING_S = 0.05
_NONE: Vector = (0.0, 0.0, 0.0)


class TouchFrame(NamedTuple):
    """The device's state at one moment, in the library's axes and units."""

    number: int
    """The frame's number; frames without a device count too."""
    at_s: float
    position_mm: Vector
    velocity_mmps: Vector
    transform: Vector
    """The handle's pose: 16 numbers, column by column."""
    buttons: int
    force: Vector
    """The force set in this frame [N], which acts from here on."""
    had_errors: bool
    """Whether there were errors: the force may have ended since the previous frame, or not have begun."""


class Faults:
    """The effect of the library's errors on the force: the time without force, and whether the device is lost.

    Attributes
    ----------
    lost : the reason why there is no reading now; empty: there is a reading.
    """

    def __init__(self) -> None:
        self.lost: str = ""
        self._off, self._until_s, self._is_warm = "", 0.0, False

    def take(self, now_s: float, failures: list[oh.Failure], hottest: float) -> bool:
        """Take the errors of one frame, and the temperature of the warmest motor (0 to 1); return whether there were
        any.

        Raises HapnetError: an error that only a defect of hapnet can cause.
        """
        self.lost = ""
        for failure in failures:
            if failure.code in oh.LOST:
                self.lost = str(failure)
            elif failure.code == oh.WARM_MOTORS:
                self._end_force(now_s + COOLING_S, f"its motors are warm: {failure}")
                self._is_warm = True
            elif failure.code in oh.FORCE_ENDED:
                self._end_force(now_s + AMPLIFIERS_S, f"its amplifiers went off: {failure}")
            else:
                raise HapnetError(f"the library reports {failure}")
        if self._is_warm and hottest > COOL:
            self._until_s = max(self._until_s, now_s + AMPLIFIERS_S)
        self._is_warm &= now_s < self._until_s
        return bool(failures)

    def off(self, now_s: float) -> str:
        """The reason why the device renders no force now; empty: it renders force."""
        return self._off if now_s < self._until_s else ""

    def _end_force(self, until_s: float, why: str) -> None:
        """Set the force to zero until `until_s`, or until an earlier error's later end."""
        if until_s >= self._until_s:
            self._until_s, self._off = until_s, why


class TouchFrames:
    """Frames of the device `handle` from `start` to `close`.

    hd : the library. handle : of the device. clock : monotonic [s].
    """

    def __init__(self, hd: oh.OpenHaptics, handle: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._hd, self._handle, self._clock = hd, handle, clock
        self._came, self._ended = threading.Event(), threading.Event()
        self._frames: deque[TouchFrame] = deque(maxlen=_KEPT)
        self._command: tuple[Vector, float] = _NONE, 0.0
        self._output = self._has_output = self._closing = False
        self._count = 0
        self._hottest = 0.0
        self.faults: Faults = Faults()
        self._wrong = ""
        self._three, self._sixteen, self._buttons = (c_double * 3)(), (c_double * 16)(), c_int()
        self._callback = oh.CALLBACK(self._tick)  # must exist as long as the library may call it
        self._scheduled: int | None = None

    def start(self) -> None:
        """Begin the frames, without force. Raises HapnetError: the library refuses."""
        self._hd.slow.c.hdDisable(oh.FORCE_OUTPUT)
        self._scheduled = self._hd.slow.c.hdScheduleAsynchronous(self._callback, None, oh.HIGHEST_PRIORITY)
        self._hd.slow.c.hdStartScheduler()
        if (failure := next(self._hd.slow.errors(), None)) is not None:
            raise HapnetError(f"the library's scheduler does not start: {failure}")

    def enable(self) -> None:
        """Switch the motors on from the next frame on."""
        self._output = True

    def command(self, force: Vector) -> None:
        """Let `force` [N] act from the next frame on."""
        self._command = force, self._clock()

    def wait(self, seconds: float) -> list[TouchFrame]:
        """The frames since the last call; none if none came within `seconds`.

        Raises HapnetError: the library refused a command.
        """
        until_s = self._clock() + seconds
        while not self._frames:
            if self._wrong:
                raise HapnetError(self._wrong)
            if (left_s := until_s - self._clock()) <= 0.0 or not self._came.wait(left_s):
                return []
            self._came.clear()
        frames = []
        while self._frames:
            frames.append(self._frames.popleft())
        return frames

    def close(self) -> None:
        """Set the force to zero and end the frames."""
        if self._scheduled is None:
            return
        self._closing = True
        self._ended.wait(_CLOSING_S)  # wait for the frame that sets the force to zero
        self._hd.slow.c.hdStopScheduler()
        if not self._ended.is_set():
            self._hd.slow.c.hdUnschedule(self._scheduled)
        self._scheduled = None

    def _tick(self, _: object) -> int:
        try:
            return self._frame()
        except BaseException as error:  # ctypes would print it and continue
            self._wrong = f"{type(error).__name__}: {error}"
            return oh.DONE

    def _frame(self) -> int:
        """Do a frame, in the library's thread."""
        slow, quick = self._hd.slow.c, self._hd.quick
        slow.hdBeginFrame(self._handle)
        now_s = self._clock()
        if self._output and not self._has_output:
            self._has_output = True
            quick.c.hdEnable(oh.FORCE_OUTPUT)
        quick.c.hdGetDoublev(oh.POSITION, self._three)
        position = tuple(self._three)
        quick.c.hdGetDoublev(oh.VELOCITY, self._three)
        velocity = tuple(self._three)
        quick.c.hdGetDoublev(oh.TRANSFORM, self._sixteen)
        quick.c.hdGetIntegerv(oh.BUTTONS, byref(self._buttons))
        failures = list(quick.errors())
        if self._count % _TEMPERATURE_EVERY == 0:
            self._hottest = max(quick.doubles(oh.TEMPERATURE, 6))
            list(quick.errors())  # drop errors of a device that does not report this
        self._count += 1
        wanted, at_s = self._command
        if now_s - at_s > WATCHDOG_S or self.faults.off(now_s) or self._closing:
            wanted = _NONE
        quick.c.hdSetDoublev(oh.FORCE, (c_double * 3)(*wanted))
        slow.hdEndFrame(self._handle)
        had_errors = self.faults.take(now_s, failures + list(quick.errors()), self._hottest)
        if self.faults.lost:
            self._command = _NONE, now_s
        else:
            turned, buttons = tuple(self._sixteen), self._buttons.value
            self._frames.append(TouchFrame(self._count, now_s, position, velocity, turned, buttons, wanted, had_errors))
            self._came.set()
        if self._closing:
            quick.c.hdDisable(oh.FORCE_OUTPUT)
            self._ended.set()
            return oh.DONE
        return oh.CONTINUE
