"""`hapnet device` and `hapnet world`: run one side in this process."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol, cast, get_args

from hapnet import checks
from hapnet.assembly.build import prepare
from hapnet.assembly.operators import LIVE
from hapnet.assembly.simulated_device import real_time_warnings
from hapnet.commands import known_devices, output
from hapnet.commands.console import run_console
from hapnet.commands.log import Log, check_target
from hapnet.commands.options import SideFlags, ZenohOptions
from hapnet.commands.outcome import FILES, of_side, write_files
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import extension
from hapnet.params import Params
from hapnet.processes.child import FrameWriter
from hapnet.processes.system import ENDING, HANGUP, handle_on_loop, handled
from hapnet.realtime.runner import RealtimeSide
from hapnet.side.notices import Notice
from hapnet.summary.structure import SIDES, Summary
from hapnet.summary.verdict import incomplete
from hapnet.transport.config import Mode, ZenohSettings, zenoh_warnings
from hapnet.transport.diagnosis import check_hosts
from hapnet.transport.refusals import Refusals, watched
from hapnet.transport.router import FREE, free_name
from hapnet.wire.messages import Role

PARENT = "HAPNET_PARENT"
"""Environment variable of a side that `hapnet run` starts: the id of its parent process."""

CONSOLE = "HAPNET_CONSOLE"
"""Environment variable of such a side: set if commands come on standard input."""

PLACE = "HAPNET_PLACE"
"""Environment variable of such a side: its starting place, as a JSON array of coordinates [m]."""

ORPHANED = "HAPNET_ORPHANED"
"""Environment variable of such a side: the directory for its summary if its parent was killed."""

PAGE = "HAPNET_PAGE"
"""Environment variable of a side that `hapnet play` starts alone: the pipe for the telemetry of both sides, and
the id of its parent process."""

PARENT_EVERY_S = 0.2


def zenoh_settings(options: ZenohOptions) -> ZenohSettings:
    """Zenoh's settings from the flags. Without an endpoint or a file, a side looks for the other on this machine.

    Raises InvalidParameter: there is no such mode, or an endpoint is malformed or has a host without an address.
    """
    alone = not options.connect and not options.listen and options.config is None
    if options.mode is not None:
        checks.one_of("mode", options.mode, get_args(Mode))
    check_hosts(options.connect or ())
    return ZenohSettings(
        mode=cast(Mode | None, options.mode),
        connect=tuple(options.connect or ()),
        listen=tuple(options.listen or ()),
        config=options.config,
        multicast_scouting=alone and not options.no_multicast_scouting,
        cfg=tuple(options.cfg or ()),
        security=options.security,
    )


def main(role: Role, params: Params, given: SideFlags, zenoh: ZenohOptions) -> int:
    """Run one side until its duration is over or a signal stops it; returns the exit code."""
    settings, directory = zenoh_settings(zenoh), None
    if given.files and (given.record is None or given.out is not None):
        directory = output.run_directory(given.out, role)
    try:
        with watched(settings) as refusals:
            return _main(role, params, given, settings, refusals, directory)
    except BaseException:
        if directory is not None and given.out is None:
            output.discard(directory, "log.jsonl")
        raise


def _name(role: Role, given: SideFlags, settings: ZenohSettings, log: Log) -> str:
    """The name of this side: that of the first free seat, if it is `FREE`. Raises as `free_name`."""
    if given.name != FREE:
        return given.name
    if role == "world":
        raise InvalidParameter("--name", FREE, "", why="with it a device takes a free seat: give the world another")
    name = free_name(settings, given.session)
    log.notify(Notice("seat", f"takes the free seat {name}", time.monotonic_ns()))
    return name


def _main(
    role: Role, params: Params, given: SideFlags, settings: ZenohSettings, refusals: Refusals, directory: Path | None
) -> int:
    setup = prepare(params, "sampled")
    if params.operator == LIVE and CONSOLE not in os.environ:
        raise InvalidParameter(
            "operator", LIVE, "", why="only hapnet play has a page on which the mouse leads the hand"
        )
    warnings = setup.warnings + zenoh_warnings(settings)
    if role == "device":
        warnings += real_time_warnings(setup.params)
    check_target(given.log_to, given.json_to)
    record = given.record or (None if directory is None else directory / f"{role}.mcap")
    words = None if given.log_to == "-" else output.console(given.json_to)
    if words is not None:
        output.show_warnings(words, warnings)
    log_to = given.log_to or (None if directory is None else str(directory / "log.jsonl"))
    log = Log(role, words, log_to, progress=given.progress, verbose=given.verbose)
    for warning in warnings:
        log.write(Notice("warning", warning, time.monotonic_ns(), "warning"))
    for part in extension("compiled names").missing(setup.params) if role == "device" else ():
        log.write(Notice("compiling", "compiling, once for all runs", time.monotonic_ns()))
        extension("compiled ends").make_ready(part)
    written, started_by = output.Written(), int(os.environ.get(PARENT, "0"))
    orphaned = os.environ.pop(ORPHANED, None)
    page, parent = map(int, os.environ.pop(PAGE, "0 0").split())
    caught: list[signal.Signals] = []
    try:
        side = RealtimeSide(
            setup,
            role,
            settings,
            session=given.session,
            name=_name(role, given, settings, log),
            seed=given.seed,
            record=record,
            realtime=given.realtime,
            once=given.once,
            notify=log.notify,
            refused=refusals.take,
            page=FrameWriter(page).put if page else None,
        )
        if (place := os.environ.pop(PLACE, None)) is not None:
            side.place(tuple(json.loads(place)))
        failure: HapnetError | None = None
        try:
            summary = asyncio.run(_run(side, params.duration_s, log, caught, parent))
        except HapnetError as error:
            failure, summary = error, side.summary()
            if side.control.origin_ns is None and not _in_vain(summary):
                raise  # nothing has run
    finally:
        log.close()
    with held_back(caught):
        written.missing += filter(None, (side.unrecorded, log.failure))
        if words is not None:
            output.show_verdict(words, summary, verbose=given.verbose)
        if directory is not None and record is not None:
            write_files(of_side(summary, record, written), directory, written, words)
        if words is not None and not given.verbose:
            more = output.more_in(directory, "report.html")
            if directory is None and record is not None:
                more = output.more_in(record.parent, record.name, "hapnet report ")
            output.show_fact(words, summary, more)
        elif words is not None:
            if directory is not None:
                other = SIDES[1 - SIDES.index(role)]
                output.show_files(words, FILES, directory, f"; hapnet report joins them with the {other}'s")
            elif record is not None:
                output.show_files(words, [record.name], record.parent)
        if not started_by:  # hapnet run judges both sides together
            written.missing += setup.missing if role == "device" else ()
            known_devices.learn(params, summary)
            written.judge(summary, params, virtual=False)
            if side.control.origin_ns is not None or not caught:  # a side that was stopped before it began is complete
                written.missing += incomplete(summary)
        if orphaned is not None and os.getppid() != started_by:
            _leave(summary, Path(orphaned), f"{role}-summary.json", written)
        with written.part():
            output.write_json(summary, given.json_to)
    code = written.code(0 if failure is not None else exit_code(caught))
    if failure is not None:
        raise failure
    return code


def _in_vain(summary: Summary) -> bool:
    """Whether the device missed readings, in a run that has not begun."""
    device = summary["device"]
    return device is not None and device["driver"] is not None and bool(device["driver"]["missed"])


def _leave(summary: Summary, directory: Path, name: str, written: output.Written) -> None:
    """Write the summary into `directory`, as the process that reads it has ended."""
    with suppress(OSError):
        directory.mkdir(parents=True, exist_ok=True)
    with written.part():
        output.write_json(summary, str(directory / name))


async def _run(
    side: RealtimeSide, duration_s: float, log: Log, caught: list[signal.Signals], page_parent: int
) -> Summary:
    stop = asyncio.Event()
    on_signal = catch(stop, caught, again=side.leave_at_once)
    if sys.platform != "win32":
        handle_on_loop(signal.SIGUSR1, side.stop_force, "SIGUSR1")
    run = int(os.environ.pop(PARENT, "0"))  # not getppid(), which differs if the parent has been killed by now
    starter = "hapnet run" if run and CONSOLE not in os.environ else "hapnet play"
    parent = run or page_parent
    beside = [asyncio.create_task(outlive(side, parent, starter, on_signal))] if parent else []
    if os.environ.pop(CONSOLE, None) is not None:

        def complain(text: str) -> None:
            log.notify(Notice("console", text, time.monotonic_ns(), "warning"))

        beside.append(asyncio.create_task(run_console(side, complain)))
    try:
        summary = await side.run(stop, duration_s)
    finally:
        for task in beside:
            task.cancel()
    return summary


class Interrupted(Protocol):
    """A side, or the sides of a node, that may end before their time."""

    def interrupt(self, why: str) -> None:
        """Store why it is to end."""


async def outlive(side: Interrupted, parent: int, starter: str, on_signal: Callable[[signal.Signals], None]) -> None:
    """End as on SIGTERM when `parent` has died, as nothing else would end this side, which may drive a device."""
    while os.getppid() == parent:
        await asyncio.sleep(PARENT_EVERY_S)
    side.interrupt(f"{starter}, which had started it, was killed")
    on_signal(signal.SIGTERM)


def catch(
    stop: asyncio.Event, caught: list[signal.Signals], *, again: Callable[[], object]
) -> Callable[[signal.Signals], None]:
    """Set `stop` on SIGINT, SIGTERM or a closed terminal, and note the signal in `caught`; returns the handler.

    again : called when the same signal comes again, for a quick end; not for SIGHUP, which a closing terminal may
        send twice.
    """

    def on_signal(number: signal.Signals) -> None:
        if number in caught and number != HANGUP:
            again()
        caught.append(number)
        stop.set()

    for number in ENDING:
        if number != HANGUP or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            handle_on_loop(number, on_signal, number)
    return on_signal


@contextmanager
def held_back(caught: list[signal.Signals]) -> Iterator[None]:
    """A context that delays signals to end the process until it has written a run's results; they are noted in
    `caught`.

    The same signal again ends the process at once, except SIGHUP (see `catch`).
    """

    def on_signal(number: int, stack: object) -> None:
        if number in caught and number != HANGUP:
            as_before(number)
            signal.raise_signal(number)
        caught.append(signal.Signals(number))

    with handled(on_signal) as as_before:
        yield


def exit_code(caught: list[signal.Signals]) -> int:
    """0, or 128 + N after signal N, as in shells."""
    return 128 + caught[0] if caught else 0
