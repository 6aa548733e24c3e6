"""A graph of pairs, read from TOML: nodes are devices, worlds and followers; each edge is a pair with its own link.

    duration_s = 20.0                  # any parameter of a run, for all edges

    [nodes.table]
    kind = "world"
    scene = "shared:block?mass=0.2"

    [nodes.alice]
    kind = "device"
    operator = "hand-1"

    [[edges]]
    from = "alice"
    to = "table"
    link = "4g"                        # or link.up and link.down
    at = [0.1, 0, 0]                   # where the device's origin is in the world [m]; by default at its origin
    rights = "watch"                   # its hand sees the blocks, and touches none; by default: touch
    proxy = "left"                     # the body or site of a MuJoCo model that its hand holds
    share = 0.5                        # of alice's spring, damper, limits and reservoir; by default 1/(number of edges)
    force = false                      # alice does not feel this edge; by default: true

A follower is a world whose mass is a robot. It has one edge from its leader, and leads others as a device does; with an
`operator` a hand holds it. A node's and an edge's parameters go before those for all. An edge has the name
``alice-table``, or its own `name`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.file_content import read_toml
from hapnet.param_sources import FILE, RULE
from hapnet.param_values import flatten
from hapnet.params import Params
from hapnet.transport.router import FREE
from netem.errors import ProfileError

MOST_SEATS = 64
"""The most hands in one world."""

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}", re.ASCII)
_EDGE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,79}", re.ASCII)
"""Of its files too: no part of a path."""
_FARTHEST_M = 1000.0
_OF_KINDS: Mapping[str, tuple[str, ...]] = {
    "device": ("operator", "operator_model", "hardware", "device"),
    "world": ("scene", "dof", "units", "world", "follower"),
    "follower": ("scene", "dof", "units", "world", "follower", "operator", "operator_model", "device"),
}
"""The parameters and sections that a node of each kind sets."""

DEVICE, WORLD, FOLLOWER = _OF_KINDS
_LEADERS, _LED = (DEVICE, FOLLOWER), (WORLD, FOLLOWER)
_OF_ROBOTS = (
    "servo_hz", "mass", "own_damping", "resolution_m", "force_limit_N", "step_limit_N", "greatest_speed"
)  # fmt: skip
"""The parameters that a follower has as a leader too."""

_OF_EDGES = ("link", "wire")
_WORDS_OF_EDGES = ("from", "to", "name", "at", "rights", "proxy", "share", "force")
_MORE = 1e-9
TOUCH, WATCH = RIGHTS = ("touch", "watch")
"""Whether a hand touches the blocks of its world, or only sees them."""


@dataclass(frozen=True)
class Node:
    """A device, a world or a follower: its kind, and its parameters by dotted names."""

    name: str
    kind: str
    changes: Mapping[str, object]

    def of(self, kind: str) -> dict[str, object]:
        """Its parameters of a world, of the hand that holds it, or of its device: of `_OF_KINDS`."""
        return {name: value for name, value in self.changes.items() if name.partition(".")[0] in _OF_KINDS[kind]}

    @property
    def is_held(self) -> bool:
        """Whether a hand holds it."""
        return self.kind == DEVICE or "operator" in self.changes


@dataclass(frozen=True)
class Edge:
    """A pair: the names of the nodes at its device's and at its world's end, where the device's origin is in the world
    [m] (empty: at its origin), the parameters of its link by dotted names, one of `RIGHTS`, and the proxy that its hand
    holds in a MuJoCo model (empty: the next one that the scene names, or a sphere).

    share : of its leader, as it was set; None: the leader's edges have equal shares. force : whether the leader feels
        it.
    """

    name: str
    device: str
    world: str
    at: Vector
    changes: Mapping[str, object]
    rights: str = TOUCH
    proxy: str = ""
    share: float | None = None
    force: bool = True


@dataclass(frozen=True)
class Graph:
    """The nodes and edges by their names, and the parameters for all edges."""

    nodes: Mapping[str, Node]
    edges: Mapping[str, Edge]
    params: Params

    def pair(self, edge: Edge) -> Params:
        """The parameters of this edge's pair. Raises InvalidParameter: names the node or the edge."""
        leader, led = self.nodes[edge.device], self.nodes[edge.world]
        with about(f"nodes.{led.name}"):
            params = self._robot(led, self.params.set(led.of(WORLD), FILE))
        with about(f"nodes.{leader.name}"):
            params = params.set(leader.of(DEVICE), FILE)
            if leader.kind == FOLLOWER:
                params = params.set(self._as_leader(leader), RULE)
        with about(f"edges.{edge.name}"):
            return params.set(edge.changes, FILE)

    def _robot(self, node: Node, params: Params) -> Params:
        """The parameters with the robot of this node, if it is a follower; with a hand's mass, if one holds it."""
        if node.kind != FOLLOWER:
            return params
        if params.follower.robot == "none":
            params = params.set({"follower.robot": "simulated"}, FILE)
        held = self.hand(node).operator_model.mass if node.is_held else 0.0
        return params.set({"follower.mass": params.follower.mass + held}, RULE) if held else params

    def _as_leader(self, node: Node) -> dict[str, object]:
        """The parameters of a follower's robot as the device of the edges that it leads."""
        robot = self._robot(node, self.params.set(node.of(WORLD), FILE)).follower
        own = {f"device.{name}": getattr(robot, name) for name in _OF_ROBOTS}
        for name in own:
            if name in node.changes:
                why = f"a follower leads with its robot's own, follower.{name.partition('.')[2]}; leave this out"
                raise InvalidParameter(name, node.changes[name], "", why=why)
        return {**own, "hardware": "simulated", "operator": "rest"}

    def hand(self, node: Node) -> Params:
        """The parameters of the hand that holds this follower. Raises InvalidParameter."""
        return self.params.set(
            {name: node.changes[name] for name in node.of(DEVICE) if name.startswith("operator")}, FILE
        )

    def led_by(self, node: str) -> list[Edge]:
        """The edges that begin at this node."""
        return [edge for edge in self.edges.values() if edge.device == node]

    def led_to(self, node: str) -> list[Edge]:
        """The edges that end at this node."""
        return [edge for edge in self.edges.values() if edge.world == node]

    def share_of(self, edge: Edge) -> float:
        """The share of its leader that this edge has."""
        return 1.0 / len(self.led_by(edge.device)) if edge.share is None else edge.share

    def port_of(self, edge: Edge) -> str:
        """The name under which both sides of this edge meet in real time."""
        return port_name(edge.device, edge.world, len(self.led_by(edge.device)))

    def edges_of(self, node: str) -> list[Edge]:
        """The edges that begin or end at this node."""
        return [edge for edge in self.edges.values() if node in (edge.device, edge.world)]


