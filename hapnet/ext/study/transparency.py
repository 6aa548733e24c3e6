"""Measures the transmitted impedance of a wall over frequency, and the stiffest wall without limit cycles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import inf
from typing import Any, NamedTuple

from hapnet.ext.metrics.impedance import Curve
from hapnet.ext.study import impedance
from hapnet.ext.study.impedance import Transmission
from hapnet.ext.study.stable_stiffness import StiffnessCase, stiffest
from hapnet.ext.study.z_width import ZWidth, z_width
from hapnet.params import RELAXED_HAND, Params

Z_SEEDS = (0,)
HANDS: dict[str, dict[str, float]] = {"firm hand": {}, "relaxed hand": dict(RELAXED_HAND)}


class SearchTask(NamedTuple):
    """A run or, with `hand`, a bisection for the Z-width or, with `case`, a bisection for the stiffest stable K.

    motion : of a run, as in `impedance.transmission`.
    """

    coupling: str
    link: str
    params: Params
    seed: int
    hand: str | None = None
    case: StiffnessCase | None = None
    motion: str = ""


def run(tasks: Sequence[SearchTask], progress: Callable[[float], None]) -> list[Transmission | ZWidth]:
    """Run these tasks, one after the other."""
    found: list[Transmission | ZWidth] = []
    for done, task in enumerate(tasks):
        progress(done / len(tasks))
        found.append(run_one(task))
    return found


def run_one(task: SearchTask) -> Transmission | ZWidth:
    """Run this task."""
    if task.case is not None:
        return stiffest(task.case.of(task.params))
    if task.hand is None:
        return impedance.transmission(task.params, task.seed, motion=task.motion)
    return z_width(task.params.set(HANDS[task.hand]), Z_SEEDS)


Curves = dict[tuple[str, str, str], Curve]
"""Curves by coupling, link and motion (empty: into a wall)."""


def as_dict(curves: Curves, widths: dict[tuple[str, str, str], ZWidth]) -> dict[str, Any]:
    """The results for JSON; None for an infinite frequency: nowhere 3 dB off up to 20 Hz."""

    def finite(value: float) -> float | None:
        return None if value == inf else value

    def one_of(coupling: str, link: str, motion: str, found: Curve) -> dict[str, Any]:
        stiffness, damping = ("Nm_per_rad", "Nms_per_rad") if found.turns else ("N_per_m", "Ns_per_m")
        return {
            "coupling": coupling, "link": link, **({"motion": motion} if motion else {}),
            "off_3dB_hz": {name: finite(value) for name, value in asdict(found.off_3dB_hz).items()},
            "frequency_hz": found.frequency_hz,
            f"stiffness_{stiffness}": [asdict(one) for one in found.stiffness],
            f"damping_{damping}": [asdict(one) for one in found.damping],
            f"true_stiffness_{stiffness}": [z.real for z in found.truth],
            f"true_damping_{damping}": found.true_damping,
        }  # fmt: skip

    return {
        "curves": [one_of(*names, found) for names, found in curves.items()],
        "z_width_N_per_m": [
            {"coupling": coupling, "link": link, "hand": hand, **found._asdict()}
            for (coupling, link, hand), found in widths.items()
        ],
    }
