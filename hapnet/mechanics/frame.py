"""The transformation between a device's own axes and the coupling's: an offset, and scales of motion and force.

    x = (x_d - o)/a,    F = b F_d                   x_d, F_d : the device's own;  x, F : the coupling's

Work is scaled too: F . dx = (b/a) F_d . dx_d. All values in couplings, accounts and messages are in the coupling's
units; if one robot follows another, these are the leader's units. So energy crosses a link without a factor, and
Theorem 1 bounds the work at the leader's port plus b/a times the work at the follower's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hapnet.checks import Vector
from hapnet.mechanics.curvature import Curvature
from hapnet.mechanics.plane import Plane
from hapnet.records.vectors import inner


@dataclass
class Frame:
    """motion : a, the device's motion per coupling's. force : b, the coupling's force per device's. offset : o [m].
    jaw : whether the last axis is the opening of a jaw: it is 0 where the jaw is closed, so it never has an offset.
    """

    motion: float
    force: float
    offset: Vector
    jaw: bool = False

    @property
    def energy(self) -> float:
        """b/a: joules of the coupling per joule of the device."""
        return self.force / self.motion

    @property
    def is_one(self) -> bool:
        """True for the identity: no scale and no offset."""
        return self.motion == self.force == 1.0 and not any(self.offset)

    def own(self, x: Sequence[float]) -> Vector:
        """Convert the coupling's position x to the device's own [m]."""
        return tuple([self.motion * part + o for part, o in zip(x, self.offset, strict=True)])

    def coupled(self, own: Sequence[float]) -> Vector:
        """Convert the device's own position to the coupling's x [m]."""
        return tuple([(part - o) / self.motion for part, o in zip(own, self.offset, strict=True)])

    def meet(self, own: Sequence[float], x: Sequence[float]) -> None:
        """Choose o so that the device's own position `own` is x [m]."""
        offset = tuple([part - self.motion * coupled for part, coupled in zip(own, x, strict=True)])
        self.offset = (*offset[:-1], 0.0) if self.jaw else offset

    def reach(self, reach_m: float) -> float:
        """Convert the coupling's distance `reach_m` to the device's own [m]."""
        return self.motion * reach_m

    def velocity(self, own: Sequence[float]) -> Vector:
        """Convert the device's own velocity to the coupling's [m/s]."""
        return tuple([part / self.motion for part in own])

    def own_force(self, force: Vector) -> Vector:
        """Convert the coupling's force to the device's own [N]."""
        return force if self.force == 1.0 else tuple([part / self.force for part in force])

    def coupled_force(self, own: Vector) -> Vector:
        """Convert the device's own force to the coupling's [N]."""
        return own if self.force == 1.0 else tuple([self.force * part for part in own])

    def plane(self, plane: Plane) -> Plane:
        """Convert a plane near the device to the coupling's units; its effects are dropped if the units differ."""
        a, stiff = self.motion, self.motion * self.force
        return plane._replace(
            offset_m=(plane.offset_m - inner(plane.normal, self.offset)) / a,
            stiffness=plane.stiffness * stiff,
            damping=plane.damping * stiff,
            velocity_mps=plane.velocity_mps / a,
            curvatures=tuple([Curvature(bend.direction, bend.per_m * a) for bend in plane.curvatures]),
            effects=plane.effects if a == self.force == 1.0 else None,
        )
