"""A flat piece of an obstacle's surface: all that a spring needs to know of an obstacle nearby."""

from __future__ import annotations

from typing import NamedTuple

from hapnet.checks import Vector


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
