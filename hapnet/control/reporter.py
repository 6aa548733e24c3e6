"""The world's messages about its proxy: the time for which its position holds, and the planes around it."""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.coupling import ProxySample
from hapnet.control.predicted_device import PredictedDevice
from hapnet.mechanics.contacts import Step, Surroundings
from hapnet.mechanics.plane import Plane, checked

MOST_REACH_M = 1.0
"""Planes farther away are never sent [m]: a desktop device does not reach so far."""


class SampleReporter:
    """Makes the world's samples for the device: its proxy's position, the time for which it holds, and the planes.

    position : of the virtual mass at the start [m]. predicted : chooses the proxy's target.
    reach : planes within this distance are sent [m]. reach_speed : so are planes that a device of this speed [m/s]
        could reach before it receives them.
    """

    def __init__(self, position: Vector, predicted: PredictedDevice, reach: float, reach_speed: float) -> None:
        self.predicted = predicted
        self._reach, self._reach_speed = reach, reach_speed
        self.contacts: Surroundings | None = None
        """The surroundings of the proxy; None before its first step."""
        self._force: Vector = (0.0,) * len(position)
        self._planes: tuple[Plane, ...] | None = ()  # the proxy starts outside of every obstacle
        self._searched_m: float | None = None
        self._aimed_s = 0.0

    @property
    def touches(self) -> bool:
        """Whether a force acted on the proxy in the last step."""
        return any(self._force)

    def know_nothing(self) -> None:
        """Send no planes: the surroundings are unknown, as with a real robot, which is felt through its position."""
        self._planes = None

    def moved(self, done: Step, contacts: Surroundings) -> None:
        """Take in a step that the mass made among these contacts."""
        self.contacts = contacts
        own = contacts.contact_force  # an engine's `force` includes the proxy's inertia
        self._force = done.force if own is None else own

    def look(self, dt: float, x: Vector) -> None:
        """Find the planes around x [m], `dt` seconds after the last step began, and pass them to the prediction."""
        predicted = self.predicted
        if self.contacts is not None:
            self._searched_m = reach = min(MOST_REACH_M, self._reach + self._reach_speed * predicted.turn_s)
            planes = self.contacts.planes(x, reach)
            self._planes = None if planes is None else tuple([plane.unfolded(x) for plane in checked(planes, len(x))])
        predicted.see(self._planes or ())
        self._aimed_s = predicted.stands_for(dt)

    def proxy(self, x: Vector, level: float | None) -> ProxySample:
        """Return the sample for the proxy at x [m], with the level of the reservoir (None: there is no reservoir)."""
        return ProxySample(x, self._aimed_s, self._force, self._planes, self._searched_m, level)
