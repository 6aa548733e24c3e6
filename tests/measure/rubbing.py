"""A hand that slides over a surface that rubs, through a bad link: the friction at the device beside Coulomb's.

``python -m tests.measure rubbing`` prints the table of hapnet/ext/solids/rigid.md.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.simulation.simulation import Simulation

K, K_WORLD, K_WALL = 100.0, 500.0, 3000.0
FACE_M, DEEP_M, TRAVEL_M = 0.02, 0.01, 0.03
LINKS = {"5 ms": "delay 5ms", "40 ms": "delay 40ms", "40±10 ms, 2 %": "delay 40ms 10ms loss 2%"}


class Rub:
    """A firm hand: it goes 10 mm deep in half a second, then to and fro along y, or a little aside and stays there."""

    speed_mps = 0.05
    aside_m = 0.0
    """Above 0: it goes so far aside and stays."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance, self._dof = Impedance(0.5, 60.0, 3000.0), dof

    def reference(self, t: float) -> Vector:
        within = min(1.0, t / 0.5)
        within = within * within * (3.0 - 2.0 * within)
        way = max(0.0, t - 0.7) * self.speed_mps
        to_and_fro = TRAVEL_M * (1.0 - abs(way / TRAVEL_M % 2.0 - 1.0))
        along = min(way, self.aside_m) if self.aside_m else to_and_fro
        return ((FACE_M + DEEP_M) * within, along, 0.0)[: self._dof]


class Felt(NamedTuple):
    """What a run has shown; rows are ticks of 1 ms."""

    x: Array
    """Of the device [m]."""
    v: Array
    """[m/s]"""
    force: Array
    """At the device, without its damper [N]."""
    summary: Any

    def push(self) -> Array:
        return -self.force[:, 0]

    def rub(self) -> Array:
        return self.force[:, 1]

    def sliding(self) -> Array:
        """The ticks in which the hand has slid steadily for longer than the spring needs to be strained."""
        fast = np.abs(self.v[:, 1]) > 0.5 * Rub.speed_mps
        long = round(1e3 * 0.5 * TRAVEL_M / Rub.speed_mps)
        steady = np.convolve(fast & (np.sign(self.v[:, 1]) > 0), np.ones(long), "full")[: len(fast)] >= long - 0.5
        steady |= np.convolve(fast & (np.sign(self.v[:, 1]) < 0), np.ones(long), "full")[: len(fast)] >= long - 0.5
        return steady

    def steps(self) -> Array:
        """Of the force from tick to tick [N], while touching."""
        touched = self.push()[1:] > 0.05
        return np.linalg.norm(np.diff(self.force, axis=0), axis=1)[touched]


def run(
    scene: str, link: str = "5 ms", *, steps_s: tuple[float, float] = (0.01, 0.05), speed_mps: float = 0.05,
    aside_m: float = 0.0, seconds: float = 3.0, dof: int = 3, seed: int = 1,
    watch: Callable[[Simulation], None] | None = None, **more: object,
) -> Felt:  # fmt: skip
    hand: Any = import_module("tests.measure.rubbing").Rub  # of the module that the run imports
    hand.speed_mps, hand.aside_m = speed_mps, aside_m
    params = Params().set({
        "device.stiffness": K,
        "scene": scene, "dof": dof, "operator": f"{__name__}:Rub",
        "link.up": LINKS.get(link, link), "link.down": LINKS.get(link, link),
        "duration_s": seconds, "record_hz": 1000.0, "world.step_min_s": steps_s[0], "world.step_max_s": steps_s[1],
        **more,
    })  # fmt: skip
    simulation = Simulation(params, seed, kernel=None if watch is None else False)
    if watch is not None:
        watch(simulation)
    result = simulation.run()
    device = result.recording.device
    x = device["position_m"]
    v = np.gradient(x, 1e-3, axis=0)
    return Felt(x, v, device["force_N"] + params.device.damping * v, result.summary)


def lied_to(
    planes: Callable[[Vector, float], tuple[Plane, ...]], link: str, *, seed: int, dof: int, coupling: str
) -> Any:
    """The summary of two seconds of a light hand in a world that sends these planes, whatever it is."""

    def watch(simulation: Simulation) -> None:
        contacts: Any = simulation.world.scene.contacts
        contacts.planes = planes

    hand = {"operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 40.0}
    more: dict[str, object] = {"coupling": coupling, "operator": "press", **hand}
    return run("sphere", link, seconds=2.0, dof=dof, seed=seed, watch=watch, **more).summary


def slack_of(summary: Any) -> float:
    return float(min(summary[side]["ledger"]["slack_J"] for side in ("device", "world")))


def check_no_energy(summary: Any) -> None:
    """That whatever was sent has created no energy."""
    assert slack_of(summary) >= -1e-12
    assert summary["theorem"]["margin_J"] >= 0.0
    assert summary["device"]["reservoir_min_J"] >= 0.0


def smooth(simulation: Simulation) -> None:
    """Send planes as before: without friction."""
    contacts: Any = simulation.world.scene.contacts
    report = contacts.planes
    contacts.planes = lambda x, reach: tuple(plane._replace(friction=0.0) for plane in report(x, reach))


def rubbed(felt: Felt, mu: float) -> tuple[float, float, float]:
    """The friction against the motion over mu times the push, while sliding: mean, least, most."""
    on = felt.sliding()
    ratio = -felt.rub()[on] * np.sign(felt.v[on, 1]) / (mu * felt.push()[on])
    return float(ratio.mean()), float(ratio.min()), float(ratio.max())


def main() -> None:
    print("| mu | one way | steps [ms] | smooth planes | planes that rub (least to most) | force steps, p95 | slack |")
    print("|---|---|---|---|---|---|---|")
    for mu in (0.2, 0.5, 0.8):
        for link in LINKS:
            for steps in ((0.001, 0.001), (0.01, 0.05)):
                before, felt = (run(f"plane?friction={mu}", link, steps_s=steps, watch=w) for w in (smooth, None))
                (without, *_), (mean, minimum, most) = (rubbed(one, mu) for one in (before, felt))
                p95 = np.percentile(felt.steps(), 95)
                slack = slack_of(felt.summary)
                print(
                    f"| {mu} | {link} | {1e3 * steps[0]:.0f} to {1e3 * steps[1]:.0f} | {without:.3f} | {mean:.3f} "
                    f"({minimum:.3f} to {most:.3f}) | {1e3 * p95:.1f} mN | {slack:.0e} J |"
                )
