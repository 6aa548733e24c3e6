"""A peg in a hole 0.2 mm wider, by random hands: how deep it goes, and what that costs.

Beside each run over a link stands the same hand with the same springs on the spot: no link, and steps of 1 ms.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context

import numpy as np

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.ext.compiled import catalogue
from hapnet.ext.compiled.names import HANDLE
from hapnet.ext.tools.device import turned
from hapnet.mechanics.pose import ARM_M
from hapnet.plant.operator import Impedance, minimum_jerk
from hapnet.records.machine_code import no_compiler
from hapnet.simulation.simulation import Simulation
from tests.measure.tools import wrench

RADIUS_M, CLEARANCE_M, LENGTH_M, MOUTH_M, DEEP_M = 0.005, 0.0002, 0.03, 0.02, 0.02
SCENE = (
    f"tool:peg?radius={RADIUS_M}m&length={LENGTH_M}m + "
    f"hole?radius={RADIUS_M + CLEARANCE_M}m&at=0,0,-{MOUTH_M}m&friction=0.2"
)
ON_THE_SPOT: Mapping[str, object] = {
    "link.up": "delay 0ms", "link.down": "delay 0ms", "world.step_min_s": 0.001, "world.step_max_s": 0.001,
}  # fmt: skip
LASTS_S, DOWN_S = 4.0, 2.5


class Inserting:
    """A hand that misses the hole's middle by up to 0.7 mm and its direction by up to 2 degrees, and pushes in."""

    def __init__(self, number: int) -> None:
        rng = np.random.default_rng([2009, number])
        self.impedance: Impedance = Impedance()
        angle, size = rng.uniform(0.0, 2.0 * np.pi), 0.0007 * np.sqrt(rng.random())
        self._off = size * np.cos(angle), size * np.sin(angle)
        self._tilt: Vector = tuple((np.radians(2.0) * rng.uniform(-1.0, 1.0, 3)).tolist())
        self._down_s = DOWN_S * rng.uniform(0.6, 1.0)

    def reference(self, t: float) -> Vector:
        """The pose (12,) [m] at t [s]: first it turns and moves aside, then down."""
        aside, down = minimum_jerk(t / 0.5), minimum_jerk((t - 0.5) / self._down_s)
        deep = down * (MOUTH_M - 0.5 * LENGTH_M + DEEP_M)
        place = (aside * self._off[0], aside * self._off[1], -deep)
        return turned(place, tuple([aside * part for part in self._tilt]), ARM_M)


@dataclass(frozen=True)
class Insertion:
    """How deep the peg's end is in the hole at the end [m]; largest steps from tick to tick [N], [Nm]; the account."""

    deep_m: float
    step_N: float
    step_Nm: float
    modulated: float
    slack_J: float
    env_slack_J: float
    passive: bool


def insert(number: int, link: str = "") -> Insertion:
    """link : a profile; empty: on the spot."""
    over = {"link.up": link, "link.down": link} if link else ON_THE_SPOT
    setup = prepare({"scene": SCENE, "duration_s": LASTS_S, "record_hz": 1000.0, **over}, "continuous")
    result = Simulation(setup.params, number, setup=replace(setup, hand=Inserting(number))).run()
    device, summary = result.recording.device, result.summary
    pairs = [wrench(x, f) for x, f in zip(device["position_m"], device["force_N"], strict=True)]
    forces, torques = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    return Insertion(
        -float(device["position_m"][-1, 2]) + 0.5 * LENGTH_M - MOUTH_M,
        float(np.linalg.norm(np.diff(forces, axis=0), axis=1).max()),
        float(np.linalg.norm(np.diff(torques, axis=0), axis=1).max()),
        summary["world"]["modulated_share"],
        min(summary[side]["ledger"]["slack_J"] for side in ("device", "world")),
        summary["environment"]["env_slack_J"],
        summary["verdict"]["passive"],
    )


def insertions(numbers: Sequence[int], link: str, workers: int) -> Iterator[Insertion]:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(partial(insert, link=link), numbers)


def compile_ends() -> None:
    """Make the machine code of the handle and of both ends of the coupling, which all runs then use."""
    if no_compiler() is None:
        for name in catalogue.ends():
            if name == HANDLE or name.endswith("-12"):
                catalogue.makers()[name]()


def main(links: str = "4g,wan-intercontinental", hands: int = 100, first: int = 0, workers: int = 2) -> None:
    """hands : how many; first : the number of the first. On the spot, at ten times the cost, only those run that did
    not end within 1 mm of the full depth."""
    compile_ends()
    for link in links.split(","):
        found = dict(
            zip(range(first, first + hands), insertions(range(first, first + hands), link, workers), strict=True)
        )
        short = [number for number, one in found.items() if one.deep_m < DEEP_M - 1e-3]
        spot = dict(zip(short, insertions(short, "", workers), strict=True))
        worse = [number for number, one in spot.items() if found[number].deep_m < one.deep_m - 1e-3]
        each = found.values()
        print(
            f"{link}: in {sum(one.deep_m > 0.9 * DEEP_M for one in each)} of {hands}, "
            f"{1e3 * min(one.deep_m for one in each):.2f} mm deep at least, "
            f"less deep than on the spot: {worse}; passive {sum(one.passive for one in each)}; "
            f"slack {min(one.slack_J for one in each):.1e} J, env_slack {min(one.env_slack_J for one in each):.1e} J; "
            f"largest step: {max(one.step_N for one in each):.3f} N, {1e3 * max(one.step_Nm for one in each):.2f} mNm; "
            f"modulated {100.0 * max(one.modulated for one in each):.1f} %",
            flush=True,
        )
