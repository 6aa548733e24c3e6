"""`hapnet run --graph FILE`: every node of a graph in a process of its own on this machine, and one result."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import signal
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from hapnet.commands import output
from hapnet.commands.log import Repeats
from hapnet.commands.progress import Progress
from hapnet.commands.side import PARENT, catch, exit_code, held_back
from hapnet.ext.many.accounts import node_account
from hapnet.ext.many.graph import DEVICE, WORLD, Edge, Graph, Node, read_graph
from hapnet.ext.many.hands import Change, require_live, warnings_of
from hapnet.ext.many.shared_bodies import checked_setups
from hapnet.ext.many.shares import has_one_side
from hapnet.ext.many.summary import environment_line, graph_verdict, pairs_table, show_verdict
from hapnet.param_values import toml_value
from hapnet.params import Params
from hapnet.processes.start import NOTHING, ProgramOnLoop, how_it_ended, module, started_on_loop
from hapnet.summary.causes import INCOMPLETE
from hapnet.summary.run import Summary, merge
from hapnet.transport.config import local_address

STOP_LIMIT_S = 30.0
"""The processes are killed if they have not ended this long after the request [s]."""


def run(
    file: Path,
    change: Change,
    *,
    seed: int,
    json_to: str | None,
    out: Path | None,
    files: bool,
    verbose: bool,
    realtime: bool,
) -> int:
    """Run a graph on this machine. change : changes each pair's parameters by the flags of the command."""
    graph = read_graph(file)
    setups = checked_setups(graph, change)
    for world in graph.nodes:
        require_live([setups[edge.name] for edge in graph.led_to(world)])
    words = output.console(json_to)
    output.show_warnings(words, warnings_of(setups.values()))
    directory = output.run_directory(out, seed) if files else None
    written, caught = output.Written(), list[signal.Signals]()
    with (
        tempfile.TemporaryDirectory(prefix="hapnet-") as private,
        Progress(output.progress_console(words), "starting") as progress,
    ):
        nodes = _Nodes(graph, file.absolute(), Path(private), directory, seed, _flags(change), realtime=realtime)
        duration_s = next(iter(setups.values())).params.duration_s

        def show(name: str, notice: dict[str, Any]) -> None:
            if notice["kind"] == "progress":
                progress.stage("running", duration_s or None)
                progress.update(float(notice["text"]))
            elif verbose or notice["level"] != "info":
                words.print(f"{name}: {notice['text']}", markup=False)

        asyncio.run(nodes.run(show, caught))
    with held_back(caught):
        edges = {name: found for name in graph.edges if (found := _joined(nodes, graph, graph.edges[name])) is not None}
        written.missing += [f"{name}: {why}" for name, why in nodes.failures.items()]
        of_nodes = {node.name: _node(nodes, graph, node) for node in graph.nodes.values()}
        missing = [name for name in graph.edges if name not in edges]
        show_verdict(words, verdict := graph_verdict(edges, of_nodes, missing))
        words.print(pairs_table(edges))
        for name, node in of_nodes.items():
            if (line := environment_line(name, len(node["edges"]), node.get("environment"))) is not None:
                words.print(line, markup=False)
        for name, summary in edges.items():
            written.judge(summary, setups[name].params, virtual=False)
        result = {"verdict": verdict, "edges": edges, "nodes": of_nodes}
        for target in filter(None, (json_to, None if directory is None else str(directory / "summary.json"))):
            with written.part():
                output.write_json(result, target)
        if directory is not None:
            output.show_files(words, ["summary.json"], directory, "; a recording of each side is in it")
    return written.code(exit_code(caught))


def _flags(change: Change) -> list[str]:
    """The flags that make this change, for the nodes' commands."""
    values = change(Params()).changes()
    texts = {name: value if isinstance(value, str) else toml_value(value) for name, value in values.items()}
    return [word for name, text in texts.items() for word in ("--set", f"{name}={text}")]


def _node(nodes: _Nodes, graph: Graph, node: Node) -> dict[str, Any]:
    """A node in the summary; its own accounts are as its process wrote them."""
    part = nodes.parts.get(node.name, {})
    sides = {edge.name: _side(nodes, graph, node, edge) for edge in graph.edges_of(node.name)}
    halves = {name: side and side["device" if graph.edges[name].device == node.name else "world"]
              for name, side in sides.items()}  # fmt: skip
    found = node_account(graph, node.name, halves)
    if node.kind == WORLD:
        found |= {key: part.get(key) for key in ("environment", "reservoirs")}
    return found | (part.get("work") or {})


