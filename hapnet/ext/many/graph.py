"""A graph of pairs, read from TOML: nodes are devices and worlds, and each edge is a pair with its own link.

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

A node's and an edge's parameters go before those for all. An edge has the name ``alice-table``, or its own `name`.
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
from hapnet.param_sources import FILE
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
}
"""The parameters and sections that a node of each kind sets."""

_OF_EDGES = ("link", "wire")
_WORDS_OF_EDGES = ("from", "to", "name", "at", "rights", "proxy")
TOUCH, WATCH = RIGHTS = ("touch", "watch")
"""Whether a hand touches the blocks of its world, or only sees them."""


@dataclass(frozen=True)
class Node:
    """A device or a world: its kind, and its parameters by dotted names."""

    name: str
    kind: str
    changes: Mapping[str, object]


@dataclass(frozen=True)
class Edge:
    """A pair: the names of its device and its world, where the device's origin is in the world [m] (empty: at its
    origin), the parameters of its link by dotted names, one of `RIGHTS`, and the proxy that its hand holds in a MuJoCo
    model (empty: the next one that the scene names, or a sphere).
    """

    name: str
    device: str
    world: str
    at: Vector
    changes: Mapping[str, object]
    rights: str = TOUCH
    proxy: str = ""


@dataclass(frozen=True)
class Graph:
    """The nodes and edges by their names, and the parameters for all edges."""

    nodes: Mapping[str, Node]
    edges: Mapping[str, Edge]
    params: Params

    def pair(self, edge: Edge) -> Params:
        """The parameters of this edge's pair. Raises InvalidParameter: names the node or the edge."""
        params = self.params
        for node in (self.nodes[edge.world], self.nodes[edge.device]):
            with about(f"nodes.{node.name}"):
                params = params.set(node.changes, FILE)
        with about(f"edges.{edge.name}"):
            return params.set(edge.changes, FILE)

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
        count = len(graph.edges_of(node.name))
        most = MOST_SEATS if node.kind == "world" else 1
        if not 1 <= count <= most:
            allowed = f"1 to {most} edges" if most > 1 else "one edge: a device has one world"
            raise InvalidParameter(f"nodes.{node.name}", f"{count} edges", allowed)
    for edge in edges.values():
        graph.pair(edge)
    return graph


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
        raise InvalidParameter(f"nodes.{name}.kind", kind, " or ".join(_OF_KINDS), _OF_KINDS)
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
    for key, kind in (("from", "device"), ("to", "world")):
        name = entries.get(key)
        there = [node.name for node in nodes.values() if node.kind == kind]
        if name not in there:
            raise InvalidParameter(f"{where}.{key}", name, f"a {kind} of [nodes]: {', '.join(there) or 'none'}", there)
        ends.append(str(name))
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
    return Edge(name, ends[0], ends[1], tuple(map(float, at)), dict(flatten(changes)), rights, proxy)


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
