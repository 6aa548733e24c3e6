"""`hapnet report DIRECTORY` of a graph's run: a report on each pair, and one page with the verdict on all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hapnet.commands import output
from hapnet.commands.outcome import write
from hapnet.commands.progress import Progress
from hapnet.errors import RecordingError
from hapnet.ext.many.graph import DEVICE, port_name
from hapnet.ext.many.summary import PAIR_HEAD, environment_line, graph_verdict, pair_row, pairs_table, show_verdict
from hapnet.loading import extension
from hapnet.recording.opened import fitting
from hapnet.side.endpoint import NANO
from hapnet.summary.verdict import ROUNDING_J

PAGE = "report.html"
_MOST_BYTES = 100_000_000
_OUTCOMES = {True: "good", False: "bad", None: "unknown"}


@dataclass(frozen=True)
class GraphRun:
    """The files of a graph's run: the summary that it wrote, and the recordings of each pair by its name.

    ends : the device and the world of each pair.
    """

    directory: Path
    summary: Mapping[str, Any]
    files: Mapping[str, list[Path]]
    ends: Mapping[str, tuple[str, str]]


def run_in(directory: Path) -> GraphRun | None:
    """The run of a graph in this directory; None: there is none.

    Raises RecordingError: its summary is not one of a graph that hapnet wrote.
    """
    file = directory / "summary.json"
    try:
        if not file.is_file() or file.stat().st_size > _MOST_BYTES:
            return None
        summary = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(summary, dict) or not {"edges", "nodes", "verdict"} <= summary.keys():
        return None
    with fitting(file):
        nodes = summary["nodes"]
        for name in [*nodes, *(edge for node in nodes.values() for edge in node["edges"])]:
            if Path(name).name != name:
                raise RecordingError(f"{file} cannot be used: {name!r} is no name of a pair or node")
        ends = _ends(nodes)
        graph_verdict({}, nodes, ends)
        _of_nodes(nodes)
        return GraphRun(directory, summary, {name: _files(directory, name, ends) for name in ends}, ends)


def _ends(nodes: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for name, node in nodes.items():
        leads = node.get("leads", node["edges"] if node["kind"] == DEVICE else [])  # older runs: no follower leads
        for edge in node["edges"]:
            found.setdefault(edge, {})["device" if edge in leads else "world"] = name
    return {edge: (two["device"], two["world"]) for edge, two in found.items()}


def _files(directory: Path, name: str, ends: Mapping[str, tuple[str, str]]) -> list[Path]:
    """A pair's one recording of both sides, or each side's own; those that exist."""
    device, world = ends[name]
    whole, port = directory / f"{name}.mcap", port_name(device, world, [one for one, _ in ends.values()].count(device))
    own = [directory / device / "device.mcap", *(directory / node / f"{port}.mcap" for node in (device, world))]
    return [whole] if whole.exists() else [file for file in own if file.exists()]


def report(found: GraphRun, json_to: str | None, out: Path | None, *, verbose: bool) -> int:
    """Write a report on each pair, and the page of all."""
    reports = extension("reports")
    words, written = output.console(json_to), output.Written()
    directory = found.directory if out is None else output.run_directory(out, None)
    edges: dict[str, Any] = {}
    for name, files in found.files.items():
        if not files:
            written.missing.append(f"{name}: there is no recording of it in {found.directory}")
            continue
        with Progress(output.progress_console(words), "reading"), fitting(files[0]):
            try:
                one = reports.report(files)
            except RecordingError as error:
                written.missing.append(f"{name}: {error}")
                continue
            edges[name] = one.summary
            written.missing += [source.missing for source in one.sources if source.missing is not None]
            write(one, directory, f"{name}.html", reports.names_of(name), written)
            virtual = one.recording.meta.get("clock") == "virtual"
            written.judge(one.summary, extension("report commands").asked(one.parts), virtual=virtual, ran=False)
    nodes = found.summary["nodes"]
    with fitting(found.directory / "summary.json"):
        verdict = graph_verdict(edges, nodes, [name for name in found.files if name not in edges])
        page = _page(found, edges, verdict)
        lines = [environment_line(name, len(node["edges"]), node.get("environment")) for name, node in nodes.items()]
    with written.part():
        reports.save(page.encode("utf-8", errors="replace"), directory / PAGE, "report")
    show_verdict(words, verdict)
    words.print(pairs_table(edges))
    for line in filter(None, lines):
        words.print(line, markup=False)
    pages = [PAGE, *(f"{name}.html" for name in edges)]
    output.show_files(words, pages if verbose else [PAGE], directory)
    with written.part():
        output.write_json({"verdict": verdict, "edges": edges, "nodes": nodes}, json_to)
    return written.code()


def _page(found: GraphRun, edges: Mapping[str, Any], verdict: Mapping[str, Any]) -> str:
    of_several = extension("several reports")
    pairs = [
        of_several.PairOf(
            name, device, world, f"{name}.html" if name in edges else "",
            _OUTCOMES[edges[name]["verdict"]["passive"] if name in edges else None],
        )
        for name, (device, world) in found.ends.items()
    ]  # fmt: skip
    rows, seats = _of_nodes(found.summary["nodes"])
    tables = [
        of_several.Listed("Pairs", PAIR_HEAD, [pair_row(name, of) for name, of in edges.items()]),
        of_several.Listed("Nodes", _NODE_HEAD, rows),
        of_several.Listed("Reservoirs at the world", _SEAT_HEAD, seats),
    ]
    word = {True: "PASSIVE", False: "NOT PASSIVE", None: "PASSIVITY NOT KNOWN"}[verdict["passive"]]
    title = f"{len(pairs)} pairs: {', '.join(dict.fromkeys(world for _, world in found.ends.values()))}"
    return str(of_several.several(title, f"{word}: {verdict['reason']}", _OUTCOMES[verdict["passive"]], pairs, tables))


_NODE_HEAD = ("node", "kind", "pairs", "sent, mJ", "its ledgers count, mJ", "least balance of its blocks, mJ")
_SEAT_HEAD = ("seat", "used, mJ", "got, mJ", "given, mJ", "refilled, mJ", "left, mJ")


def _of_nodes(nodes: Mapping[str, Any]) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """The rows of the nodes, and of their seats' reservoirs."""
    rows: list[tuple[str, ...]] = []
    seats: list[tuple[str, ...]] = []
    for name, node in nodes.items():
        sent, own, reservoirs = node.get("sent_nJ"), node.get("environment") or {}, node.get("reservoirs") or {}
        values = [None if sent is None else sent * NANO, node.get("ledger_sent_J"), own.get("env_slack_J")]
        rows.append((name, str(node["kind"]), str(len(node["edges"])), *map(_milli, values)))
        for seat, account in reservoirs.get("seats", {}).items():
            cells = [_milli(account[key]) for key in ("used_J", "got_J", "given_J", "refilled_J", "left_J")]
            seats.append((seat, *cells))
    return rows, seats


def _milli(value: float | None) -> str:
    return "-" if value is None else "0" if abs(value) < ROUNDING_J else f"{1e3 * value:.4g}"
