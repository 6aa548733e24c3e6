"""`hapnet doctor`: checks of this machine, network and device, one line each, with advice."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import Dialling
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import Params, is_simulated

if TYPE_CHECKING:
    from hapnet.assembly.user_device import UserDevice
    from hapnet.ext.doctor.machine import Check


def doctor(
    *,
    zenoh: Dialling,
    session: flags.Session = "default",
    name: flags.Name = "device",
    hardware: flags.Hardware = None,
    dof: flags.Dof = None,
    ramp: Annotated[
        float,
        typer.Option(
            metavar="N", help="With --device: push its handle to and fro by N, to check that force and motion agree."
        ),
    ] = 0.0,
    damping: Annotated[
        float, typer.Option(metavar="N", help="With --device: push its free handle by N, to measure its own damping.")
    ] = 0.0,
    share: Annotated[
        bool,
        typer.Option(
            "--share", help="With --device: measure all, run at a wall twice, and write a file and a picture to post."
        ),
    ] = False,
    run_s: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="With --share: seconds of each run. [60]")
    ] = None,
    pair: Annotated[
        str | None,
        typer.Option(
            "--pair", metavar="RUN", help="Say why two robots vibrate, from a run with --follower, and what to set."
        ),
    ] = None,
    json_to: flags.Json = None,
) -> int:
    """With -e, also check whether Zenoh answers there, and measure the network: a side that
    listens there answers probes. With --device, measure that device instead: rate, latency, noise and resolution;
    --ramp and --damping use a force, and --share both.
    """
    if pair is not None:
        from hapnet.ext.doctor.pair import examine_pair

        return _show(examine_pair(pair), json_to)
    if share and hardware is None:
        raise InvalidParameter("--device", "(not given)", "", why="--share needs a device of `hapnet devices`")
    if run_s is not None and not share:
        raise InvalidParameter("--duration", run_s, "", why="it needs --share")
    if share and hardware is not None:
        return share_device(hardware, dof or 1, ramp, damping, run_s, json_to)
    if hardware is not None:
        return examine_device(hardware, dof or 1, ramp, damping, json_to)
    if force := ramp or damping:
        raise InvalidParameter("--ramp" if ramp else "--damping", force, "", why="it needs --device")
    from hapnet.ext.doctor.machine import examine
    from hapnet.transport.diagnosis import check_hosts

    check_hosts(zenoh.connect or ())
    return _show(examine(zenoh.connect or [], zenoh.security, session, name), json_to)


def examine_device(hardware: str, dof: int, ramp_N: float, damping_N: float, json_to: str | None) -> int:
    """Measure a device; returns 0 even with warnings, which the user must judge."""
    if ramp_N and damping_N:
        raise InvalidParameter("--damping", damping_N, "", why="run --ramp and --damping one after the other")
    with _opened(hardware, dof, ramp_N, damping_N) as device:
        return _show(_measured(device, hardware, ramp_N, damping_N), json_to)


def share_device(
    hardware: str, dof: int, ramp_N: float, damping_N: float, run_s: float | None, json_to: str | None
) -> int:
    """Measure a device in all ways, run it at a wall, and write a file and a picture about it to the current folder;
    returns 0 also if something speaks against the device."""
    from hapnet.ext.doctor import share
    from hapnet.ext.pictures.shared_device import draw
    from hapnet.installing import require

    seconds = share.run_length(run_s)
    require("report", "--share, for its picture,")
    files = share.Files(hardware, Path.cwd())
    words, ask = output.console(json_to), output.asker() or (lambda text: None)
    with _opened(hardware, dof, ramp_N, damping_N) as device:
        declared, push_N = share.declared(device), share.push_N(device)
    checks: dict[str, Check] = {}
    for pushes in ((0.0, damping_N or push_N), (ramp_N or push_N, 0.0)):
        if any(pushes):
            words.print(f"Let go of the handle, in the middle of its range: the device pushes it by {max(pushes):g} N.")
            ask("Enter: begin ")
        with _opened(hardware, dof, *pushes) as device:
            new = {check.name: check for check in _measured(device, hardware, *pushes)}
        checks = new | checks  # the second adds whether force and motion agree
    runs = {}
    for link in share.LINKS:
        words.print(
            f"Hold the handle for {seconds:g} s: move it freely, push the wall, tap it, slide along it ({link})."
        )
        ask("Enter: begin ")
        runs[link] = share.run_at_a_wall(hardware, dof, link, seconds)
    made = share.report(hardware, declared, list(checks.values()), runs)
    share.write(made, files, draw)
    _show(checks.values(), json_to)
    for line in made["findings"] or ["nothing speaks against it"]:
        words.print(line)
    words.print(
        f"{files.report.name} and {files.picture.name} hold no names, addresses or paths: please post them, with the"
        " project's form 'A device was tried'"
    )
    return 0


@contextmanager
def _opened(hardware: str, dof: int, *forces_N: float) -> Iterator[UserDevice]:
    """The device, for forces that it can render [N]. Raises InvalidParameter."""
    from hapnet.assembly.user_device import UserDevice

    if is_simulated(hardware):
        raise InvalidParameter("--device", hardware, "a real device (`hapnet devices`), or module:Class")
    device = UserDevice(hardware, dof)
    try:
        most_N = device.force_limit
        for flag, force_N in zip(("--ramp", "--damping"), forces_N, strict=True):
            if force_N < 0.0 or (most_N is not None and force_N > most_N):
                allowed = "0 (no force), or above" + ("" if most_N is None else f", at most {most_N:g} N")
                raise InvalidParameter(flag, force_N, allowed)
        yield device
    finally:
        device.close()


def _measured(device: UserDevice, hardware: str, ramp_N: float, damping_N: float) -> Iterator[Check]:
    """The checks of a device, each as soon as it is done."""
    from hapnet.assembly.device_class import servo_rate
    from hapnet.commands import known_devices
    from hapnet.ext.doctor.device import examine_device as measure

    return measure(
        device, min(servo_rate(hardware, Params().device.servo_hz), device.rate_hz or math.inf), time.monotonic_ns,
        time.sleep, ramp_N, damping_N,
        known_mass=known_devices.mass_of(hardware, device.dof) or (),
        on_mass=lambda mass: known_devices.remember(hardware, mass),
    )  # fmt: skip


def _show(examined: Iterable[Check], json_to: str | None) -> int:
    from rich.text import Text

    from hapnet.ext.doctor.machine import MISSING, OK, SKIPPED, WARNING

    style = {OK: "green", WARNING: "yellow", MISSING: "bold red", SKIPPED: "dim"}
    words = output.console(json_to)
    checks = []
    with Progress(output.progress_console(words), "examining"):
        for check in examined:
            checks.append(check)
            line = Text(f"{check.state:<8} ", style=style[check.state]).append(
                f"{check.name:<20} {check.value}", "default"
            )
            words.print(line.append(f" → {check.advice}", style[check.state]) if check.advice else line)
    output.write_json([check.as_dict() for check in checks], json_to)
    return 1 if any(check.state == MISSING for check in checks) else 0
