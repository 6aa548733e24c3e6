"""The summary of a graph: each edge's own summary, each node's account, and the whole; and its lines for people.

verdict : passive (true, false; null: not known), reason.
edges.NAME : the summary of the pair, as `hapnet simulate --json -` prints it.
nodes.NAME : kind; edges; leads, those at whose device's end it is; bound_J, d^2 of its ends; sent_nJ, what its sessions
    sent in all; ledger_sent_J, what its ledgers count as sent. A node that sends more than its ledgers count breaks its
    claim: no single pair would see it, as each receiver is credited what was sent to it. Of a body with several pairs
    also work_J, put in at the port of all their forces together, and ledger_work_J, what their ledgers count: more
    would be harvested twice. Of a world with several hands also environment, one account for all of them, and
    reservoirs: those of the seats, see `Reservoirs.as_dict`.
total : bound_J, energy_out_J and margin_J, summed over the edges.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from hapnet.ext.many.accounts import beyond, node_account, work_of
from hapnet.ext.many.joint import seat_of
from hapnet.simulation.result import Result
from hapnet.summary.structure import Summary

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hapnet.ext.many.run import GraphSimulation

_WORTH_TELLING_J = 0.05
"""As much as the reservoir of a seat holds by default: a hand that now and then needs more than it has takes less."""


def graph_summary(run: GraphSimulation, pairs: Mapping[str, Result]) -> dict[str, Any]:
    """The summary of a graph after its run."""
    edges = {name: result.summary for name, result in pairs.items()}
    nodes = {name: _node(run, name, edges) for name in run.graph.nodes}
    theorems: list[Mapping[str, Any]] = [summary["theorem"] for summary in edges.values()]
    total = {}
    for key in ("bound_J", "energy_out_J", "margin_J"):
        values = [theorem[key] for theorem in theorems]
        total[key] = None if None in values else sum(values)
    return {
        "verdict": graph_verdict(edges, nodes),
        "nodes": nodes,
        "edges": edges,
        "total": total,
        "seed": run.seed,
        "duration_s": run.duration_s,
    }


def _node(run: GraphSimulation, name: str, edges: Mapping[str, Summary]) -> dict[str, Any]:
    leads = [run.pairs[edge.name] for edge in run.graph.led_by(name)]
    pairs = [run.pairs[edge.name] for edge in run.graph.led_to(name)]
    halves = {edge.name: edges[edge.name]["device"] for edge in run.graph.led_by(name)}
    halves |= {edge.name: edges[edge.name]["world"] for edge in run.graph.led_to(name)}
    node = node_account(run.graph, name, halves)
    if leads and name in run.bodies:
        node |= work_of(run.bodies[name], [pair.device for pair in leads])
    if len(pairs) > 1:
        if (seat := seat_of(pairs[0].world.scene)) is not None:
            node["environment"] = seat.shared.as_dict()
        node["reservoirs"] = run.reservoirs(name)
    return node


def graph_verdict(
    edges: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, Mapping[str, Any]], missing: Collection[str] = ()
) -> dict[str, Any]:
    """The verdict on the graph: the worst of its edges and nodes, and who took most of a shared reservoir.

    missing : edges without a summary of both sides.
    """
    passive, reasons = _passive(edges, nodes, missing)
    reasons += filter(None, [reservoir_line(name, node.get("reservoirs")) for name, node in nodes.items()])
    return {"passive": passive, "reason": "; ".join(reasons)}


def _passive(
    edges: Mapping[str, Mapping[str, Any]], nodes: Mapping[str, Mapping[str, Any]], missing: Collection[str]
) -> tuple[bool | None, list[str]]:
    against = list(beyond(nodes))
    judged = {name: summary["verdict"] for name, summary in edges.items()}
    against += [f"{name}: {verdict['reason']}" for name, verdict in judged.items() if verdict["passive"] is False]
    if against:
        return False, against
    unknown = [f"{name}: {verdict['reason']}" for name, verdict in judged.items() if verdict["passive"] is None]
    unknown += [f"{name}: there is no energy account of both sides" for name in missing]
    if unknown:
        return None, unknown
    out = sum(summary["theorem"]["energy_out_J"] for summary in edges.values())
    bound = sum(summary["theorem"]["bound_J"] for summary in edges.values())
    pairs = "the pair" if len(edges) == 1 else f"each of {len(edges)} pairs; together they"
    return True, [f"{pairs} gave out at most {1e3 * out:.3g} mJ of the {1e3 * bound:.4g} mJ allowed"]


def reservoir_line(name: str, reservoirs: Mapping[str, Any] | None) -> str | None:
    """Who took the most out of the reservoir that the hands of a world share; None: nobody took much."""
    seats = {} if reservoirs is None else reservoirs["seats"]
    taken = {seat: one["got_J"] - one["given_J"] for seat, one in seats.items()}
    most = max(taken, key=taken.__getitem__, default=None)
    if most is None or taken[most] < _WORTH_TELLING_J:
        return None
    return f"{name} has one reservoir for all hands: {most} took {1e3 * taken[most]:.3g} mJ of the others'"


def show_verdict(words: Console, verdict: Mapping[str, Any]) -> None:
    """Print the verdict on a graph in one line."""
    known = {True: ("PASSIVE", "green"), False: ("NOT PASSIVE", "red"), None: ("PASSIVITY NOT KNOWN", "yellow")}
    word, color = known[verdict["passive"]]
    words.print(f"{word}: {verdict['reason']}", style=f"bold {color}", markup=False)


def environment_line(name: str, hands: int, own: Mapping[str, float] | None) -> str | None:
    """A line about the account of a world's bodies; None: it has none."""
    if own is None:
        return None
    balance = own["env_slack_J"]
    gave = "nothing of their own" if balance >= -1e-9 else f"{-1e3 * balance:.3g} mJ of their own"
    held = f"{1e3 * own['env_stored_J']:.3g} mJ"
    return f"{name}: one account for {hands} hands; its bodies gave out {gave}, and hold {held}"


PAIR_HEAD = ("pair", "passive", "gave out, mJ", "of, mJ", "largest force, N", "modulated: device, world, %")


def pairs_table(pairs: Mapping[str, Mapping[str, Any]]) -> Table:
    """A row for each pair: its verdict, its energy, its force, and how often PSPM modulated."""
    from rich.table import Table

    table = Table(*PAIR_HEAD)
    for name, of in pairs.items():
        table.add_row(*pair_row(name, of))
    return table


def pair_row(name: str, of: Mapping[str, Any]) -> tuple[str, ...]:
    """The cells of a pair in that table."""
    passive = {True: "yes", False: "no", None: "not known"}[of["verdict"]["passive"]]
    sides = [_percent(of["device"]), _percent(of["world"])]
    theorem = [_scaled(value) for value in (of["theorem"]["energy_out_J"], of["theorem"]["bound_J"])]
    force = of["motion"]["peak_force_N"]
    return name, passive, *theorem, "-" if force is None else f"{force:.3g}", ", ".join(sides)


def _scaled(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.4g}"


def _percent(side: Mapping[str, Any] | None) -> str:
    share = None if side is None else side["modulated_share"]
    return "-" if share is None else f"{100.0 * share:.3g}"
