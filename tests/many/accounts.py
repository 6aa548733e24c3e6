"""The accounts of a graph's run, from its recordings alone: held force times way, summed by the test itself."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphResult, GraphSimulation
from hapnet.plant.operator import Impedance

LINK = "delay 50ms 10ms loss 20%"
PAPER: dict[str, Any] = {
    "rendering": "paper",
    "device": {"stiffness": 100.0, "damping": 0.8, "ceiling_J": 0.05},
    "world": {"stiffness": 100.0, "damping": 0.8, "ceiling_J": 0.05},
}
"""The springs of the prototype of graphs."""


class Lead:
    """The hand of the prototype: a spring and a damper without mass, on a Lissajous figure."""

    impedance: Impedance = Impedance(0.0, 6.45, 135.0)

    def reference(self, t: float) -> Vector:
        grown = min(1.0, t)
        x, y = 0.03 * math.sin(2.5 * t), 0.03 * (math.cos(2.0 * t) - 1.0)
        return x * grown, y * grown, 0.015 * math.sin(4.0 * t) * grown


def table(edges: Sequence[tuple[int, int]], *, held: Sequence[int] = (0,), **others: Any) -> dict[str, Any]:
    """A graph in free space: node 0 is a device, all others are followers; a hand that rests holds those in `held`."""
    nodes: dict[str, Any] = {"n0": {"kind": "device"}}
    for k in range(1, 1 + max(max(edge) for edge in edges)):
        nodes[f"n{k}"] = {"kind": "follower", **({"operator": "rest"} if k in held else {})}
    listed = [{"from": f"n{a}", "to": f"n{b}", "link": LINK} for a, b in edges]
    plain = {"duration_s": 4.0, "scene": "free", "dof": 3, "record_hz": 1000.0}
    return {**plain, "nodes": nodes, "edges": listed, **others}


def ran(graph: dict[str, Any], seed: int = 0, **hands: Any) -> tuple[GraphSimulation, GraphResult]:
    """The run of a graph, in which `hands` hold the nodes; by default `Lead` holds node n0."""
    run = GraphSimulation(graph_of(graph), seed, hands=hands or {"n0": Lead()})
    return run, run.run()


def require_passive(run: GraphSimulation, result: GraphResult) -> None:
    """Each half of each pair, each pair, each link's energy, and each node, in both directions."""
    for name, pair in result.pairs.items():
        device, world, simulated = pair.recording.device, pair.recording.world, run.pairs[name]
        assert device is not None
        assert world is not None
        at_device = _half(device, device["force_N"], held=True)
        at_world = _half(world, _port_force(run, name, world), held=False)
        together = np.interp(device["time_ns"], world["time_ns"], at_world, left=0.0) + at_device
        assert together.min() >= -pair.summary["theorem"]["bound_J"], name  # type: ignore[operator]
        for way, sender, receiver in (
            ("up", simulated.device_endpoint, simulated.world_endpoint),
            ("down", simulated.world_endpoint, simulated.device_endpoint),
        ):
            assert receiver.session.credited_nJ <= sender.session.sent_nJ, (name, way)
            assert receiver.coupling.ledger.credited <= 1e-9 * receiver.session.credited_nJ + 1e-12, (name, way)
        margin = pair.summary["theorem"]["margin_J"]
        assert margin is not None
        assert margin >= -1e-9, name
        environment = simulated.world.environment
        assert environment is not None
        assert environment.slack_min >= -1e-12, name
    for name, node in result.summary["nodes"].items():
        assert 1e-9 * node["sent_nJ"] <= node["ledger_sent_J"] + 1e-12, name
        if "work_J" in node:
            assert node["ledger_work_J"] == pytest.approx(node["work_J"], rel=1e-9, abs=1e-12), name
            assert _all_forces(run, result, name) == pytest.approx(node["work_J"], rel=1e-9, abs=1e-12), name


def _half(samples: dict[str, Array], force: Array, *, held: bool) -> Array:
    """Theorem 1 of one side, with the work summed here; returns that work at each sample [J]."""
    ways = np.diff(samples["position_m"], axis=0)
    acting = force[:-1] if held else force[1:]
    work = -np.cumsum(np.concatenate([[0.0], np.sum(acting * ways, axis=1)])) + samples["work_J"][0]
    assert samples["work_J"] == pytest.approx(work, rel=1e-9, abs=1e-12)
    margin = work + samples["bound_J"] + samples["credited_J"] - samples["sent_J"]
    assert np.min(margin - samples["potential_J"] - samples["account_J"]) >= -1e-12
    assert np.min(margin) >= -1e-9
    assert abs(samples["work_J"][0]) < 1e-4  # of the first sample's step, which the recording does not have
    return work


def _port_force(run: GraphSimulation, name: str, world: dict[str, Array]) -> Array:
    """The force at the port of the world's end: of a robot its actuators', of a virtual mass its contacts'."""
    robot = run.pairs[name].world.scene.robot
    return world["coupling_force_N"] if robot else -world["contact_force_N"]


def _all_forces(run: GraphSimulation, result: GraphResult, name: str) -> float:
    """The work put in at the port of all forces of a node's edges together [J]. A robot may move before all begin."""
    work = 0.0
    for edge in run.graph.led_by(name):
        one = result.pairs[edge.name].recording.device
        assert one is not None
        work += float(one["work_J"][0] - np.sum(one["force_N"][:-1] * np.diff(one["position_m"], axis=0)))
    together(result, [edge.name for edge in run.graph.led_by(name)])
    return work


def together(result: GraphResult, edges: Sequence[str]) -> tuple[Array, Array]:
    """The sum of the forces of these edges of a body [N], and its position [m], since all have begun."""
    recorded = [result.pairs[edge].recording.device for edge in edges]
    begun = max(int(one["time_ns"][0]) for one in recorded if one is not None)
    force, position = 0.0, None
    for one in recorded:
        assert one is not None
        since = one["time_ns"] >= begun
        assert position is None or np.array_equal(one["position_m"][since], position)
        position, force = one["position_m"][since], force + one["force_N"][since]
    assert position is not None
    return np.asarray(force), position


def apart_mm(result: GraphResult, of: str, world: str, from_s: float = 3.0) -> float:
    """The mean distance [mm] of the follower of edge `world` from the device of edge `of`, at the same time."""
    leader, follower = result.pairs[of].recording.device, result.pairs[world].recording.world
    assert leader is not None
    assert follower is not None
    at = follower["time_ns"]
    there = np.stack([np.interp(at, leader["time_ns"], x) for x in leader["position_m"].T], axis=1)
    away = np.linalg.norm(follower["position_m"] - there, axis=1)
    return float(1e3 * np.mean(away[at > from_s * 1e9]))