def read_graph(file: Path) -> Graph:
    """The graph in a TOML file. Raises InvalidParameter: one line that names the entry, and what is allowed."""
    try:
        table = read_toml(file)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InvalidParameter("--graph", str(file), f"a TOML file with nodes and edges ({why})") from None
    return graph_of(table)


def graph_of(table: Mapping[str, Any]) -> Graph:
    """The graph in a table, as TOML gives it. Raises InvalidParameter as `read_graph`."""
    rest = {name: value for name, value in table.items() if name not in ("nodes", "edges")}
    nodes = {name: _node(name, value) for name, value in _table("nodes", table.get("nodes")).items()}
    listed = table.get("edges")
    if not isinstance(listed, list) or not listed:
        raise InvalidParameter("edges", listed, "one or more tables [[edges]], each with from and to")
    edges: dict[str, Edge] = {}
    for number, entry in enumerate(listed):
        edge = _edge(f"edges[{number}]", _table(f"edges[{number}]", entry, "[[edges]] with from and to"), nodes)
        if edge.name in edges:
            raise InvalidParameter(f"edges[{number}].name", edge.name, "a name that no other edge has")
        edges[edge.name] = edge
    graph = Graph(nodes, edges, Params().set(dict(flatten(rest)), FILE))
    for node in nodes.values():
        _check_edges(graph, node)
    for node in nodes.values():
        _check_led(graph, node)
    for edge in edges.values():
        graph.pair(edge)
    return graph


def _check_edges(graph: Graph, node: Node) -> None:
    """Raise InvalidParameter: the node has too few or too many edges, or its edges have more than the whole of it."""
    led, leads = len(graph.led_to(node.name)), graph.led_by(node.name)
    if node.kind != FOLLOWER:
        count = led if node.kind == WORLD else len(leads)
        if not 1 <= count <= MOST_SEATS:
            raise InvalidParameter(f"nodes.{node.name}", f"{count} edges", f"1 to {MOST_SEATS} edges")
    elif led != 1 or len(leads) > MOST_SEATS:
        allowed = f"one leader, and up to {MOST_SEATS} edges of its own"
        raise InvalidParameter(f"nodes.{node.name}", f"a follower with {led} leaders and {len(leads)} edges", allowed)
    elif not node.is_held and (unheld := [name for name in node.changes if name.startswith("operator_model")]):
        raise InvalidParameter(f"nodes.{node.name}", unheld[0], "left out without operator, which holds the follower")
    if (total := sum(graph.share_of(edge) for edge in leads)) > 1.0 + _MORE:
        shares = ", ".join(f"{edge.name} {graph.share_of(edge):.4g}" for edge in leads)
        allowed = f"shares that add up to at most 1 ({shares}; an edge without share has 1/{len(leads)})"
        raise InvalidParameter(f"nodes.{node.name}: the sum of its shares", round(total, 6), allowed)
    for number, edge in enumerate(leads):
        if edge.world in [other.world for other in leads[:number]]:
            allowed = f"one edge from {edge.device} to {edge.world}"
            raise InvalidParameter(f"edges.{edge.name}", f"another edge to {edge.world}", allowed)


