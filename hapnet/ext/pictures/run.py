"""The main figure of a run: three or four panels over time.

`html` shows it in a notebook, and `replay_figure` draws a replay together with its original.
"""

from __future__ import annotations

import math
from base64 import b64encode
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapnet.couplings.registry import jointly_passive, known as known_coupling
from hapnet.errors import MissingLibrary
from hapnet.ext.pictures.html import Html, element, join
from hapnet.ext.pictures.style import (
    COLOURS,
    DEVICE_COLOR,
    NOT_PASSIVE,
    WORLD_COLOR,
    also_to as also_to,
    headed,
    legend_above,
    png,
    save_figure as save_figure,
    sheet,
)
from hapnet.installing import require
from hapnet.recording.hand import hand_times
from hapnet.recording.poses import of_point, of_turning
from hapnet.recording.samples import Columns, Recording
from hapnet.summary.from_samples import total_margin
from hapnet.summary.recorded import from_recording
from hapnet.summary.structure import DIRECTIONS, read
from hapnet.summary.tables import brief
from hapnet.summary.verdict import has_reservoirs
from hapnet.summary.words import get, millijoule, outcome, verdict
from hapnet.units import RADIANS, units_in, within

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 20000  # the largest number of points of a curve: more than print can resolve, and enough to zoom in
_TITLE = 300  # letters of a title's part: a link's words are shorter
# device, proxy (or world), and a thinner third curve, which differ in dash and grey value as well as in hue
_DEVICE: dict[str, Any] = {"color": DEVICE_COLOR, "linestyle": "-"}
_WORLD: dict[str, Any] = {"color": WORLD_COLOR, "linestyle": (0, (5, 1.5))}
_THIRD: dict[str, Any] = {"color": "0.35", "linestyle": (0, (1, 1.2)), "linewidth": 0.8}


def figure(recording: Recording, *, titled: bool = True) -> Figure:
    """Positions, forces, reservoirs (of couplings that have them) and passivity margin over time, 180 mm wide; for a
    tool that turns, rotation and torque too.

    With several axes, positions and forces are drawn along a single axis, which the labels name: the axis with the
    largest mean contact force or, if there was no contact, the axis along which the device moved most. The path in the
    plane is added for the scene ``paper``, and whenever the device moves along two axes. titled : put the settings and
    the verdict above the figure, if it is used alone.
    """
    require("report", "a figure")
    point = of_point(recording)
    seen = [point] if (turning := of_turning(recording)) is None else [point, turning]
    plane = _plane(point, _main_axis(point))
    full = has_reservoirs(_coupling(recording))
    ratios = [1.25, 1.0] * len(seen) + [0.9, 0.9][not full :]
    with sheet(40 * (len(ratios) + 1) + (0 if plane is None else 80)) as fig:
        if titled:
            summary = recording.summary if recording.summary is not None else from_recording(recording)  # a torn file
            headed(fig, _settings(recording), verdict(summary), letters=100)
        rows = len(ratios)
        ratios += [] if plane is None else [1.7]
        grid = fig.add_gridspec(len(ratios), 1, height_ratios=ratios)
        panels = [fig.add_subplot(grid[0])]
        panels += [fig.add_subplot(grid[row], sharex=panels[0]) for row in range(1, rows)]
        for k, one in enumerate(seen):
            _positions(panels[2 * k], one, _main_axis(one))
            _forces(panels[2 * k + 1], one, _main_axis(one))
        if full:
            _reservoirs(panels[-2], recording)
        _margins(panels[-1], recording)
        silences = _silences(recording)
        for panel in panels:
            _shade_silences(panel, silences, named=panel is panels[0])
        for panel in panels[:-1]:
            panel.tick_params(labelbottom=False)
        panels[-1].set_xlabel("time [s]")
        panels[0].margins(x=0.01)
        if plane is not None:
            _path(fig.add_subplot(grid[rows]), point, plane)
        for panel in fig.axes:
            legend_above(panel, handlelength=2.6, columnspacing=1.4)
    return fig


