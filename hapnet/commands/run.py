"""`hapnet run`: runs both processes on this machine, and joins their results in one summary."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hapnet.commands import flags, output
from hapnet.commands.options import LinkOptions, ModelOptions, ParamsOptions, no_out_without_files
from hapnet.commands.progress import Progress
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.installing import require
from hapnet.loading import extension
from hapnet.params import Params, is_simulated

if TYPE_CHECKING:
    import signal

    from hapnet.assembly.build import Setup
    from hapnet.commands.pair import Pair
    from hapnet.summary.structure import Summary


def run(
    *,
    model: ModelOptions,
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
    files: flags.Files = True,
    log_to: flags.Log = None,
    realtime: flags.Realtime = False,
    graph: flags.Graph = None,
) -> int:
    """Runs for 10 s by default, with 40 ms delay, 10 ms jitter and 2 % loss in each direction. Writes two
    recordings, a report, its figure and a summary.
    """
    chosen = params.over(Params(), model.named("device", "world"), links)
    if params.show_params:
        if graph is not None:
            raise InvalidParameter("--show-params", "with --graph", "", why="each pair has its own; leave --graph out")
        return params.show(chosen)
    no_out_without_files(out, files)
    if graph is not None:
        if log_to is not None:
            why = "each node has its own events; leave --log out, or use -v"
            raise InvalidParameter("--log", log_to, "", why=why)

        def over(pair: Params) -> Params:
            return params.over(pair, model.named("device", "world"), links)

        code: int = extension("local graphs").run(
            graph, over, seed=seed, json_to=json_to, out=out, files=files, verbose=verbose, realtime=realtime
        )
        return code
    import asyncio
    from tempfile import TemporaryDirectory

    from hapnet.assembly.build import prepare
    from hapnet.commands import known_devices
    from hapnet.commands.log import Repeats, check_target
    from hapnet.commands.outcome import FILES, of_pair, write_files
    from hapnet.commands.pair import Pair
    from hapnet.commands.side import exit_code, held_back
    from hapnet.summary.structure import SIDES
    from hapnet.summary.verdict import incomplete

    setup = prepare(chosen, "sampled")
    check_sides(setup)
    check_target(log_to, json_to)
    chosen = known_devices.introduced(chosen, output.asker())
    with ExitStack() as passing:
        if files:
            directory = output.run_directory(out, seed)
        else:  # the summary needs both recordings
            require("record", "hapnet run")
            directory = Path(passing.enter_context(TemporaryDirectory(prefix="hapnet-")))
        words = output.console("-" if log_to == "-" else json_to)
        name = log_to or str(directory / "log.jsonl")
        try:
            target = os.dup(sys.stdout.fileno()) if log_to == "-" else Path(name)
            log = open(target, "ab" if log_to else "wb", buffering=0)  # noqa: SIM115
        except OSError as error:
            by = "--log: " if log_to else ""
            raise HapnetError(f"{by}cannot write to {name}: {error.strerror or error}") from None
        output.show_warnings(words, setup.warnings)
        written = output.Written()
        written.missing += setup.missing
        caught: list[signal.Signals] = []
        with log, Progress(output.progress_console(words), "starting") as progress:
            running = False
            repeats = Repeats()

            def on_notice(role: str, line: bytes, notice: dict[str, Any]) -> None:
                """Show a notice and log it; update the progress from the device's clock."""
                nonlocal running
                if notice["kind"] != "progress":
                    text = repeats.line(role, notice)
                    if text is not None and (verbose or not _expected(notice)):
                        words.print(f"{role}: {text}", markup=False)
                    with written.part():
                        output.write_line(log.fileno(), line, name)
                elif role == "device":
                    if not running:
                        running = True
                        progress.stage("running", chosen.duration_s or None)
                    progress.update(float(notice["text"]))

            for part in extension("compiled names").missing(setup.params):
                extension("compiled ends").make_ready(part)
            reads = not is_simulated(chosen.hardware) and may_read_input()
            pair = Pair(chosen, seed, directory, on_notice, realtime=realtime, keyboard=reads)
            with terminal_restored():
                asyncio.run(_run(pair, caught))
        with held_back(caught):
            for role, text in repeats.rest():
                words.print(f"{role}: {text}", markup=False)
            for lines in pair.errors.values():
                written.missing += [line for line in lines if line != pair.failure]
            reported = {role: cast("Summary", part) for role, part in pair.parts.items()}
            recorded: dict[str, Path] = {role: file for role in SIDES if (file := pair.recording(role)).exists()}
            began = bool(recorded) or len(reported) == 2
            if not began:  # a process that is interrupted while it starts leaves nothing
                if pair.refused:
                    if out is None:
                        output.discard(directory, "log.jsonl", "params.toml")
                    raise HapnetError(pair.failure or "")
                words.print("stopped before both processes ran", style="yellow")
            found = of_pair(reported, recorded, pair.failed, setup, seed, written)
            known_devices.learn(chosen, found.summary)
            output.show_verdict(words, found.summary, verbose=verbose)
            if files:
                write_files(found, directory, written, words)
            if not verbose:
                more = output.more_in(directory if files else None, "report.html")
                output.show_fact(words, found.summary, more)
            elif files:
                output.show_files(words, FILES, directory)
            written.judge(found.summary, chosen, virtual=False)
            if began and pair.failure is None:  # else the failure is the reason, and is raised below
                written.missing += incomplete(found.summary)
            with written.part():
                output.write_json(found.summary, json_to)
        code = written.code(exit_code(caught))
        if pair.failure is not None:
            raise HapnetError(pair.failure)
        return code


