"""The margin of both ports together, from the recordings of both sides."""

from __future__ import annotations

import math

import numpy as np

from hapnet.checks import Array
from hapnet.recording.samples import Columns, Recording


def total_margin(recording: Recording) -> Columns | None:
    """The sum of both sides' margins over time: ``time_s`` and ``margin_J`` at every sample of either side.

    The other side contributes its last sample up to that time. So energy that went in and out again between two samples
    does not show. The sum covers the time in which both sides are recorded. None if they are not on one clock: a
    difference of clocks that was only measured may be wrong by milliwatts times milliseconds, and proves nothing.
    """
    if (both := _on_one_clock(recording)) is None:
        return None
    device, world = both
    of_device, of_world = device["time_s"], world["time_s"]
    times = np.union1d(of_device, of_world)
    times = times[(times >= max(of_device[0], of_world[0])) & (times <= min(of_device[-1], of_world[-1]))]
    if not len(times):
        return None
    halves = [_at(side, "margin_J", times) for side in (device, world)]
    return {"time_s": times, "margin_J": halves[0] + halves[1]}


def two_port_margin(recording: Recording) -> float | None:
    """The least of d^2 and the energy put in at both ports, over the recorded time [J]; None: as of `total_margin`.

    The sum of both margins leaves out what is on its way. This has it, also where more was credited than was sent.
    """
    total, both = total_margin(recording), _on_one_clock(recording)
    if total is None or both is None:
        return None
    sums = [_at(side, "sent_J", total["time_s"]) - _at(side, "credited_J", total["time_s"]) for side in both]
    margin = total["margin_J"] + sums[0] + sums[1]
    known = margin[np.isfinite(margin)]
    return float(known.min()) if len(known) else None


def credited_early(recording: Recording) -> tuple[float | None, float | None]:
    """The most that was credited before it was sent, from the device and from the world [J]; None: not known.

    The receiver's samples are held against the sender's next ones, which can only tell more.
    """
    if (both := _on_one_clock(recording)) is None:
        return None, None
    device, world = both
    return _early(device, world), _early(world, device)


def _early(sender: Columns, receiver: Columns) -> float | None:
    following = np.searchsorted(sender["time_s"], receiver["time_s"], side="left")
    seen = following < len(sender["time_s"])
    early = receiver["credited_J"][seen] - sender["sent_J"][following[seen]]
    known = early[np.isfinite(early)]
    return max(0.0, float(known.max())) if len(known) else None


def _at(side: Columns, name: str, times: Array) -> Array:
    return side[name][np.searchsorted(side["time_s"], times, side="right") - 1]


def _on_one_clock(recording: Recording) -> tuple[Columns, Columns] | None:
    device, world, meta = recording.device, recording.world, recording.meta
    if device is None or world is None or not meta.get("aligned", True) or "clock_difference" in meta:
        return None
    return device, world


def least_total_margin(recording: Recording, since_s: float = -math.inf) -> float | None:
    """The least value of `total_margin` from `since_s` on [J]; None if it is unknown."""
    total = total_margin(recording)
    margin = np.array([]) if total is None else total["margin_J"][total["time_s"] >= since_s]
    known = margin[np.isfinite(margin)]
    return float(known.min()) if len(known) else None
