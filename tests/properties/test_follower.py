"""Theorem 1 with a robot in the virtual mass's place, over links, scenes and scales drawn at random."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hapnet import simulate
from tests.conftest import mostly_slow

TOOLS = ("tool:box", "tool:box + plane", "tool:peg + hole?at=0,0,-20mm", "tool:stick + sphere?at=0,0,-60mm&radius=15mm")
SCENES = ("free", "wall", "box", "sphere?at=0,0,-30mm&radius=15mm")
OPERATORS = ("hand-21", "hand-22", "press", "sine")


def drawn(case: int) -> dict[str, object]:
    """The parameters of a case."""
    rng = np.random.default_rng([33, case])
    delay, jitter = rng.uniform(0.0, 200.0), rng.uniform(0.0, 30.0)
    link = f"delay {delay:.0f}ms {min(jitter, delay):.0f}ms loss {rng.uniform(0.0, 40.0):.0f}%"
    scene = SCENES[rng.integers(len(SCENES))]
    staged = rng.random() < 0.7
    held = rng.random() < 0.8
    motion, force = np.exp(rng.uniform(math.log(0.1), math.log(5.0), 2)) if rng.random() < 0.6 else (1.0, 1.0)
    feedback = ["position", *["force"] * held, *["planes"] * staged]
    return {
        "duration_s": 4.0,
        "scene": scene,
        "operator": OPERATORS[rng.integers(len(OPERATORS))],
        "rendering": "hapnet" if staged else "paper",
        "device.servo": "sampled",
        "device.clutch": "1-1.6, 2.5-2.8" if rng.random() < 0.5 else "",
        "device.resolution_m": 2e-5 if rng.random() < 0.3 else 0.0,
        "link.up": link,
        "link.down": link,
        "follower.robot": "simulated",
        "follower.servo": "sampled" if held else "continuous",
        "follower.servo_hz": float(rng.choice([1000.0, 500.0, 100.0])),
        "follower.resolution_m": 1e-4 if held and rng.random() < 0.5 else 0.0,
        "follower.motion_scale": float(motion),
        "follower.force_scale": float(force),
        "follower.feedback": feedback[rng.integers(len(feedback))],
        "follower.start": ("here", "origin")[rng.integers(2)],
    }


def drawn_tool(case: int) -> dict[str, object]:
    """As `drawn`, of a tool: it is moved by a held force."""
    params, rng = drawn(case), np.random.default_rng([34, case])
    fits = {"scene": TOOLS[case % len(TOOLS)], "follower.servo": "sampled", "duration_s": 2.0}
    hand = ("hand-21", "hand-22", "press")[rng.integers(3)]
    motion, force = np.exp(rng.uniform(math.log(0.1), math.log(5.0), 2)) if case % 5 else (1.0, 1.0)
    scales = {"follower.motion_scale": float(motion), "follower.force_scale": float(force)}
    return {**params, **fits, **scales, "operator": hand}


def check(case: int, make: Callable[[int], dict[str, object]] = drawn) -> None:
    params = make(case)
    result = simulate(params, seed=case)
    summary, mass = result.summary, result.world.mass
    device, world = summary["device"], summary["world"]
    assert device is not None
    for side in (device, world):
        slack = side["ledger"]["slack_J"]
        assert slack >= -1e-12, params
    margin, own = summary["theorem"]["margin_J"], summary["environment"]["env_slack_J"]
    assert margin >= -1e-9, params
    assert own >= -1e-12, params
    assert summary["verdict"]["passive"] is not False, params  # coarse encoders may leave it unknown
    if (blur := world.get("quantisation_J")) is not None:  # what its encoders hide of what its motor really did
        counted = result.world.coupling.ledger.work
        assert abs(mass.port_J(counted) - counted) <= blur + 1e-12, params


@pytest.mark.parametrize("case", mostly_slow(range(10), 2, 6))
def test_the_theorem_holds_with_a_robot_as_the_world(case: int) -> None:
    check(case)


@pytest.mark.parametrize("case", mostly_slow([4, 1, 0, 2, 3, *range(5, 20)], 1, 3))
def test_the_theorem_holds_with_a_tool_that_turns(case: int) -> None:
    check(case, drawn_tool)


@pytest.mark.parametrize("case", mostly_slow(range(10, 100), 0, 3))
def test_the_theorem_holds_with_a_robot_over_a_hundred_links(case: int) -> None:
    check(case)