def _expected(notice: dict[str, Any]) -> bool:
    """Whether the notice occurs in every run: both sides wait, pair once and leave; the summary shows the path."""
    from hapnet.side.notices import OVER

    kind, values = notice["kind"], notice.get("values", {})
    once = (kind == "paired" and values.get("pair") == 1) or (kind == "left" and values.get("reason") == OVER)
    return once or kind in ("waiting", "path")


async def _run(pair: Pair, caught: list[signal.Signals]) -> None:
    """Run to the end, or until a signal stops the run; signals are noted in `caught`."""
    import asyncio

    from hapnet.commands.side import catch

    stop = asyncio.Event()
    catch(stop, caught, again=pair.stop)
    await pair.start()
    await pair.run(stop)


def check_sides(setup: Setup) -> None:
    """Create both sides once, so that errors appear here, before anything is started or written.

    A user's own device is only imported: created here, it would be open when the device's process needs it.

    Raises InvalidParameter: as `device_side` and `world_side` do.
    """
    import time

    import numpy as np

    from hapnet.assembly.build import device_session, device_side, world_session, world_side
    from hapnet.assembly.device_class import load_class
    from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint

    if is_simulated(setup.params.hardware):
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), time.monotonic_ns, lambda sample: None)
    else:
        load_class(setup.params.hardware)
    if setup.follower.is_driven(setup.params):
        load_class(setup.params.follower.robot, "follower.robot")
    world_side(setup, WorldEndpoint(world_session(setup, 1)), np.random.default_rng(0), lambda sample: None)


def may_read_input() -> bool:
    """Whether a child process may read standard input. A terminal stops a background process that reads."""
    may = True
    if sys.platform != "win32" and sys.stdin.isatty():
        with suppress(OSError):  # the terminal of another session stops nobody
            may = os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    return may


@contextmanager
def terminal_restored() -> Iterator[None]:
    """Restore the terminal's mode at the end: a device's class may read the keyboard, and may be killed."""
    if sys.platform == "win32" or not sys.stdin.isatty() or not may_read_input():
        yield
    else:
        import termios

        before = termios.tcgetattr(sys.stdin.fileno())
        try:
            yield
        finally:
            with suppress(termios.error):  # it was closed meanwhile
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, before)
