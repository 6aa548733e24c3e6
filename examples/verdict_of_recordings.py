"""Recompute energy account and verdict of a run with pspm (or zoh) from its recordings, as far as the samples show.

python examples/verdict_of_recordings.py device.mcap world.mcap    (of a simulation: run.mcap)
"""

import sys
from typing import Any

import numpy as np

from hapnet import HapnetError, read_recording


def both_ports(device: Any, world: Any) -> float:
    """The minimum energy put in at both ports on one clock [J], with and without the world's current step."""
    times = np.union1d(device["time_ns"], world["time_ns"])
    of_device = np.append(0.0, device["work_J"])[np.searchsorted(device["time_ns"], times, side="right")]
    begun = np.searchsorted(world["time_ns"], times, side="right")
    of_world = np.append(0.0, world["work_J"])[np.minimum([begun, begun + 1], len(world["time_ns"]))]
    return float(np.min(of_device + of_world, initial=0.0))


def judge(files: list[str], rounding_J: float = 1e-9) -> str:
    recordings = [read_recording(file) for file in files]
    sides = {name: getattr(each, name) for each in recordings for name in ("device", "world") if getattr(each, name)}
    if len(sides) < 2:
        return "not known: recordings of both sides are needed"
    one_clock = len({one.meta.get("clock", file) for one, file in zip(recordings, files, strict=True)}) == 1
    bound, halves, against = 0.0, 0.0, list[str]()
    doubts = ["a recording is incomplete" for one in recordings if one.torn or one.lost]
    doubts += ["a side was restarted" for one in recordings if [each.kind for each in one.events].count("paired") > 1]
    for name, other in (("device", "world"), ("world", "device")):
        of, far = sides[name], sides[other]
        margin = of["work_J"] + of["bound_J"] + of["credited_J"] - of["sent_J"]  # W + V(0) + E(0) + credited - sent
        slack = margin - of["stored_J"] - of["account_J"]  # margin - V - E
        bound, halves = bound + of["bound_J"][0], halves + np.min(margin, initial=of["bound_J"][0])
        print(f"{name}: margin {1e3 * margin.min():.6f} mJ and slack {1e3 * slack.min():.6f} mJ at least")
        if slack.min() < -rounding_J and recordings[0].meta["coupling"] == "pspm":
            against.append(f"the {name}'s half of the theorem fails")
        if not max(np.abs(margin - of["margin_J"]).max(), np.abs(slack - of["slack_J"]).max()) <= rounding_J:
            doubts.append(f"the {name}'s account is not what was recorded of it, or was not recorded")
        if np.max(of.get("deficit_J", 0.0)) > 1e-12:
            doubts.append(f"the {name} gave out what its reservoir did not have")
        times: np.ndarray[Any, np.dtype[np.int64]] = of["time_ns"]
        by_then = np.searchsorted(far["time_ns"], times) if one_clock else len(times) * [-1]
        if not np.max(of["credited_J"] - np.append(far["sent_J"], far["sent_J"][-1])[by_then]) <= rounding_J:
            doubts.append(f"the {name} credited what the {other} had not sent")
    lowest = halves if len(files) == 2 else bound + both_ports(**sides)
    print(f"both: margin {1e3 * lowest:.6f} mJ at least, of d2 = {1e3 * bound:.6f} mJ")
    against += ["more came out than d2"] if lowest < -rounding_J else []
    verdict = "not passive: " if against else "not known: " if doubts else "passive"
    return verdict + "; ".join(against or doubts)


if __name__ == "__main__":
    try:
        print(judge(sys.argv[1:]))
    except HapnetError as error:  # the file is missing or is no recording
        print(f"verdict_of_recordings: {error}", file=sys.stderr)
        sys.exit(2)
