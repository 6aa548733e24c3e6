"""Functions for drivers of arms: a force's share within the motors' limits, and the force that did a given work."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hapnet.checks import Vector


def share(torques: Iterable[float], loads: Iterable[float], limits: Iterable[float]) -> float:
    """The largest factor up to 1 at which motors with these limits can add `torques` to the loads [Nm]."""
    factor = 1.0
    for torque, load, limit in zip(torques, loads, limits, strict=True):
        if torque:
            factor = min(factor, max(0.0, limit - math.copysign(1.0, torque) * load) / abs(torque))
    return factor


def paid(owed_J: float, force: Vector, moved: Vector, most_N: float) -> tuple[Vector, float]:
    """The force nearest to `force` [N] that does `owed_J` more work along `moved` [m], and the work still owed [J].

    It differs by at most `most_N`; if the arm moves too little to assign all the work to a force, the rest stays owed.
    """
    if not (far := math.hypot(*moved)) > 0.0:
        return force, owed_J
    now_J = math.copysign(min(abs(owed_J), most_N * far), owed_J)
    return tuple([part + now_J / far * (along / far) for part, along in zip(force, moved, strict=True)]), owed_J - now_J
