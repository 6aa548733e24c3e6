"""A force law solved together with a step: the mean velocity w and the force f with ``w = w_0 + G f``, ``f = F(w)``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet.checks import Array

_ROUNDS = 8
"""The greatest number of Newton rounds; a spring with a surface takes four."""

_PROBE_MPS = 1e-6
"""The change of a velocity for a difference quotient of the force [m/s]."""

_SOLVED = 1e-12
"""A change below this share of the velocities is rounding."""


def solved(law: Callable[[Array], Array], free: Array, compliance: Array, axes: int) -> Array:
    """The force f [N], by Newton's method with differences.

    It is the force of the last linearisation, so w and f satisfy the step exactly even if the law has a jump and the
    method does not converge.

    law : F, returns (m,) for w of shape (m,). It consists of blocks of `axes` components, each a function of its own
        components of w. free : w_0 (m,). compliance : G (m, m), positive definite.
    """
    w, size = free, len(free)
    force = law(w)
    if not force.any():
        return force
    linear: Array = force
    for _ in range(_ROUNDS):
        J = np.zeros((size, size))
        for axis in range(axes):
            probe = w.copy()
            probe[axis::axes] += _PROBE_MPS
            change: Array = (law(probe) - force) / _PROBE_MPS
            for i in range(0, size, axes):
                J[i : i + axes, i + axis] = change[i : i + axes]
        slope = _resisting(J)
        system: Array = np.eye(size) - compliance @ slope
        known: Array = free + compliance @ (force - slope @ w)
        after: Array = np.array(np.linalg.solve(system, known), dtype=np.float64)
        moved = float(np.abs(after - w).max())
        linear = force + slope @ (after - w)
        if moved <= _SOLVED * (1.0 + float(np.abs(w).max())):
            break
        w, force = after, law(after)
    return linear


def _resisting(J: Array) -> Array:
    """J without its parts that push along with the motion, so that the step has a solution for any law."""
    values, basis = np.linalg.eigh(0.5 * (J + J.T))
    if values[-1] <= 0.0:
        return J
    resisting: Array = J - (basis * np.maximum(values, 0.0)) @ basis.T
    return resisting
