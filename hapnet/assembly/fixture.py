"""A virtual fixture: planes in the air that a real robot's own motors render.

A plane is a spring and a damper between the robot and a place that does not move. Its force is held from tick to tick,
so it could give out more than it took in. So it has an account: at the depth d its stiffness is at most 2 E / d^2,
where E is `LENT_J` plus the energy taken in and not yet given back. So it gives out at most `LENT_J` more than it took,
and ``k (v h)^2 / 2`` of the tick in which the account reaches zero.

The motors' force is that of the coupling plus the fixture's. The driver reports the sum, and the coupling's account has
the sum without the fixture's part: the fixture belongs to the robot's surroundings. So however a late force is divided
between fixture and coupling, both accounts together contain all work of the motors.
"""

from __future__ import annotations

from operator import add, sub
from typing import Any

from hapnet.checks import Vector
from hapnet.mechanics.contacts import Surroundings
from hapnet.records.vectors import inner

LENT_J = 0.005
"""Energy that a fixture may give out before it took any in: a held force is late by a tick on the way in too."""


class Fixture:
    """The driver `device`, with the planes of `surroundings`, in the driver's own axes."""

    def __init__(self, device: Any, surroundings: Surroundings) -> None:
        self._device, self._surroundings = device, surroundings
        self._x: Vector = ()
        self._v: Vector = ()
        self._force: Vector = (0.0,) * device.dof
        self._before = self._acted = self._force
        self.taken_J: float = 0.0
        """The energy that it has taken in, less the energy that it gave out [J]."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s]."""
        x, self._v = self._device.read()
        # which of the two forces acted: a driver may be a tick late
        moved = tuple(map(sub, x, self._x or x))
        self._acted = max(self._before, self._force, key=lambda force: inner(force, moved))
        self.taken_J -= inner(self._acted, moved)
        self._x = x
        return self._x, self._v

    def apply(self, force: Vector) -> Vector | None:
        """Hold `force` [N] plus the planes' force; returns the applied part of `force`. If `force` is 0, hold none."""
        self._before, self._force = self._force, self._push() if any(force) else (0.0,) * len(force)
        return _without(self._device.apply(tuple(map(add, force, self._force))), self._force)

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings, without the fixture's part."""
        return _without(self._device.acted(), self._acted)

    def contact_force(self) -> Vector | None:
        """The force of the robot's surroundings and of the planes; None: the surroundings' force is not measured."""
        measured = getattr(self._device, "contact_force", None)
        force = None if measured is None else measured()
        return None if force is None else tuple([one + own for one, own in zip(force, self._acted, strict=True)])

    def _push(self) -> Vector:
        push = (0.0,) * len(self._x)
        for plane in self._surroundings.planes(self._x, 0.0) or ():
            if (depth := plane.depth(self._x)) > 0.0:
                stiffness = min(plane.stiffness, max(0.0, 2.0 * (LENT_J + self.taken_J) / depth**2))
                size = max(0.0, stiffness * depth + plane.damping * inner(plane.normal, self._v))
                push = tuple([one - size * n for one, n in zip(push, plane.normal, strict=True)])
        return push


def _without(force: Vector | None, own: Vector) -> Vector | None:
    return None if force is None else tuple(map(sub, force, own))
