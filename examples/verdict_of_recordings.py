"""Was a run with pspm (or zoh) passive? Account and verdict again, from what was recorded: as far as the samples show.

python examples/verdict_of_recordings.py device.mcap world.mcap    (of a simulation: run.mcap)
"""

import sys
from typing import Any

import numpy as np

from hapnet import read_recording

ROUNDING_J = 1e-9


def both_ports(device: Any, world: Any) -> float:
    """The least energy put in at both ports on one clock [J], with and without the world's step that is running."""
    times = np.union1d(device["time_ns"], world["time_ns"])
    of_device = np.append(0.0, device["work_J"])[np.searchsorted(device["time_ns"], times, side="right")]
    begun = np.searchsorted(world["time_ns"], times, side="right")
    of_world = np.append(0.0, world["work_J"])[np.minimum([begun, begun + 1], len(world["time_ns"]))]
    return float(np.min(of_device + of_world, initial=0.0))


def ahead(here: Any, there: Any, one_clock: bool) -> float:
    """How much more was credited here than sent there by the next sample there [J]; without one clock: in all."""
    last = len(there["sent_J"]) - 1
    by_then = np.searchsorted(there["time_ns"], here["time_ns"]).clip(max=last) if one_clock else last
    return float(np.max(here["credited_J"] - there["sent_J"][by_then]))


def judge(files: list[str]) -> str:
    recordings = [read_recording(file) for file in files]
    sides = {name: getattr(one, name) for one in recordings for name in ("device", "world") if getattr(one, name)}
    if len(sides) < 2:
        return "not known: recordings of both sides are needed"
    one_clock = len({one.meta.get("clock", file) for one, file in zip(recordings, files, strict=True)}) == 1
    against: list[str] = []
    bound = halves = 0.0
    doubts = ["a recording is torn" for one in recordings if one.torn]
    doubts += ["a side was restarted" for one in recordings if [each.kind for each in one.events].count("paired") > 1]
    for name, other in (("device", "world"), ("world", "device")):
        of = sides[name]
        margin = of["work_J"] + of["bound_J"] + of["credited_J"] - of["sent_J"]  # W + V(0) + E(0) + credited - sent
        slack = margin - of["stored_J"] - of["account_J"]  # margin - V - E
        bound, halves = bound + of["bound_J"][0], halves + np.min(margin, initial=of["bound_J"][0])
        print(f"{name}: margin {1e3 * margin.min():.6f} mJ and slack {1e3 * slack.min():.6f} mJ at least")
        if slack.min() < -ROUNDING_J and recordings[0].meta["coupling"] == "pspm":
            against.append(f"the {name}'s half of the theorem fails")
        if not max(np.abs(margin - of["margin_J"]).max(), np.abs(slack - of["slack_J"]).max()) <= ROUNDING_J:
            doubts.append(f"the {name}'s account is not what was recorded of it, or was not recorded")
        if np.max(of.get("deficit_J", 0.0)) > 1e-12:
            doubts.append(f"the {name} gave out what its reservoir did not have")
        if not ahead(of, sides[other], one_clock) <= ROUNDING_J:
            doubts.append(f"the {name} credited what the {other} had not sent")
    least = halves if len(files) == 2 else bound + both_ports(**sides)
    print(f"both: margin {1e3 * least:.6f} mJ at least, of d2 = {1e3 * bound:.6f} mJ")
    if least < -ROUNDING_J:
        against.append("more came out than d2")
    said = "not passive: " if against else "not known: " if doubts else "passive"
    return said + "; ".join(against or doubts)


if __name__ == "__main__":
    print(judge(sys.argv[1:]))
