"""`hapnet run`: runs both processes on this machine, and makes one summary of them."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from hapnet.assembly.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.assembly.user_device import load_class
from hapnet.commands import output
from hapnet.commands.log import check_target
from hapnet.commands.outcome import FILES, outcome, write_files
from hapnet.commands.pair import Pair
from hapnet.commands.progress import Progress
from hapnet.commands.repeats import Repeats
from hapnet.commands.side import catch, exit_code
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.notices import OVER
from hapnet.summary.structure import SIDES, Summary


@dataclass(frozen=True)
class RunOptions:
    """The options of a run besides its parameters."""

    seed: int
    json_to: str | None
    out: Path | None
    files: bool
    log_to: str | None
    """Where notices go as JSON lines: a file; "-": to standard output; None: log.jsonl among the files."""
    realtime: bool
    verbose: bool


def main(params: Params, options: RunOptions) -> int:
    """Start both processes, wait for them, and print the summary; with files also write it, a report and a figure."""
    setup = prepare(params, "sampled")
    check_sides(setup)
    check_target(options.log_to, options.json_to)
    with ExitStack() as passing:
        if options.files:
            directory = output.run_directory(options.out, options.seed)
        else:  # the summary needs both recordings
            directory = Path(passing.enter_context(TemporaryDirectory(prefix="hapnet-")))
        return _main(params, setup, directory, options)


def _main(params: Params, setup: Setup, directory: Path, options: RunOptions) -> int:
    seed, json_to, files, verbose = options.seed, options.json_to, options.files, options.verbose
    words = output.console("-" if options.log_to == "-" else json_to)
    log_to = options.log_to or str(directory / "log.jsonl")
    try:
        target = os.dup(sys.stdout.fileno()) if log_to == "-" else Path(log_to)
        log = open(target, "ab" if options.log_to else "wb", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise HapnetError(f"cannot write to {log_to}: {error.strerror or error}") from None
    output.show_warnings(words, setup.warnings)
    written = output.Written()
    with log, Progress(output.progress_console(), "starting") as progress:
        running = False
        repeats = Repeats()

        def on_notice(role: str, line: bytes, notice: dict[str, Any]) -> None:
            """Show a notice and log it; the device's clock says how far the run is."""
            nonlocal running
            if notice["kind"] != "progress":
                text = repeats.line(role, notice["kind"], notice["text"], notice["monotonic_ns"])
                if text is not None and (verbose or not _expected(notice)):
                    words.print(f"{role}: {text}", markup=False)
                with written.part():
                    output.write_line(log.fileno(), line, log_to)
            elif role == "device":
                if not running:
                    running = True
                    progress.stage("running", params.duration_s or None)
                progress.update(float(notice["text"]))

        pair = Pair(params, seed, directory, on_notice, realtime=options.realtime)
        code = asyncio.run(_run(pair))
    for role, text in repeats.rest():
        words.print(f"{role}: {text}", markup=False)
    for said in pair.errors.values():
        written.missing += [line for line in said if line != pair.failure]
    told = {role: cast(Summary, part) for role, part in pair.parts.items()}
    recorded: dict[str, Path] = {role: file for role in SIDES if (file := pair.recording(role)).exists()}
    if not recorded and len(told) < 2:  # a process that is interrupted while it starts leaves nothing
        words.print("stopped before both processes ran", style="yellow")
    found = outcome(told, recorded, setup, seed, written)
    if files:
        write_files(found, directory, written)
    output.show_summary(words, found.summary, verbose=verbose)
    written.judge(found.summary, params, virtual=False)
    if files:
        output.show_files(words, FILES, directory)
    with written.part():
        output.write_json(found.summary, json_to)
    code = written.code(code)
    if pair.failure is not None:
        raise HapnetError(pair.failure)
    return code


def _expected(notice: dict[str, Any]) -> bool:
    """Is the notice part of every run? Both sides wait, are paired once and leave; the summary shows the path."""
    kind, values = notice["kind"], notice.get("values", {})
    once = (kind == "paired" and values.get("pair") == 1) or (kind == "left" and values.get("reason") == OVER)
    return once or kind in ("waiting", "path")


async def _run(pair: Pair) -> int:
    """Run to the end, or until a signal stops it; returns the exit code."""
    stop = asyncio.Event()
    caught: list[signal.Signals] = []
    catch(stop, caught, again=pair.stop)
    await pair.start()
    await pair.run(stop)
    return exit_code(caught)


def check_sides(setup: Setup) -> None:
    """Make both sides once, so that errors show here, before anything is started or written.

    A user's own device is only imported: made here, it would be open when the device's process needs it.

    Raises
    ------
    InvalidParameter : as `device_side` and `world_side` do.
    """
    if setup.params.hardware == "simulated":
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), time.monotonic_ns, lambda sample: None)
    else:
        load_class(setup.params.hardware)
    world_side(setup, WorldEndpoint(world_session(setup, 1)), np.random.default_rng(0), lambda sample: None)
