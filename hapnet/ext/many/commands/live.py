"""`hapnet world --seats`, and `hapnet device` and `hapnet world` with `--graph`: the sides of a graph in real time."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.commands import output
from hapnet.commands.log import Log, check_target
from hapnet.commands.options import SideFlags, ZenohOptions
from hapnet.commands.side import catch, exit_code, held_back, main, zenoh_settings
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import Edge, Graph, graph_of, read_graph
from hapnet.ext.many.hands import Change, warnings_of, world_setups
from hapnet.ext.many.seats import SeatedWorld, seat_names
from hapnet.ext.many.shares import require_real_time
from hapnet.ext.many.summary import environment_line, reservoir_line
from hapnet.side.notices import Notice
from hapnet.summary.run import Summary
from hapnet.transport.config import zenoh_warnings
from hapnet.transport.refusals import watched
from hapnet.transport.router import routed

if TYPE_CHECKING:
    from rich.table import Table


def device(file: Path, node: str | None, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a device of the graph in this file: `hapnet device --graph FILE --node NAME`."""
    graph = read_graph(file)
    require_real_time(graph, file)
    edge = _edges_of(graph, node, "device")[0]
    return main("device", change(graph.pair(edge)), replace(side, name=edge.device), zenoh)


def world_of_graph(file: Path, node: str | None, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a world of the graph in this file: `hapnet world --graph FILE --node NAME`."""
    graph = read_graph(file)
    require_real_time(graph, file)
    return _world(graph, _edges_of(graph, node, "world"), change, side, zenoh)


def world_of_seats(seats: str, change: Change, side: SideFlags, zenoh: ZenohOptions) -> int:
    """Run a world with these seats: `hapnet world --seats alice,bob`."""
    rights = seat_names(seats)
    names = list(rights)
    if "world" in names:
        raise InvalidParameter("--seats", seats, "names other than world, such as alice,bob")
    nodes = {name: {"kind": "device", "operator": "rest"} for name in names}
    edges = [{"from": name, "to": "world", "rights": rights[name]} for name in names]
    try:
        graph = graph_of({"nodes": {**nodes, "world": {"kind": "world", "dof": 0}}, "edges": edges})
    except InvalidParameter as error:
        raise error.renamed("--seats", seats) if error.name == "nodes" else error from None
    return _world(graph, graph.edges_of("world"), change, side, zenoh)


def _edges_of(graph: Graph, name: str | None, kind: str) -> list[Edge]:
    known = [node.name for node in graph.nodes.values() if node.kind == kind]
    if name is None and len(known) == 1:
        name = known[0]
    if name not in known:
        raise InvalidParameter("--node", name, f"a {kind} of the graph: {', '.join(known)}", known)
    return graph.edges_of(name)


def _world(graph: Graph, edges: list[Edge], change: Change, given: SideFlags, zenoh: ZenohOptions) -> int:
    if given.record is not None:
        raise InvalidParameter("--record", str(given.record), "", why="each seat has a recording; use --out DIRECTORY")
    settings = zenoh_settings(zenoh)
    setups = {edge.device: setup for edge, setup in zip(edges, world_setups(graph, edges, change), strict=True)}
    check_target(given.log_to, given.json_to)
    directory = output.run_directory(given.out, edges[0].world) if given.files else None
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
            world = SeatedWorld(
                setups, own, session=given.session, seed=given.seed, records=records, notify=notify,
                refused=refusals.take,
            )  # fmt: skip
            duration_s = next(iter(setups.values())).params.duration_s
            summaries = asyncio.run(_run(world, duration_s, caught))
    finally:
        for log in logs.values():
            log.close()
    with held_back(caught):
        written.missing += [f"{name}: {why}" for name, why in world.failures.items()]
        written.missing += filter(None, [side.unrecorded for side in world.sides.values()])
        result = {"environment": world.environment, "reservoirs": world.reservoirs, "seats": summaries}
        if words is not None:
            words.print(_table(summaries))
            name = edges[0].world
            lines = environment_line(name, len(edges), world.environment), reservoir_line(name, world.reservoirs)
            for line in filter(None, lines):
                words.print(line, markup=False)
            if directory is not None:
                output.show_files(words, [*(f"{name}.mcap" for name in setups), "summary.json", "log.jsonl"], directory)
        for name, summary in summaries.items():
            written.judge(summary, setups[name].params, virtual=False)
        for target in filter(None, (given.json_to, None if directory is None else str(directory / "summary.json"))):
            with written.part():
                output.write_json(result, target)
    return written.code(exit_code(caught))


async def _run(world: SeatedWorld, duration_s: float, caught: list[signal.Signals]) -> dict[str, Summary]:
    stop = asyncio.Event()

    def leave_at_once() -> None:
        for side in world.sides.values():
            side.leave_at_once()

    catch(stop, caught, again=leave_at_once)
    return await world.run(stop, duration_s)


def _table(summaries: Mapping[str, Summary]) -> Table:
    from rich.table import Table

    table = Table("seat", "passive", "gave out, mJ", "of, mJ", "pairs", "silences", "longest, s", "modulated, %")
    for name, summary in summaries.items():
        table.add_row(name, *_cells(summary))
    return table


def _cells(summary: Summary) -> list[str]:
    part: Any = summary["world"] or {}
    ledger, outages = part["ledger"], part["outages"]
    passive = {True: "yes", False: "no", None: "not known"}[summary["verdict"]["passive"]]
    share = part["modulated_share"]
    energies = ["-" if value is None else f"{1e3 * value:.4g}" for value in (ledger["energy_out_J"], ledger["bound_J"])]
    times = [str(part["incarnations"]), str(outages["count"]), f"{outages['longest_s']:.2g}"]
    return [passive, *energies, *times, "-" if share is None else f"{100.0 * share:.3g}"]
