"""The picture of a device's report (`hapnet doctor --share`): the checks, the wall that was felt, and a contact."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.ext.pictures.style import COLOURS, DEVICE_COLOR, WORLD_COLOR, save_figure, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LINE = 88
"""Characters of a line of text."""


def draw(report: Mapping[str, Any], path: Path) -> None:
    """Draw the picture of a report, and write it. Raises RecordingError: it cannot be written."""
    with sheet(160.0) as fig:
        panels = fig.subplot_mosaic("CC;FP", height_ratios=(1.0, 1.2))
        words = report["findings"] or ["nothing speaks against it"]
        fig.suptitle(textwrap.fill(f"{report['driver']}: {'; '.join(words)}", _LINE), fontsize=9.0)
        _write_checks(panels["C"], report)
        _draw_felt(panels["F"], report["runs"])
        _draw_contact(panels["P"], report["runs"])
        save_figure(fig, path)


def _write_checks(panel: Axes, report: Mapping[str, Any]) -> None:
    panel.axis("off")
    made = report["made_with"]
    lines = [
        f"hapnet {made['hapnet']}, Python {made['python']}, {made['system']}, {made['processors']} processors",
        "",
        *(f"{one['state']:<8} {one['name']:<20} {one['value']}" for one in report["checks"]),
        "",
        *(_run(link, run) for link, run in report["runs"].items()),
    ]
    whole = [part for line in lines for part in textwrap.wrap(line, _LINE, subsequent_indent=" " * 30) or [""]]
    panel.text(0.0, 1.0, "\n".join(whole), va="top", family="monospace", fontsize=7.0, transform=panel.transAxes)


def _run(link: str, run: Mapping[str, Any]) -> str:
    if run["exit_code"] != 0 or "passive" not in run:
        return f"{link:<8} exit code {run['exit_code']}"
    ticks = run["ticks"] + run["skipped"]
    passive = "passive" if run["passive"] else "not shown to be passive"
    felt = "" if run["felt_N_m"] is None else f", felt as {run['felt_N_m']:.0f} N/m"
    return (
        f"{link:<8} {passive}, {run['contacts']} contacts{felt}, at most {run['peak_force_N'] or 0.0:.1f} N, "
        f"{100.0 * run['modulated_share']:.1f} % modulated, {100.0 * run['skipped'] / max(1, ticks):.2f} % "
        f"of the ticks skipped, p99 of their lateness {run['late_p99_us'] or 0.0:.0f} us"
    )


def _draw_felt(panel: Axes, runs: Mapping[str, Any]) -> None:
    panel.set(title="force over position", xlabel="position [mm]", ylabel="force [N]")
    for (link, run), colour in zip(runs.items(), COLOURS, strict=False):
        if part := run.get("shown"):
            panel.plot(part["position_mm"], part["force_N"], ".", ms=2.0, color=colour, label=link)
            _draw_stiffness(panel, part, run, colour)
    if panel.lines:
        panel.legend(loc="best")


def _draw_stiffness(panel: Axes, part: Mapping[str, Any], run: Mapping[str, Any], colour: str) -> None:
    """The line of the stiffness that should be felt, through the middle of the contact."""
    x, force = (np.array(part[name]) for name in ("position_mm", "force_N"))
    touching = np.abs(force) > 0.2 * np.abs(force).max(initial=0.0)
    if run.get("felt_N_m") and touching.any():
        middle, pushed = np.median(x[touching]), np.median(force[touching])
        reach = np.ptp(x[touching]) / 2.0
        ends = np.array([middle - reach, middle + reach])
        panel.plot(ends, pushed - run["felt_N_m"] * 1e-3 * (ends - middle), "--", lw=0.8, color=colour)


def _draw_contact(panel: Axes, runs: Mapping[str, Any]) -> None:
    link, run = list(runs.items())[-1]
    panel.set(title=f"a contact over {link}", xlabel="time [s]", ylabel="position [mm]")
    if part := run.get("shown"):
        panel.plot(part["time_s"], part["set_position_mm"], color=WORLD_COLOR, label="set-position")
        panel.plot(part["time_s"], part["position_mm"], color=DEVICE_COLOR, label="device")
        panel.legend(loc="best")
