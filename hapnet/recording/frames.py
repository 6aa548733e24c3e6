"""A recording's columns as a table: plain, or for pandas (extra `pandas`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.recording.poses import of_point, of_turning, orientations
from hapnet.recording.samples import VECTORS, Columns, Recording, utc_less_clock_ns
from hapnet.units import RADIANS, column, units_in

if TYPE_CHECKING:
    from pandas import DataFrame

AXES = "xyz"


def table(recording: Recording, side: str = "device") -> Columns:
    """One side's samples as columns of numbers, all of shape (N,), the first ``time_s``, the time since the start.

    A vector is a column for each axis: ``position_m`` (N, 2) is ``position_m_x`` and ``position_m_y``, or
    ``position_rad_x`` where an axis is in radians. If the real time is known, it is in ``utc_ns``.

    For a tool that turns, positions and forces are those of its point, ``position_m_x`` and ``force_N_x``; beside them
    there are quaternions, ``position_quaternion_w`` to ``_z``, torques, ``torque_Nm_x``, and ``velocity_radps_x``.
    For an arm's tip, the joints' angles are beside its positions: ``joint_1_rad``, ..., or ``joint_1_m`` of
    a joint that slides.

    Raises InvalidParameter: this side was not recorded.
    """
    recorded = {name: columns for name in ("device", "world") if (columns := getattr(recording, name)) is not None}
    if side not in recorded:
        raise InvalidParameter("side", side, " or ".join(recorded) or "none: nothing was recorded")
    columns = getattr(of_point(recording), side)
    found = {"time_s": columns["time_s"]}
    if knows_utc(recording):
        found["utc_ns"] = columns["time_ns"] + utc_less_clock_ns(recording.meta)
    for name, values in columns.items():
        if values.ndim == 1:
            found.setdefault(name, values)
        else:
            names = [column(name, unit) for unit in units_in(recording.meta, values.shape[1])]
            found.update({f"{one}_{AXES[k] if k < 3 else k}": values[:, k] for k, one in enumerate(names)})
    if side == "device" and recording.posture:
        found |= _joints(recording, columns["time_ns"])
    return (
        found
        if (turning := of_turning(recording)) is None
        else found | _turning(getattr(turning, side), recorded[side])
    )


def _joints(recording: Recording, times: NDArray[np.int64]) -> Columns:
    """The recorded angles at these times; NaN where there are none."""
    at = {one.time_ns: one.angles_rad for one in recording.posture}
    unknown = (math.nan,) * len(recording.posture[0].angles_rad)
    rows = np.array([at.get(time_ns, unknown) for time_ns in times.tolist()])
    slides = recording.meta.get("arm", {}).get("slides", ())
    return {f"joint_{k + 1}_{'m' if k in slides else 'rad'}": rows[:, k] for k in range(rows.shape[1])}


def _turning(columns: Columns, poses: Columns) -> Columns:
    """Replace rotation vectors by quaternions."""
    found = {
        f"{name.removesuffix('_m')}_quaternion_{axis}": values[:, k]
        for name, values in orientations(poses).items()
        for k, axis in enumerate("wxyz")
    }
    for name in [name for name in columns if name in VECTORS and not name.endswith("_m")]:
        stem = column(name, RADIANS).replace("force", "torque")
        found |= {f"{stem}_{axis}": columns[name][:, k] for k, axis in enumerate(AXES)}
    return found


def knows_utc(recording: Recording) -> bool:
    """Whether the recording has the real time. A simulation and older recordings do not have it.

    A recording of two hosts whose clocks cannot be compared does not have it either.
    """
    meta = recording.meta
    return meta.get("utc_origin_ns") is not None and meta.get("utc_clock") != "virtual" and meta.get("aligned", True)


def to_pandas(recording: Recording, side: str = "device") -> DataFrame:
    """One side's `table` as a DataFrame, indexed by the time since the start [s].

    Raises InvalidParameter: this side was not recorded. MissingLibrary: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingLibrary("a table", "pandas", "pandas") from error
    return pandas.DataFrame(table(recording, side)).set_index("time_s")
