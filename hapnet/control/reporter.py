"""The world's messages about its proxy: where it will be, and the planes around it."""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.coupling import ProxySample
from hapnet.control.prediction import PredictedDevice
from hapnet.mechanics.contacts import Step, Surroundings
from hapnet.mechanics.plane import Plane, checked

MOST_REACH_M = 1.0
"""Planes that are farther away are never sent [m]: no desktop device reaches so far."""


class Teller:
    """Computes what the world sends the device of its proxy: where it will be, and what is around it.

    position : of the virtual mass at the start [m]. predicted : aims the proxy.
    reach : planes within this distance are sent [m]. reach_speed : and those that a device so fast [m/s] could reach
        before it receives them.
    """

    def __init__(self, position: Vector, predicted: PredictedDevice, reach: float, reach_speed: float) -> None:
        self.predicted = predicted
        self._reach, self._reach_speed = reach, reach_speed
        self._contacts: Surroundings | None = None
        self._force: Vector = (0.0,) * len(position)
        self._planes: tuple[Plane, ...] | None = ()  # it starts outside of every obstacle
        self._looked_m: float | None = None
        self._stands_for = 0.0

    def know_nothing(self) -> None:
        """Nobody knows what is around it, as of a real robot: it is felt through its position."""
        self._planes = None

    def moved(self, done: Step, contacts: Surroundings) -> None:
        """The mass has made a step among these contacts."""
        self._contacts = contacts
        own = contacts.contact_force  # an engine's `force` holds the proxy's inertia too
        self._force = done.force if own is None else own

    def look(self, dt: float, x: Vector) -> None:
        """See what is around x [m], `dt` seconds after the last step began; the prediction knows it then too."""
        predicted = self.predicted
        if self._contacts is not None:
            self._looked_m = reach = min(MOST_REACH_M, self._reach + self._reach_speed * predicted.turn_s)
            reported = self._contacts.planes(x, reach)
            self._planes = (
                None if reported is None else tuple([plane.unfolded(x) for plane in checked(reported, len(x))])
            )
        predicted.see(self._planes or ())
        self._stands_for = predicted.stands_for(dt)

    def proxy(self, x: Vector, level: float | None) -> ProxySample:
        """Return the message about the proxy at x [m], with the level of the reservoir; None: there is no reservoir."""
        return ProxySample(x, self._stands_for, self._force, self._planes, self._looked_m, level)
