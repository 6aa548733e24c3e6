"""Figures of a jaw that grips an object over a network: the felt force, the account, and a link that is down for 5 s.

The felt force is compared with the statics of springs in series over an ideal link, solved here: the hand K_h with its
reference in the object, the device's K, the world's (or the robot's) K', the object K_w. The proxy p of the opening is
in equilibrium if K'(x - p) = K_w p, and the hand if K_h (d - x) = K (x - p), each from the object's surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hapnet.couplings.stiffness import PAPERS
from hapnet.simulation.simulation import Result, simulate

HOLD_S, REACH_S, WAIT_S, DEEP_M = 3.0, 1.0, 0.5, 0.02
HAND = {"operator": "press", "operator_model.hold_s": HOLD_S, "operator_model.reach_s": REACH_S,
        "operator_model.wait_s": WAIT_S, "operator_model.goal_m": 0.02 + DEEP_M}  # fmt: skip
HANDS_N_M, WORLDS_N_M, WORLDS_NS_M = 135.0, 500.0, 14.0
OBJECTS = {"grip:soft": 500.0, "grip:hard": 5000.0, "grip?stiffness=20000": 20000.0}
KINDS: Mapping[str, dict[str, object]] = {
    "virtual": {},
    "follower": {"follower.robot": "simulated"},
    "  force": {"follower.robot": "simulated", "follower.feedback": "force"},
}


NONE: Mapping[str, object] = {}


def run(scene: str, changes: Mapping[str, object] = NONE, link: str = "4g", seed: int = 3) -> Result:
    """A hand that closes a jaw on an object, and opens it again."""
    both = {"device.servo": "sampled", "link.up": link, "link.down": link, "duration_s": 2 * (2 + HOLD_S + WAIT_S)}
    return simulate({"scene": scene, **both, **HAND, **changes}, seed)


def statics_N(device: float, world: float, thing: float, deep: float = DEEP_M) -> float:
    """The force of a resting hand on springs in series [N]; of the stiffnesses `device`, `world` and `thing` [N/m]."""
    x, p = np.linalg.solve([[-world, world + thing], [HANDS_N_M + device, -device]], [0.0, HANDS_N_M * deep])
    return float(device * (x - p))


def expected_N(kind: str, device: float, thing: float) -> float:
    """The felt force by the statics: with a robot whose surroundings are not sent, the device's spring has 100 N/m;
    with its measured force the hand feels the robot's spring and the object in series."""
    if kind == "virtual":
        return statics_N(device, WORLDS_N_M, thing)
    if kind == "follower":
        return statics_N(PAPERS, WORLDS_N_M, thing)
    series = 1.0 / (1.0 / WORLDS_N_M + 1.0 / thing)
    return DEEP_M / (1.0 / HANDS_N_M + 1.0 / series)


class Felt(NamedTuple):
    """The mean force on the hand while it holds, and its deviation [N]; whether the run is passive, and its slacks."""

    force: float
    deviation: float
    passive: bool
    slack: float
    margin: float


def felt(result: Result) -> Felt:
    """What the hand felt on the jaw's axis, in the last 60 % of each hold."""
    device: Any = result.recording.device
    summary = result.summary
    phase = device["time_s"] % (2.0 * REACH_S + HOLD_S + WAIT_S)
    until = WAIT_S + REACH_S + HOLD_S
    force = device["force_N"][(phase > until - 0.6 * HOLD_S) & (phase < until)][:, -1]
    sides: list[Any] = [summary["device"], summary["world"]]
    slack = min(one["ledger"]["slack_J"] for one in sides)
    margin = summary["theorem"]["margin_J"]
    return Felt(float(force.mean()), float(force.std()), bool(summary["verdict"]["passive"]), slack, margin or 0.0)


