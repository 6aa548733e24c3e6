"""`hapnet world --seats`, and `hapnet device` and `hapnet world` with `--graph`: the nodes of a graph in real time."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.assembly.operators import LIVE
from hapnet.commands import output
from hapnet.commands.log import Log, check_target
from hapnet.commands.options import SideFlags, ZenohOptions
from hapnet.commands.side import PARENT, catch, exit_code, held_back, main, outlive, zenoh_settings
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import DEVICE, FOLLOWER, WORLD, Graph, Node, graph_of, read_graph
from hapnet.ext.many.hands import Change, graph_setups, live_setups, warnings_of, world_setups
from hapnet.ext.many.seats import NodePort, NodeSides, Outputs, seat_names
from hapnet.ext.many.shared_bodies import body_of
from hapnet.ext.many.shares import has_one_side
from hapnet.ext.many.summary import environment_line, reservoir_line
from hapnet.side.endpoint import NANO
from hapnet.side.notices import Notice
from hapnet.summary.run import Summary
from hapnet.transport.config import zenoh_warnings
from hapnet.transport.refusals import watched
from hapnet.transport.router import routed

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hapnet.assembly.build import Setup
    from hapnet.ext.many.bodies import SharedBody
    from hapnet.wire.messages import Role


def device(file: Path, node: str | None, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a device of the graph in this file: `hapnet device --graph FILE --node NAME`."""
    graph = read_graph(file)
    found = _named(graph, node, DEVICE)
    if not has_one_side(graph, found):
        return _node(graph, found, change, side, zenoh)
    edge = graph.led_by(found.name)[0]
    return main("device", change(graph.pair(edge)), replace(side, name=graph.port_of(edge)), zenoh)


