"""Where a device's own axes are, as the coupling has them: moved, and scaled in motion and in force.

    x = (x_d - o)/a,    F = b F_d                   x_d, F_d : the device's own;  x, F : the coupling's

Work is scaled too: F . dx = (b/a) F_d . dx_d. Everything that a coupling, an account or a message holds is in the
coupling's units, which are those of the leader where one robot follows another. So energy crosses a link without a
factor, and Theorem 1 bounds the work of the leader's port plus b/a times the follower's.
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
    """motion : a, the device moves so many times as far. force : b, its force counts so many times. offset : o [m]."""

    motion: float
    force: float
    offset: Vector

    @property
    def energy(self) -> float:
        """b/a: joules of the coupling for each of the device."""
        return self.force / self.motion

    @property
    def is_one(self) -> bool:
        """Whether both are the same, in the same place."""
        return self.motion == self.force == 1.0 and not any(self.offset)

    def own(self, x: Sequence[float]) -> Vector:
        """The device's own position of x [m]."""
        return tuple([self.motion * one + o for one, o in zip(x, self.offset, strict=True)])

    def coupled(self, own: Sequence[float]) -> Vector:
        """x of the device's own position [m]."""
        return tuple([(one - o) / self.motion for one, o in zip(own, self.offset, strict=True)])

    def meet(self, own: Sequence[float], x: Sequence[float]) -> None:
        """Choose o so that `own` is x [m]."""
        self.offset = tuple([one - self.motion * two for one, two in zip(own, x, strict=True)])

    def reach(self, reach_m: float) -> float:
        """How far away from the device may be what is `reach_m` [m] away for the coupling."""
        return self.motion * reach_m

    def velocity(self, own: Sequence[float]) -> Vector:
        """The coupling's of the device's own [m/s]."""
        return tuple([one / self.motion for one in own])

    def own_force(self, force: Vector) -> Vector:
        """The device's own of the coupling's [N]."""
        return force if self.force == 1.0 else tuple([one / self.force for one in force])

    def coupled_force(self, own: Vector) -> Vector:
        """The coupling's of the device's own [N]."""
        return own if self.force == 1.0 else tuple([self.force * one for one in own])

    def plane(self, plane: Plane) -> Plane:
        """A plane near the device; effects of its surface stay behind if the units differ."""
        a, stiff = self.motion, self.motion * self.force
        return plane._replace(
            offset_m=(plane.offset_m - inner(plane.normal, self.offset)) / a,
            stiffness=plane.stiffness * stiff,
            damping=plane.damping * stiff,
            velocity_mps=plane.velocity_mps / a,
            curvatures=tuple([Curvature(bend.direction, bend.per_m * a) for bend in plane.curvatures]),
            effects=plane.effects if a == self.force == 1.0 else None,
        )
