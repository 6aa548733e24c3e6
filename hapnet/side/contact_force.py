"""The measured force of its surroundings on a robot that follows, whose sensor may fail."""

from __future__ import annotations

import math
from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.recording.samples import Event
from hapnet.side.device import Clock, Write

MOST_N = 1e4
"""A force beyond this, or one that is no number, is missing: the sensor has failed."""

HELD_NS = 100_000_000
"""A force that is missing stands for so long as it was; then there is none."""


class ContactForce:
    """The force that a driver measures, tick by tick, in the robot's own axes.

    ask : the newest force [N]; None: there is none. name : the robot's.

    Attributes
    ----------
    force : the one that counts [N]. missed : how many were missing.
    """

    def __init__(self, ask: Callable[[], Vector | None], dof: int, name: str, clock: Clock, write: Write) -> None:
        self._ask, self._name, self._clock, self._write = ask, name, clock, write
        self._none = self.force = (0.0,) * dof
        self.missed: int = 0
        self._lost = False
        self._heard_ns: int | None = None

    def sense(self) -> Vector:
        """The force that counts in this tick [N]. Raises HapnetError: the driver fails."""
        now_ns, force = self._clock(), self._ask()
        if force is not None and math.hypot(*force) <= MOST_N:
            self.force, self._heard_ns = force, now_ns
            self._report(now_ns, lost=False)
            return force
        self.missed += 1
        if self._heard_ns is None or now_ns - self._heard_ns > HELD_NS:
            self.force = self._none
            self._report(now_ns, lost=True)
        return self.force

    def _report(self, now_ns: int, *, lost: bool) -> None:
        if lost != self._lost:
            self._lost = lost
            state = "is missing: the hand feels none" if lost else "is measured again"
            text = f"the contact force of {self._name} {state}"
            self._write(Event(now_ns, "device", text, "warning" if lost else "info"))
