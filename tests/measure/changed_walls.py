"""A world that changes under the hand, or lies about its planes: what the device feels, and what it costs.

``python -m tests.measure changed_walls`` prints a table over all changes, hands and moments; test_changed_walls.py
asserts it.
"""

import statistics
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from examples.pictures.lying import lying_planes
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.worlds.moving_wall import MovingWall
from hapnet.simulation.simulation import Simulation
from tests.support.own_motion import largest_step

CHANGES = {
    "moves by 3 mm": "shift 3mm",
    "comes by 3 mm": "shift -3mm",
    "turns by 20 degrees": "turn 20deg",
    "three times softer": "stiffness 1000",
    "vanishes": "gone",
    "comes": "back",
    "lies": "",
}
LIGHT = {"operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 40.0}
HANDS: dict[str, dict[str, float]] = {"firm": {}, "light": LIGHT}
LINK = "delay 40ms 10ms loss 2%"
CORRECTED_S = 0.1
"""After the world's word arrived, the force must be right again within this time [s]."""


@dataclass(frozen=True)
class Denied:
    """A run: the largest step of the force under zero-order hold [N], smallest slack and margin [J], and how far the
    force was from the present wall's 100 ms after its word had come: `wrong` [N], beside `right` [N] (None: the world
    lied)."""

    step: float
    slack: float
    margin: float
    right: float | None
    wrong: float | None


def denied(
    change: str, hand: str, at_s: float, *, coupling: str = "pspm", seed: int = 0, dof: int = 2, stiffness: float = 0.0
) -> Denied:
    """Press a wall of scene `moving` over 4G, and let it change at this time. stiffness : K [N/m]; 0: by rule."""
    words = CHANGES[change]
    timeline = f"at {at_s}s: {words}" if words else ""
    if change == "comes":
        timeline = f"at 0.1s: gone; {timeline}"
    params = Params().set({
        "scene": "moving", "dof": dof, "world.wall.timeline": timeline, "coupling": coupling, "operator": "press",
        "operator_model.hold_s": 2.0, "link.up": LINK, "link.down": LINK, "record_hz": 1000.0,
        "duration_s": at_s + 0.5, "device.stiffness": stiffness, **HANDS[hand],
    })  # fmt: skip
    run = Simulation(params, seed)
    scene: Any = run.world.scene
    if change == "lies":
        scene.planes = lying_planes(np.random.default_rng(seed))
    heard: list[tuple[int, tuple[Plane, ...] | None]] = []
    run.pair()
    source = run.device.coupling.source  # type: ignore[attr-defined]  # the test looks at what arrives
    receive = source.receive

    def listen(sample: Any, sent_s: float, age_s: float) -> None:
        heard.append((run.now_ns, sample.planes))
        receive(sample, sent_s, age_s)

    source.receive = listen
    result = run.run()
    device, summary = result.recording.device, result.summary
    force, x = device["force_N"], device["position_m"]
    slack = min(summary[side]["ledger"]["slack_J"] for side in ("device", "world"))  # type: ignore[literal-required]
    K: Any = run.setup.params.device.stiffness
    step = largest_step(force, x, K)
    right = wrong = None
    if words:
        since = run.world.origin_ns + round(at_s * 1e9)  # the wall's clock begins with the world's first step
        before = [planes for now, planes in heard if now < since][-1]
        word_ns = next((now for now, planes in heard if now >= since and planes != before), None)
        assert word_ns is not None, f"{change}, {hand}, at {at_s} s, {coupling}, seed {seed}: no word of it came"
        i = int(np.searchsorted(device["time_ns"], word_ns + round(CORRECTED_S * 1e9)))
        part = slice(i, i + 50)
        ideal = _ideal(scene, at_s, x[part], run.setup.params)
        held = params.device.damping  # in contact; in free motion, what the lead leaves of all of it
        left = (held + run.setup.tuning.damping_Ns_m) * (1.0 - params.contact_model.lead)
        damping = np.where(np.any(ideal, axis=1), held, left)[:, None]
        drag = damping * np.gradient(x, 1e-3, axis=0)[part]
        right = float(np.linalg.norm(ideal, axis=1).mean())
        wrong = float(np.linalg.norm(force[part] + drag - ideal, axis=1).mean())
    return Denied(step, slack, summary["theorem"]["margin_J"] or 0.0, right, wrong)


def _ideal(scene: MovingWall, at_s: float, x: Any, params: Params) -> Any:
    """Springs in series: the force of the present wall through K' and K, without delay [N]."""
    wall = scene.schedule.at(at_s + 1.0)
    if wall is None:
        return np.zeros_like(x)
    normal, K, K_world = np.array(wall.normal), params.device.stiffness, params.world.stiffness
    depth = np.maximum(0.0, x @ normal - wall.offset)
    return -np.outer(K * depth * wall.stiffness / (K_world + wall.stiffness), normal)  # type: ignore[operator]


def rows(moments: int, couplings: tuple[str, ...]) -> Iterator[tuple[str, str, list[Denied]]]:
    """Every change, with both hands at so many moments from touch to release."""
    for change in CHANGES:
        for coupling in couplings:
            times = [round(float(t), 4) for t in np.linspace(1.3, 3.2, moments)]
            runs = [denied(change, hand, t, coupling=coupling, seed=k) for hand in HANDS for k, t in enumerate(times)]
            yield change, coupling, runs


def main(moments: int = 8) -> None:
    """Moments : of the change, with each hand."""
    print("| the wall | coupling | largest step [N] | smallest slack [J] | min margin [J] | off by, median, most [N] |")
    print("|---|---|---|---|---|---|")
    for change, coupling, runs in rows(moments, ("pspm", "zoh")):
        wrong = [one.wrong for one in runs if one.wrong is not None]
        off = f"{statistics.median(wrong):.3f}, {max(wrong):.3f}" if wrong else "-"
        print(
            f"| {change} | {coupling} | {max(one.step for one in runs):.3f} | {min(one.slack for one in runs):.1e} | "
            f"{min(one.margin for one in runs):.4f} | {off} |"
        )
