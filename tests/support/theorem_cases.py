"""Random cases for Theorem 1: everything that the theorem allows to be arbitrary, drawn from one seed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hapnet.assembly.scenes import for_its_scene
from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation
from tests.conftest import DATA, random_spd

HANDWRITING = DATA / "hand" / "handwriting.csv"
TOLERANCE_J = 1e-9


def random_link(rng: np.random.Generator) -> str:
    """tc words: delay to 500 ms, jitter, loss to 40 %, random or in bursts, reordering, a rate."""
    delay = rng.uniform(0.0, 500.0)
    words = f"delay {delay:.3f}ms"
    if rng.random() < 0.7:
        words += f" {rng.uniform(0.01, 1.0) * min(delay, 150.0):.3f}ms"
        if rng.random() < 0.5:
            words += " distribution " + str(rng.choice(["normal", "pareto", "paretonormal"]))
    kind = rng.integers(3)
    if kind == 1:
        words += f" loss {rng.uniform(0.0, 40.0):.2f}%"
    elif kind == 2:  # bursts: bad with p/(p + r) of the messages, at most 40 %
        recovery = rng.uniform(5.0, 60.0)
        words += f" loss gemodel {recovery * rng.uniform(0.01, 0.66):.3f}% {recovery:.3f}%"
    if rng.random() < 0.4:
        words += f" reorder {rng.uniform(1.0, 50.0):.2f}% {rng.uniform(0.0, 50.0):.2f}%"
        if rng.random() < 0.5:
            words += f" gap {rng.integers(2, 8)}"
    if rng.random() < 0.3:
        words += f" rate {rng.integers(200, 3000)}kbit limit {rng.integers(20, 400)}"
    return words


def matrix(rng: np.random.Generator, n: int, low: float, high: float, *, general: bool = True) -> list[list[float]]:
    """A random SPD matrix, or a random diagonal one."""
    rows: list[list[float]] = random_spd(rng, n, low, high).tolist()
    return rows if general else np.diag(np.diagonal(rows)).tolist()


def diagonal(rng: np.random.Generator, n: int, low: float, high: float) -> list[float]:
    return np.exp(rng.uniform(np.log(low), np.log(high), size=n)).tolist()


def random_case(seed: int, duration_s: float = 5.0) -> Params:
    """Case `seed`."""
    return for_its_scene(with_any_scene(seed, duration_s))


def with_any_scene(seed: int, duration_s: float) -> Params:
    """Case `seed`, also with what its scene does not read."""
    rng = np.random.default_rng([seed, 2009])
    scene = str(rng.choice(["free", "wall", "box", "paper"]))
    n = 3 if scene == "paper" else int(rng.integers(1, 4))
    operators = ["rest", "sine", "press"] + ([str(HANDWRITING)] if HANDWRITING.exists() else [])
    separate = scene != "box"  # a box's walls do not act on each other through M, B' and K'
    shortest, maximum = sorted(np.exp(rng.uniform(np.log(1e-3), np.log(0.1), size=2)).tolist())
    changes: dict[str, object] = {
        "rendering": "hapnet" if seed % 4 == 3 else "paper",
        "duration_s": duration_s,
        "record_hz": 250.0,
        "scene": scene,
        "operator": str(rng.choice(operators)),
        "link.up": random_link(rng),
        "link.down": random_link(rng),
        "device.stiffness": matrix(rng, n, 20.0, 600.0),
        "device.damping": diagonal(rng, n, 0.02, 3.0),
        "device.servo_hz": rng.choice([1000.0, rng.uniform(300.0, 1000.0)]),
        "device.pspm_period_s": rng.uniform(0.001, 0.02),
        "device.own_damping": rng.choice([0.0, 0.1, 0.3, 1.0]),
        "device.mass": rng.uniform(0.02, 0.3),
        "device.force_limit_N": 0.0 if rng.random() < 0.4 else rng.uniform(0.3, 5.0),
        "device.step_limit_N": 0.0 if rng.random() < 0.4 else rng.uniform(0.05, 2.0),
        "device.substeps": int(rng.integers(1, 5)),
        "world.mass": matrix(rng, n, 0.005, 0.5, general=separate),
        "world.damping": matrix(rng, n, 1.0, 30.0, general=separate),
        "world.stiffness": matrix(rng, n, 50.0, 3000.0, general=separate),
        "world.step_min_s": shortest,
        "world.step_max_s": maximum,
        "world.wall.stiffness": rng.uniform(300.0, 30000.0),
        "world.wall.damping": rng.choice([0.0, rng.uniform(0.1, 50.0)]),
        "wire.accept_stale": bool(rng.random() < 0.5),
        "wire.admission_W": rng.uniform(0.01, 10.0),
        "wire.admission_burst_J": rng.uniform(0.01, 1.0),
        "operator_model.amplitude_m": rng.uniform(0.005, 0.05),
        "operator_model.frequency_hz": rng.uniform(0.2, 3.0),
        "operator_model.goal_m": rng.uniform(0.01, 0.06),
        "operator_model.start_m": rng.uniform(-0.03, 0.0),
        "operator_model.reach_s": rng.uniform(0.2, 1.0),
        "operator_model.hold_s": rng.uniform(0.0, 1.0),
        "operator_model.mass": rng.uniform(0.0, 0.6),
        "operator_model.damping": rng.uniform(0.0, 7.0),
        "operator_model.stiffness": rng.uniform(20.0, 300.0),
    }
    if scene != "paper":
        changes["dof"] = n
    shuffle = str(rng.choice(["harvested", "all"]))
    for side in ("device", "world"):
        changes[f"{side}.shuffle"] = shuffle
        changes[f"{side}.ceiling_J"] = rng.choice([0.0, rng.uniform(0.001, 0.1)])
        changes[f"{side}.smoothing_s"] = rng.choice([0.0, rng.uniform(0.002, 0.05)])
        changes[f"{side}.predict_s"] = rng.choice([0.0, rng.uniform(0.005, 0.2)])
        changes[f"{side}.on_silence"] = str(rng.choice(["hold", "release"]))
        changes[f"{side}.silence_after_s"] = rng.uniform(0.02, 0.5)
    if changes["device.on_silence"] == "release" and not changes.get("device.step_limit_N", 0.5):
        changes["device.step_limit_N"] = 0.5  # letting go is a ramp, and needs its limit
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in changes.items()}
    return Params().set(plain)


@dataclass(frozen=True)
class Outcome:
    """What one case came to [J, nJ]; `credit_gap_nJ` is the least of sent(there) - credited(here) at any event."""

    device_slack: float
    world_slack: float
    margin: float
    reservoir: float
    credit_gap_nJ: int
    result: Result


class Watched(Simulation):
    """A simulation that compares what was credited with what was sent after every event."""

    credit_gap_nJ = 0

    def hindrance(self, kind: int) -> int:
        self._compare()
        return super().hindrance(kind)

    def _compare(self) -> None:
        """Both ways, between the protocol's halves and between the ledgers (their credits are whole nanojoules)."""
        one, other = self.device.endpoint, self.world.endpoint
        for here, there in ((one, other), (other, one)):
            gap = there.session.sent_nJ - here.session.credited_nJ
            if one.started and other.started:
                sent = there.coupling.ledger.sent * 1e9 + 1e-3
                gap = min(gap, math.floor(sent) - round(here.coupling.ledger.credited * 1e9))
            self.credit_gap_nJ = min(self.credit_gap_nJ, gap)


def run_case(params: Params, seed: int) -> Outcome:
    """Run it; the reservoirs' minimum is over every recorded sample and every update."""
    simulation = Watched(params, seed)
    result = simulation.run()
    device, world = result.recording.device, result.recording.world
    summary = result.summary
    minima = [float(device["reservoir_J"].min()), float(world["reservoir_J"].min())]
    minima += [side["reservoir_min_J"] for side in sides(summary) if side["reservoir_min_J"] is not None]
    return Outcome(
        summary["device"]["ledger"]["slack_J"],
        summary["world"]["ledger"]["slack_J"],
        summary["theorem"]["margin_J"],
        min(minima),
        simulation.credit_gap_nJ,
        result,
    )


def sides(summary: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The device's and the world's part of a summary."""
    yield summary["device"]
    yield summary["world"]
