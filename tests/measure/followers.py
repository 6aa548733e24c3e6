"""Figures of one robot that follows another.

``--endurance`` : the first ten seconds and the last minute of 600 s.
"""

from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

import numpy as np

from hapnet.errors import InvalidParameter
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Result, simulate
from hapnet.summary.from_samples import position_error

LINK = "delay 50ms loss 20%"
HANDS = ("hand-21", "hand-22", "hand-23", "hand-24", "hand-25")
TAKEN_AWAY: Mapping[str, dict[str, object]] = {
    "pspm": {},
    "  no lead": {"contact_model.lead": 0.0},
    "  no added damping": {"contact_model.damping_ratio": 0.0},
    "  no prediction": {"contact_model.longest_s": 1e-3},
    "pspm, paper": {"rendering": "paper"},
    "zoh": {"coupling": "zoh"},
    "zoh, paper": {"coupling": "zoh", "rendering": "paper"},
    "tdpa": {"coupling": "tdpa"},
    "popc": {"coupling": "popc"},
    "wave": {"coupling": "wave"},
    "digital-wave": {"coupling": "digital-wave"},
    "pd": {"coupling": "pd"},
}
"""What is changed for each row of the table."""


def run(link: str, seed: int, changes: Mapping[str, object]) -> Result:
    """A leader and a follower of these parameters."""
    both = {"follower.robot": "simulated", "device.servo": "sampled", "link.up": link, "link.down": link}
    return simulate({**both, **changes}, seed)


def apart_mm(recording: Recording, since_s: float = 1.0, until_s: float = np.inf) -> float:
    """How far the two were apart at the same time (rms) [mm]."""
    assert recording.world is not None
    error, known = position_error(recording.device, recording.world)
    at = recording.device["time_s"][known]
    seen = error[(at >= since_s) & (at < until_s)]
    return 1e3 * float(np.sqrt(np.mean(seen * seen)))


def drag_N(recording: Recording) -> float:
    """The force on the leader's hand in free motion (rms) [N]."""
    force = recording.device["force_N"][recording.device["time_s"] > 1.0]
    return float(np.sqrt(np.mean(np.sum(force * force, axis=1))))


def row(name: str, link: str, changes: Mapping[str, object], hands: tuple[str, ...]) -> str:
    """A law in free motion, and where it taps at a wall."""
    free = [run(link, k, {"scene": "free", "operator": hand, **changes}) for k, hand in enumerate(hands)]
    tap = run(link, 9, {"scene": "wall", "operator": "press", **changes})
    found: list[Callable[[Recording], float]] = [apart_mm, drag_N]
    apart, drag = (median(one(result.recording) for result in free) for one in found)
    margins = [_number(result.summary["theorem"]["margin_J"]) for result in (*free, tap)]
    depth, force = tap.summary["motion"]["peak_penetration_m"], tap.summary["motion"]["peak_force_N"]
    slack = [_number(result.summary[side]["ledger"]["slack_J"]) for result in (*free, tap) for side in SIDES]  # type: ignore[index,literal-required]
    return (
        f"{name:18} {apart:6.2f} {drag:6.3f} {_number(force):6.2f} {1e3 * _number(depth):6.2f}"
        f" {1e3 * min(margins):8.1f} {min(slack):9.1e}"
    )


SIDES = ("device", "world")


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def endurance(link: str, hands: tuple[str, ...], duration_s: float) -> None:
    """The first ten seconds beside the last minute."""
    print(f"{'':18} {'hand':>8} {'first':>6} {'last':>6} {'modulated %':>12} {'margin':>8} {'slack':>9}  [mm, mJ, J]")
    for name in ("pspm", "pspm, paper", "zoh"):
        for k, hand in enumerate(hands):
            changes = {"scene": "free", "operator": hand, "duration_s": duration_s, **TAKEN_AWAY[name]}
            result = run(link, k, changes)
            first, last = apart_mm(result.recording, 1.0, 10.0), apart_mm(result.recording, duration_s - 60.0)
            shares = [_number(result.summary[side]["modulated_share"]) for side in SIDES]  # type: ignore[index,literal-required]
            slack = min(_number(result.summary[side]["ledger"]["slack_J"]) for side in SIDES)  # type: ignore[index,literal-required]
            margin = _number(result.summary["theorem"]["margin_J"])
            figures = f"{first:6.2f} {last:6.2f} {100 * max(shares):12.2f} {1e3 * margin:8.1f} {slack:9.1e}"
            print(f"{name:18} {hand:>8} {figures}", flush=True)


def main(link: str = LINK, long: bool = False, duration_s: float = 600.0, hands: int = len(HANDS)) -> None:
    if long:
        endurance(link, HANDS[:hands], duration_s)
        return
    print(
        f"{'':18} {'apart':>6} {'drag':>6} {'force':>6} {'depth':>6} {'margin':>8} {'slack':>9}  [mm, N, N, mm, mJ, J]"
    )
    for name, changes in TAKEN_AWAY.items():
        try:
            print(row(name, link, changes, HANDS[:hands]), flush=True)
        except InvalidParameter as error:
            print(f"{name:18} {error}")
