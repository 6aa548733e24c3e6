"""Parts that drivers of arms share: how much of a force their motors can give, and which force did a work."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hapnet.checks import Vector


def share(torques: Iterable[float], loads: Iterable[float], limits: Iterable[float]) -> float:
    """The largest multiple of `torques` up to 1 that motors with these limits can give beside the loads [Nm]."""
    found = 1.0
    for torque, load, limit in zip(torques, loads, limits, strict=True):
        if torque:
            found = min(found, max(0.0, limit - math.copysign(1.0, torque) * load) / abs(torque))
    return found


def paid(owed_J: float, force: Vector, moved: Vector, most_N: float) -> tuple[Vector, float]:
    """The force nearest to `force` [N] that does `owed_J` more work on the way `moved` [m], and what is still owed [J].

    It changes by at most `most_N`; where the arm moves too little to say which force did a work, the rest is owed.
    """
    if not (far := math.hypot(*moved)) > 0.0:
        return force, owed_J
    now_J = math.copysign(min(abs(owed_J), most_N * far), owed_J)
    return tuple([part + now_J / far * (along / far) for part, along in zip(force, moved, strict=True)]), owed_J - now_J
