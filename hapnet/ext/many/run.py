"""A graph in virtual time: each edge is a pair with its own clock, and all hands of a world make its steps together.

The pair stays the unit: its two sides, links, reservoirs and margin are those of a run with one hand
(`hapnet.simulation`), and Theorem 1 holds for it whatever moves the world on the other side of its proxy. The events
are those of `hapnet.simulation.events` too. Only the order is new: the earliest event of all pairs comes next, and a
step of a world comes for all its pairs at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hapnet.control.two_port import begin
from hapnet.errors import HapnetError
from hapnet.ext.many.graph import Edge, Graph
from hapnet.ext.many.hands import Change, JointSteps, world_setups
from hapnet.ext.many.reservoirs import Reservoirs
from hapnet.ext.many.summary import graph_summary
from hapnet.plant.operator import Operator
from hapnet.records.record import NEVER
from hapnet.side.endpoint import NANO
from hapnet.simulation import events
from hapnet.simulation.result import Result
from hapnet.simulation.simulation import PAIRING_LIMIT_NS, Simulation

_REPORT_NS = 500_000_000
"""Simulated time between two reports of progress [ns]."""


@dataclass(frozen=True)
class GraphResult:
    """The result of a graph's run.

    summary : of the whole graph, see `hapnet.ext.many.summary`. pairs : the result of each edge, by its name.
    """

    summary: dict[str, Any]
    pairs: dict[str, Result]


class _World:
    """A world with its pairs, which make its steps together."""

    def __init__(self, pairs: list[Simulation]) -> None:
        self.pairs = pairs
        self.reservoirs = Reservoirs.of(pairs[0].setup.params, pairs[0].setup.scene)
        sides = [(pair.world, pair.world_endpoint.session) for pair in pairs]
        self._joint = JointSteps(sides, self.reservoirs if len(pairs) > 1 else None)

    def step(self, now_ns: int) -> None:
        """End the current step of all hands, and begin the next."""
        self._joint.begin(now_ns)
        for pair in self.pairs:
            pair.clock.now_ns = now_ns
            events.happen(pair, events.STEP, now_ns)
        self._joint.end(now_ns)
        due_ns = next((one.clock.due[events.STEP] for one in self.pairs if one.world.origin_ns is not None), None)
        for pair in self.pairs:  # a hand that pairs later joins at the beginning of a step
            pair.clock.due[events.STEP] = due_ns or pair.clock.due[events.STEP]


class GraphSimulation:
    """One run of a graph in virtual time.

    graph : see `hapnet.ext.many.graph`. seed : of all random draws; the first edge draws as a run of one pair does.
    change : changes each pair's parameters, after those of the graph. hands : simulated hands, by the names of their
        devices, in place of the operators that the parameters name.

    Raises InvalidParameter, netem.NetemError: a pair's parameters are not valid for a run, or its world has room for
    one hand only.
    """

    def __init__(
        self,
        graph: Graph,
        seed: int = 0,
        change: Change = lambda params: params,
        hands: Mapping[str, Operator] | None = None,
    ) -> None:
        self.graph, self.seed = graph, seed
        self._change, self._hands = change, hands or {}
        made: dict[str, Simulation] = {}
        self._world_of: dict[str, _World] = {}
        for node in graph.nodes.values():
            if node.kind == "world":
                of_world = self._of_world(graph.edges_of(node.name))
                made |= of_world
                self._world_of |= dict.fromkeys(of_world, _World(list(of_world.values())))
        self.pairs: dict[str, Simulation] = {name: made[name] for name in graph.edges}
        self.duration_s: float = next(iter(made.values())).setup.params.duration_s  # the same for all
        self.now_ns = 0

    def _of_world(self, edges: list[Edge]) -> dict[str, Simulation]:
        """The pairs of a world, by their edges' names."""
        made, numbers = {}, {name: number for number, name in enumerate(self.graph.edges)}
        for edge, setup in zip(edges, world_setups(self.graph, edges, self._change), strict=True):
            setup, number = replace(setup, hand=self._hands.get(edge.device)), numbers[edge.name]
            seed = self.seed if not number else int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])
            pair = made[edge.name] = Simulation(setup.params, seed, setup, kernel=False)
            pair.about["graph"] = {"edge": edge.name, "world": edge.world, "hands": len(edges), "seed": self.seed}
        return made

    def run(self, progress: Callable[[float], None] | None = None) -> GraphResult:
        """Run to the end, then let the links deliver what is in flight.

        `progress` is called from time to time with the simulated seconds since all were paired.

        Raises HapnetError: two sides did not find each other.
        """
        self._run(PAIRING_LIMIT_NS, lambda: all(pair.started for pair in self.pairs.values()))
        for name, pair in self.pairs.items():
            try:
                pair.begin(self.now_ns)
            except HapnetError as error:
                raise HapnetError(f"{name}: {error}") from None
        start_ns = self.now_ns
        end_ns = start_ns + round(self.duration_s / NANO)
        while self.now_ns < end_ns:
            self._run_to(min(end_ns, start_ns + ((self.now_ns - start_ns) // _REPORT_NS + 1) * _REPORT_NS))
            if progress is not None:
                progress((self.now_ns - start_ns) * NANO)
        found = {name: pair.result(end_ns) for name, pair in self.pairs.items()}
        return GraphResult(graph_summary(self, found), found)

    def reservoirs(self, world: str) -> dict[str, Any]:
        """The accounts of the seats' reservoirs of this world, by the names of the edges."""
        edges = [edge.name for edge in self.graph.edges_of(world)]
        found = self._world_of[edges[0]].reservoirs
        return found.as_dict([(name, self.pairs[name].world) for name in edges])

    def _run_to(self, end_ns: int) -> None:
        """Run to `end_ns`, as `events.run_to` does for one pair."""
        pairs = list(self.pairs.values())
        if (later_ns := min(pair.clock.later_ns for pair in pairs)) <= end_ns:
            self._reach(later_ns)
            for pair in pairs:
                pair.clock.later_ns = NEVER
                begin(pair.two_port)
                if pair.clock.apart:
                    begin(pair.hand_port)
        self._reach(end_ns)

    def _reach(self, end_ns: int) -> None:
        self._run(end_ns, lambda: False)
        for pair in self.pairs.values():
            events.catch_up(pair, end_ns + 1)
            pair.clock.now_ns = end_ns
        self.now_ns = end_ns

    def _run(self, end_ns: int, done: Callable[[], bool]) -> None:
        """Run the earliest event of all pairs, until nothing is due by `end_ns`, or the run is `done`."""
        pairs = list(self.pairs.items())
        while not done():
            now_ns, kind, k = min(
                (max(self.now_ns, pair.clock.due[kind]), kind, k)
                for k, (_, pair) in enumerate(pairs)
                for kind in (events.earliest(pair.clock.due),)
            )
            if now_ns > end_ns:
                return
            self.now_ns, (name, pair) = now_ns, pairs[k]
            if kind == events.STEP:
                self._world_of[name].step(now_ns)
            else:
                pair.clock.now_ns = now_ns
                events.happen(pair, kind, now_ns)
