"""`hapnet run`: both processes on this machine, and one summary of them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import signal
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from hapnet.commands import output
from hapnet.commands.side import catch, exit_code
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

STOP_LIMIT_S = 15.0
"""How long the processes may take to end after they were asked to [s]; after that they are killed."""


def main(params: Params, seed: int, json_to: str | None, out: Path | None, *, realtime: bool) -> int:
    """Start both processes, wait for them, write the run's figure and summary."""
    setup = prepare(params, "sampled")
    check_sides(setup)
    words = output.console(json_to)
    directory = output.run_directory(out, seed)
    (directory / "params.toml").write_text(params.toml(), encoding="utf-8")
    output.show_warnings(words, setup.warnings)
    pair = Pair(setup, seed, directory, words, realtime=realtime)
    code = asyncio.run(pair.run())
    if not pair.reported:
        words.print("stopped before both processes ran: there is nothing to report", style="yellow")
        return code
    summary, recording = pair.result()
    output.write_json(summary, str(directory / "summary.json"))
    figure = "" if recording is None else f", figure {output.save_figure(recording, directory / 'figure.png').name}"
    output.show_summary(words, summary)
    words.print(f"recordings device.mcap and world.mcap{figure}, summary.json, log.jsonl in {directory}")
    output.write_json(summary, json_to)
    return code


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
    """The two child processes of a run."""

    def __init__(self, setup: Setup, seed: int, directory: Path, words: Console, *, realtime: bool) -> None:
        self.setup, self.seed, self.directory, self.words = setup, seed, directory, words
        self._realtime = realtime
        self._children: dict[str, asyncio.subprocess.Process] = {}
        self._errors: dict[str, bytes] = {}

    async def run(self) -> int:
        """Run to the end; the exit code.

        Raises
        ------
        HapnetError : a process failed; the message is its own.
        """
        stop = asyncio.Event()
        caught: list[signal.Signals] = []
        catch(stop, caught.append)
        address = free_address()
        session = f"run-{secrets.token_hex(4)}"
        with (
            _Progress(self.words, self.setup.params.duration_s) as progress,
            (self.directory / "log.jsonl").open("wb", buffering=0) as log,
        ):
            for role, flag in (("world", "--listen"), ("device", "--connect")):
                self._children[role] = await self._start(role, flag, address, session)
            watchers = [asyncio.create_task(self._watch(role, progress, log)) for role in self._children]
            stopping = asyncio.create_task(stop.wait())
            ended, _ = await asyncio.wait([*watchers, stopping], return_when=asyncio.FIRST_COMPLETED)
            if stopping in ended or any(child.returncode for child in self._children.values()):
                self._signal(signal.SIGINT)  # a second one to a child that has got it from the terminal does no harm
            stopping.cancel()
            _, late = await asyncio.wait(watchers, timeout=STOP_LIMIT_S)
            if late:
                self._signal(signal.SIGKILL)
                await asyncio.wait(watchers)
        self._raise_failure(caught)
        return exit_code(caught)

    @property
    def reported(self) -> bool:
        """Have both processes left their summary? One that is interrupted while it starts does not."""
        return all(self._file(role, "json").exists() for role in self._children)

    def result(self) -> tuple[dict[str, Any], Recording | None]:
        """The summary of both sides, and what they recorded."""
        parts = [json.loads(self._file(role, "json").read_text(encoding="utf-8")) for role in ("device", "world")]
        for role in ("device", "world"):
            self._file(role, "json").unlink()
        summary = merge(*parts, seed=self.seed)
        try:
            recording = join(*(read_recording(self._file(role, "mcap")) for role in ("device", "world")))
        except RecordingError as error:
            self.words.print(f"no figure: {error}", style="yellow")
            return summary, None
        summary["motion"] = motion(recording)
        recording.meta["seed"] = self.seed
        recording.meta["links"] = {"up": str(self.setup.up), "down": str(self.setup.down)}
        return summary, Recording(recording.meta, recording.device, recording.world, recording.events, summary)

    async def _start(self, role: str, flag: str, address: str, session: str) -> asyncio.subprocess.Process:
        command = [sys.executable, "-m", "hapnet", role, flag, address, "--no-multicast-scouting"]
        command += ["--session", session, "--params", str(self.directory / "params.toml"), "--seed", str(self.seed)]
        command += [
            "--record",
            str(self._file(role, "mcap")),
            "--json",
            str(self._file(role, "json")),
            "--log",
            "-",
            "--progress",
        ]
        if self._realtime and role == "device":
            command.append("--realtime")
        pipe = asyncio.subprocess.PIPE
        return await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.DEVNULL, stdout=pipe, stderr=pipe
        )

    async def _watch(self, role: str, progress: _Progress, log: BinaryIO) -> None:
        child = self._children[role]
        assert child.stderr is not None
        errors = asyncio.create_task(child.stderr.read())
        async for line, notice in _notices(child):
            progress.tell(role, notice["kind"], notice["text"])
            if notice["kind"] != "progress":
                log.write(line)
        self._errors[role] = await errors
        await child.wait()

    def _signal(self, number: signal.Signals) -> None:
        for child in self._children.values():
            if child.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(number)

    def _raise_failure(self, caught: list[signal.Signals]) -> None:
        for role, child in self._children.items():
            if child.returncode and not caught and child.returncode != 128 + signal.SIGINT:
                said = self._errors[role].decode(errors="replace").strip().splitlines()
                line = f"the {role} process ended with exit code {child.returncode}"
                raise HapnetError(said[-1].removeprefix("hapnet: ") if said else line)

    def _file(self, role: str, ending: str) -> Path:
        return self.directory / f"{role}.{ending}"


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
