"""`hapnet doctor`: what this machine allows, one line each, with what to do about it."""

from __future__ import annotations

import time
from collections.abc import Iterable

from hapnet.assembly.user_device import UserDevice, servo_rate
from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.doctor.device import examine_device as measure
from hapnet.doctor.machine import MISSING, OK, SKIPPED, WARNING, Check, examine
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.transport.security import Security

_STYLE = {OK: "green", WARNING: "yellow", MISSING: "bold red", SKIPPED: "dim"}


def main(connect: list[str], json_to: str | None, security: Security, session: str, name: str) -> int:
    """Run the checks; returns 1 if something that hapnet needs is missing, otherwise 0."""
    return _show(examine(connect, security, session, name), json_to)


def examine_device(hardware: str, dof: int, ramp_N: float, damping_N: float, json_to: str | None) -> int:
    """Measure a device; returns 0, as a warning is for people to judge."""
    if hardware == "simulated":
        raise InvalidParameter("--device", hardware, "a real device (`hapnet devices`), or module:Class")
    params = Params().set({"hardware": hardware})
    rate_hz = servo_rate(params)
    device = UserDevice(hardware, dof, params.set({"device.servo_hz": rate_hz}).device)
    most_N = device.force_limit
    try:
        for flag, force_N in (("--ramp", ramp_N), ("--damping", damping_N)):
            if force_N < 0.0 or (most_N is not None and force_N > most_N):
                allowed = "0 (no force), or above" + ("" if most_N is None else f", at most {most_N:g} N")
                raise InvalidParameter(flag, force_N, allowed)
        if ramp_N and damping_N:
            raise InvalidParameter("--damping", damping_N, "without --ramp: one wants a hand on the handle, one none")
        return _show(measure(device, rate_hz, time.monotonic_ns, time.sleep, ramp_N, damping_N), json_to)
    finally:
        device.close()


def _show(examined: Iterable[Check], json_to: str | None) -> int:
    from rich.text import Text

    words = output.console(json_to)
    checks = []
    with Progress(output.progress_console(), "examining"):
        for check in examined:
            checks.append(check)
            line = Text(f"{check.state:<8} ", style=_STYLE[check.state]).append(
                f"{check.name:<20} {check.value}", "default"
            )
            words.print(line.append(f" → {check.advice}", _STYLE[check.state]) if check.advice else line)
    output.write_json([check.as_dict() for check in checks], json_to)
    return 1 if any(check.state == MISSING for check in checks) else 0
