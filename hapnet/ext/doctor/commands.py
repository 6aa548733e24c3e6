"""`hapnet doctor`: checks of this machine, network and device, one line each, with advice."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import Dialling
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import Params, is_simulated

if TYPE_CHECKING:
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
    json_to: flags.Json = None,
) -> int:
    """With -e, also check whether Zenoh answers there, and measure the network: a side that
    listens there answers probes. With --device, measure that device instead: rate, latency, noise and resolution;
    --ramp and --damping use a force.
    """
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
    from hapnet.assembly.device_class import servo_rate
    from hapnet.assembly.user_device import UserDevice
    from hapnet.commands import known_devices
    from hapnet.ext.doctor.device import examine_device as measure

    if is_simulated(hardware):
        raise InvalidParameter("--device", hardware, "a real device (`hapnet devices`), or module:Class")
    device = UserDevice(hardware, dof)
    rate_hz = min(servo_rate(hardware, Params().device.servo_hz), device.rate_hz or math.inf)
    most_N = device.force_limit
    try:
        for flag, force_N in (("--ramp", ramp_N), ("--damping", damping_N)):
            if force_N < 0.0 or (most_N is not None and force_N > most_N):
                allowed = "0 (no force), or above" + ("" if most_N is None else f", at most {most_N:g} N")
                raise InvalidParameter(flag, force_N, allowed)
        if ramp_N and damping_N:
            raise InvalidParameter("--damping", damping_N, "", why="run --ramp and --damping one after the other")
        checks = measure(
            device, rate_hz, time.monotonic_ns, time.sleep, ramp_N, damping_N,
            known_mass=known_devices.mass_of(hardware, dof) or (),
            on_mass=lambda mass: known_devices.remember(hardware, mass),
        )  # fmt: skip
        return _show(checks, json_to)
    finally:
        device.close()


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
