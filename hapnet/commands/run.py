"""`hapnet run`: runs both processes on this machine, and makes one summary of them."""

from __future__ import annotations

import asyncio
import signal
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hapnet.assembly.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.assembly.user_device import load_class
from hapnet.commands import output
from hapnet.commands.pair import Pair
from hapnet.commands.progress import Progress
from hapnet.commands.repeats import Repeats
from hapnet.commands.report import source_of, write
from hapnet.commands.side import catch, exit_code
from hapnet.errors import HapnetError, RecordingError
from hapnet.metrics import motion
from hapnet.params import Params
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Recording, join
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.notices import OVER
from hapnet.summary.run import Summary, merge

if TYPE_CHECKING:
    from hapnet.report import Source


def main(
    params: Params, seed: int, json_to: str | None, out: Path | None, *, files: bool, realtime: bool, verbose: bool
) -> int:
    """Start both processes, wait for them, and print the summary; with `files` also write it, a report and a figure."""
    setup = prepare(params, "sampled")
    check_sides(setup)
    with ExitStack() as passing:
        if files:
            directory = output.run_directory(out, seed)
        else:  # the summary needs both recordings
            directory = Path(passing.enter_context(TemporaryDirectory(prefix="hapnet-")))
        return _main(params, seed, setup, directory, json_to, files=files, realtime=realtime, verbose=verbose)


def _main(
    params: Params,
    seed: int,
    setup: Setup,
    directory: Path,
    json_to: str | None,
    *,
    files: bool,
    realtime: bool,
    verbose: bool,
) -> int:
    words = output.console(json_to)
    try:
        log = (directory / "log.jsonl").open("wb", buffering=0)
    except OSError as error:
        raise HapnetError(f"cannot write to {directory}: {error.strerror or error}") from None
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
                    output.write_line(log.fileno(), line, str(directory / "log.jsonl"))
            elif role == "device":
                if not running:
                    running = True
                    progress.stage("running", params.duration_s or None)
                progress.update(float(notice["text"]))

        pair = Pair(params, seed, directory, on_notice, realtime=realtime)
        code = asyncio.run(_run(pair))
    for role, text in repeats.rest():
        words.print(f"{role}: {text}", markup=False)
    for said in pair.errors.values():
        written.missing += said
    if len(pair.parts) < 2:  # a process that is interrupted while it starts leaves no summary
        words.print("stopped before both processes ran: there is nothing to report", style="yellow")
        return written.code(code)
    summary, recording, sources = _result(pair, setup, seed, written)
    if files:
        with written.part():
            output.write_json(summary, str(directory / "summary.json"))
        if recording is not None:
            with Progress(output.progress_console(), "drawing"):
                write(recording, sources, directory, "report.html", {"run": "figure.png"}, written)
    output.show_summary(words, summary, verbose=verbose)
    written.judge(summary, params, virtual=False)
    if files:
        there = ("device.mcap", "world.mcap", "report.html", "figure.png", "summary.json", "log.jsonl")
        output.show_files(words, there, directory)
    with written.part():
        output.write_json(summary, json_to)
    return written.code(code)


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


def _result(
    pair: Pair, setup: Setup, seed: int, written: output.Written
) -> tuple[Summary, Recording | None, list[Source]]:
    """The summary of both sides, and what they recorded."""
    sides = cast(Summary, pair.parts["device"]), cast(Summary, pair.parts["world"])
    try:
        parts = {(file := pair.recording(role)): read_recording(file) for role in ("device", "world")}
        recording = join(*parts.values())
    except RecordingError as error:
        written.missing.append(f"no report: {error}")
        return merge(*sides, seed=seed), None, []
    summary = merge(*sides, seed=seed, recording=recording)
    summary["motion"] = motion(recording)
    recording.meta["seed"] = seed
    recording.meta["links"] = {"up": str(setup.up), "down": str(setup.down)}
    sources = [source_of(file, part) for file, part in parts.items()]
    return summary, replace(recording, summary=summary), sources


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
