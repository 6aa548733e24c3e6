"""`hapnet run`: both processes on this machine, and one summary of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import signal
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.commands import output
from hapnet.commands.side import PARENT, catch, exit_code
from hapnet.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.errors import HapnetError, RecordingError
from hapnet.mcap_file import read_recording
from hapnet.metrics import motion
from hapnet.params import Params
from hapnet.record import Recording, join
from hapnet.runtime.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.runtime.own_device import load_class
from hapnet.runtime.summary import merge
from hapnet.runtime.zenoh_config import free_address

if TYPE_CHECKING:
    from rich.console import Console

STOP_LIMIT_S = 30.0
"""How long the processes may take to end after they were asked to [s]; after that they are killed."""


def main(params: Params, seed: int, json_to: str | None, out: Path | None, *, realtime: bool) -> int:
    """Start both processes, wait for them, write the run's figure and summary."""
    setup = prepare(params, "sampled")
    check_sides(setup)
    words = output.console(json_to)
    directory = output.run_directory(out, seed)
    try:
        (directory / "params.toml").write_text(params.toml(), encoding="utf-8")
        log = (directory / "log.jsonl").open("wb", buffering=0)
    except OSError as error:
        raise HapnetError(f"cannot write to {directory}: {error.strerror or error}") from None
    output.show_warnings(words, setup.warnings)
    written = output.Written()
    with log:
        pair = Pair(setup, seed, directory, words, log.fileno(), written, realtime=realtime)
        code = asyncio.run(pair.run())
    if not pair.reported:
        words.print("stopped before both processes ran: there is nothing to report", style="yellow")
        return written.code(code)
    summary, recording = pair.result()
    figure = directory / "figure.png"
    with written.part():
        output.write_json(summary, str(directory / "summary.json"))
    if recording is not None:
        with written.part():
            output.save_figure(recording, figure)
    output.show_summary(words, summary)
    files = ("device.mcap", "world.mcap", "figure.png", "summary.json", "log.jsonl")
    there = [file for file in files if (directory / file).exists()]
    words.print(f"{', '.join(there)} in {directory}")
    with written.part():
        output.write_json(summary, json_to)
    return written.code(code)


def check_sides(setup: Setup) -> None:
    """Make both sides once, so that what does not fit is said here, before anything is started or written.

    A device of the user's own is only imported: made here, it would be open when the device's process wants it.

    Raises
    ------
    InvalidParameter : as `device_side` and `world_side` do.
    """
    if setup.params.hardware == "simulated":
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), time.monotonic_ns, lambda sample: None)
    else:
        load_class(setup.params.hardware)
    world_side(setup, WorldEndpoint(world_session(setup, 1)), np.random.default_rng(0), lambda sample: None)