def world_of_graph(file: Path, node: str | None, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a world or a follower of the graph in this file: `hapnet world --graph FILE --node NAME`."""
    graph = read_graph(file)
    return _node(graph, _named(graph, node, WORLD, FOLLOWER), change, side, zenoh)


def world_of_seats(seats: str, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a world with these seats: `hapnet world --seats alice,bob`."""
    graph = graph_of_seats(seats)
    return _node(graph, graph.nodes["world"], change, side, zenoh)


def seat_setups(seats: str, change: Change) -> dict[str, Setup]:
    """The setup of each seat's pair, by its name. Raises InvalidParameter: the world has no room for them."""
    graph = graph_of_seats(seats)
    edges = graph.led_to("world")
    return {edge.device: setup for edge, setup in zip(edges, world_setups(graph, edges, change), strict=True)}


def graph_of_seats(seats: str) -> Graph:
    """The graph of one world, named world, with these seats. Raises InvalidParameter: they are no seats."""
    rights = seat_names(seats)
    names = list(rights)
    if "world" in names:
        raise InvalidParameter("--seats", seats, "names other than world, such as alice,bob")
    nodes = {name: {"kind": "device", "operator": "rest"} for name in names}
    edges = [{"from": name, "to": "world", "rights": rights[name]} for name in names]
    try:
        return graph_of({"nodes": {**nodes, "world": {"kind": "world", "dof": 0}}, "edges": edges})
    except InvalidParameter as error:
        raise error.renamed("--seats", seats) if error.name == "nodes" else error from None


def _named(graph: Graph, name: str | None, *kinds: str) -> Node:
    known = [node.name for node in graph.nodes.values() if node.kind in kinds]
    if name is None and len(known) == 1:
        name = known[0]
    if name not in known:
        allowed = f"a {' or a '.join(kinds)} of the graph: {', '.join(known) or 'it has none'}"
        raise InvalidParameter("--node", name, allowed, known)
    return graph.nodes[name]


def _ports(graph: Graph, node: Node, change: Change) -> tuple[dict[str, NodePort], SharedBody | None, int | None]:
    """The ports of a node, its body (None: it has none), and the period of its servo [ns] (None: it is a world)."""
    led, leads = graph.led_to(node.name), graph.led_by(node.name)
    if node.kind == WORLD:
        seats = zip(led, live_setups(graph, led, change), strict=True)
        return {graph.port_of(edge): NodePort(setup, "world") for edge, setup in seats}, None, None
    of_all = graph_setups(graph, change)
    ports = {graph.port_of(edge): NodePort(of_all[edge.name], "world") for edge in led}
    ports |= {graph.port_of(edge): NodePort(of_all[edge.name], "device") for edge in leads}
    first = next(iter(ports.values())).setup.params
    hand = graph.hand(node).operator if node.kind == FOLLOWER and node.is_held else first.operator
    if node.is_held and hand == LIVE:
        why = "only hapnet play has a page on which the mouse leads the hand"
        raise InvalidParameter("operator", LIVE, "", why=why)
    rate_hz = first.follower.servo_hz if led else first.device.servo_hz
    return ports, body_of(graph, node, of_all, change, waits=False), round(1.0 / rate_hz / NANO)


def _node(graph: Graph, node: Node, change: Change, given: SideFlags, zenoh: ZenohOptions) -> int:
    if given.record is not None:
        raise InvalidParameter("--record", str(given.record), "", why="each pair has a recording; use --out DIRECTORY")
    settings = zenoh_settings(zenoh)
    ports, body, period_ns = _ports(graph, node, change)
    setups = {name: port.setup for name, port in ports.items()}
    check_target(given.log_to, given.json_to)
    directory = output.run_directory(given.out, node.name) if given.files else None
    words = None if given.log_to == "-" else output.console(given.json_to)
    if words is not None:
        output.show_warnings(words, (*warnings_of(setups.values()), *zenoh_warnings(settings)))
    log_to = given.log_to or (None if directory is None else str(directory / "log.jsonl"))
    logs = {
        name: Log(name, words, log_to, progress=given.progress and not number, verbose=given.verbose)
        for number, name in enumerate(setups)
    }

    def notify(name: str, notice: Notice) -> None:
        logs[name].notify(
            replace(notice, text=notice.text if notice.kind in ("progress", "access") else f"{name}: {notice.text}")
        )

    records = {} if directory is None else {name: directory / f"{name}.mcap" for name in setups}
    written, caught = output.Written(), list[signal.Signals]()
    try:
        with watched(settings) as refusals, routed(settings) as own:
            sides = NodeSides(
                ports, own, Outputs(records, notify, refusals.take), body=body, period_ns=period_ns,
                session=given.session, seed=given.seed, realtime=given.realtime,
            )  # fmt: skip
            duration_s = next(iter(setups.values())).params.duration_s
            summaries = asyncio.run(_run(sides, duration_s, caught))
    finally:
        for log in logs.values():
            log.close()
    with held_back(caught):
        written.missing += [f"{name}: {why}" for name, why in sides.failures.items()]
        written.missing += filter(None, [side.unrecorded for side in sides.sides.values()])
        result: dict[str, Any] = {"pairs": summaries, "work": sides.work}
        if node.kind == WORLD:
            result = {"environment": sides.environment, "reservoirs": sides.reservoirs, "seats": summaries}
        if words is not None:
            if node.kind == WORLD:
                show_seats(words, node.name, result)
            else:
                words.print(_table("pair", summaries, {name: port.role for name, port in ports.items()}))
            if directory is not None:
                output.show_files(words, [*(f"{name}.mcap" for name in setups), "summary.json", "log.jsonl"], directory)
        for name, summary in summaries.items():
            written.judge(summary, setups[name].params, virtual=False)
        for target in filter(None, (given.json_to, None if directory is None else str(directory / "summary.json"))):
            with written.part():
                output.write_json(result, target)
    return written.code(exit_code(caught))


async def _run(sides: NodeSides, duration_s: float, caught: list[signal.Signals]) -> dict[str, Summary]:
    stop = asyncio.Event()
    on_signal = catch(stop, caught, again=sides.leave_at_once)
    parent = int(os.environ.pop(PARENT, "0"))
    beside = asyncio.create_task(outlive(sides, parent, "the program", on_signal)) if parent else None
    try:
        return await sides.run(stop, duration_s)
    finally:
        if beside is not None:
            beside.cancel()


def show_seats(words: Console, name: str, result: Mapping[str, Any]) -> None:
    """Print the result of a world with seats: a row for each, and the accounts of its bodies and reservoirs."""
    words.print(_table("seat", result["seats"], dict.fromkeys(result["seats"], "world")))
    environment = environment_line(name, len(result["seats"]), result["environment"])
    for line in filter(None, (environment, reservoir_line(name, result["reservoirs"]))):
        words.print(line, markup=False)


def _table(what: str, summaries: Mapping[str, Summary], roles: Mapping[str, Role]) -> Table:
    from rich.table import Table

    table = Table(what, "passive", "gave out, mJ", "of, mJ", "pairs", "silences", "longest, s", "modulated, %")
    for name, summary in summaries.items():
        table.add_row(name, *_cells(summary, roles[name]))
    return table


def _cells(summary: Summary, role: Role) -> list[str]:
    part: Any = summary[role] or {}
    passive = {True: "yes", False: "no", None: "not known"}[summary["verdict"]["passive"]]
    ledger, outages = part["ledger"], part["outages"]
    share = part["modulated_share"]
    energies = ["-" if value is None else f"{1e3 * value:.4g}" for value in (ledger["energy_out_J"], ledger["bound_J"])]
    times = [str(part["incarnations"]), str(outages["count"]), f"{outages['longest_s']:.2g}"]
    return [passive, *energies, *times, "-" if share is None else f"{100.0 * share:.3g}"]
