"""The measured contact force on a robot that follows; its sensor may fail."""

from __future__ import annotations

import math
from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.recording.samples import Event
from hapnet.side.device import Clock, Write

MOST_N = 1e4
"""A force above this, or NaN, counts as missing: the sensor has failed."""

HELD_NS = 100_000_000
"""While the force is missing, the last force is kept for this time [ns]; then the force is zero."""


class ContactForce:
    """The force that a driver measures, tick by tick, in the robot's own axes.

    ask : returns the newest force [N]; None: there is none. name : the robot's name.

    Attributes
    ----------
    force : the force to use now [N]. missed : the number of missing readings.
    """

    def __init__(self, ask: Callable[[], Vector | None], dof: int, name: str, clock: Clock, write: Write) -> None:
        self._measure, self._name, self._clock, self._write = ask, name, clock, write
        self._zero = self.force = (0.0,) * dof
        self.missed: int = 0
        self._lost = False
        self._measured_ns: int | None = None

    def sense(self) -> Vector:
        """Return the force to use in this tick [N]. Raises HapnetError: the driver fails."""
        now_ns, force = self._clock(), self._measure()
        if force is not None and math.hypot(*force) <= MOST_N:
            self.force, self._measured_ns = force, now_ns
            self._report(now_ns, lost=False)
            return force
        self.missed += 1
        if self._measured_ns is None or now_ns - self._measured_ns > HELD_NS:
            self.force = self._zero
            self._report(now_ns, lost=True)
        return self.force

    def _report(self, now_ns: int, *, lost: bool) -> None:
        if lost != self._lost:
            self._lost = lost
            state = "is missing: it counts as zero" if lost else "is measured again"
            text = f"the contact force of {self._name} {state}"
            self._write(Event(now_ns, "device", text, "warning" if lost else "info"))
