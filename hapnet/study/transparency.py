"""What couplings transmit of a wall over frequency, and the stiffest wall without limit cycles: the runs for these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import inf
from typing import Any, NamedTuple

from hapnet.metrics.impedance import Curve
from hapnet.params import RELAXED_HAND, Params
from hapnet.study import impedance
from hapnet.study.impedance import Transmission
from hapnet.study.stable_stiffness import Case, stiffest
from hapnet.study.z_width import ZWidth, z_width

Z_SEEDS = (0,)
HANDS: dict[str, dict[str, float]] = {"firm hand": {}, "relaxed hand": dict(RELAXED_HAND)}


class Task(NamedTuple):
    """One run, with `hand` one bisection of the Z-width, or with `case` one of the stiffest stable K."""

    coupling: str
    link: str
    params: Params
    seed: int
    hand: str | None = None
    case: Case | None = None


def run(tasks: Sequence[Task], progress: Callable[[float], None]) -> list[Transmission | ZWidth]:
    """Do these tasks, one after the other."""
    found: list[Transmission | ZWidth] = []
    for done, task in enumerate(tasks):
        progress(done / len(tasks))
        found.append(run_one(task))
    return found


def run_one(task: Task) -> Transmission | ZWidth:
    """Do this task."""
    if task.case is not None:
        return stiffest(task.case.of(task.params))
    if task.hand is None:
        return impedance.transmission(task.params, task.seed)
    return z_width(task.params.set(HANDS[task.hand]), Z_SEEDS)


def as_dict(curves: dict[tuple[str, str], Curve], widths: dict[tuple[str, str, str], ZWidth]) -> dict[str, Any]:
    """All of it for JSON; an infinite frequency is None: nowhere 3 dB off up to 20 Hz."""

    def finite(value: float) -> float | None:
        return None if value == inf else value

    return {
        "curves": [
            {
                "coupling": coupling, "link": link,
                "off_3dB_hz": {name: finite(value) for name, value in asdict(found.off_3dB_hz).items()},
                "frequency_hz": found.frequency_hz,
                "stiffness_N_per_m": [asdict(one) for one in found.stiffness],
                "damping_Ns_per_m": [asdict(one) for one in found.damping],
                "true_stiffness_N_per_m": [z.real for z in found.truth],
                "true_damping_Ns_per_m": found.true_damping,
            }
            for (coupling, link), found in curves.items()
        ],
        "z_width_N_per_m": [
            {"coupling": coupling, "link": link, "hand": hand, **found._asdict()}
            for (coupling, link, hand), found in widths.items()
        ],
    }  # fmt: skip
