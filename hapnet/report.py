"""What people look at after a run: a figure of four panels against time, and the summary as a table."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapnet.errors import RecordingError
from hapnet.record import Columns, Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType
    from rich.table import Table

ROUNDING_J = 1e-9
"""A margin is called negative below minus this [J]: what minutes of double precision may add up to."""

_NOTHING_J = 1e-12  # printed as 0: rounding
_MM = 1 / 25.4
_POINTS = 4000  # a curve keeps at most about this many: more than the paper can resolve
_STYLE: dict[Any, Any] = {  # Any: matplotlib types its keys as literals
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.grid": True,
    "grid.linewidth": 0.4,
    "grid.color": "0.85",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "hatch.linewidth": 0.4,
    "path.simplify_threshold": 0.2,
}
# device, proxy (or world), and the thinner third: told apart by dash and grey value as well as by hue
_DEVICE: dict[str, Any] = {"color": "#08306b", "linestyle": "-"}
_WORLD: dict[str, Any] = {"color": "#e6550d", "linestyle": (0, (5, 1.5))}
_THIRD: dict[str, Any] = {"color": "0.35", "linestyle": (0, (1, 1.2)), "linewidth": 0.8}


def figure(recording: Recording) -> Figure:
    """Positions, forces, reservoirs and passivity margin against time, 180 mm wide.

    With several axes, positions and forces are drawn along one: the axis along which the contact force is largest on
    average or, if there was no contact, along which the device moved most. It is named in the panels' labels. The path
    in the plane is added for the scene ``paper`` and whenever the device moves along two axes.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    axis = _main_axis(recording)
    plane = _plane(recording, axis)
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(180 * _MM, (200 if plane is None else 280) * _MM), dpi=150, layout="constrained")
        FigureCanvasAgg(fig)
        fig.suptitle(_title(recording), fontsize=9)
        ratios = [1.25, 1.0, 0.9, 0.9] + ([] if plane is None else [1.7])
        grid = fig.add_gridspec(len(ratios), 1, height_ratios=ratios)
        panels = [fig.add_subplot(grid[0])]
        panels += [fig.add_subplot(grid[row], sharex=panels[0]) for row in (1, 2, 3)]
        _positions(panels[0], recording, axis)
        _forces(panels[1], recording, axis)
        _reservoirs(panels[2], recording)
        _margins(panels[3], recording)
        for panel in panels[:3]:
            panel.tick_params(labelbottom=False)
        panels[3].set_xlabel("time [s]")
        panels[0].margins(x=0.01)
        if plane is not None:
            _path(fig.add_subplot(grid[4]), recording, plane)
        for panel in fig.axes:
            _legend(panel)
    return fig


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write `fig` as a PNG that appears only when it is complete. Raises `RecordingError` if it cannot be written."""
    target = Path(path)
    part = target.with_name(target.name + ".part")
    try:
        fig.savefig(part, format="png", dpi=150)
        part.replace(target)
    except OSError as error:
        raise RecordingError(f"cannot write figure {target}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def verdict(summary: Mapping[str, Any] | None) -> str:
    """One line: whether the two ports stayed passive, and by how much of the bound d^2."""
    theorem = _get(summary, "theorem")
    margin, bound = _get(theorem, "margin_J"), _get(theorem, "bound_J")
    who = ""
    if margin is None:  # one process knows its own half only
        halves = {side: _get(summary, side, "ledger", "margin_J") for side in ("device", "world")}
        known = {side: value for side, value in halves.items() if value is not None}
        if not known:
            return "passivity unknown: no ledger"
        who = "both halves " if len(known) == 2 else f"{next(iter(known))}'s half "
        margin = sum(known.values())
        bounds = [_get(summary, side, "ledger", "bound_J") for side in known]
        bound = None if None in bounds else sum(bounds)
    of = "" if bound is None else f" of d² = {_milli(bound)} mJ"
    if margin < -ROUNDING_J:
        return f"{who}NOT passive: margin {_millijoule(margin)} mJ{of}"
    return f"{who}passive: margin ≥ {_millijoule(margin)} mJ{of}"


def summary_text(summary: Mapping[str, Any]) -> RenderableType:
    """The summary object as a table for people: verdict, both sides, motion, links; ``-`` where a value is unknown."""
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    line = verdict(summary)
    style = "bold red" if "NOT" in line else "bold yellow" if "unknown" in line else "bold green"
    layout: dict[str, Any] = {"title_justify": "left", "box": box.SIMPLE_HEAD, "pad_edge": False}
    sides = Table("", "device", "world", title="sides", **layout)
    for label, unit, path, convert in (
        ("margin, least", "mJ", ("ledger", "margin_J"), _millijoule),
        ("slack, least", "mJ", ("ledger", "slack_J"), _millijoule),
        ("true slack, least", "mJ", ("true_slack_J",), _millijoule),
        ("reservoir, least", "mJ", ("reservoir_min_J",), _millijoule),
        ("deficit, largest", "mJ", ("deficit_max_J",), _millijoule),
        ("sent", "J", ("sent_nJ",), _exact_joule),
        ("credited", "J", ("credited_nJ",), _exact_joule),
        ("discarded", "J", ("discarded_nJ",), _exact_joule),
        ("abandoned", "J", ("abandoned_nJ",), _exact_joule),
        ("quantisation", "mJ", ("quantisation_J",), _millijoule),
        ("pairs", "", ("incarnations",), _number),
        ("initial energy of its peers", "mJ", ("peers_J",), _milli),
        ("silences", "", ("outages", "count"), _number),
        ("longest silence", "s", ("outages", "longest_s"), _number),
        ("slowest recovery", "ms", ("outages", "recovery_max_s"), _milli),
        ("positions lost or overtaken", "", ("missing",), _number),
        ("servo ticks", "", ("servo", "ticks"), _number),
        ("servo late p50", "µs", ("servo", "late_p50_us"), _number),
        ("servo late p99", "µs", ("servo", "late_p99_us"), _number),
        ("servo skipped", "", ("servo", "skipped"), _number),
        ("steps", "", ("step", "count"), _number),
        ("step mean", "ms", ("step", "mean_s"), _milli),
        ("step longest", "ms", ("step", "max_s"), _milli),
    ):
        _add_known(sides, label, unit, convert, [_get(summary, side, *path) for side in ("device", "world")])
    links = Table("", "up", "down", title="links (up: from the device)", **layout)
    for label, unit, key, convert in (
        ("energy sent", "J", "sent_nJ", _exact_joule),
        ("energy credited", "J", "credited_nJ", _exact_joule),
        ("energy in flight", "J", "in_flight_nJ", _exact_joule),
        ("energy abandoned", "J", "abandoned_nJ", _exact_joule),
    ):
        _add_known(links, label, unit, convert, [_get(summary, "energy", way, key) for way in ("up", "down")])
    ways = [_get(summary, "links", way) for way in ("up", "down")]
    _add_known(links, "asked", "", _text, [_get(way, "profile") for way in ways])
    for label, unit, key in (
        ("delay p50", "ms", "delay_p50_ms"),
        ("delay p99", "ms", "delay_p99_ms"),
        ("released late, most", "ms", "late_max_ms"),
        ("packets offered", "", "offered"),
        ("delivered", "", "delivered"),
        ("reordered", "", "reordered"),
    ):
        _add_known(links, label, unit, _number, [_get(way, key) for way in ways])
    _add_known(links, "lost", "%", _text, [_loss(way) for way in ways])
    motion = Table("", "", title="motion", show_header=False, **layout)
    for label, unit, key, convert in (
        ("position error, free (rms)", "mm", "free_rms_m", _milli),
        ("position error, in contact (rms)", "mm", "contact_rms_m", _milli),
        ("penetration, largest", "mm", "peak_penetration_m", _milli),
        ("force, largest", "N", "peak_force_N", _number),
        ("contacts", "", "contacts", _number),
    ):
        _add_known(motion, label, unit, convert, [_get(summary, "motion", key)])
    for table in (sides, links, motion):
        for column in table.columns[1:]:
            column.justify = "right"
    about = ", ".join(
        f"{name} {value}"
        for name, value in (
            ("coupling", _get(summary, "coupling")),
            ("seed", _get(summary, "seed")),
            ("duration", None if _get(summary, "duration_s") is None else f"{_number(summary['duration_s'])} s"),
        )
        if value is not None
    )
    return Group(Text(line, style=style), Text(about), *(table for table in (sides, links, motion) if table.row_count))


def _positions(panel: Axes, recording: Recording, axis: int) -> None:
    device, world = recording.device, recording.world
    _shade_contact(panel, world)
    if device is not None:
        _curve(panel, device, device["position_m"][:, axis] * 1e3, "device", **_DEVICE)
    if world is not None:
        _curve(panel, world, world["position_m"][:, axis] * 1e3, "proxy", **_WORLD)
    modulated = device if device is not None else world
    if modulated is not None:
        name = "device's" if device is not None else "world's"
        y = modulated["set_position_m"][:, axis] * 1e3
        _curve(panel, modulated, y, f"{name} set-position (modulated)", drawstyle="steps-post", **_THIRD)
    panel.set_ylabel(f"position{_along(recording, axis)} [mm]")


def _forces(panel: Axes, recording: Recording, axis: int) -> None:
    device, world = recording.device, recording.world
    _shade_contact(panel, world)
    if device is not None:
        _curve(panel, device, device["force_N"][:, axis], "coupling on the device", **_DEVICE)
    if world is not None:
        y = world["contact_force_N"][:, axis]
        _curve(panel, world, y, "contact on the proxy", drawstyle="steps-post", **_WORLD)
    panel.set_ylabel(f"force{_along(recording, axis)} [N]")


def _reservoirs(panel: Axes, recording: Recording) -> None:
    for columns, label, style in ((recording.device, "device", _DEVICE), (recording.world, "world", _WORLD)):
        if columns is not None:
            _curve(panel, columns, columns["reservoir_J"] * 1e3, label, drawstyle="steps-post", **style)
    panel.set_ylabel("reservoir [mJ]")
    panel.set_ylim(bottom=0.0)


def _margins(panel: Axes, recording: Recording) -> None:
    device, world = recording.device, recording.world
    low = 0.0
    for columns, label, style in ((device, "device's half", _DEVICE), (world, "world's half", _WORLD)):
        if columns is not None:
            low = min(low, _least(columns["margin_J"]) * 1e3)
            _curve(panel, columns, columns["margin_J"] * 1e3, label, drawstyle="steps-post", **style)
    if (total := _total_margin(recording)) is not None:
        low = min(low, _least(total["margin_J"]) * 1e3)
        known = _get(recording.summary, "theorem", "margin_J")
        label = "sum" if known is None else f"sum (theorem's margin: {_millijoule(known)} mJ)"
        _curve(panel, total, total["margin_J"] * 1e3, label, color="black", linestyle="-.", linewidth=0.9)
    top = panel.get_ylim()[1]
    bottom = low * 1.1 - 0.08 * (top - low)
    panel.set_ylim(bottom, top)
    panel.axhspan(bottom, 0.0, facecolor="#fcbba1", edgecolor="#cb181d", hatch="////", alpha=0.6, lw=0, zorder=0)
    panel.axhline(0.0, color="#cb181d", linewidth=1.0)
    panel.set_ylabel("passivity margin [mJ]")


def _path(panel: Axes, recording: Recording, plane: tuple[int, int]) -> None:
    first, second = plane
    if (device := recording.device) is not None:
        path = device["position_m"][:: _stride(device)] * 1e3
        panel.plot(path[:, first], path[:, second], label="device", **{**_DEVICE, "linewidth": 2.4, "alpha": 0.35})
    if (world := recording.world) is not None:
        path, label = world["position_m"] * 1e3, "proxy"
        if _written(recording) and (inside := world["penetration_m"] > 0.0).any():
            path, label = np.where(inside[:, None], path, np.nan), "proxy, where it touched"
        path = path[:: _stride(world)]
        panel.plot(path[:, first], path[:, second], label=label, color=_WORLD["color"], linewidth=0.9)
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel(f"{'xyz'[first]} [mm]")
    panel.set_ylabel(f"{'xyz'[second]} [mm]")


def _total_margin(recording: Recording) -> Columns | None:
    """Margin of both ports together at the device's times, the world's held between its steps; needs one clock."""
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    latest = np.searchsorted(world["time_s"], device["time_s"], side="right") - 1
    known = latest >= 0
    total = device["margin_J"][known] + world["margin_J"][latest[known]]
    return {"time_s": device["time_s"][known], "margin_J": total}


def _curve(panel: Axes, columns: Columns, values: NDArray[np.float64], label: str, **style: Any) -> None:
    kept = _envelope(values)
    panel.plot(columns["time_s"][kept], values[kept], label=label, **style)


def _envelope(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices to draw: all of them or, of a long curve, the least and the greatest value of each short stretch."""
    if len(values) <= _POINTS:
        return np.arange(len(values))
    stretches = np.array_split(np.arange(len(values)), _POINTS // 2)
    kept = [stretch[int(pick(values[stretch]))] for stretch in stretches for pick in (np.argmin, np.argmax)]
    return np.unique(np.array([0, *kept, len(values) - 1], dtype=np.intp))


def _shade_contact(panel: Axes, world: Columns | None) -> None:
    if world is not None and (inside := world["penetration_m"] > 0.0).any():
        whole_height = panel.get_xaxis_transform()
        style: dict[str, Any] = {"color": "0.9", "linewidth": 0, "zorder": 0, "label": "contact"}
        panel.fill_between(world["time_s"], 0, 1, where=inside, step="post", transform=whole_height, **style)


def _legend(panel: Axes) -> None:
    """Above the panel, where it cannot cover data."""
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        style = {"ncols": len(handles), "handlelength": 2.6, "borderaxespad": 0.1, "columnspacing": 1.4}
        panel.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=8, **style)


