"""Devices that only measure a motion: a gamepad's stick, a 3D mouse. Without motors the account counts no force.

The deflection of the stick is the position: full deflection is `reach` from the origin, no deflection the origin. With
a `rate` the deflection is the velocity (rate control), and the position stays where it is when the hand lets go. A
low-pass filter of 20 ms smooths the steps in which such devices report. The kernel's files are read without waiting;
no library is needed.
"""

from __future__ import annotations

import math
import os
import time
from abc import abstractmethod
from collections.abc import Sequence

from hapnet.checks import Vector
from hapnet.devices.driver import NO_FORCE, Axes, Driver
from hapnet.errors import DeviceSilent, InvalidParameter

SMOOTHING_S = 0.02
_AGAIN_S = 0.5
_MOST_BYTES = 4096
_NO_WAIT: int = getattr(os, "O_NONBLOCK", 0)  # not on Windows


class InputDevice(Driver):
    """A device behind a file of the kernel.

    path : the file; empty: the first one found. axes : the axes for the scene, as in `Axes`. reach : the position at
    full deflection [m]. dead : deflections below this share count as none.

    Raises InvalidParameter: a value is not allowed, or there is no such device.
    """

    tested = "tested with recorded events, not on hardware"
    force_limit: float = NO_FORCE
    resolution: float = 0.0
    smallest_mass: float = 1.0  # without motors this has no effect

    def __init__(
        self, dof: int, path: str = "", axes: str = "", reach: float = 0.04, dead: float = 0.05, rate: float = 0.0
    ) -> None:
        if not 1e-3 <= reach <= 1.0:
            raise InvalidParameter("reach", reach, "0.001 to 1 m")
        if not 0.0 <= dead < 1.0:
            raise InvalidParameter("dead", dead, "0 or above, below 1")
        if not 0.0 <= rate <= 100.0:
            raise InvalidParameter("rate", rate, "0 to 100 1/s")
        found = self.found()
        if not path and not found:
            raise InvalidParameter("path", path, f"a device of this machine, and none was found ({self.about})")
        self.dof = dof
        self.workspace: float = 2.0 * reach
        self.greatest_speed: float = 10.0 * reach / SMOOTHING_S
        self._axes, self.reach, self._dead, self.rate = Axes(axes, dof - self.jaw), reach, dead, rate
        self._path = path or found[0]
        self._file: int | None = None
        self._unread = b""
        self._next_try_s = 0.0
        self.deflections: list[float] = [0.0] * 3
        """The deflections along x, y, z, each -1 to 1."""
        self.pressed: dict[int, bool] = {}
        self._velocity: Vector = (0.0,) * dof
        self._position: Vector = (*(0.0,) * (dof - self.jaw), *self.jaws())
        self._read_s: float | None = None
        try:
            self._open()
        except OSError as error:
            raise InvalidParameter("path", self._path, f"a file that can be read ({error.strerror})") from None

    @abstractmethod
    def take(self, data: bytes) -> int:
        """Process the complete reports in `data`: set `deflections` and `pressed`. Returns the number of bytes used."""

    def read(self) -> tuple[Vector, Vector]:
        self._listen()
        now_s = time.monotonic()
        dt = 0.0 if self._read_s is None else now_s - self._read_s
        self._read_s = now_s
        self.move(dt)
        return self._position, self._velocity

    def move(self, dt: float) -> None:
        """Move the position by what the present deflections make of it in `dt` seconds."""
        goal = self._axes.take(tuple([self.reach * self.beyond_dead_zone(d) for d in self.deflections]))
        before, count = self._position, len(goal)
        point = before[:count]
        if self.rate:
            velocity = follow(self._velocity[:count], [self.rate * g for g in goal], dt)
            moved = [x + v * dt for x, v in zip(point, velocity, strict=True)]
            point = tuple([max(-self.reach, min(self.reach, x)) for x in moved])
        else:
            point = follow(point, goal, dt)
        self._position = (*point, *follow(before[count:], self.jaws(), dt))
        if dt > 0.0:
            self._velocity = tuple([(x - b) / dt for x, b in zip(self._position, before, strict=True)])

    def jaws(self) -> Vector:
        """The opening of its jaw [m]; empty: it has none."""
        return ()

    def apply(self, force: Vector) -> Vector:
        """Return zeros: without motors no force is applied."""
        return (0.0,) * self.dof

    def buttons(self) -> tuple[bool, ...]:
        return tuple(self.pressed.get(number, False) for number in range(1 + max(self.pressed, default=-1)))

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def beyond_dead_zone(self, deflection: float) -> float:
        """The deflection beyond the dead zone; full deflection stays full."""
        size = max(0.0, abs(deflection) - self._dead) / (1.0 - self._dead)
        return math.copysign(min(1.0, size), deflection)

    def _listen(self) -> None:
        if self._file is None:
            self._open_again()
        while True:
            try:
                assert self._file is not None
                data = os.read(self._file, _MOST_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                self.close()
                raise DeviceSilent(f"{self._path} was disconnected ({error.strerror})") from None
            if not data:
                return
            self._unread += data
            self._unread = self._unread[self.take(self._unread) :]

    def _open_again(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_try_s:
            self._next_try_s = now_s + _AGAIN_S
            try:
                self._open()
            except OSError:
                pass
            else:
                return
        raise DeviceSilent(f"{self._path} was disconnected")

    def _open(self) -> None:
        self._file = os.open(self._path, os.O_RDONLY | _NO_WAIT)
        self._unread = b""
        self.deflections = [0.0] * 3
        self.pressed.clear()


def follow(value: Vector, goal: Sequence[float], dt: float) -> Vector:
    """The value of the low-pass filter `dt` seconds later."""
    share = -math.expm1(-dt / SMOOTHING_S)
    return tuple([x + share * (g - x) for x, g in zip(value, goal, strict=True)])


def existing(paths: Sequence[str]) -> tuple[str, ...]:
    """The paths that can be read."""
    return tuple(path for path in paths if os.access(path, os.R_OK))
