"""A device that lies in a world with three hands: two hold a block, and the third is not what it says."""

from math import pi, sin
from typing import Any

import numpy as np

from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphResult, GraphSimulation
from hapnet.plant.operator import Impedance
from tests.support.carrying_hands import Carrier, smooth

STARTS_AT_TICK = 400
FAR_M = 0.5


class Waiting(Carrier):
    """Stays where it begins, in front of a face of its own."""

    def reference(self, t: float) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0)


class Strong(Carrier):
    """Drives through the block from 2 s on: to and fro, twice a second, or slowly once."""

    def __init__(self, axis: int, *, rams: bool) -> None:
        super().__init__(axis, 1.0)
        self.impedance = Impedance(0.554, 40.0, 2000.0)
        self._rams = rams

    def reference(self, t: float) -> tuple[float, ...]:
        t = max(0.0, t - 2.0)
        way = 0.3 * (abs(sin(2.0 * pi * t)) if self._rams else smooth(t))
        return tuple([-way if axis == self.axis else 0.0 for axis in range(3)])


STRONG = {
    "rammer": Strong(0, rams=True), "presser": Strong(0, rams=False), "rammer across": Strong(1, rams=True),
    "presser across": Strong(1, rams=False),
}  # fmt: skip
"""Hands that are honest: against another one's, or across both."""


def run(kind: str, duration_s: float = 5.0, speed: float = 1.0, **top: object) -> tuple[GraphResult, float]:
    """The run, and the block's largest speed [m/s].

    kind : "honest"; "liar", which sends places all over; "forger", which pulls to one side and says that it has sent
        5 W; "shaker", which does so and pulls to and fro; or one of `STRONG`.
    speed : that the third device declares [m/s].
    """
    hands = {"left": Carrier(0, -1.0), "right": Carrier(0, 1.0), "third": STRONG.get(kind, Waiting(1, 1.0))}
    world = {"kind": "world", "scene": "shared:block?at=0,0,0", "world": {"step_min_s": 0.01, "step_max_s": 0.05}}
    nodes: dict[str, Any] = {name: {"kind": "device", "operator": "rest"} for name in hands}
    nodes["third"]["device"] = {"greatest_speed": speed}
    edges = [
        {"from": name, "to": "table", "link": "delay 40ms 10ms loss 2%", "at": hand.at} for name, hand in hands.items()
    ]
    table = {"duration_s": duration_s, "nodes": {**nodes, "table": world}, "edges": edges, **top}
    simulation = GraphSimulation(graph_of(table), 1, hands=hands)
    pair = simulation.pairs["third-table"]
    if kind != "honest" and kind not in STRONG:
        _lies(pair, kind)
    blocks, speeds = pair.setup.scene.shared.blocks, [0.0]
    solve = blocks.solve

    def seen(*arguments: Any) -> Any:
        found = solve(*arguments)
        speeds.append(max(abs(v) for v in blocks.v[0]))
        return found

    blocks.solve = seen
    return simulation.run(), max(speeds)


def _lies(pair: Any, kind: str) -> None:
    end, honest, rng, ticks = pair.device_endpoint, pair.tick, np.random.default_rng(5), 0

    def tick(now_ns: int) -> Any:
        nonlocal ticks
        ticks += 1
        if ticks < STARTS_AT_TICK or not end.paired:
            return honest(now_ns)
        if ticks % 5:
            return None
        to_and_fro = kind == "shaker" and (ticks // 50) % 2 == 0
        place = (0.0, FAR_M if to_and_fro else -FAR_M, 0.0)
        if kind == "liar":
            place = tuple((rng.random(3) - 0.5).tolist())
        else:
            end.session.shuffle(0.025)  # every 5 ms: 5 W
        return pair.device_port.outward(end.session.positions.position(now_ns, place, 1.0))

    pair.tick = tick
