"""One case of a study: parameters and a seed, and what was measured."""

from __future__ import annotations

from hapnet.params import Params
from hapnet.runtime.virtual import simulate

Measures = dict[str, float | None]
"""Values by the names of their metrics; None where a run cannot tell."""


def measure(params: Params, seed: int) -> Measures:
    """Simulate, and measure.

    Raises
    ------
    HapnetError, netem.NetemError : the parameters do not make a run, or the sides did not find each other.
    """
    result = simulate(params, seed)
    return {"margin_J": result.summary["theorem"]["margin_J"], **result.summary["motion"]}
