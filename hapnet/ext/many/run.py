"""A graph in virtual time: each edge is a pair with its own clock, and all hands of a world make its steps together.

The pair stays the unit: its two sides, links, reservoirs and margin are those of a run with one hand
(`hapnet.simulation`), and Theorem 1 holds for it whatever moves the world on the other side of its proxy. The events
are those of `hapnet.simulation.events` too. Only the order is new: the earliest event of all pairs comes next, and a
step of a world comes for all its pairs at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from typing import Any

import numpy as np

from hapnet.assembly.build import Setup, compiled_ends
from hapnet.control.two_port import begin
from hapnet.errors import HapnetError
from hapnet.ext.many.bodies import EdgeEnds, SharedBody
from hapnet.ext.many.graph import Edge, Graph
from hapnet.ext.many.hands import Change, JointSteps, graph_setups
from hapnet.ext.many.reservoirs import Reservoirs
from hapnet.ext.many.shared_bodies import bind, bodies_of
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
        self._hands = hands or {}
        self.now_ns = 0
        setups = graph_setups(graph, change)
        self.bodies: dict[str, SharedBody] = bodies_of(graph, setups, change, self._hands)
        self.pairs: dict[str, Simulation] = {
            edge.name: self._pair(number, edge, setups[edge.name]) for number, edge in enumerate(graph.edges.values())
        }
        self._world_of: dict[str, _World] = {}
        for node in graph.nodes:
            pairs = {edge.name: self.pairs[edge.name] for edge in graph.led_to(node)}
            if pairs:
                self._world_of |= dict.fromkeys(pairs, _World(list(pairs.values())))
            bind(self.bodies.get(node), [pair.world for pair in pairs.values()])
        self.duration_s: float = next(iter(setups.values())).params.duration_s  # the same for all

    def _pair(self, number: int, edge: Edge, setup: Setup) -> Simulation:
        """The pair of an edge."""
        setup = replace(setup, hand=self._hands.get(edge.device), ends=compiled_ends())
        if edge.device in self.bodies:
            setup = replace(setup, ends=EdgeEnds(self.bodies[edge.device]))
        seed = self.seed if not number else int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])
        pair = Simulation(setup.params, seed, setup, kernel=False)
        hands = len(self.graph.led_to(edge.world))
        pair.about["graph"] = {"edge": edge.name, "world": edge.world, "hands": hands, "seed": self.seed}
        return pair

    def run(self, progress: Callable[[float], None] | None = None) -> GraphResult:
        """Run to the end, then let the links deliver what is in flight.

        `progress` is called from time to time with the simulated seconds since all were paired.

        Raises HapnetError: two sides did not find each other.
        """
        unpaired = list(self.pairs.values())

        def all_started() -> bool:
            while unpaired and unpaired[-1].started:  # most calls ask one pair only: they come for each event
                unpaired.pop()
            return not unpaired

        self._run(PAIRING_LIMIT_NS, all_started)
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
        edges = [edge.name for edge in self.graph.led_to(world)]
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
        pairs, worlds = list(self.pairs.values()), [self._world_of[name] for name in self.pairs]
        of_world = {id(world): [k for k, other in enumerate(worlds) if other is world] for world in worlds}
        next_of = [self._next(k, pair) for k, pair in enumerate(pairs)]
        due = next_of.copy()
        heapify(due)
        while not done():
            event = due[0]
            now_ns, kind, k = event
            if event is not next_of[k]:
                heappop(due)  # since then another event of this pair has come to be due
                continue
            if now_ns > end_ns:
                return
            self.now_ns = now_ns
            if kind == events.STEP:
                worlds[k].step(now_ns)
                changed = of_world[id(worlds[k])]
            else:
                pairs[k].clock.now_ns = now_ns
                events.happen(pairs[k], kind, now_ns)
                changed = [k]
            for k in changed:
                next_of[k] = self._next(k, pairs[k])
                heappush(due, next_of[k])

    def _next(self, k: int, pair: Simulation) -> tuple[int, int, int]:
        """The next event of pair `k`: when it is due [ns], its kind, and `k`."""
        kind = events.earliest(pair.clock.due)
        return max(self.now_ns, pair.clock.due[kind]), kind, k