class Cut(NamedTuple):
    """While the link is down: the change of the jaw's opening [m], and its least force over that before. In the two
    seconds after that: the largest steps of the forces in a tick, on the leader and at the jaw (there beyond those
    of its own motion) [N], and the largest opening [m]. The opening at the end [m]."""

    moved: float
    share: float
    leaders_step: float
    jaws_step: float
    waited: float
    last: float
    passive: bool
    slack: float


DOWN_S, UP_S = 4.0, 9.0


def cut(scene: str, opens: bool = False, changes: Mapping[str, object] = NONE) -> Cut:
    """The link is down for 5 s while the jaw holds the object. opens : the hand lets go meanwhile, closes again when
    the link is up, and opens at last."""
    timeline = f"at {DOWN_S}s: down; at {UP_S}s: up"
    result = run(
        scene,
        {"follower.robot": "simulated", "link.up_timeline": timeline, "link.down_timeline": timeline,
           "operator_model.wait_s": 2.5, "operator_model.hold_s": 2.0 if opens else 60.0, "record_hz": 1000.0,
           "duration_s": 14.2 if opens else 11.5, "operator_model.reach_s": REACH_S, **changes},
    )  # fmt: skip
    world: Any = result.recording.world
    device: Any = result.recording.device
    summary = result.summary
    at = world["time_s"]
    down, before = (at >= DOWN_S) & (at < UP_S), (at >= DOWN_S - 0.2) & (at < DOWN_S)
    opening, force = world["position_m"][:, -1], world["coupling_force_N"]
    holds = np.abs(force[:, -1])
    sides: list[Any] = [summary["device"], summary["world"]]
    return Cut(
        float(np.max(np.abs(opening[down] - opening[before].mean()))),
        float(holds[down].min() / holds[before].mean()),
        _step(device["time_s"], device["force_N"]),
        _step(at, force, WORLDS_N_M * world["position_m"] + WORLDS_NS_M * world["velocity_mps"]),
        float(opening[(at >= UP_S) & (at < UP_S + 2.0)].max()),
        float(opening[-1]),
        bool(summary["verdict"]["passive"]),
        min(one["ledger"]["slack_J"] for one in sides),
    )


def _step(at: Any, force: Any, own: Any = None) -> float:
    """The largest step of a force in a tick, in the two seconds after the link came back [N]; beyond that which the
    spring and damper make of the motion, if `own` has their forces."""
    steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
    if own is not None:
        steps = steps - np.linalg.norm(np.diff(own, axis=0), axis=1)
    return float(steps[(at[1:] >= UP_S) & (at[1:] < UP_S + 2.0)].max())


def main(link: str = "4g") -> None:
    print(f"{'':10} {'object':22} {'felt':>7} {'ideal':>7} {'error %':>8} {'passive':>8} {'slack':>9}  [N, J]")
    for kind, changes in KINDS.items():
        for scene, thing in OBJECTS.items():
            result = run(scene, changes, link)
            one = felt(result)
            params: Any = result.recording.meta["params"]
            ideal = expected_N(kind, float(params["device"]["stiffness"]), thing)
            error = 100.0 * (one.force / ideal - 1.0)
            print(
                f"{kind:10} {scene:22} {one.force:7.4f} {ideal:7.4f} {error:8.2f} {one.passive!s:>8} {one.slack:9.1e}"
            )
    head = f"{'link down':10} {'object':22} {'moved um':>9} {'force %':>8} {'steps N':>13} {'passive':>8} {'slack':>9}"
    print(f"\n{head} {'open mm':>13}")
    for scene in OBJECTS:
        for opens in (False, True):
            found = cut(scene, opens)
            steps = f"{found.leaders_step:6.3f} {found.jaws_step:6.3f}"
            print(
                f"{'opens' if opens else 'holds':10} {scene:22} {1e6 * found.moved:9.2f} {100 * found.share:8.2f}"
                f" {steps} {found.passive!s:>8} {found.slack:9.1e} {1e3 * found.waited:6.2f} {1e3 * found.last:6.2f}"
            )
