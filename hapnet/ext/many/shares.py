"""The share of its leader that an edge has: of a device's spring, damper, limits and reservoir.

An edge with the share s couples a device of mass s m and own damping s b by s K and s B, within s times the limits of
the force, and with s times the reservoir. All its ratios and times are those of the whole, and so the edges together
are one device with the whole K and B, and its d^2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hapnet.assembly.build import Setup, prepare
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import DEVICE, FOLLOWER, Edge, Graph, Node
from hapnet.ext.many.unfelt import unfelt
from hapnet.param_sources import RULE
from hapnet.params import Params
from hapnet.units import POSE

SHARED_OUT = (
    "device.stiffness", "device.damping", "device.ceiling_J", "device.force_limit_N", "device.step_limit_N",
    "device.mass", "device.own_damping", "device.trusted_damping", "device.stiffness_range",
    "contact_model.delayed_stiffness",
)  # fmt: skip
"""The parameters of which each edge has its share."""

_LAWS = ("pspm", "zoh")


def is_shared(graph: Graph, edge: Edge) -> bool:
    """Whether this edge has only a part of its leader, or leads with a follower's robot."""
    whole = graph.share_of(edge) == 1.0 and len(graph.led_by(edge.device)) == 1
    return graph.nodes[edge.device].kind == FOLLOWER or not whole


def prepared(graph: Graph, edge: Edge, params: Params) -> Setup:
    """The setup of an edge's pair, with the edge's share of its leader. Raises InvalidParameter."""
    setup = prepare(params, "sampled")
    _check_robot(graph, edge, setup)
    if not is_shared(graph, edge) and edge.force:
        return setup
    _check(graph, edge, setup)
    if (share := graph.share_of(edge)) != 1.0:
        used = setup.params
        setup = prepare(used.set({name: _part(share, used.get(name)) for name in SHARED_OUT}, RULE), "sampled")
    if not edge.force:
        setup = replace(setup, coupling=replace(setup.coupling, device=unfelt))
    return setup


def _part(share: float, value: Any) -> Any:
    """This share of a number, or of a matrix."""
    return share * value if isinstance(value, float) else (share * np.asarray(value)).tolist()


def _check(graph: Graph, edge: Edge, setup: Setup) -> None:
    """Raise InvalidParameter: this edge's end at its leader cannot be a share, or cannot be at a robot."""
    params, spec = setup.params, setup.coupling
    laws = _LAWS if edge.force else _LAWS[:1]
    what = f"where a node leads with a share, as {edge.device} does"
    if graph.nodes[edge.device].kind == FOLLOWER:
        what = f"where a follower leads, as {edge.device} does"
    if not edge.force:
        what = "with force = false"
    shares = spec.follower is not None and not spec.between_robots  # its device's end is a spring and a damper
    if not shares or not (edge.force or spec.halves):
        raise InvalidParameter(
            "coupling", params.coupling, f"{' or '.join(laws)} {what}: each side has its own account"
        )
    if not edge.force and params.follower.feedback != "position":
        raise InvalidParameter("follower.feedback", params.follower.feedback, f"position {what}")
    if params.hardware != "simulated":
        raise InvalidParameter("hardware", params.hardware, f"simulated {what}")
    if setup.scene.units == POSE:
        raise InvalidParameter("scene", params.scene, f"a scene without a tool that turns, {what}")
    if setup.harvest != "measured":
        raise InvalidParameter("device.harvest", setup.harvest, f"measured {what}")


def _check_robot(graph: Graph, edge: Edge, setup: Setup) -> None:
    """Raise InvalidParameter: this edge's follower has a driver, or cannot lead others or be held by a hand."""
    node, params = graph.nodes[edge.world], setup.params
    if node.kind == FOLLOWER and params.follower.robot != "simulated":
        raise InvalidParameter("follower.robot", params.follower.robot, "simulated: a graph's followers have no driver")
    if node.kind != FOLLOWER or not (node.is_held or graph.led_by(node.name)):
        return
    does = "a hand holds the follower" if node.is_held else "the follower leads others"
    if not setup.follower.is_held(params, setup.coupling):
        raise InvalidParameter("coupling", params.coupling, f"{' or '.join(_LAWS)}, with a held force, where {does}")
    if setup.scene.units == POSE or params.scene.startswith("mujoco:"):
        raise InvalidParameter("scene", params.scene, f"one without a tool and without a physics engine, where {does}")
    if node.is_held and params.follower.feedback == "force":
        raise InvalidParameter(
            "follower.feedback", "force", f"position or planes where {does}: no sensor knows its force"
        )


def checked(graph: Graph, setups: Mapping[str, Setup]) -> dict[str, Setup]:
    """The setups in the order of the edges. Raises InvalidParameter: the edges of a node do not fit each other."""
    for node in graph.nodes.values():
        around = [edge for edge in graph.edges_of(node.name) if node.kind != DEVICE or edge.device == node.name]
        for edge in around[1:]:
            _require_fit(node.name, around[0], edge, setups)
    return {name: setups[name] for name in graph.edges}


def _require_fit(node: str, first: Edge, edge: Edge, setups: Mapping[str, Setup]) -> None:
    one, other = setups[first.name], setups[edge.name]
    if (one.dof, one.units) != (other.dof, other.units):
        allowed = f"{one.dof} axes in {one.units}, as {first.name} has at {node}"
        raise InvalidParameter(f"edges.{edge.name}", f"{other.dof} axes in {other.units}", allowed)


def has_one_side(graph: Graph, node: Node) -> bool:
    """Whether this node is a device with one pair and the whole of it, as without a graph."""
    leads = graph.led_by(node.name)
    return node.kind == DEVICE and not is_shared(graph, leads[0]) and leads[0].force
