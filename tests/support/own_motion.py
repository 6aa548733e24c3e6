"""How far a force or a set-position stepped beyond the part of the change that the own motion causes."""

from collections.abc import Sequence
from typing import Any

import numpy as np


def beyond(new: Sequence[float], old: Sequence[float], own: Sequence[float]) -> float:
    """The distance of `new` from the line from old to old + own."""
    start, way = np.asarray(old, dtype=float), np.asarray(own, dtype=float)
    to, square = np.asarray(new, dtype=float) - start, float(way @ way)
    share = float(np.clip(to @ way / square, 0.0, 1.0)) if square else 0.0
    return float(np.linalg.norm(to - share * way))


def largest_step(forces: Sequence[Any], positions: Sequence[Any], stiffness: float) -> float:
    """The largest step of the forces (N, n) [N] beyond the change that a spring [N/m] between the positions causes."""
    F, own = np.asarray(forces, dtype=float), -stiffness * np.diff(np.asarray(positions, dtype=float), axis=0)
    return max(beyond(*one) for one in zip(F[1:], F[:-1], own, strict=True))
