"""The parts of the force on the hand, as numbers and as stacked curves."""

from __future__ import annotations

import math

import numpy as np

from hapnet.checks import Array
from hapnet.ext.page.history import Track
from hapnet.mechanics.pose import torques

STACK = ("contact model", "added damping", "rest of the spring", "damper")
"""The parts that add up to the force, in the order of `stacked`."""


def force_of(track: Track) -> Array:
    """The force on the device (N,) [N]: with its sign if there is one axis, otherwise its magnitude."""
    one = track.force_N.shape[1] == 1
    return np.asarray(track.force_N[:, 0] if one else np.linalg.norm(track.force_N, axis=1))


def parts_of(track: Track) -> Array:
    """Return the parts of that force (N, 4) [N]: spring, damper, and the spring's parts of model and added damping.

    With more than one axis, each part's component along the force. NaN if the coupling does not report them.
    """
    if track.force_N.shape[1] == 1:
        return np.asarray(track.parts_N[:, :, 0])
    length = np.linalg.norm(track.force_N, axis=1, keepdims=True)
    along = np.divide(track.force_N, length, out=np.zeros_like(track.force_N), where=length > 0.0)
    return np.asarray(np.einsum("tpn,tn->tp", track.parts_N, along))


def stacked(track: Track) -> Array:
    """The parts named in `STACK` (N, 4) [N]; 0 if the coupling does not report them."""
    spring, damper, model, added = np.nan_to_num(parts_of(track)).T
    return np.stack([model, added, spring - model - added, damper], axis=1)


def force_now(track: Track | None, unit: str = "N") -> list[tuple[str, str]]:
    """The newest force and its parts, as names and values in `unit`."""
    if track is None:
        return []
    spring, damper, model, added = (_value(value, unit) for value in parts_of(track)[-1])
    return [
        ("force on the hand", _value(force_of(track)[-1], unit)),
        ("spring K (y − x)", spring),
        ("– of it local contact model", model),
        ("– of it added damping", added),
        ("damper B v", damper),
    ]


def torque_now(track: Track) -> str:
    """The newest torque on a tool that turns."""
    return f"{1e3 * float(np.linalg.norm(torques(track.position_m[-1], track.force_N[-1]))):.0f} mNm"


def _value(value: float, unit: str) -> str:
    return f"{round(value, 2) + 0.0:.2f} {unit}" if math.isfinite(value) else "not known"
