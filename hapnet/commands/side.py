"""`hapnet device` and `hapnet world`: one side in this process."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast, get_args

from hapnet import checks
from hapnet.commands import output
from hapnet.commands.log import Log, check_target
from hapnet.params import Params
from hapnet.runtime.build import prepare
from hapnet.runtime.realtime import RealtimeSide, Role
from hapnet.runtime.zenoh_config import Mode, ZenohSettings


@dataclass(frozen=True)
class SideOptions:
    """What one side is told beside its parameters."""

    role: Role
    zenoh: ZenohSettings
    session: str
    name: str
    seed: int | None
    record: Path | None
    realtime: bool
    json_to: str | None
    log_to: str | None
    """Notices as JSON lines: to a file, or for "-" on standard output instead of words for people."""
    progress: bool
    """Of these also how far the run is."""


def zenoh_settings(
    mode: str | None,
    connect: list[str] | None,
    listen: list[str] | None,
    config: str | None,
    no_multicast_scouting: bool,
    cfg: list[str] | None,
) -> ZenohSettings:
    """Zenoh's flags. Without an endpoint or a configuration file the sides find each other by multicast scouting."""
    alone = not connect and not listen and config is None
    if mode is not None:
        checks.one_of("mode", mode, get_args(Mode))
    return ZenohSettings(
        mode=cast(Mode | None, mode),
        connect=tuple(connect or ()),
        listen=tuple(listen or ()),
        config=config,
        multicast_scouting=alone and not no_multicast_scouting,
        cfg=tuple(cfg or ()),
    )


def main(params: Params, options: SideOptions) -> int:
    """Run one side until its duration is over or it is told to stop."""
    setup = prepare(params, "sampled")
    check_target(options.log_to, options.json_to)
    words = None if options.log_to == "-" else output.console(options.json_to)
    if words is not None:
        output.show_warnings(words, setup.warnings)
    log = Log(options.role, words, options.log_to, progress=options.progress)
    side = RealtimeSide(
        setup,
        options.role,
        options.zenoh,
        session=options.session,
        name=options.name,
        seed=options.seed,
        record=options.record,
        realtime=options.realtime,
        notify=log.tell,
    )
    try:
        summary, code = asyncio.run(_run(side, params.duration_s))
    finally:
        log.close()
    if words is not None:
        output.show_summary(words, summary)
    output.write_json(summary, options.json_to)
    return code


async def _run(side: RealtimeSide, duration_s: float) -> tuple[dict[str, Any], int]:
    stop = asyncio.Event()
    caught: list[signal.Signals] = []
    catch(stop, caught.append)
    summary = await side.run(stop, duration_s)
    return summary, exit_code(caught)


def catch(stop: asyncio.Event, note: Callable[[signal.Signals], None]) -> None:
    """SIGINT, SIGTERM and a closed terminal ask for a clean stop."""
    loop = asyncio.get_running_loop()

    def on_signal(number: signal.Signals) -> None:
        note(number)
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, on_signal, number)


def exit_code(caught: list[signal.Signals]) -> int:
    """0, or as a shell says that a signal ended a program: 128 and its number."""
    return 128 + caught[0] if caught else 0
