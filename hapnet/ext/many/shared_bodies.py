"""Makes the bodies of a graph: of devices with several edges, of followers that lead others or are held by a hand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from hapnet.assembly.build import Setup, held, prepare, virtual_mass
from hapnet.assembly.operators import operator
from hapnet.assembly.own_parts import named_section
from hapnet.assembly.simulated_device import simulated_device
from hapnet.ext.many.bodies import HeldBody, RobotBody, SharedBody
from hapnet.ext.many.graph import DEVICE, FOLLOWER, Edge, Graph, Node, about
from hapnet.ext.many.hands import graph_setups
from hapnet.ext.many.shares import is_shared
from hapnet.ext.robots.follower import Robot
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Operator
from hapnet.side.world import WorldSide


def bodies_of(
    graph: Graph,
    setups: Mapping[str, Setup],
    change: Callable[[Params], Params],
    hands: Mapping[str, Operator],
) -> dict[str, SharedBody]:
    """The bodies by the names of their nodes. setups : of the edges. hands : in place of the nodes' operators.

    Raises InvalidParameter: a hand is not valid.
    """
    bodies = {
        node.name: body_of(graph, node, setups, change, hands.get(node.name), waits=True)
        for node in graph.nodes.values()
    }
    return {name: body for name, body in bodies.items() if body is not None}


def body_of(
    graph: Graph,
    node: Node,
    setups: Mapping[str, Setup],
    change: Callable[[Params], Params],
    hand: Operator | None = None,
    *,
    waits: bool,
) -> SharedBody | None:
    """The body of this node; None: it is a world, or has just one pair with the whole of it. waits : see `HeldBody`.

    Raises InvalidParameter: its hand is not valid.
    """
    leads = graph.led_by(node.name)
    if node.kind == DEVICE and is_shared(graph, leads[0]):
        return HeldBody(_held(graph, leads[0], change, hand), waits=waits)
    if node.kind == FOLLOWER and (leads or node.is_held):
        return _robot(graph, node, setups[graph.led_to(node.name)[0].name], hand)
    return None


def _held(graph: Graph, edge: Edge, change: Callable[[Params], Params], hand: Operator | None) -> SimulatedDevice:
    """The whole device of which this edge has a share."""
    with about(f"edges.{edge.name}"):
        setup = prepare(change(graph.pair(edge)), "sampled")
        device = replace(setup.params.device, force_limit_N=0.0)
        whole = replace(setup.params, device=device)
        return simulated_device(whole, setup.scene, hand or operator(whole, setup.scene))


def _robot(graph: Graph, node: Node, setup: Setup, hand: Operator | None) -> RobotBody:
    if hand is None and node.is_held:
        with about(f"nodes.{node.name}"):
            hand = operator(graph.hand(node), setup.scene)
    return RobotBody(setup.scene.start, hand)


def bind(body: SharedBody | None, worlds: Iterable[WorldSide]) -> None:
    """Let the body of a follower have the robot of its leader's pair."""
    if isinstance(body, RobotBody):
        for world in worlds:
            robot = world.mass
            assert isinstance(robot, Robot), "a follower moves a robot"
            body.robot, robot.outside = robot, body


def checked_setups(graph: Graph, change: Callable[[Params], Params] = lambda params: params) -> dict[str, Setup]:
    """The setups of all edges, after their hands, masses and device's ends were made once. Raises InvalidParameter."""
    setups = graph_setups(graph, change)
    bodies_of(graph, setups, change, {})
    for name, setup in setups.items():
        with about(f"edges.{name}"):
            hand = operator(setup.params, setup.scene)
            virtual_mass(setup)
            with named_section("device"):
                held(setup)(hand.reference(0.0), False)
    return setups
