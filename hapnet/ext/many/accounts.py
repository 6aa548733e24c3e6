"""The account of a node over all its edges: what no single pair can see."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hapnet.ext.many.bodies import SharedBody
from hapnet.ext.many.graph import Graph
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import NANO
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.summary.structure import SidePart
from hapnet.summary.verdict import ROUNDING_J


def node_account(graph: Graph, name: str, halves: Mapping[str, SidePart | None]) -> dict[str, Any]:
    """The account of a node for the summary: see `hapnet.ext.many.summary`.

    halves : the node's own sides of its edges, as they reported them; those that are not known are left out.
    """
    node: dict[str, Any] = {
        "kind": graph.nodes[name].kind,
        "edges": [edge.name for edge in graph.edges_of(name)],
        "leads": [edge.name for edge in graph.led_by(name)],
    }
    known = [half for half in halves.values() if half is not None and half["ledger"]["sent_J"] is not None]
    if known:
        ledgers = [half["ledger"] for half in known]
        node["bound_J"] = sum(ledger["bound_J"] or 0.0 for ledger in ledgers)
        node["sent_nJ"] = sum(half["sent_nJ"] or 0 for half in known)
        node["ledger_sent_J"] = sum(ledger["sent_J"] or 0.0 for ledger in ledgers)
    return node


def work_of(body: SharedBody, sides: Iterable[DeviceSide]) -> dict[str, float]:
    """The work at the port of all forces of a body, and what the ledgers of its edges count [J]."""
    held = [side.held for side in sides if isinstance(side, SampledDeviceSide)]
    counted = sum(one.true_ledger.work for one in held if one is not None)
    return {"work_J": body.work_J, "ledger_work_J": counted}


def beyond(nodes: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """A line for each node that sent more than its ledgers count, or whose ledgers count more than was put in."""
    for name, node in nodes.items():
        if "sent_nJ" in node and node["sent_nJ"] * NANO > node["ledger_sent_J"] + ROUNDING_J:
            yield f"{name} sent {1e-6 * node['sent_nJ']:.3g} mJ, its ledgers count {1e3 * node['ledger_sent_J']:.3g} mJ"
        work, counted = node.get("work_J"), node.get("ledger_work_J")
        if work is not None and counted is not None and counted > work + ROUNDING_J:
            yield f"{1e3 * work:.3g} mJ were put in at {name}, its ledgers count {1e3 * counted:.3g} mJ"
