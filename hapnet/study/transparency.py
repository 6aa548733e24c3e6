"""What couplings transmit of a wall over frequency, and the stiffest wall without limit cycles."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import inf, pi
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from hapnet.params import RELAXED_HAND, Params
from hapnet.reports.style import MM, STYLE
from hapnet.study import impedance
from hapnet.study.figures import COLOURS
from hapnet.study.impedance import MOST_HZ, Curve, Transmission
from hapnet.study.impedance import Figure as Spread
from hapnet.study.stable_stiffness import Case, stiffest
from hapnet.study.z_width import ZWidth, z_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STIFFNESS_SHOWN, DAMPING_SHOWN = (-0.7, 1.9), (-12.0, 12.0)
"""Ranges of the figure's axes: shares of the true wall's stiffness, and [Ns/m]."""

TICKS_HZ = (0.5, 1, 2, 5, 10, 20)

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
                "true_damping_Ns_per_m": _damping(found),
            }
            for (coupling, link), found in curves.items()
        ],
        "z_width_N_per_m": [
            {"coupling": coupling, "link": link, "hand": hand, **found._asdict()}
            for (coupling, link, hand), found in widths.items()
        ],
    }  # fmt: skip


def draw(curves: dict[tuple[str, str], Curve]) -> Figure:
    """One column per link: stiffness and damping over frequency, with quartiles, beside the true wall's."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    links = list(dict.fromkeys(link for _, link in curves))
    with mpl.rc_context(STYLE):
        made = Figure(figsize=(180.0 * MM, 120.0 * MM), layout="constrained")
        axes = made.subplots(2, len(links), sharex=True, sharey="row", squeeze=False)
        for column, link in enumerate(links):
            shown = {coupling: found for (coupling, over), found in curves.items() if over == link}
            above, below = axes[0][column], axes[1][column]
            for colour, (coupling, found) in zip(COLOURS, shown.items(), strict=False):
                _line(above, found.frequency_hz, found.stiffness, colour, coupling)
                _line(below, found.frequency_hz, found.damping, colour, coupling)
            any_of = next(iter(shown.values()))
            for axis, truth in ((above, [z.real for z in any_of.truth]), (below, _damping(any_of))):
                axis.semilogx(any_of.frequency_hz, truth, "k--", label="true wall, through the springs")
            best, off = min(((name, _off(one)) for name, one in shown.items()), key=itemgetter(1))
            said = f"{link}: {best} shows the wall's stiffness within {100.0 * off:.2g} %"
            above.set_title("\n".join(textwrap.wrap(said, 100 // len(links))), parse_math=False)
            below.set_xlabel("frequency [Hz]")
            below.set_xlim(any_of.frequency_hz[0], MOST_HZ)
            below.set_xticks(TICKS_HZ, map(str, TICKS_HZ))
            below.minorticks_off()
        truest = max(z.real for found in curves.values() for z in found.truth)
        axes[0][0].set_ylim(*(share * truest for share in STIFFNESS_SHOWN))
        axes[1][0].set_ylim(*DAMPING_SHOWN)
        axes[0][0].set_ylabel("transmitted stiffness [N/m]")
        axes[1][0].set_ylabel("transmitted damping [Ns/m]")
        handles, labels = axes[0][0].get_legend_handles_labels()
        made.legend(handles, labels, loc="outside lower center", ncols=5)
    return made


def _off(found: Curve) -> float:
    """By how much the median stiffness differs from the true wall's, at most, as a share of that."""
    pairs = zip(found.stiffness, found.truth, strict=True)
    return max((abs(one.median - z.real) / z.real for one, z in pairs if z.real > 0.0), default=inf)


def _line(axis: Axes, x: Sequence[float], values: Sequence[Spread], colour: str, label: str) -> None:
    axis.semilogx(x, [one.median for one in values], color=colour, label=label)
    low, high = [one.q1 for one in values], [one.q3 for one in values]
    axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0.0)


def _damping(found: Curve) -> list[float]:
    return [z.imag / (2.0 * pi * f) for z, f in zip(found.truth, found.frequency_hz, strict=True)]