def _check_led(graph: Graph, node: Node) -> None:
    """Raise InvalidParameter: no hand leads this follower, as it and its leaders form a cycle."""
    passed = [node.name]
    while not graph.nodes[passed[-1]].is_held and node.kind == FOLLOWER:
        leader = graph.led_to(passed[-1])[0].device
        if leader in passed:
            allowed = "a hand that leads them: an edge from a device, or an operator at one of them"
            raise InvalidParameter(f"nodes.{node.name}", f"in a cycle of followers: {', '.join(passed)}", allowed)
        passed.append(leader)


def _table(name: str, value: object, example: str = '[nodes.alice] with kind = "device"') -> Mapping[str, Any]:
    if not isinstance(value, Mapping) or not value:
        raise InvalidParameter(name, value, f"a table, such as {example}")
    return value


def _node(name: str, value: object) -> Node:
    if not _NAME.fullmatch(name) or name == FREE:
        allowed = f"names other than {FREE} of small letters, digits and _, beginning with a letter, up to 32"
        raise InvalidParameter("nodes", name, allowed)
    entries = dict(_table(f"nodes.{name}", value))
    kind = entries.pop("kind", None)
    if not isinstance(kind, str) or kind not in _OF_KINDS:
        raise InvalidParameter(f"nodes.{name}.kind", kind, "device, world or follower", _OF_KINDS)
    for key in entries:
        if key not in _OF_KINDS[kind]:
            allowed = f"a parameter of a {kind}: {', '.join(_OF_KINDS[kind])}; those for all edges go to the top"
            raise InvalidParameter(f"nodes.{name}", key, allowed, _OF_KINDS[kind])
    return Node(name, kind, dict(flatten(entries)))


def _edge(where: str, entries: Mapping[str, Any], nodes: Mapping[str, Node]) -> Edge:
    for key in entries:
        if key not in (known := (*_WORDS_OF_EDGES, *_OF_EDGES)):
            raise InvalidParameter(where, key, f"one of {', '.join(known)}", known)
    ends = []
    for key, kinds in (("from", _LEADERS), ("to", _LED)):
        name = entries.get(key)
        there = [node.name for node in nodes.values() if node.kind in kinds]
        if name not in there:
            allowed = f"a {' or a '.join(kinds)} of [nodes]: {', '.join(there) or 'none'}"
            raise InvalidParameter(f"{where}.{key}", name, allowed, there)
        ends.append(str(name))
    if ends[0] == ends[1]:
        others = [name for name in there if name != ends[0]]
        raise InvalidParameter(f"{where}.to", ends[1], f"a node that is not from: {', '.join(others)}", others)
    changes = {key: value for key, value in entries.items() if key in _OF_EDGES}
    if isinstance(link := changes.get("link"), str):
        changes["link"] = {"up": link, "down": link}
    at = entries.get("at", [])
    if not isinstance(at, list) or not all(type(x) in (int, float) and abs(x) <= _FARTHEST_M for x in at):
        allowed = f"a list of lengths up to {_FARTHEST_M:g} m, such as [0.1, 0, 0]"
        raise InvalidParameter(f"{where}.at", at, allowed)
    name = entries.get("name", "-".join(ends))
    if not isinstance(name, str) or not _EDGE_NAME.fullmatch(name):
        raise InvalidParameter(f"{where}.name", name, "up to 80 letters, digits, _ and -, such as left-hand")
    if (rights := entries.get("rights", TOUCH)) not in RIGHTS:
        raise InvalidParameter(f"{where}.rights", rights, " or ".join(RIGHTS), RIGHTS)
    proxy = entries.get("proxy", "")
    if not isinstance(proxy, str) or (not proxy and "proxy" in entries):
        raise InvalidParameter(f"{where}.proxy", proxy, "the name of a body or site of the world's MuJoCo model")
    share, force = entries.get("share"), entries.get("force", True)
    if share is not None and not (type(share) in (int, float) and 0.0 < share <= 1.0):
        raise InvalidParameter(f"{where}.share", share, "a number above 0, up to 1, such as 0.25")
    if not isinstance(force, bool):
        raise InvalidParameter(f"{where}.force", force, "true or false")
    if at and nodes[ends[1]].kind == FOLLOWER:
        why = f"the follower {ends[1]} begins at its own place (follower.start); leave at out"
        raise InvalidParameter(f"{where}.at", at, "", why=why)
    changes = dict(flatten(changes))
    return Edge(
        name, ends[0], ends[1], tuple(map(float, at)), changes, rights, proxy, share and float(share), force=force
    )


def port_name(device: str, world: str, edges: int) -> str:
    """The name of a pair in real time: its device's; if this has several edges, the device's and the world's. The name
    of a node has no dash."""
    return device if edges == 1 else f"{device}-{world}"


@contextmanager
def about(entry: str) -> Iterator[None]:
    """A context whose errors, of links too, name the entry of the graph."""
    try:
        yield
    except InvalidParameter as error:
        raise error.renamed(f"{entry}: {error.name}") from None
    except ProfileError as error:
        name = f"{entry}: link: {error.word}"
        raise InvalidParameter(name, error.value, error.allowed, error.known, error.why) from None