def _main_axis(recording: Recording) -> int:
    device, world = recording.device, recording.world
    if world is not None and (pressed := np.nansum(np.abs(world["contact_force_N"]), axis=0)).any():
        return int(np.argmax(pressed))
    columns = device if device is not None else world
    return 0 if columns is None else int(np.argmax(np.ptp(columns["position_m"], axis=0)))


def _plane(recording: Recording, axis: int) -> tuple[int, int] | None:
    """The plane to draw the path in: across the main axis for three axes. None if the motion is along a line."""
    columns = recording.device if recording.device is not None else recording.world
    if columns is None or (n := columns["position_m"].shape[1]) < 2:
        return None
    first, second = [i for i in range(n) if n == 2 or i != axis][:2]
    extent = np.ptp(columns["position_m"], axis=0)
    both = min(extent[first], extent[second]) > 0.05 * extent.max() > 0.0
    return (first, second) if _written(recording) or both else None


def _written(recording: Recording) -> bool:
    return bool(_get(recording.meta, "params", "scene") == "paper")


def _stride(columns: Columns) -> int:
    return max(1, len(columns["time_s"]) // (2 * _POINTS))


def _along(recording: Recording, axis: int) -> str:
    columns = recording.device if recording.device is not None else recording.world
    n = 1 if columns is None else columns["position_m"].shape[1]
    return "" if n == 1 else f" along {'xyz'[axis] if n <= 3 else axis + 1}"


def _title(recording: Recording) -> str:
    summary, meta = recording.summary or {}, recording.meta
    up, down = (_get(summary, "links", way, "profile") or _get(meta, "links", way) for way in ("up", "down"))
    asked = {"link": up} if up == down else {"uplink": up, "downlink": down}
    words = [f"{name}: {profile}" for name, profile in asked.items() if profile is not None]
    for name in ("coupling", "seed"):
        value = summary.get(name, meta.get(name))
        words += [] if value is None else [f"{name}\N{NO-BREAK SPACE}{value}"]
    about = (line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(", ".join(words), 100))
    return "\n".join([*about, verdict(_known(recording))])


def _known(recording: Recording) -> Mapping[str, Any]:
    """The summary or, where there is none (a torn file), what the samples tell."""
    if recording.summary is not None:
        return recording.summary
    if (total := _total_margin(recording)) is not None and len(total["margin_J"]):
        return {"theorem": {"margin_J": _least(total["margin_J"])}}
    sides = {"device": recording.device, "world": recording.world}
    return {s: {"ledger": {"margin_J": _least(c["margin_J"])}} for s, c in sides.items() if c is not None}


def _least(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else 0.0


def _get(tree: Any, *keys: str) -> Any:
    """`tree[key][key]...`, or None where the branch ends early."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def _add_known(table: Table, label: str, unit: str, convert: Callable[[Any], str], values: list[Any]) -> None:
    """A row of `table`, unless nothing of it is known."""
    if any(value is not None for value in values):
        table.add_row(f"{label} \\[{unit}]" if unit else label, *map(convert, values))


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _milli(value: float | None) -> str:
    """Joules, metres or seconds in thousandths."""
    return _number(None if value is None else value * 1e3 if value else 0)


def _millijoule(value: float | None) -> str:
    """As `_milli`; what is pure rounding is 0."""
    return _milli(0 if value is not None and abs(value) < _NOTHING_J else value)


def _exact_joule(value_nJ: int | None) -> str:
    """Whole nanojoules in joules, to the last digit."""
    if value_nJ is None:
        return "-"
    whole, rest = divmod(abs(value_nJ), 1_000_000_000)
    return f"{'-' if value_nJ < 0 else ''}{whole}.{rest:09d}"


def _text(value: str | None) -> str:
    return "-" if value is None else value


def _loss(link: Mapping[str, Any] | None) -> str | None:
    lost, offered = _get(link, "lost"), _get(link, "offered")
    return None if lost is None or not offered else f"{100 * lost / offered:.2f}"
