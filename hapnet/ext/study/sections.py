"""The default comparisons of `hapnet compare`: a quick set, and a full set in sections, each a comparison of its
own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES
from hapnet.param_values import toml_value
from hapnet.params import OperatorParams
from netem.presets import PRESETS

HANDS = tuple(f"hand-{number}" for number in range(21, 41))
"""Hands on which nothing is tuned. Each touches a wall at the default place within 10 s, with any device spring."""

_FEW = HANDS[:8]
_BOTH = ("pspm", "zoh")
"""PSPM, and a plain spring with the same stages. Both run on the compiled kernel."""

_STAGED = ("pspm", "zoh", *(f"{law}:rendering=hapnet" for law in ("popc", "eba", "pd", "two-layer")))
"""Every law that can have the stages, with the same stages and limits."""

_FAR = ("lan", "4g", "leo", "intercontinental")


def _tap(start_m: float, peak_mps: float) -> str:
    """A press from `start_m` to 40 mm with this peak speed, which with minimum jerk is 1.875 times the mean speed."""
    reach_s = 1.875 * (0.04 - start_m) / peak_mps
    return f"press:operator_model.start_m={start_m:g}:operator_model.reach_s={reach_s:.3g}"


def _grip(hand: str, stiffness: float) -> str:
    """The hand with a grip of this stiffness [N/m], and a damping ratio of 0.37, as the default hand's."""
    damping = 2.0 * 0.37 * math.sqrt(stiffness * OperatorParams().mass)
    return f"{hand}:operator_model.stiffness={stiffness:g}:operator_model.damping={damping:.3g}"


TAPS = tuple(_tap(start_m, peak_mps) for start_m in (0.0, -0.05, -0.1, -0.15) for peak_mps in (0.2, 0.4, 0.8))


@dataclass(frozen=True)
class StudySection:
    """A comparison of the full set, or the quick one.

    about : a title. changes : parameters of all its cases. The other fields are as in `Plan`, with links by name.
    """

    about: str
    couplings: tuple[str, ...]
    links: tuple[str, ...]
    operators: tuple[str, ...]
    changes: Mapping[str, object] = field(default_factory=dict)
    seeds: tuple[int, ...] = (0,)


def _arm(mass: float, inside: bool) -> str:
    """A loosely held leader and a follower of this mass [kg] with friction; inside: its position servo runs at 200 Hz.

    On its spring the follower has 5 Hz and is nearly critically damped; friction is a twentieth of its weight.
    """
    own = {
        "device.mass": min(mass, 0.5), "follower.mass": mass, "follower.own_damping": 2.0 * mass,
        "follower.friction_N": 0.5 * mass, "world.stiffness": 1000.0 * mass, "world.damping": 50.0 * mass,
        "follower.position_servo": inside, "follower.servo_hz": 200.0 if inside else 1000.0,
    }  # fmt: skip
    return ":".join(["press@light", *(f"{name}={toml_value(value)}" for name, value in own.items())])


ARMS = {"0.1 kg": _arm(0.1, False), "1 kg, servo": _arm(1.0, True), "5 kg, servo": _arm(5.0, True)}
"""Pairs of arms; servo: the follower has a position servo of its own."""

BILATERAL = tuple(f"{law}{port}" for law in BILATERAL_NAMES for port in ("", ":bilateral.port=pspm"))
"""The laws between two robots, each bare and behind PSPM."""

GRIPS = tuple(_grip(hand, stiffness) for stiffness in (50.0, 135.0, 350.0, 900.0) for hand in ("press", "strokes-51"))

QUICK = StudySection(
    "every coupling for ten seconds",
    COUPLING_NAMES,
    ("ideal", "lan", "4g", "intercontinental"),
    ("press@light", "sine@light", "hand-11", _tap(-0.1, 0.5)),
)


def _moving(about: str, timeline: str) -> StudySection:
    return StudySection(
        about, _BOTH, ("4g", "intercontinental"), _FEW,
        {"scene": "moving", "duration_s": 30.0, "world.wall.timeline": timeline},
    )  # fmt: skip


FULL: Mapping[str, StudySection] = {
    "hands": StudySection("twenty hands that nothing was tuned on", COUPLING_NAMES, ("lan", "wifi", *_FAR[1:]), HANDS),
    "minutes": StudySection(
        "five minutes: the first 10 s beside the last minute", _BOTH, ("lan", "wifi", *_FAR[1:]), HANDS,
        {"duration_s": 300.0},
    ),
    "taps": StudySection("taps from afar, at 0.2 to 0.8 m/s", _BOTH, _FAR, TAPS, {"duration_s": 60.0}),
    "stiffness": StudySection(
        "device springs of 100, 300 and 700 N/m",
        tuple(f"{coupling}:device.stiffness={stiffness}" for stiffness in (100, 300, 700) for coupling in _BOTH),
        ("lan", "4g", "intercontinental"), HANDS, {"duration_s": 60.0},
    ),
    "untold": _moving(
        "a wall that was never sent before: it appears, and jumps to new places",
        "at 0s: gone; at 4s: back; at 9s: shift 5mm; at 14s: shift -9mm; at 19s: shift 7mm; at 24s: shift -3mm",
    ),
    "moves": _moving(
        "a wall that moves and softens",
        "at 3s: shift 6mm over 2s; at 7s: shift -8mm over 1s; at 11s: shift 4mm over 500ms; "
        "at 15s: stiffness 500 over 2s; at 20s: stiffness 3000 over 1s; at 23s: shift -2mm over 1s",
    ),
    "vanishes": _moving(
        "a wall that vanishes, and comes back",
        "at 4s: gone; at 7s: back; at 10s: gone; at 14s: back; at 17s: gone; at 19s: back; at 23s: gone; at 25s: back",
    ),
    "strokes": StudySection(
        "fast strokes, 0.3 to 0.9 m/s, at a true wall that stands still", _STAGED, _FAR[1:],
        tuple(f"strokes-{number}" for number in range(51, 57)), {"duration_s": 30.0},
    ),
    "writing": StudySection(
        "handwriting on a plane", _STAGED, _FAR[1:], tuple(f"writing-{number}" for number in range(51, 55)),
        {"scene": "plane", "duration_s": 20.0},
    ),
    "grips": StudySection("grips of 50 to 900 N/m", _STAGED, _FAR[1:], GRIPS, {"duration_s": 20.0}),
    "peg": StudySection(
        "a peg in a hole, in six axes", _BOTH, ("4g",), _FEW[:2],
        {"scene": "tool:peg + hole?at=0,0,-20mm", "duration_s": 10.0},
    ),
    "solid": StudySection("a ball", _BOTH, ("4g", "intercontinental"), _FEW, {"scene": "sphere", "duration_s": 20.0}),
    "arms": StudySection(
        "pairs of arms: laws between two robots, bare and behind PSPM", BILATERAL, tuple(PRESETS), tuple(ARMS.values()),
        {
            "follower.robot": "simulated", "duration_s": 6.0, "device.stiffness": 300.0, "device.damping": 1.0,
            "device.force_limit_N": 10.0, "follower.force_limit_N": 60.0, "follower.step_limit_N": 5.0,
        },
    ),
    "friction": StudySection(
        "a rough plane", _BOTH, ("4g", "intercontinental"), _FEW,
        {"scene": "plane?friction=0.3", "duration_s": 20.0},
    ),
}  # fmt: skip
