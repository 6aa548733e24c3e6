"""What `hapnet devices` and `hapnet emulate` do."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hapnet import checks
from hapnet.assembly.operators import operator
from hapnet.commands import output
from hapnet.devices import registry
from hapnet.devices.emulator import Emulator, Handle
from hapnet.errors import InvalidParameter
from hapnet.loading import cause, load
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.worlds.registry import make_scene


def show_devices(json_to: str | None) -> int:
    """Print a line for each device; returns 0."""
    words = output.console(json_to)
    rows = []
    for name, (target, package) in registry.known().items():
        row = _row(name, target, package)
        rows.append(row)
        words.print(f"{name:<10} {row['about']}", markup=False)
        state = f"missing: {row['missing']}" if row["missing"] else f"found: {', '.join(row['found']) or 'none'}"
        words.print(f"{'':<10} {row['tested']}; {row['from']}; {state}", style="dim", markup=False)
    words.print("your own: --device module:Class, or a package with the entry point hapnet.devices")
    output.write_json(rows, json_to)
    return 0


def _row(name: str, target: str, package: str) -> dict[str, Any]:
    row: dict[str, Any] = {"name": name, "about": "", "tested": "untested", "from": package, "missing": "", "found": []}
    try:
        made = load("device", target, "a class that can be imported")
        row["about"], row["tested"] = getattr(made, "about", ""), getattr(made, "tested", "untested")
        row["missing"] = made.missing() if hasattr(made, "missing") else ""
        if not row["missing"] and hasattr(made, "found"):
            row["found"] = list(made.found())
    except Exception as error:  # another package's driver may raise anything
        row["missing"] = cause(error)
    return row


def emulate(device: str, params: Params, duration_s: float, json_to: str | None) -> int:
    """Run the device's emulator until the time is over or a signal comes; returns the exit code."""
    name, _, _ = device.partition(":")
    checks.non_negative("--duration", duration_s)
    emulator = make_emulator(device, params)
    words = output.console(json_to)
    words.print(f"emulates {name}: hapnet run --device {name}:{emulator.address}", markup=False)
    stop, caught = threading.Event(), []

    def on_signal(number: int, _: object) -> None:
        caught.append(number)
        stop.set()

    with _signals_to(on_signal):
        if duration_s > 0.0:
            timer = threading.Timer(duration_s, stop.set)
            timer.daemon = True
            timer.start()
        emulator.run(stop)
    handle = emulator.handle
    words.print(
        f"{handle.commands} commands; the watchdog acted {handle.released} times; the actuators gave at most "
        f"{handle.most_given_J * 1e3:.3f} mJ, and at the end {handle.work_J * 1e3:.3f} mJ"
    )
    found = {
        "commands": handle.commands, "released": handle.released, "most_given_J": handle.most_given_J,
        "given_J": handle.work_J,
    }  # fmt: skip
    output.write_json(found, json_to)
    return 0 if not caught or caught[0] == signal.SIGTERM else 128 + caught[0]


def make_emulator(device: str, params: Params) -> Emulator:
    """The emulator of a device, with the simulated hand of `params` on its handle.

    Raises
    ------
    InvalidParameter : the device has no emulator, or not these options.
    """
    name, _, behind = device.partition(":")
    known = registry.known()
    made = load("device", known[name][0], "a class that can be imported") if name in known else None
    target = getattr(made, "emulator", "")
    if not target:
        having = [each for each, (where, _) in known.items() if _has_emulator(where)]
        raise InvalidParameter(
            "NAME", name, f"one with an emulator: {', '.join(having)} (a driver names its own in `emulator`)"
        )
    kind = load("emulator", target, "a class that can be imported")
    given = registry.options(device, kind, behind)
    scene = make_scene("free", dof=kind.dof)
    simulated = SimulatedDevice(
        operator(params, scene),
        mass=params.device.mass,
        damping=params.device.own_damping,
        force_limit=kind.force_limit,
        substeps=params.device.substeps,
    )
    emulator: Emulator = kind(Handle(simulated, kind.watchdog_s), time.monotonic_ns, **given)
    return emulator


def _has_emulator(target: str) -> bool:
    try:
        return bool(getattr(load("device", target, ""), "emulator", ""))
    except InvalidParameter:
        return False


@contextmanager
def _signals_to(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """The signals that end a program go to `handler` meanwhile."""
    before: dict[signal.Signals, Any] = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            before[number] = signal.signal(number, handler)
        yield
    finally:
        for caught, earlier in before.items():
            if earlier is not None:  # None: it was not set by Python, which cannot set it again
                signal.signal(caught, earlier)
