"""A local plane of an obstacle's surface: enough for a spring to render a nearby obstacle."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import islice
from operator import sub
from typing import Any, NamedTuple

from hapnet.checks import (
    MOST_FRICTION,
    MOST_PLANES,
    MOST_TOOL_PLANES,
    UNIT_TOLERANCE,
    Vector,
    wrong_curvatures,
    wrong_effects,
)
from hapnet.errors import InvalidParameter
from hapnet.mechanics.curvature import Curvature, Curvatures, round_all_over
from hapnet.mechanics.effects import Effects, Grain
from hapnet.records.vectors import added, inner
from hapnet.units import POSE_AXES

FOLDED = 0.9
"""At depths above this share of its radius, a curved surface is sent as flat: its nearest point would depend on
rounding."""


class Plane(NamedTuple):
    """A plane with a one-sided spring and damper behind it: solid where ``normal . x > offset_m``.

    stiffness, damping : of the solid, along the normal [N/m], [Ns/m].
    velocity_mps : of the plane along its normal [m/s]; 0: it stands still.
    curvatures : of the surface to which the plane is tangent, at the surface's point nearest to the place for which the
        plane is sent. Empty: flat, or unknown.
    friction : Coulomb's mu at that point, 0 to 10. effects : of the surface at the device's rate; None: no effects.
    """

    normal: Vector
    offset_m: float
    stiffness: float
    damping: float
    velocity_mps: float = 0.0
    curvatures: Curvatures = ()
    friction: float = 0.0
    effects: Effects | None = None

    @classmethod
    def of_ball(
        cls,
        position: Sequence[float],
        centre: Sequence[float],
        radius: float,
        stiffness: float,
        damping: float = 0.0,
        velocity_mps: float = 0.0,
    ) -> Plane:
        """The tangent plane of a ball at its point nearest to `position`. centre : (n,) [m]. radius : [m]."""
        inwards = tuple(map(sub, centre, position))
        size = math.hypot(*inwards)
        normal = tuple([part / size for part in inwards]) if size else (1.0,) + (0.0,) * (len(inwards) - 1)
        offset = inner(normal, centre) - radius
        return cls(normal, offset, stiffness, damping, velocity_mps, round_all_over(normal, radius))

    @classmethod
    def all_of(
        cls,
        planes: Sequence[Sequence[Any]] | None,
        bends: Sequence[Sequence[Any]] | None = None,
        friction: Sequence[float] | None = None,
        effects: Sequence[Sequence[Any] | None] | None = None,
    ) -> tuple[Plane, ...] | None:
        """Planes from a message's fields: the first five fields of each plane, and its curvatures, friction, effects.

        None: the message has no planes.
        """
        if planes is None or (bends is None and friction is None and effects is None):
            return None if planes is None else tuple([cls(*plane) for plane in planes])
        count = len(planes)
        each = zip(
            planes, bends or ((),) * count, friction or (0.0,) * count, effects or (None,) * count, strict=True
        )  # fmt: skip
        return tuple(
            [
                cls(*(*plane, tuple([Curvature(*bend) for bend in bent]), mu, Effects.of(values)))
                for plane, bent, mu, values in each
            ]
        )

    def depth(self, position: Sequence[float]) -> float:
        """The depth of `position` (n,) behind the flat plane [m]."""
        along: float = inner(self.normal, position)
        return along - self.offset_m

    def unfolded(self, position: Sequence[float]) -> Plane:
        """The plane without curvatures that have their centre about as near to `position` (n,) [m] as the surface."""
        if not self.curvatures:
            return self
        depth = self.depth(position)
        kept = tuple([curvature for curvature in self.curvatures if curvature.per_m * depth < FOLDED])
        return self if kept == self.curvatures else self._replace(curvatures=kept)


def checked(planes: Iterable[Plane], dof: int) -> tuple[Plane, ...]:
    """The first four of a user's planes (eight for a pose), checked and converted to plain floats.

    Raises InvalidParameter: a normal is not a unit vector of `dof` components, or a number is out of its range.
    """
    few = tuple(islice(planes, MOST_TOOL_PLANES if dof == POSE_AXES else MOST_PLANES))
    try:
        return _all_checked(few, dof)
    except TypeError:  # a list is not hashable
        return _all_checked.__wrapped__(few, dof)


@lru_cache  # planes are sent at each step, and walls mostly stand still
def _all_checked(planes: tuple[Plane, ...], dof: int) -> tuple[Plane, ...]:
    return tuple([_checked(Plane(*plane), dof) for plane in planes])


def _checked(plane: Plane, dof: int) -> Plane:
    normal = tuple(map(float, plane.normal))
    if len(normal) != dof or not abs(added([n * n for n in normal]) - 1.0) <= UNIT_TOLERANCE:
        raise InvalidParameter("a plane's normal", normal, f"a unit vector of {dof} components")
    offset, stiffness, damping, velocity = numbers = tuple(map(float, plane[1:5]))
    if not (all(map(math.isfinite, numbers)) and stiffness > 0.0 and damping >= 0.0):
        raise InvalidParameter(
            "a plane's offset, stiffness, damping, velocity", numbers, "finite, stiffness above 0, damping 0 or above"
        )
    if not 0.0 <= (friction := float(plane.friction)) <= MOST_FRICTION:
        raise InvalidParameter("a plane's friction", plane.friction, f"0 to {MOST_FRICTION:g}")
    try:
        bends = tuple([Curvature(tuple(map(float, direction)), float(per_m)) for direction, per_m in plane.curvatures])
    except (TypeError, ValueError):
        raise InvalidParameter("a plane's curvatures", plane.curvatures, "a direction and a number each") from None
    if wrong := wrong_curvatures(bends, normal):
        raise InvalidParameter("a plane's curvatures", bends, f"those of a surface ({wrong})")
    return Plane(normal, offset, stiffness, damping, velocity, bends, friction, _effects(plane.effects, dof))


def _effects(values: Sequence[Any] | None, dof: int) -> Effects | None:
    if values is None:
        return None
    try:
        viscosity, sticking, snap_N, snap_m, grain = values
        plain = None if grain is None else Grain(tuple(map(float, grain[0])), float(grain[1]), bytes(grain[2]))
        made = Effects(float(viscosity), float(sticking), float(snap_N), float(snap_m), plain)
        wrong = wrong_effects(made, dof)
    except (TypeError, ValueError, IndexError):
        raise InvalidParameter("a plane's effects", values, "an Effects") from None
    if wrong:
        raise InvalidParameter("a plane's effects", values, f"those of a surface ({wrong})")
    return made
