"""The forecast of a graph before it runs: the lag along each path from a hand, and the followers that will starve.

Lag: the typical delays of the links, and at each node the mean length of a step. hapnet's rendering hides up to
`contact_model.longest_s` of each link's delay by prediction; the lag is what is left to predict.

A follower starves if what it passes on is more than its edge brings. All nodes of a path move with about the same
velocity v, so powers are compared as dampings, P/v^2 [Ns/m]:

* an edge brings its share of the leader's damper, B_k, and the drag of a spring that lags behind by the delay there and
  back: K_k t, with the stiffness that is felt; without force only B_k.
* a follower spends its own damping, that of the hand that holds it, and what its own edges bring to others.

A reservoir lasts for a while: a starving follower may track well for seconds. A follower that a hand holds must also
stretch this hand's spring: with the energy E that its reservoir can spend, by at most sqrt(2 E/K) beyond where the hand
is, K that of both springs in series. Beyond that its set-positions are modulated, whatever its edge brings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from hapnet.assembly.build import Setup
from hapnet.couplings import held_torque
from hapnet.couplings.link_delays import delays
from hapnet.couplings.rendering import largest
from hapnet.couplings.set_position import servo_of
from hapnet.ext.many.graph import DEVICE, FOLLOWER, WORLD, Edge, Graph, Node


def one_way_s(setup: Setup) -> tuple[float, float]:
    """The typical delays up and down [s]."""
    up, down = (delays(link, link, setup.params.link.path_s).one_way_s for link in (setup.up, setup.down))
    return up, down


def step_s(graph: Graph, edge: Edge, setup: Setup) -> float:
    """The mean length of a step at the end of this edge [s]."""
    params = setup.params
    if graph.nodes[edge.world].kind == FOLLOWER:
        return 1.0 / params.follower.servo_hz
    return 0.5 * (params.world.step_min_s + params.world.step_max_s)


def paths(graph: Graph, setups: Mapping[str, Setup]) -> list[dict[str, Any]]:
    """The paths from each hand to the next hand or to a node that leads no other: their nodes, and their lag [s]."""
    found = []
    for edge in graph.edges.values():
        end = graph.nodes[edge.world]
        if not end.is_held and graph.led_by(end.name):
            continue  # a longer path passes through it
        way = [edge]
        while not graph.nodes[way[0].device].is_held:
            way.insert(0, graph.led_to(way[0].device)[0])
        lag_s = sum(one_way_s(setups[one.name])[0] + step_s(graph, one, setups[one.name]) for one in way)
        found.append({"nodes": [way[0].device, *[one.world for one in way]], "lag_s": lag_s})
    return found


def brings(edge: Edge, setup: Setup) -> float:
    """The damping with which the leader's motion feeds this edge [Ns/m]."""
    params = setup.params
    damper = largest(params.device.damping)
    if not edge.force:
        return damper
    stiffness = largest(params.device.stiffness)
    if setup.coupling.staged(params) and params.follower.feedback != "planes":
        stiffness = min(stiffness, params.contact_model.delayed_stiffness)
    return damper + stiffness * sum(one_way_s(setup))


def node_rows(graph: Graph, setups: Mapping[str, Setup]) -> list[dict[str, Any]]:
    """Each node: its kind, whether a hand holds it, its d^2 [J]; and of a follower, what it gets and spends [Ns/m]."""
    rows = []
    for node in graph.nodes.values():
        leads, led = graph.led_by(node.name), graph.led_to(node.name)
        bound_J = sum(setups[edge.name].params.device.ceiling_J for edge in leads)
        bound_J += sum(setups[edge.name].params.world.ceiling_J for edge in led)
        row: dict[str, Any] = {"node": node.name, "kind": node.kind, "hand": node.is_held, "bound_J": bound_J}
        if node.kind == FOLLOWER:
            hand = graph.hand(node).operator_model.damping if node.is_held else 0.0
            robot = setups[led[0].name].params.follower
            gets = brings(led[0], setups[led[0].name])
            spends = robot.own_damping + hand + sum(brings(edge, setups[edge.name]) for edge in leads)
            row |= {"gets_Ns_m": gets, "spends_Ns_m": spends, "starves": spends > gets}
            row["reach_m"] = _reach_m(graph, node, setups[led[0].name]) if node.is_held else None
        rows.append(row)
    return rows


def _reach_m(graph: Graph, node: Node, setup: Setup) -> float:
    """How far a held follower can be led from its hand's place before its reservoir has spent all that it may [m]."""
    servo = servo_of(setup.params)
    _, holding = held_torque.guard(servo, "measured", setup.dof)
    hand, own = graph.hand(node).operator_model.stiffness, largest(servo.stiffness)
    if not hand:
        return math.inf
    return math.sqrt(2.0 * (servo.ceiling_J - holding.reserve) * (hand + own) / (hand * own))


def has_followers(graph: Graph) -> bool:
    """Whether this graph is more than devices with one edge each, to worlds."""
    return any(node.kind not in (DEVICE, WORLD) or len(graph.led_by(node.name)) > 1 for node in graph.nodes.values())
