"""A recording of a tool that turns, as two recordings of three axes: its point in metres, and its rotation in radians.

Code for recordings of three axes can read both. In the second, positions are rotation vectors [rad], forces are
torques [Nm] and velocities are angular velocities [rad/s]. A modulated set-position is not exactly a pose: the nearest
orientation is used.
"""

from __future__ import annotations

from dataclasses import replace

from hapnet.checks import Array
from hapnet.mechanics.pose import ARM_M, quaternions, rotation, rotation_vectors, torques
from hapnet.recording.samples import VECTORS, Columns, Recording
from hapnet.units import POSE, POSE_AXES, RADIANS, text_in

SIDES = ("device", "world")


def is_pose(recording: Recording) -> bool:
    """Whether the recording's axes are those of a pose."""
    return text_in(recording.meta, POSE_AXES) == POSE


def of_point(recording: Recording) -> Recording:
    """Return the recording of a pose's point, the first three axes; any other recording unchanged."""
    if not is_pose(recording):
        return recording
    return _with(
        recording, None, *[None if (columns := getattr(recording, side)) is None else _cut(columns) for side in SIDES]
    )


def of_turning(recording: Recording) -> Recording | None:
    """Return the rotation, in radians; None: it is not a recording of poses."""
    if not is_pose(recording):
        return None
    sides = [getattr(recording, side) for side in SIDES]
    return _with(recording, RADIANS, *[None if columns is None else _turning(columns) for columns in sides])


def orientations(columns: Columns) -> dict[str, Array]:
    """The quaternions (N, 4) w, x, y, z of one side's positions, by the names of the columns."""
    return {name: quaternions(rotation(values)) for name, values in columns.items() if _places(name)}


def _with(recording: Recording, units: str | None, device: Columns | None, world: Columns | None) -> Recording:
    params = {name: value for name, value in recording.meta["params"].items() if name != "units"}
    meta = recording.meta | {"params": params if units is None else params | {"units": units}}
    return replace(recording, meta=meta, device=device, world=world)


def _cut(columns: Columns) -> Columns:
    return {name: values[:, :3] if name in VECTORS else values for name, values in columns.items()}


def _turning(columns: Columns) -> Columns:
    x = columns["position_m"]
    rates = {
        name: torques(x, values) / (2.0 * ARM_M**2 if name.endswith("_mps") else 1.0)
        for name, values in columns.items()
        if name in VECTORS and not _places(name)
    }
    turns = {name: rotation_vectors(values) for name, values in columns.items() if _places(name)}
    return columns | rates | turns


def _places(name: str) -> bool:
    return name in VECTORS and name.endswith("_m")
