"""The account of a node over all its edges: what no single pair can see."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from hapnet.side.endpoint import NANO
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.summary.verdict import ROUNDING_J

if TYPE_CHECKING:
    from hapnet.ext.many.run import GraphSimulation


def node_account(run: GraphSimulation, name: str) -> dict[str, Any]:
    """The account of a node in virtual time, for its summary: see `hapnet.ext.many.summary`."""
    leads = [run.pairs[edge.name] for edge in run.graph.led_by(name)]
    led = [run.pairs[edge.name] for edge in run.graph.led_to(name)]
    ends = [pair.device_endpoint for pair in leads] + [pair.world_endpoint for pair in led]
    node = {
        "kind": run.graph.nodes[name].kind,
        "edges": [edge.name for edge in run.graph.edges_of(name)],
        "leads": [edge.name for edge in run.graph.led_by(name)],
        "bound_J": sum(end.coupling.ledger.bound for end in ends),
        "sent_nJ": sum(end.session.sent_nJ for end in ends),
        "ledger_sent_J": sum(end.coupling.ledger.sent for end in ends),
    }
    if name in run.bodies and leads:
        held = [pair.device.held for pair in leads if isinstance(pair.device, SampledDeviceSide)]
        node["work_J"] = run.bodies[name].work_J
        node["ledger_work_J"] = sum(one.true_ledger.work for one in held if one is not None)
    return node


def beyond(nodes: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """A line for each node that sent more than its ledgers count, or whose ledgers count more than was put in."""
    for name, node in nodes.items():
        if "sent_nJ" in node and node["sent_nJ"] * NANO > node["ledger_sent_J"] + ROUNDING_J:
            yield f"{name} sent {1e-6 * node['sent_nJ']:.3g} mJ, its ledgers count {1e3 * node['ledger_sent_J']:.3g} mJ"
        work, counted = node.get("work_J"), node.get("ledger_work_J")
        if work is not None and counted is not None and counted > work + ROUNDING_J:
            yield f"{1e3 * work:.3g} mJ were put in at {name}, its ledgers count {1e3 * counted:.3g} mJ"
