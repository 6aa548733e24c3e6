"""A flat piece of an obstacle's surface: all that a spring needs to know of an obstacle nearby."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from itertools import islice
from typing import NamedTuple

from hapnet.checks import MOST_PLANES, UNIT_TOLERANCE, Vector
from hapnet.errors import InvalidParameter


class Plane(NamedTuple):
    """A plane with a one-sided spring and damper behind it: solid where ``normal . x > offset_m``.

    stiffness, damping : of the solid, along the normal [N/m], [Ns/m].
    velocity_mps : of the plane along its normal [m/s]; 0: it stands still.
    """

    normal: Vector
    offset_m: float
    stiffness: float
    damping: float
    velocity_mps: float = 0.0


def checked(planes: Iterable[Plane], dof: int) -> tuple[Plane, ...]:
    """The first four of a user's planes, with plain floats.

    Raises
    ------
    InvalidParameter : a normal is not a unit vector of `dof` components, or a number is out of its range.
    """
    few = tuple(islice(planes, MOST_PLANES))
    try:
        return _all_checked(few, dof)
    except TypeError:  # a list cannot be looked up
        return _all_checked.__wrapped__(few, dof)


@lru_cache  # they are told at each step, and walls mostly stand still
def _all_checked(planes: tuple[Plane, ...], dof: int) -> tuple[Plane, ...]:
    return tuple([_checked(Plane(*plane), dof) for plane in planes])


def _checked(plane: Plane, dof: int) -> Plane:
    normal = tuple(map(float, plane.normal))
    if len(normal) != dof or not abs(sum([n * n for n in normal]) - 1.0) <= UNIT_TOLERANCE:
        raise InvalidParameter("a plane's normal", normal, f"a unit vector of {dof} components")
    offset, stiffness, damping, velocity = numbers = tuple(map(float, plane[1:]))
    if not (all(map(math.isfinite, numbers)) and stiffness > 0.0 and damping >= 0.0):
        raise InvalidParameter(
            "a plane's offset, stiffness, damping, velocity", numbers, "finite, stiffness above 0, damping not below"
        )
    return Plane(normal, offset, stiffness, damping, velocity)