def _side(nodes: _Nodes, graph: Graph, node: Node, edge: Edge) -> Summary | None:
    """The summary that this node has written of its side of this pair; None: it has written none."""
    part: Any = nodes.parts.get(node.name)
    if part is not None and not has_one_side(graph, node):
        part = part["seats" if node.kind == WORLD else "pairs"].get(graph.port_of(edge))
    return cast("Summary | None", part)


def _joined(nodes: _Nodes, graph: Graph, edge: Edge) -> Summary | None:
    """The summary of a pair from both sides' own; None: a process has written none."""
    device, world = (_side(nodes, graph, graph.nodes[name], edge) for name in (edge.device, edge.world))
    return None if device is None or world is None else merge(device, world)


class _Nodes:
    """The processes of a graph's nodes."""

    def __init__(
        self,
        graph: Graph,
        file: Path,
        private: Path,
        directory: Path | None,
        seed: int,
        flags: Sequence[str],
        *,
        realtime: bool,
    ) -> None:
        self._graph, self._file, self._private, self._directory = graph, file, private, directory
        self._seed, self._flags, self._realtime = seed, flags, realtime
        self._session = f"run-{secrets.token_hex(4)}"
        self._children: dict[str, ProgramOnLoop] = {}
        self._ending = False
        self.parts: dict[str, dict[str, Any]] = {}
        self.failures: dict[str, str] = {}

    async def run(self, show: Any, caught: list[signal.Signals]) -> None:
        """Run all nodes until they have ended, or one has failed, or a signal stops them."""
        stop = asyncio.Event()
        catch(stop, caught, again=self._end)
        word = self._private / "word"
        word.write_text(secrets.token_hex(16), encoding="ascii")
        word.chmod(0o600)
        graph, addresses = self._graph, dict[str, str]()
        for number, node in enumerate(graph.nodes.values()):
            if graph.led_to(node.name):
                sockets = self._private / str(number)
                sockets.mkdir()
                addresses[node.name] = local_address(str(sockets))
        for number, node in enumerate(sorted(graph.nodes.values(), key=lambda node: node.kind, reverse=True)):
            there = ["--listen", addresses[node.name]] if node.name in addresses else []
            there += [text for edge in graph.led_by(node.name) for text in ("--connect", addresses[edge.world])]
            self._children[node.name] = await self._start(node, number, [*there, "--secret-file", str(word)])
        watchers = [asyncio.create_task(self._watch(name, show)) for name in self._children]
        stopping = asyncio.create_task(stop.wait())
        pending = set(watchers)
        while pending and not stopping.done() and not self.failures:
            _, left = await asyncio.wait({*pending, stopping}, return_when=asyncio.FIRST_COMPLETED)
            pending = {task for task in watchers if task in left}
        if pending:
            self._end()
            _, pending = await asyncio.wait(pending, timeout=STOP_LIMIT_S)
        for child in self._children.values():
            if child.returncode is None:
                child.kill()
        stopping.cancel()
        await asyncio.gather(*watchers)

    async def _start(self, node: Node, number: int, there: list[str]) -> ProgramOnLoop:
        kind, name = "device" if node.kind == DEVICE else "world", node.name
        command = module("hapnet", kind, "--graph", str(self._file), "--node", name, *there, *self._flags)
        command += ["--no-multicast-scouting", "--session", self._session, "--seed", str(self._seed + number)]
        command += ["--json", str(self._private / f"{name}.json"), "--log", "-", "--progress"]
        command += ["--realtime"] * (self._realtime and node.kind == DEVICE)
        if self._directory is None:
            command.append("--no-files")
        else:
            command += ["--out", str(self._directory / name)]
        return await started_on_loop(command, stdin=NOTHING, environment={PARENT: str(os.getpid())})

    async def _watch(self, name: str, show: Any) -> None:
        child, repeats = self._children[name], Repeats()
        assert child.stdout is not None
        assert child.stderr is not None
        errors = asyncio.create_task(child.stderr.read())
        async for line in child.stdout:
            with contextlib.suppress(json.JSONDecodeError):
                notice = json.loads(line)
                text = notice["text"] if notice["kind"] == "progress" else repeats.line(name, notice)
                if text is not None and (notice["kind"] != "progress" or self._graph.nodes[name].kind == "device"):
                    show(name, {**notice, "text": text})
        lines = (await errors).decode(errors="replace").strip().splitlines()
        code = await child.wait()
        with contextlib.suppress(OSError, json.JSONDecodeError):
            self.parts[name] = json.loads((self._private / f"{name}.json").read_text(encoding="utf-8"))
        if code not in (0, INCOMPLETE) and not self._ending:
            self.failures[name] = lines[-1].removeprefix("hapnet: ") if lines else how_it_ended(code)

    def _end(self) -> None:
        self._ending = True
        for child in self._children.values():
            if child.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(signal.SIGTERM)
