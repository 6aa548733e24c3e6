"""A hand's motion, recorded in a CSV file."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.params import OperatorParams
from hapnet.plant.operating_range import check_motion
from hapnet.plant.operator import Impedance, Recorded
from hapnet.recording.motion_file import read_columns
from netem.files import read_once

_HAND = OperatorParams()
_GRID_S = 1e-3
_GAP_S = 0.05  # a longer gap in a recording at 133 Hz means that the tablet lost the pen
_JUMP_MPS = 0.5  # faster than a hand writes: the tablet lost the pen and found it elsewhere
_JUMP_S = 0.06  # samples this near to a jump are dropped, so that the motion across is slow enough for a hand
_PEN_S = 0.08  # the pen is lowered or lifted over this time


@read_once
def read_motion(
    name: str,
    dof: int,
    impedance: Impedance,
    *,
    press_depth: float = _HAND.press_depth_m,
    hover: float = _HAND.hover_m,
    reach: float = math.inf,
    columns: str = "",
) -> Recorded:
    """Read a recorded hand from CSV: columns `time_s`, `x_m` and optionally `y_m`, `z_m`, or `time_ms`, `x_mm` and so
    on; `columns` names those that are called otherwise (see `read_columns`).

    A pen tablet's recording has `pressure` (0 to 1), and optionally `pen_down`, instead of `z_m`. Pressure becomes
    depth below the surface z = 0 (`press_depth` [m] at full pressure); a lifted pen hovers at `hover` [m]. Where
    samples are missing for longer than 50 ms, or the pen jumps, it is lifted and moves on with minimum jerk. Uneven
    samples are joined by cubic curves and resampled at 1 kHz. A one-dimensional device gets the last axis, along which
    the hand presses. No coordinate may be farther than `reach` [m] from the origin.

    Raises InvalidParameter: the file cannot be read, is not such a recording, or is not in metres.
    """
    table = read_columns(name, columns)
    check_motion(name, np.column_stack([table[name] for name in ("x_m", "y_m", "z_m") if name in table]), reach)
    table = _without_jumps(table)
    t = table["time_s"]
    if "pressure" in table:
        down = table.get("pen_down", np.ones_like(t)) > 0.0
        depth = np.where(down, -press_depth * table["pressure"], hover)
        across = [table["x_m"], table["y_m"]] if "y_m" in table else [table["x_m"]]
        grid, planar, lifted = _resample(t, np.column_stack(across))
        height = np.where(lifted, hover, np.interp(grid, t, depth))
        waiting = round(_PEN_S / _GRID_S)  # lifted at both ends, so that the pen is lowered and lifted
        planar = np.pad(planar, ((waiting, waiting), (0, 0)), mode="edge")
        path = np.column_stack([planar, _soften(np.pad(height, waiting, constant_values=hover))])
    else:
        names = [name for name in ("x_m", "y_m", "z_m") if name in table]
        _, path, _ = _resample(t, np.column_stack([table[name] for name in names]))
    if dof == 1 and path.shape[1] > 1:
        path = path[:, -1:]
    if path.shape[1] < dof:
        raise InvalidParameter("operator", name, f"a recording with {dof} axes for a {dof}-axis device")
    return Recorded(path[:, :dof], _GRID_S, impedance)


def _resample(t: Array, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(grid, points on it, whether each lies in a gap): cubic Hermite between samples, with zero slope at the ends."""
    grid = np.arange(t[0], t[-1], _GRID_S)
    step = np.diff(t)
    gap = step > _GAP_S
    slope = np.zeros_like(points)
    inner = (points[2:] - points[:-2]) / (t[2:] - t[:-2])[:, None]
    slope[1:-1] = np.where((gap[1:] | gap[:-1])[:, None], 0.0, inner)
    at = np.clip(np.searchsorted(t, grid, side="right") - 1, 0, len(t) - 2)
    s = ((grid - t[at]) / step[at])[:, None]
    h = step[at][:, None]
    a, b = points[at], points[at + 1]
    cubic = (
        a * (1 + 2 * s) * (1 - s) ** 2
        + slope[at] * h * s * (1 - s) ** 2
        + b * s**2 * (3 - 2 * s)
        + slope[at + 1] * h * s**2 * (s - 1)
    )
    quintic = a + (b - a) * (s**3 * (10 - 15 * s + 6 * s**2))
    return grid, np.where(gap[at][:, None], quintic, cubic), gap[at]


def _without_jumps(table: dict[str, Array]) -> dict[str, Array]:
    """Remove the samples near jumps of the position; a gap remains there."""
    t = table["time_s"]
    planar = [table[name] for name in ("x_m", "y_m") if name in table]
    speed = np.hypot.reduce([np.diff(column) for column in planar]) / np.diff(t)
    keep = np.ones(len(t), dtype=bool)
    for at in np.flatnonzero(speed > _JUMP_MPS):
        keep &= (np.abs(t - (t[at] + t[at + 1]) / 2.0) >= _JUMP_S) | (t == t[0]) | (t == t[-1])
    return {name: column[keep] for name, column in table.items()}


def _soften(height: Array) -> Array:
    """The pen's height, smoothed by a Hann window: lowering a pen takes time."""
    width = round(_PEN_S / _GRID_S)
    window = np.hanning(width + 2)[1:-1]
    smooth = np.convolve(np.pad(height, width, mode="edge"), window / window.sum(), mode="same")
    return np.asarray(smooth[width:-width], dtype=np.float64)
