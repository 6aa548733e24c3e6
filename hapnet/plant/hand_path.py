"""The path of a hand's reference over many ticks, at once where its kind allows it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet.checks import Array
from hapnet.plant.operator import Operator


def hand_path(operator: Operator, times: Array) -> Array:
    """Where the hand aims at these times [s], which increase, (N, n) [m]: what `reference` gives, bit by bit.

    A kind of hand that can compute many points at once has a method `path`, with the same arguments and result.
    """
    many: Callable[[Array], Array] | None = getattr(operator, "path", None)
    if many is not None:
        return many(times)
    return np.array([operator.reference(t) for t in times.tolist()])
