"""`hapnet devices` lists the drivers; `hapnet emulate` stands in for a device, with a simulated hand on its handle."""

from __future__ import annotations

import signal
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import ParamsOptions
from hapnet.errors import InvalidParameter
from hapnet.loading import extension, failure, load
from hapnet.params import Params
from netem.groups import Without

if TYPE_CHECKING:
    from hapnet.ext.devices.emulator import Emulator


def devices(json_to: flags.Json = None) -> int:
    from hapnet.devices import registry

    words = output.console(json_to)
    rows = []
    for name, (target, package) in registry.known().items():
        row = _row(name, target, package)
        rows.append(row)
        words.print(f"{name:<10} {row['about']}", markup=False)
        state = f"missing: {row['missing']}" if row["missing"] else f"found: {', '.join(row['found']) or 'none'}"
        words.print(f"{'':<10} {row['tested']}; {row['from']}; {state}", style="dim", markup=False)
    if rules := [rule for row in rows if (rule := row["udev"])]:
        words.print(
            "without these udev rules (/etc/udev/rules.d/70-hapnet.rules) only root may open some:", markup=False
        )
        for rule in rules:
            words.print(f"  {rule}", style="dim", markup=False)
    words.print("simulated arms: --device omni, or arm:FILE.urdf?tip=LINK", markup=False)
    words.print("your own: --device module:Class, or a package with the entry point hapnet.devices")
    output.write_json(rows, json_to)
    return 0


def _row(name: str, target: str, package: str) -> dict[str, Any]:
    row: dict[str, Any] = {"name": name, "about": "", "tested": "untested", "from": package, "missing": "", "found": []}
    row["udev"] = ""

    try:
        made = load("device", target, "a class that can be imported")
        row["about"], row["tested"] = getattr(made, "about", ""), getattr(made, "tested", "untested")
        row["udev"] = getattr(made, "udev", "")
        row["missing"] = made.missing() if hasattr(made, "missing") else ""
        if not row["missing"] and hasattr(made, "found"):
            row["found"] = list(made.found())
    except BaseException as error:  # another package's driver may raise anything: see `loading.failure`
        row["missing"] = failure(error)
    return row


def emulate(
    *,
    device: Annotated[
        str, typer.Argument(metavar="NAME[:OPTIONS]", help="A device of `hapnet devices`, such as serial:noise=0.01.")
    ],
    operator: flags.Operator = None,
    duration: Annotated[float, typer.Option(help="Seconds; 0: until Ctrl-C.")] = 0.0,
    params: Annotated[ParamsOptions, Without("show_params", "schema")],
    json_to: flags.Json = None,
) -> int:
    """It says how to reach it, and at its end how much energy its actuators gave to the hand."""
    from hapnet import checks
    from hapnet.processes.system import handled

    name, _, _ = device.partition(":")
    checks.non_negative("--duration", duration)
    emulator = make_emulator(device, params.over(Params(), {"operator": operator}))
    words = output.console(json_to)
    words.print(f"emulates {name}: hapnet run --device {name}:{emulator.address}", markup=False)
    stop, caught = threading.Event(), []

    def on_signal(number: int, _: object) -> None:
        caught.append(number)
        stop.set()

    with handled(on_signal):
        if duration > 0.0:
            timer = threading.Timer(duration, stop.set)
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

    Raises InvalidParameter: the device has no emulator, or not these options.
    """
    from hapnet.assembly.choices import choosing
    from hapnet.assembly.operators import operator
    from hapnet.assembly.units import scene_units
    from hapnet.devices import registry
    from hapnet.ext.arms.device import SimulatedArm
    from hapnet.ext.devices.emulator import ArmHandle, EmulatedHandle
    from hapnet.plant.device import SimulatedDevice
    from hapnet.plant.worlds.registry import make_scene
    from hapnet.records.machine_code import no_compiler

    name, _, behind = device.partition(":")
    known = registry.known()
    made = load("device", known[name][0], "a class that can be imported") if name in known else None
    target = getattr(made, "emulator", "")
    if not target:
        having = [each for each, (where, _) in known.items() if _has_emulator(where)]
        allowed = f"one with an emulator: {', '.join(having)} (a driver names its own in `emulator`)"
        raise InvalidParameter("device", name, allowed, () if name in known else having)
    kind = load("emulator", target, "a class that can be imported")
    given = registry.options(device, kind, behind)
    if (table := kind.arm(given)) is not None:
        scene = make_scene("joints", dof=len(table.joints))
        hand = operator(choosing(params, partial(scene_units, scene=scene)), scene)
        arm = SimulatedArm(table, hand, substeps=1, compensated=False, by_joints=True)
        if no_compiler() is None:
            arm = extension("compiled ends").CompiledDevices().simulated(arm)
        hanging: Emulator = kind(ArmHandle(arm), time.monotonic_ns, **given)
        return hanging
    scene = make_scene("free", dof=kind.dof)
    simulated = SimulatedDevice(
        operator(params, scene),
        mass=params.device.mass,
        damping=params.device.own_damping,
        force_limit=kind.force_limit,
        substeps=params.device.substeps,
    )
    emulator: Emulator = kind(EmulatedHandle(simulated, kind.watchdog_s), time.monotonic_ns, **given)
    return emulator


def _has_emulator(target: str) -> bool:
    try:
        return bool(getattr(load("device", target, ""), "emulator", ""))
    except InvalidParameter:
        return False