def _positions(panel: Axes, recording: Recording, axis: int) -> None:
    device, world = recording.device, recording.world
    turns = _turns(recording, axis)
    scale = math.degrees(1.0) if turns else 1e3
    _shade_contact(panel, world)
    if device is not None:
        _curve(panel, device, device["position_m"][:, axis] * scale, "device", **_DEVICE)
    if world is not None:
        _curve(panel, world, world["position_m"][:, axis] * scale, "proxy", **_WORLD)
    modulated = device if device is not None else world
    if modulated is not None:
        name = "device's" if device is not None else "world's"
        y = modulated["set_position_m"][:, axis] * scale
        received = " (as received)" if _received(recording) else ""
        how = " (modulated)" if has_reservoirs(_coupling(recording)) else received
        _curve(panel, modulated, y, f"{name} set-position{how}", drawstyle="steps-post", **_THIRD)
    panel.set_ylabel(("rotation" if turns else "position") + _along(recording, axis, "°" if turns else "mm"))


def _forces(panel: Axes, recording: Recording, axis: int) -> None:
    device, world = recording.device, recording.world
    _shade_contact(panel, world)
    if device is not None:
        _curve(panel, device, device["force_N"][:, axis], "coupling on the device", **_DEVICE)
    if world is not None:
        y = world["contact_force_N"][:, axis]
        _curve(panel, world, y, "contact on the proxy", drawstyle="steps-post", **_WORLD)
    what, unit = ("torque", "Nm") if _turns(recording, axis) else ("force", "N")
    panel.set_ylabel(what + _along(recording, axis, unit))


def _reservoirs(panel: Axes, recording: Recording) -> None:
    for columns, label, style in ((recording.device, "device", _DEVICE), (recording.world, "world", _WORLD)):
        if columns is not None:
            _curve(panel, columns, columns["reservoir_J"] * 1e3, label, drawstyle="steps-post", **style)
    panel.set_ylabel("reservoir [mJ]")
    panel.set_ylim(bottom=0.0)


def _margins(panel: Axes, recording: Recording) -> None:
    device, world, total = recording.device, recording.world, total_margin(recording)
    joint = jointly_passive(_coupling(recording))
    low, part = 0.0, "port" if joint else "half"
    for columns, label, style in ((device, f"device's {part}", _DEVICE), (world, f"world's {part}", _WORLD)):
        if columns is not None and not (joint and total is not None):
            low = min(low, _minimum(columns["margin_J"]) * 1e3)
            _curve(panel, columns, columns["margin_J"] * 1e3, label, drawstyle="steps-post", **style)
    if joint and total is None:  # one port alone may go below 0
        panel.set_ylabel("energy put in + d² [mJ]")
        return
    if total is not None:
        low = min(low, _minimum(total["margin_J"]) * 1e3)
        label = f"sum{_margin_words(recording)}"
        both = total["margin_J"] * 1e3
        _curve(panel, total, both, label, color="black", linestyle="-.", linewidth=0.9)
        panel.fill_between(total["time_s"], both, 0.0, where=both < 0.0, step="post", color="#99000d", linewidth=0.8)
    panel.axhline(0.0, color="#cb181d", linewidth=1.0)
    top = panel.get_ylim()[1]
    bottom = low * 1.1 - 0.08 * (top - low)
    panel.set_ylim(bottom, top)
    panel.axhspan(bottom, 0.0, alpha=0.6, **NOT_PASSIVE)
    panel.set_ylabel("passivity margin [mJ]")


def _margin_words(recording: Recording) -> str:
    """The most energy that came out, and the margin at the end."""
    theorem = read(recording.summary)["theorem"]
    energies = {"came out": theorem["energy_out_J"], "at the end": theorem["margin_end_J"]}
    parts = [f"{millijoule(value)} mJ {words}" for words, value in energies.items() if value is not None]
    return f" ({', '.join(parts)})" if parts else ""


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
    panel.set_xlabel(_along(recording, first, "mm").removeprefix(" along "))
    panel.set_ylabel(_along(recording, second, "mm").removeprefix(" along "))