class Pair:
    """The two child processes of a run.

    log : where their notices go, a file descriptor. written : told what they could not write.
    """

    def __init__(
        self,
        setup: Setup,
        seed: int,
        directory: Path,
        words: Console,
        log: int,
        written: output.Written,
        *,
        realtime: bool,
    ) -> None:
        self.setup, self.seed, self.directory, self.words = setup, seed, directory, words
        self._log, self._written = log, written
        self._realtime = realtime
        self._children: dict[str, asyncio.subprocess.Process] = {}
        self._reports: dict[str, asyncio.Task[bytes]] = {}
        self._parts: dict[str, dict[str, Any]] = {}
        self._errors: dict[str, list[str]] = {}
        self._told = False

    async def run(self) -> int:
        """Run to the end; the exit code.

        Raises
        ------
        HapnetError : a process failed; the message is its own.
        """
        stop = asyncio.Event()
        caught: list[signal.Signals] = []
        catch(stop, caught, again=self._stop_children)
        address = free_address()
        session = f"run-{secrets.token_hex(4)}"
        with _Progress(self.words, self.setup.params.duration_s) as progress:
            for role, flag in (("world", "--listen"), ("device", "--connect")):
                self._children[role] = await self._start(role, flag, address, session)
            watchers = [asyncio.create_task(self._watch(role, progress)) for role in self._children]
            stopping = asyncio.create_task(stop.wait())
            ended, _ = await asyncio.wait([*watchers, stopping], return_when=asyncio.FIRST_COMPLETED)
            if stopping in ended or any(map(self._failed, self._children)):
                self._stop_children()
            stopping.cancel()
            _, late = await asyncio.wait(watchers, timeout=STOP_LIMIT_S)
            if late:
                self._signal(signal.SIGKILL)
                await asyncio.wait(watchers)
        for role in self._children:
            if self._failed(role) and not caught:
                said = self._errors[role]
                code = self._children[role].returncode
                raise HapnetError(said[-1] if said else f"the {role} process ended with exit code {code}")
            self._written.missing += self._errors[role]
        return exit_code(caught)

    @property
    def reported(self) -> bool:
        """Have both processes left their summary? One that is interrupted while it starts does not."""
        return len(self._parts) == 2

    def result(self) -> tuple[dict[str, Any], Recording | None]:
        """The summary of both sides, and what they recorded."""
        summary = merge(self._parts["device"], self._parts["world"], seed=self.seed)
        try:
            recording = join(*(read_recording(self._recording(role)) for role in ("device", "world")))
        except RecordingError as error:
            self._written.missing.append(f"no figure: {error}")
            return summary, None
        summary["motion"] = motion(recording)
        recording.meta["seed"] = self.seed
        recording.meta["links"] = {"up": str(self.setup.up), "down": str(self.setup.down)}
        return summary, Recording(recording.meta, recording.device, recording.world, recording.events, summary)

    async def _start(self, role: str, flag: str, address: str, session: str) -> asyncio.subprocess.Process:
        report, theirs = os.pipe()  # a summary that needs no room on a disk
        command = [sys.executable, "-m", "hapnet", role, flag, address, "--no-multicast-scouting"]
        command += ["--session", session, "--params", str(self.directory / "params.toml"), "--seed", str(self.seed)]
        command += ["--record", str(self._recording(role)), "--json", f"/dev/fd/{theirs}", "--log", "-", "--progress"]
        if self._realtime and role == "device":
            command.append("--realtime")
        pipe = asyncio.subprocess.PIPE
        try:
            child = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=pipe,
                stderr=pipe,
                pass_fds=(theirs,),
                env={**os.environ, PARENT: str(os.getpid())},
            )
        finally:
            os.close(theirs)
        self._reports[role] = asyncio.create_task(_read(report))
        return child

    async def _watch(self, role: str, progress: _Progress) -> None:
        child = self._children[role]
        assert child.stderr is not None
        errors = asyncio.create_task(child.stderr.read())
        async for line, notice in _notices(child):
            progress.tell(role, notice["kind"], notice["text"])
            if notice["kind"] != "progress":
                with self._written.part():
                    output.write_line(self._log, line, str(self.directory / "log.jsonl"))
        said = (await errors).decode(errors="replace").strip().splitlines()
        await child.wait()
        self._errors[role] = [line.removeprefix("hapnet: ") for line in said if line.startswith("hapnet: ")]
        if self._failed(role) and not self._errors[role]:
            self._errors[role] = said
        with contextlib.suppress(json.JSONDecodeError):
            self._parts[role] = json.loads(await self._reports[role])

    def _failed(self, role: str) -> bool:
        """Has the process ended otherwise than it should?"""
        told = (128 + signal.SIGTERM, -signal.SIGTERM) if self._told else ()
        return self._children[role].returncode not in (None, 0, output.INCOMPLETE, *told)

    def _stop_children(self) -> None:
        """Called again: without delay. SIGINT comes from the terminal too, and would count as the second time."""
        self._told = True
        self._signal(signal.SIGTERM)

    def _signal(self, number: signal.Signals) -> None:
        for child in self._children.values():
            if child.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(number)

    def _recording(self, role: str) -> Path:
        return self.directory / f"{role}.mcap"


async def _read(pipe: int) -> bytes:
    """All that comes through a pipe, which is closed then."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(pipe, "rb", buffering=0)
    )
    return await reader.read()


class _Progress:
    """A bar on a terminal, lines now and then elsewhere."""

    _LINE_EVERY_S = 5.0

    def __init__(self, words: Console, duration_s: float) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        total = duration_s or None
        of = f" of {duration_s:g} s" if duration_s else " s"
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f}" + of))
        self._words = words
        self._bar = Progress(*columns, console=words, disable=not words.is_terminal)
        self._task = self._bar.add_task("starting", total=total)
        self._next_line_s = self._LINE_EVERY_S

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._bar.stop()

    def tell(self, role: str, kind: str, text: str) -> None:
        if kind == "progress":
            if role != "device":
                return
            elapsed = float(text)
            self._bar.update(self._task, completed=elapsed, description="running")
            if not self._words.is_terminal and elapsed >= self._next_line_s:
                self._next_line_s += self._LINE_EVERY_S
                self._words.print(f"{elapsed:.0f} s")
        elif kind != "waiting":
            self._words.print(f"{role}: {text}")


async def _notices(child: asyncio.subprocess.Process) -> AsyncIterator[tuple[bytes, dict[str, str]]]:
    """The lines that a process logs, as they are and what they say."""
    assert child.stdout is not None
    async for line in child.stdout:
        with contextlib.suppress(json.JSONDecodeError):
            yield line, json.loads(line)
