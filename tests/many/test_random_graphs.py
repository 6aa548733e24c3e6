"""Random directed graphs of devices and followers, with cycles, over bad links, and one node that lies: all passive."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, PositionSample, ProxySample
from hapnet.control.deadband import Deadband
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphResult, GraphSimulation
from hapnet.plant.operator import Impedance
from tests.many.accounts import require_passive

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

MOST_NODES = 12


class Hand:
    """Moves along each axis by two random sines, from rest."""

    impedance: Impedance = Impedance(0.1, 6.45, 135.0)

    def __init__(self, rng: np.random.Generator) -> None:
        self._size, self._rate = rng.uniform(0.01, 0.04, 3), rng.uniform(1.0, 8.0, 3)

    def reference(self, t: float) -> Vector:
        return tuple((min(1.0, t) * self._size * np.sin(self._rate * t)).tolist())


class Liar(Deadband):
    """Sends every sample with a position that is up to 0.3 m wrong on each axis."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(1.0)
        self._rng = rng

    def offer(self, now_s: float, sample: Any, opposite: Vector) -> CouplingSample | None:
        def wrong(position: Vector) -> Vector:
            return tuple([x + float(error) for x, error in zip(position, self._rng.uniform(-0.3, 0.3, 3), strict=True)])

        if isinstance(sample, PositionSample | ProxySample):
            return sample._replace(position=wrong(sample.position))
        return wrong(sample)


def random_graph(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Hand]]:
    """Up to 12 nodes: a device or two, followers with any leader, and hands wherever none leads a cycle."""
    count = int(rng.integers(2, MOST_NODES + 1))
    devices = 1 + int(count > 3 and rng.random() < 0.3)
    leader = {k: k if k < devices else int(rng.choice([j for j in range(count) if j != k])) for k in range(count)}
    for k in range(devices):
        leader[devices + k] = k
    held = {k for k in range(devices, count) if rng.random() < 0.4}
    for k in range(devices, count):
        held |= {k} if _without_hand(k, leader, held, devices) else set()
    edges: list[dict[str, Any]] = []
    for k in range(devices, count):
        links = [
            f"delay {rng.integers(1, 150)}ms {rng.integers(0, 40)}ms loss {rng.integers(0, 41)}%" for _ in range(2)
        ]
        edge = {"from": f"n{leader[k]}", "to": f"n{k}", "link": {"up": links[0], "down": links[1]}}
        edges.append({**edge, **({"force": False} if rng.random() < 0.2 else {})})
    for name in {edge["from"] for edge in edges}:
        own = [edge for edge in edges if edge["from"] == name]
        if rng.random() < 0.3:
            parts = rng.dirichlet(np.ones(len(own))) * rng.uniform(0.3, 1.0)
            for edge, share in zip(own, parts.tolist(), strict=True):
                edge["share"] = max(share, 1e-3)
    nodes = {
        f"n{k}": {"kind": "device"}
        if k < devices
        else {"kind": "follower", **({"operator": "rest"} if k in held else {})}
        for k in range(count)
    }
    hands = {f"n{k}": Hand(rng) for k in (*range(devices), *held)}
    plain = {"scene": "free", "dof": 3, "record_hz": 1000.0, "rendering": str(rng.choice(["paper", "hapnet"]))}
    return {"duration_s": 1.2, **plain, "nodes": nodes, "edges": edges}, hands


def _without_hand(k: int, leader: dict[int, int], held: set[int], devices: int) -> bool:
    passed = []
    while k not in passed:
        passed.append(k)
        if k < devices or k in held:
            return False
        k = leader[k]
    return True


def _ran(seed: int) -> tuple[GraphSimulation, GraphResult]:
    rng = np.random.default_rng(seed)
    graph, hands = random_graph(rng)
    run = GraphSimulation(graph_of(graph), seed, hands=hands)  # type: ignore[arg-type]
    pair = list(run.pairs.values())[int(rng.integers(len(run.pairs)))]
    (pair.device_endpoint if rng.random() < 0.5 else pair.world_endpoint).deadband = Liar(rng)
    return run, run.run()


def _seeds(first: int, last: int, block: int) -> Iterator[range]:
    for begin in range(first, last, block):
        yield range(begin, begin + block)


@pytest.mark.parametrize(
    "seeds",
    [
        range(2),
        *(pytest.param(seeds, marks=pytest.mark.slow) for seeds in _seeds(2, 22, 10)),
        *(pytest.param(seeds, marks=pytest.mark.soak) for seeds in _seeds(22, 202, 20)),
    ],
)
def test_random_graphs_are_passive(seeds: range) -> None:
    for seed in seeds:
        run, result = _ran(seed)
        require_passive(run, result)
        assert result.summary["verdict"]["passive"] is not False, seed


def test_the_random_graphs_have_cycles_and_chains() -> None:
    deepest, cycles = 0, 0
    for seed in range(50):
        graph = graph_of(random_graph(np.random.default_rng(seed))[0])
        for name in graph.nodes:
            passed = [name]
            while (into := graph.led_to(passed[-1])) and into[0].device not in passed:
                passed.append(into[0].device)
            deepest, cycles = max(deepest, len(passed)), cycles + bool(into)
    assert deepest >= 5
    assert cycles >= 10
