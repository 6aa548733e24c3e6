"""The stiffest wall that stays free of limit cycles: the upper end of the Z-width.

J. E. Colgate and J. M. Brown (Factors affecting the Z-width of a haptic display, 1994) define the Z-width as the range
of impedances that a display can render passively. As in their paper, it is found by trials: a hand presses into the
wall and holds still, and the force must come to rest (`hapnet.ext.metrics.force.limit_cycles`). The springs and the
wall are made stiffer together, so that the wall feels stiffer; bisection finds the stiffness from which on the force
does not come to rest. This assumes that a wall is free of limit cycles if a stiffer wall is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import sqrt
from typing import NamedTuple

from hapnet.assembly.choices import choosing
from hapnet.assembly.springs import spring
from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics.force import UNTIL_S, limit_cycles
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation

SPRINGS = ("device.stiffness", "world.stiffness", "world.wall.stiffness")
_PRESS: dict[str, object] = {
    "operator": "press", "operator_model.wait_s": 0.1, "operator_model.reach_s": 0.7, "operator_model.end_hold_s": 0.0
}  # fmt: skip
_HELD_S = UNTIL_S + 0.1


class ZWidth(NamedTuple):
    """The two stiffnesses of the wall as it is felt [N/m] between which limit cycles begin.

    free : the largest tried stiffness without a limit cycle; None: the smallest stiffness has a limit cycle already.
    cycles : the smallest tried stiffness with a limit cycle; None: the largest stiffness has none.
    """

    free: float | None
    cycles: float | None


def z_width(
    params: Params,
    seeds: Iterable[int],
    *,
    least: float = 0.05,
    most: float = 50.0,
    ratio: float = 1.05,
    springs: Sequence[str] = SPRINGS,
) -> ZWidth:
    """The stiffest wall for which no seed ends in a limit cycle, within a factor of `ratio`.

    All `springs` are multiplied by the same factor, between `least` and `most`; a stiffness is as it would be felt over
    an ideal link (`ideal_stiffness`). The hand is set by `params` and presses to `operator_model.goal_m`; its
    schedule and the duration are set here.

    Raises HapnetError, netem.NetemError: the parameters do not make a run.
    """
    timing = {"operator_model.hold_s": _HELD_S, "duration_s": 0.8 + _HELD_S, "record_hz": params.device.servo_hz}
    servo = {"device.servo": "sampled"} if params.device.servo == "auto" else {}
    pressing, tried = choosing(params.set({**_PRESS, **timing, **servo}), spring), tuple(seeds)

    def scaled(factor: float) -> Params:
        return pressing.set({name: factor * pressing.get(name) for name in springs})

    def free(factor: float) -> bool:
        run = scaled(factor)
        return not any(limit_cycles(Simulation(run, seed).run().recording) for seed in tried)

    def felt(factor: float | None) -> float | None:
        return None if factor is None else ideal_stiffness(run := scaled(factor), run.world.wall.stiffness)

    felt(1.0)  # refuses springs that are no numbers at once
    found = maximum(free, least, most, ratio)
    return ZWidth(felt(found.free), felt(found.cycles))


def maximum(free: Callable[[float], bool], least: float, most: float, ratio: float) -> ZWidth:
    """Bisect, on a log scale from `least` to `most`, for the end of `free`, until both bounds are within `ratio`."""
    if not 0.0 < least < most:
        raise InvalidParameter("least", least, f"above 0 and below {most:g}, the largest")
    if not ratio > 1.0:
        raise InvalidParameter("ratio", ratio, "above 1")
    if not free(least):
        return ZWidth(None, least)
    if free(most):
        return ZWidth(most, None)
    low, high = least, most
    while high > low * ratio:
        middle = sqrt(low) * sqrt(high)
        low, high = (middle, high) if free(middle) else (low, middle)
    return ZWidth(low, high)
