"""What the virtual world has of the hand's contact: how true its force is, how often it chatters, what is modulated."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet.checks import Array
from hapnet.metrics.windows import Mask
from hapnet.recording.samples import Columns, Recording

_MODULATED_M = 1e-9
"""A set-position that is farther than this from the wanted one is modulated [m]; less is rounding."""


def visits(inside: Mask) -> int:
    """How often a wall was visited, including a visit that had begun before the first sample. (N,) in a wall or not."""
    return int(inside[0]) + int(np.count_nonzero(inside[1:] & ~inside[:-1])) if len(inside) else 0


def contact_force_error(recording: Recording, true_force: Callable[[Array, Array], Array | None]) -> float | None:
    """Rms over time of the walls' force on the proxy less the true one, in % of the latter's peak.

    The force of a step acts during it, so it is compared with the true force where the device was in the middle of that
    step; nothing is shifted. None if the two sides are not on one clock, or if the true force is always zero or not
    known.

    Parameters
    ----------
    true_force : (N, n) [N] of positions (N, n) [m] and their times (N,) since the recording's origin [s]; None: it is
        not known.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    middle_s = world["time_s"] - 0.5 * world["step_s"]
    known = (middle_s >= device["time_s"][0]) & (middle_s <= device["time_s"][-1])
    if not known.any():
        return None
    times = middle_s[known]
    places = np.column_stack([np.interp(times, device["time_s"], axis) for axis in device["position_m"].T])
    wanted = true_force(places, times)
    if wanted is None:
        return None
    peak = float(np.linalg.norm(wanted, axis=1).max())
    apart = np.sum((world["contact_force_N"][known] - wanted) ** 2, axis=1)
    return 100.0 * float(np.sqrt(np.average(apart, weights=world["step_s"][known]))) / peak if peak > 0.0 else None


def modulated_share(world: Columns) -> float:
    """The share of the world's updates whose set-position in use is not the wanted one."""
    apart = np.linalg.norm(world["set_position_m"] - world["target_m"], axis=1)
    return float(np.mean(apart > _MODULATED_M))


def energy_out(world: Columns, bound_J: float) -> float:
    """The greatest energy over time that came out at the world's port [J], 0 at least.

    The port's work is what is left of the side's account without what was shuffled. `bound_J` : its share of d^2.
    """
    work = world["margin_J"] - bound_J - world["credited_J"] + world["sent_J"]
    return max(0.0, -float(work.min()))
