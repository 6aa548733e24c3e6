"""3D Systems' Touch, formerly Geomagic Touch and Phantom Omni, by the maker's OpenHaptics (HDAPI).

**Experimental**: written after the library's public headers and reference, and tested against a stand-in of it, never
on a device. The library is the maker's and is loaded when the device is made. Its page is touch.md.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from operator import mul, sub
from pathlib import Path

from hapnet.checks import Vector
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.devices import open_haptics as oh
from hapnet.ext.devices.touch_frames import TouchFrame, TouchFrames
from hapnet.mechanics.pose import quaternion

PATIENCE_S = 0.005
"""The longest wait of a reading [s]; a frame comes each millisecond."""

_MM = 1e-3
_MARGIN = 1.2
"""The factor from the mechanical limits that the library reports to the reach."""

_FINE = ("touch x", "desktop")
_RESOLUTION_M, _FINE_RESOLUTION_M = 5.5e-5, 2.3e-5
_OMNI_FORCE_N, _OMNI_STIFFNESS = 3.3, 700.0
"""The limits until the device is open; the stiffness [N/m] is from CHAI3D's device table."""


class TouchDriver(Driver):
    """``touch``, or ``touch:Left Device`` for the device with this name in Touch Setup.

    name : as in the maker's setup program; empty: the first device. axes : which of its axes the scene gets, as in
    `Axes`. library : path of the library; empty: where the system finds it. clock : monotonic [s].

    Raises InvalidParameter: a value is not allowed. HapnetError: no library, no licence, or no device.
    """

    about = "3D Systems Touch and Touch X, Phantom Omni and Desktop (OpenHaptics)"
    udev = 'SUBSYSTEM=="usb|tty|hidraw", ATTRS{idVendor}=="2988", TAG+="uaccess"'
    tested = "experimental: tested with a stand-in of the library"
    rate_hz: float = 1000.0
    blocking = True
    resolution: float = _RESOLUTION_M
    force_limit: float = _OMNI_FORCE_N
    stiffness_range: tuple[float, float] = (0.0, _OMNI_STIFFNESS)
    knows_force = False

    def __init__(
        self,
        dof: int,
        name: str = "",
        axes: str = "",
        library: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.dof = dof
        self._axes = Axes(axes, dof)
        self._hd = oh.OpenHaptics(library)
        self._handle = self._hd.slow.c.hdInitDevice(name.encode() if name else None)
        failure = next(self._hd.slow.errors(), None)
        if failure is not None or self._handle == oh.NO_DEVICE:
            called = f"named {name!r}" if name else "of 3D Systems"
            raise HapnetError(f"no device {called}: {failure or 'no handle'}; check the maker's setup program")
        self._clock = clock
        self._frames = TouchFrames(self._hd, self._handle, clock)
        self._last: TouchFrame | None = None
        self._acted: Vector | None = None
        self._interval_s: float | None = None
        self.model: str = (self._hd.slow.c.hdGetString(oh.MODEL) or b"").decode(errors="replace")
        self._learn_limits()
        try:
            self._frames.start()
        except HapnetError:
            self.close()
            raise

    @classmethod
    def missing(cls) -> str:
        return "" if oh.find() else oh.NEEDED

    @classmethod
    def found(cls) -> Sequence[str]:
        """The names from the maker's setup program; whether they are connected is known only after opening them."""
        home = os.environ.get("GTDD_HOME")
        return tuple(sorted(path.stem for path in (Path(home) / "config").glob("*.config"))) if home else ()

    def home(self) -> None:
        """Update the calibration from the library.

        Raises HapnetError: the user must put the stylus into the inkwell first, or calibrate with the maker's program.
        """
        if self._calibration() == oh.NEEDS_UPDATE:
            styles = self._hd.slow.integer(oh.STYLES)
            style = next((each for each in (oh.AUTO, oh.INKWELL, oh.ENCODER_RESET) if styles & each), oh.INKWELL)
            self._hd.in_scheduler(lambda: self._hd.slow.c.hdUpdateCalibration(style))
        if (state := self._calibration()) == oh.CALIBRATED:
            return
        if state == oh.NEEDS_INPUT and self._hd.slow.integer(oh.STYLES) & oh.INKWELL:
            raise HapnetError(f"{self.model} is not calibrated: put its stylus into the inkwell, then start again")
        raise HapnetError(f"{self.model} is not calibrated: calibrate it first with the maker's diagnostic program")

    def begin(self) -> None:
        """Switch the motors on."""
        self._frames.enable()

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] of the newest frame; the library smooths the velocity.

        Raises DeviceSilent: no frame came within `PATIENCE_S`. HapnetError: the library refused a command.
        """
        frames = self._frames.wait(PATIENCE_S)
        if not frames:
            why = self._frames.faults.lost or "the library's scheduler made none"
            raise DeviceSilent(f"no frame for {PATIENCE_S * 1e3:g} ms: {why}")
        newest = frames[-1]
        has_gap = self._last is None or newest.number - self._last.number != len(frames)
        self._interval_s = None if has_gap or self._last is None else newest.at_s - self._last.at_s
        self._acted = None if has_gap else self._mean_force(frames)
        self._last = newest
        x, v = (
            self._axes.take(tuple([_MM * part for part in _to_hapnet(theirs)]))
            for theirs in (newest.position_mm, newest.velocity_mmps)
        )
        return x, v

    def apply(self, force: Vector) -> None:
        """Set the force for the next frame. The library does not report the force that the motors really make."""
        self._frames.command(_theirs(self._axes.spread(force)))

    def acted(self) -> Vector | None:
        return self._acted

    def interval(self) -> float | None:
        return self._interval_s

    def orientation(self) -> Vector | None:
        """The stylus's orientation at the last reading: a unit quaternion w, x, y, z in hapnet's frame."""
        if self._last is None:
            return None
        columns = [_to_hapnet(self._last.transform[4 * k : 4 * k + 3]) for k in (0, 2, 1)]
        columns[1] = tuple([-part for part in columns[1]])  # hapnet's axes are the library's x, -z and y
        return quaternion(list(zip(*columns, strict=True)))

    def buttons(self) -> tuple[bool, bool]:
        pressed = 0 if self._last is None else self._last.buttons
        return bool(pressed & 1), bool(pressed & 2)

    def braked(self) -> str:
        return self._frames.faults.off(self._clock())

    def close(self) -> None:
        if self._handle != oh.NO_DEVICE:
            self._frames.close()
            self._hd.slow.c.hdDisableDevice(self._handle)
            self._handle = oh.NO_DEVICE

    def _learn_limits(self) -> None:
        """Take the limits that the library reports for the device; the others stay as they are."""
        hd = self._hd.slow
        self.resolution = _FINE_RESOLUTION_M if any(word in self.model.lower() for word in _FINE) else _RESOLUTION_M
        force_N, continuous_N, stiffness = (
            hd.doubles(name, 1)[0] for name in (oh.MAX_FORCE, oh.CONTINUOUS_FORCE, oh.MAX_STIFFNESS)
        )
        if force_N > 0.0:
            self.force_limit = force_N
        if 0.0 < continuous_N < self.force_limit:
            self.continuous_force = continuous_N
        self.stiffness_range = (0.0, max(stiffness / _MM, _OMNI_STIFFNESS))
        limits = hd.doubles(oh.MAX_WORKSPACE, 6)
        reach = [_MARGIN * _MM * max(map(abs, limits[axis::3])) for axis in range(3)]
        if all(reach):
            self.workspace = tuple(map(abs, self._axes.take(_to_hapnet(tuple(reach)))))
        list(hd.errors())  # drop errors of parameters that this device lacks

    def _calibration(self) -> int:
        state = [0]

        def check() -> None:
            state[0] = self._hd.slow.c.hdCheckCalibration()

        self._hd.in_scheduler(check)
        return state[0]

    def _mean_force(self, frames: list[TouchFrame]) -> Vector:
        """The force that acted since the last reading; of several possible ones, that which gave out most energy."""
        assert self._last is not None, "there was a reading before"
        moved = tuple(map(sub, frames[-1].position_mm, self._last.position_mm))
        possible = [self._last.force, *(frame.force for frame in frames[:-1])]
        if any(frame.had_errors for frame in (self._last, *frames)):
            possible.append((0.0, 0.0, 0.0))
        return self._axes.take(_to_hapnet(max(possible, key=lambda force: sum(map(mul, force, moved)))))


def _to_hapnet(theirs: Vector) -> Vector:
    """Convert to hapnet's frame; the library's x points to the right, y up, z to the user."""
    x, y, z = theirs
    return x, -z, y


def _theirs(ours: Vector) -> Vector:
    x, y, z = ours
    return x, z, -y
