"""Figures of the transmitted impedance of a wall over frequency, and of a device's stiffest stable spring over its
damping.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapnet.ext.metrics.impedance import Curve, Quartiles
from hapnet.ext.pictures.style import COLOURS, sheet
from hapnet.mechanics.pose import ARM_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STIFFNESS_SHOWN, DAMPING_SHOWN = (-0.7, 1.9), (-12.0, 12.0)
"""Ranges of the figure's axes: shares of the true wall's stiffness, and [Ns/m]."""

TICKS_HZ = (0.5, 1, 2, 5, 10, 20)


def transmitted(curves: dict[tuple[str, str], Curve], motion: str = "") -> Figure:
    """A column for each link: stiffness and damping over frequency, with quartiles, and those of the true wall.

    motion : of a tool, if these are its curves.
    """
    links = list(dict.fromkeys(link for _, link in curves))
    turns, thing = any(one.turns for one in curves.values()), "tool" if motion else "wall"
    units = ("Nm/rad", "Nms/rad") if turns else ("N/m", "Ns/m")
    with sheet(120) as fig:
        axes = fig.subplots(2, len(links), sharex=True, sharey="row", squeeze=False)
        for column, link in enumerate(links):
            shown = {coupling: found for (coupling, over), found in curves.items() if over == link}
            above, below = axes[0][column], axes[1][column]
            widths = np.linspace(2.6, 1.0, len(shown))  # so that a line is visible under another line
            for colour, width, (coupling, found) in zip(cycle(COLOURS), widths, shown.items(), strict=False):
                style = {"color": colour, "linewidth": width}
                _line(above, found.frequency_hz, found.stiffness, coupling, style)
                _line(below, found.frequency_hz, found.damping, coupling, style)
            any_of = next(iter(shown.values()))
            for axis, truth in ((above, [z.real for z in any_of.truth]), (below, any_of.true_damping)):
                axis.semilogx(any_of.frequency_hz, truth, "k--", label=f"true {thing}, through the springs")
            off, best = min((one.off, name) for name, one in shown.items())
            heading = f"{link}: {best} shows the {thing}'s stiffness within {100.0 * off:.2g} %"
            if motion:
                heading = f"{motion.replace('-', ' ')}, {heading}"
            above.set_title(fill(heading, 100 // len(links)), parse_math=False)
            below.set_xlabel("frequency [Hz]")
            below.set_xlim(any_of.frequency_hz[0], TICKS_HZ[-1])
            below.set_xticks(TICKS_HZ, map(str, TICKS_HZ))
            below.minorticks_off()
        true = [z.real for found in curves.values() for z in found.truth]
        low, high = (share * max(map(abs, true)) for share in STIFFNESS_SHOWN)
        axes[0][0].set_ylim(min(low, 1.2 * min(true)), high)
        axes[1][0].set_ylim(*(2.0 * ARM_M**2 * bound if turns else bound for bound in DAMPING_SHOWN))
        axes[0][0].set_ylabel(f"transmitted stiffness [{units[0]}]")
        axes[1][0].set_ylabel(f"transmitted damping [{units[1]}]")
        handles, labels = axes[0][0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=5)
    return fig


def _line(axis: Axes, x: Sequence[float], values: Sequence[Quartiles], label: str, style: dict[str, Any]) -> None:
    axis.semilogx(x, [one.median for one in values], label=label, **style)
    low, high = [one.q1 for one in values], [one.q3 for one in values]
    axis.fill_between(x, low, high, color=style["color"], alpha=0.15, linewidth=0.0)


class Springs(NamedTuple):
    """The stiffest stable K [N/m] by own damping [Ns/m], at a servo rate [Hz]; `style` of marks and line."""

    name: str
    servo_hz: float
    stable: Mapping[float, float]
    style: str


def stable_springs(
    found: Sequence[Springs], bound: Callable[[float, float], float], dampings: tuple[float, float]
) -> Figure:
    """A panel for each servo rate: the stiffest stable K over the device's own damping, and the bound from theory.

    bound : returns [N/m] for an own damping and a servo rate. dampings : the range in which it is drawn.
    """
    rates = list(dict.fromkeys(one.servo_hz for one in found))
    colours = dict(zip(dict.fromkeys(one.name for one in found), cycle(COLOURS), strict=False))
    with sheet(80) as fig:
        panels = fig.subplots(1, len(rates), sharey=True, squeeze=False)[0]
        for panel, hz in zip(panels, rates, strict=True):
            for one in found:
                if one.servo_hz == hz:
                    b, K = list(one.stable), list(one.stable.values())
                    panel.plot(b, K, one.style, color=colours[one.name], label=one.name, markerfacecolor="none")
            b = np.linspace(*dampings, 200)[2:].tolist()
            panel.plot(b, [bound(one, hz) for one in b], "k--", label="passive with any hand: K < 2 (b - B)/T")
            panel.set(title=f"{hz:g} Hz", xscale="log", yscale="log", xlabel="own damping b [Ns/m]")
        panels[0].set_ylabel("stiffest stable K [N/m]")
        handles, labels = panels[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=3)
    return fig