def _curve(panel: Axes, columns: Columns, values: NDArray[np.float64], label: str, **style: Any) -> None:
    kept = _envelope(values)
    alone: dict[str, Any] = {"marker": "."} if np.count_nonzero(np.isfinite(values)) == 1 else {}  # a line needs two
    panel.plot(columns["time_s"][kept], values[kept], label=label, **alone, **style)


def _envelope(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices to draw: all or, for a long curve, of the smallest and the largest value in each short stretch."""
    if len(values) <= _POINTS:
        return np.arange(len(values))
    stretches = np.array_split(np.arange(len(values)), _POINTS // 2)
    low, high = (np.where(np.isnan(values), other, values) for other in (np.inf, -np.inf))
    kept = [s[int(i)] for s in stretches for i in (np.argmin(low[s]), np.argmax(high[s]))]
    return np.unique(np.array([0, *kept, len(values) - 1], dtype=np.intp))


def _shade_contact(panel: Axes, world: Columns | None) -> None:
    if world is not None and (inside := world["penetration_m"] > 0.0).any():
        whole_height = panel.get_xaxis_transform()
        style: dict[str, Any] = {"color": "0.9", "linewidth": 0, "zorder": 0, "label": "contact"}
        panel.fill_between(world["time_s"], 0, 1, where=inside, step="post", transform=whole_height, **style)


def _silences(recording: Recording) -> list[tuple[float, float]]:
    """Begin and end [s] of each silence of a side; a silence without an end lasts until the recording's end."""
    origin_ns = int(recording.meta.get("origin_ns", 0))
    ends = [float(c["time_s"][-1]) for c in (recording.device, recording.world) if c is not None]
    since: dict[str, float] = {}
    found = []
    for event in recording.events:
        other = next((role for role in ("device", "world") if f"the {role}" in event.text), "")
        at_s = (event.time_ns - origin_ns) / 1e9
        ends.append(at_s)
        if event.kind == "silent":
            since.setdefault(other, at_s)
        elif event.kind in ("heard", "paired", "left") and other in since:
            found.append((since.pop(other), at_s))
    return found + [(at_s, max(ends)) for at_s in since.values()]


def _shade_silences(panel: Axes, silences: list[tuple[float, float]], *, named: bool) -> None:
    for number, (begin_s, end_s) in enumerate(silences):
        label = "silence" if named and number == 0 else None
        panel.axvspan(begin_s, end_s, facecolor="#fee391", edgecolor="#993404", hatch="..", alpha=0.5, lw=0, zorder=0,
                      label=label)  # fmt: skip


def _main_axis(recording: Recording) -> int:
    device, world = recording.device, recording.world
    if world is not None and (pressed := np.nansum(np.abs(world["contact_force_N"]), axis=0)).any():
        return int(np.argmax(pressed))
    columns = device if device is not None else world
    return 0 if columns is None else int(np.argmax(np.ptp(columns["position_m"], axis=0)))


def _plane(recording: Recording, axis: int) -> tuple[int, int] | None:
    """The plane of the drawn path, with three axes normal to the main axis. None: the motion is along a line."""
    columns = recording.device if recording.device is not None else recording.world
    if columns is None or (n := columns["position_m"].shape[1]) < 2:
        return None
    first, second = [i for i in range(n) if n == 2 or i != axis][:2]
    extent = np.ptp(columns["position_m"], axis=0)
    seen = (max if _written(recording) else min)(extent[first], extent[second]) > 0.05 * extent.max() > 0.0
    return (first, second) if seen else None


def _written(recording: Recording) -> bool:
    return bool(get(recording.meta, "params", "scene") == "paper")


def _coupling(recording: Recording) -> Any:
    return read(recording.summary)["coupling"] or get(recording.meta, "coupling")


def _received(recording: Recording) -> bool:
    """Whether the spring is tied to the received position, without modulation, as the world has no law."""
    spec = known_coupling(_coupling(recording))
    return spec is not None and "world" in spec.set_positions


def _stride(columns: Columns) -> int:
    return max(1, len(columns["time_s"]) // (2 * _POINTS))


def _turns(recording: Recording, axis: int) -> bool:
    """Whether the axis is in radians."""
    columns = recording.device if recording.device is not None else recording.world
    return columns is not None and units_in(recording.meta, columns["position_m"].shape[1])[axis] == RADIANS


def _along(recording: Recording, axis: int, unit: str) -> str:
    """The name of the axis, if there are several, and the unit."""
    columns = recording.device if recording.device is not None else recording.world
    n = 1 if columns is None else columns["position_m"].shape[1]
    how = "about" if _turns(recording, axis) and n <= 3 else "along"
    along = "" if n == 1 else f" {how} {'xyz'[axis] if n <= 3 else axis + 1}"
    return f"{along} [{unit}]"


def _settings(recording: Recording) -> str:
    """Links, coupling and seed."""
    summary, meta = read(recording.summary), recording.meta
    links = summary["links"]
    up, down = (None if (link := links[direction]) is None else link["profile"] for direction in DIRECTIONS)
    up, down = up or get(meta, "links", "up"), down or get(meta, "links", "down")
    profiles = {"link": up} if up == down else {"uplink": up, "downlink": down}
    words = [f"{name}: {str(profile)[:_TITLE]}" for name, profile in profiles.items() if profile is not None]
    for name, known in (("coupling", summary["coupling"]), ("seed", summary["seed"])):
        value = meta.get(name) if known is None else known
        words += [] if value is None else [f"{name}\N{NO-BREAK SPACE}{str(value)[:_TITLE]}"]
    return ", ".join(words)


def _minimum(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.min()) if len(finite) else 0.0


def replay_figure(original: Recording, again: Recording) -> Figure:
    """The device's position and the force on it, with the original dashed, along the axis of the largest motion."""
    original, again = of_point(original), of_point(again)
    assert original.device is not None
    axis = int(np.ptp(original.device["position_m"], axis=0).argmax())
    unit = units_in(original.meta, original.device["position_m"].shape[1])[axis]
    with sheet(110) as fig:
        panels = fig.subplots(2, 1, sharex=True)
        for panel, name, scale, label in (
            (panels[0], "position_m", 1e3, f"device's position [{within(unit, 'mm')}]"),
            (panels[1], "force_N", 1.0, f"force on the device [{within(unit, 'N')}]"),
        ):
            for run, parts, style in (
                (again, "replay", {"color": COLOURS[5], "linewidth": 2.2}),
                (original, "original", {"color": "black", "linestyle": "--", "linewidth": 0.9}),
            ):
                assert run.device is not None
                values = run.device[name]
                if axis < values.shape[1]:
                    panel.plot(hand_times(run), values[:, axis] * scale, label=parts, **style)
            panel.set_ylabel(label)
        legend_above(panels[0])
        panels[1].set_xlabel("time since control started [s]")
    return fig


_COLOURS = {"good": "#116329", "bad": "#a40e26", "unknown": "#7d4e00"}


def html(recording: Recording) -> str:
    """A run with a summary for a notebook; without the picture if matplotlib is not installed (extra `report`)."""
    summary = read(recording.summary)
    style = f"border-left: 0.4rem solid {_COLOURS[outcome(summary)]}; padding-left: 0.6rem; font-weight: 600"
    lines = [element("li", line) for line in brief(summary)]
    return element("div", element("p", verdict(summary), style=style), element("ul", *lines), _picture(recording))


def _picture(recording: Recording) -> Html:
    try:
        data = b64encode(png(figure(recording))).decode("ascii")
    except MissingLibrary:
        return join()
    return element("img", src=f"data:image/png;base64,{data}", alt="positions, forces and margin over time")
