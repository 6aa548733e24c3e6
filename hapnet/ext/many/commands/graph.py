"""`hapnet simulate --graph FILE` simulates a graph; `hapnet graph check FILE` says what the graph is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import flags, output
from hapnet.commands.progress import Progress
from hapnet.commands.typed import Command
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import DEVICE, Graph, Node, read_graph
from hapnet.ext.many.hands import warnings_of
from hapnet.ext.many.paths import has_followers, node_rows, one_way_s, paths
from hapnet.ext.many.summary import environment_line, pairs_table, show_verdict
from hapnet.loading import extension
from netem.command_help import PlainGroup

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.table import Table

    from hapnet.assembly.build import Setup
    from hapnet.ext.many.hands import Change
    from hapnet.ext.many.run import GraphResult

app: typer.Typer = typer.Typer(cls=PlainGroup, add_completion=False)

File = Annotated[Path, typer.Argument(metavar="FILE.toml", help="The graph: nodes, and edges with their links.")]


@app.callback()
def graph() -> None:
    """Several hands in one world: each device has a pair, a link and a reservoir of its own."""


@app.command("check", cls=Command, short_help="Check a graph, and print its pairs with their bounds and delays.")
def check(file: File, json_to: flags.Json = None) -> int:
    from hapnet.ext.many.shared_bodies import checked_setups

    found = read_graph(file)
    setups = checked_setups(found)
    rows, nodes, ways = [_row(setups, found, name) for name in found.edges], node_rows(found, setups), []
    words = output.console(json_to)
    words.print(_checked(rows))
    bound = sum(row["bound_J"] for row in rows)
    worlds = [node.name for node in found.nodes.values() if node.kind == "world"]
    places = f" in {_count(len(worlds), 'world')}" if worlds else ""
    words.print(f"{_count(len(rows), 'pair')}{places}; together they may give out {1e3 * bound:.4g} mJ.", markup=False)
    if has_followers(found):
        ways = paths(found, setups)
        words.print(_nodes(nodes))
        for way in ways:
            words.print(f"{' > '.join(way['nodes'])}: {1e3 * way['lag_s']:.3g} ms behind the hand", markup=False)
    words.print(f"on this machine: hapnet simulate --graph {file}, or hapnet run --graph {file}", markup=False)
    for node in found.nodes.values():
        words.print(f"{node.name}: {_command(found, node, file)}", markup=False)
    output.show_warnings(words, warnings_of(setups.values()))
    output.write_json({"edges": rows, "nodes": nodes, "paths": ways} if has_followers(found) else rows, json_to)
    return 0


def _command(found: Graph, node: Node, file: Path) -> str:
    """The command of this node on a host of its own: it dials those whom it leads."""
    places = ["-l tcp/0.0.0.0:17447"] * bool(found.led_to(node.name))
    places += [f"-e tcp/{edge.world.upper()}:17447" for edge in found.led_by(node.name)]
    kind = "device" if node.kind == DEVICE else "world"
    return f"hapnet {kind} --graph {file} --node {node.name} {' '.join(places)}"


def _nodes(rows: list[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table("node", "kind", "d², mJ", "gets, Ns/m", "spends, Ns/m", "will starve")
    for row in rows:
        kind = f"{row['kind']}, held" if row["hand"] and row["kind"] == "follower" else row["kind"]
        known = "starves" in row
        figures = [f"{row[name]:.3g}" if known else "" for name in ("gets_Ns_m", "spends_Ns_m")]
        starves = ("yes" if row["starves"] else "no") if known else ""
        if starves == "no" and row["reach_m"] is not None:
            starves = f"beyond {1e3 * row['reach_m']:.2g} mm"
        table.add_row(row["node"], kind, f"{1e3 * row['bound_J']:.4g}", *figures, starves)
    return table


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _row(setups: Mapping[str, Setup], found: Graph, name: str) -> dict[str, Any]:
    """An edge in figures: its bound d^2 [J], and the typical delays of its link [s]."""
    setup, edge = setups[name], found.edges[name]
    device, world = setup.params.device.ceiling_J, setup.params.world.ceiling_J
    up_s, down_s = one_way_s(setup)
    return {
        "edge": name, "device": edge.device, "world": edge.world, "coupling": setup.params.coupling,
        "axes": setup.dof, "bound_J": device + world, "up_s": up_s, "down_s": down_s,
    }  # fmt: skip


def _checked(rows: list[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table("pair", "coupling", "axes", "d², mJ", "up, ms", "down, ms", "there and back, ms")
    for row in rows:
        times = [f"{1e3 * delay:.3g}" for delay in (row["up_s"], row["down_s"], row["up_s"] + row["down_s"])]
        table.add_row(row["edge"], row["coupling"], str(row["axes"]), f"{1e3 * row['bound_J']:.4g}", *times)
    return table


def simulate(
    file: Path,
    change: Change,
    *,
    seed: int,
    json_to: str | None,
    out: Path | None,
    files: bool,
    verbose: bool,
) -> int:
    """Simulate a graph, print the verdict and a line for each pair, and write a recording of each.

    change : changes each pair's parameters by the flags of the command.
    """
    from hapnet.ext.many.run import GraphSimulation
    from hapnet.recording.mcap import save

    run = GraphSimulation(read_graph(file), seed, change)
    if run.duration_s <= 0.0:
        raise InvalidParameter("duration_s", run.duration_s, "above 0 in virtual time")
    words = output.console(json_to)
    output.show_warnings(words, warnings_of(pair.setup for pair in run.pairs.values()))
    directory = output.run_directory(out, seed) if files else None
    written = output.Written()
    with Progress(output.progress_console(words), "simulating", run.duration_s) as progress:
        result = run.run(progress.update)
        if directory is not None:
            for name, pair in result.pairs.items():
                progress.stage("writing")
                with written.part():
                    save(pair.recording, directory / f"{name}.mcap")
                progress.stage("drawing")
                with written.part():
                    extension("pictures").save_figure(pair.plot(), directory / f"{name}.png")
            with written.part():
                output.write_json(result.summary, str(directory / "summary.json"))
    _show(words, result, verbose=verbose)
    if directory is not None:
        names = [f"{name}.{kind}" for name in result.pairs for kind in ("mcap", "png")]
        output.show_files(words, (*names, "summary.json"), directory)
    for name, pair in result.pairs.items():
        written.missing += run.pairs[name].setup.missing
        written.judge(pair.summary, run.pairs[name].setup.params, virtual=True)
    with written.part():
        output.write_json(result.summary, json_to)
    return written.code()


def _show(words: Any, result: GraphResult, *, verbose: bool) -> None:
    from hapnet.summary.tables import summary_text

    show_verdict(words, result.summary["verdict"])
    words.print(pairs_table({name: pair.summary for name, pair in result.pairs.items()}))
    for name, node in result.summary["nodes"].items():
        if (own := node.get("environment")) is not None:
            words.print(environment_line(name, len(node["edges"]), own), markup=False)
    if verbose:
        for name, pair in result.pairs.items():
            words.print(f"\n{name}", style="bold", markup=False)
            words.print(summary_text(pair.summary))
