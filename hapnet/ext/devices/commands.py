"""`hapnet devices` lists the drivers; `hapnet emulate` emulates a device, with a simulated hand on its handle."""

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

    console = output.console(json_to)
    rows = []
    for name, (target, package) in registry.known().items():
        row = _row(name, target, package)
        rows.append(row)
        console.print(f"{name:<10} {row['about']}", markup=False)
        state = f"found: {', '.join(row['found'])}" if row["found"] else "none found"
        if row["missing"]:
            state = f"{'needs' if row['about'] else 'its driver cannot be loaded:'} {row['missing']}"
        whose = "" if row["from"] == "hapnet" else f"; from the package {row['from']}"
        console.print(f"{'':<10} {row['tested']}{whose}; {state}", style="dim", markup=False)
    if rules := dict.fromkeys(rule for row in rows for rule in row["udev"].splitlines()):
        console.print(
            "to open some of them without being root, put these rules into /etc/udev/rules.d/70-hapnet.rules:",
            markup=False,
        )
        for rule in rules:
            console.print(f"  {rule}", style="dim", markup=False)
    console.print("simulated arms: --device omni, or arm:FILE.urdf?tip=LINK", markup=False)
    console.print("your own driver: --device module:Class, or a package with the entry point hapnet.devices")
    output.write_json(rows, json_to)
    return 0


def _row(name: str, target: str, package: str) -> dict[str, Any]:
    row: dict[str, Any] = {"name": name, "about": "", "tested": "untested", "from": package, "missing": "", "found": []}
    row["udev"] = ""

    try:
        driver = load("device", target, "a class that can be imported")
        row["about"], row["tested"] = getattr(driver, "about", ""), getattr(driver, "tested", "untested")
        row["udev"] = getattr(driver, "udev", "")
        row["missing"] = driver.missing() if hasattr(driver, "missing") else ""
        if not row["missing"] and hasattr(driver, "found"):
            row["found"] = list(driver.found())
    except BaseException as error:  # a driver of another package may raise any exception: see `loading.failure`
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
    """Emulate a device. The output is its address, and at the end the energy that its actuators gave to the hand."""
    from hapnet import checks
    from hapnet.processes.system import handled

    name, _, _ = device.partition(":")
    checks.non_negative("--duration", duration)
    emulator = make_emulator(device, params.over(Params(), {"operator": operator}))
    console = output.console(json_to)
    console.print(f"emulates {name}: hapnet run --device {name}:{emulator.address}", markup=False)
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
    console.print(
        f"{handle.commands} commands; the watchdog acted {handle.released} times; the actuators gave at most "
        f"{handle.most_given_J * 1e3:.3f} mJ, and at the end {handle.work_J * 1e3:.3f} mJ"
    )
    result = {
        "commands": handle.commands, "released": handle.released, "most_given_J": handle.most_given_J,
        "given_J": handle.work_J,
    }  # fmt: skip
    output.write_json(result, json_to)
    return 0 if not caught or caught[0] == signal.SIGTERM else 128 + caught[0]


def make_emulator(device: str, params: Params) -> Emulator:
    """The emulator of a device, with the simulated hand of `params` on its handle.

    Raises InvalidParameter: the device has no emulator, or the emulator lacks an option.
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
    driver = load("device", known[name][0], "a class that can be imported") if name in known else None
    target = getattr(driver, "emulator", "")
    if not target:
        with_emulator = [each for each, (where, _) in known.items() if _has_emulator(where)]
        allowed = f"one with an emulator: {', '.join(with_emulator)} (a driver names its emulator in `emulator`)"
        raise InvalidParameter("device", name, allowed, () if name in known else with_emulator)
    emulator_class = load("emulator", target, "a class that can be imported")
    options = registry.options(device, emulator_class, behind)
    if (table := emulator_class.arm(options)) is not None:
        scene = make_scene("joints", dof=len(table.free))
        hand = operator(choosing(params, partial(scene_units, scene=scene)), scene)
        arm = SimulatedArm(table, hand, substeps=1, compensated=False, by_joints=True)
        if no_compiler() is None:
            arm = extension("compiled ends").CompiledDevices().simulated(arm)
        hanging: Emulator = emulator_class(ArmHandle(arm), time.monotonic_ns, **options)
        return hanging
    scene = make_scene("free", dof=emulator_class.dof)
    simulated = SimulatedDevice(
        operator(params, scene),
        mass=params.device.mass,
        damping=params.device.own_damping,
        force_limit=emulator_class.force_limit,
        substeps=params.device.substeps,
    )
    emulator: Emulator = emulator_class(
        EmulatedHandle(simulated, emulator_class.watchdog_s), time.monotonic_ns, **options
    )
    return emulator


def _has_emulator(target: str) -> bool:
    try:
        return bool(getattr(load("device", target, ""), "emulator", ""))
    except InvalidParameter:
        return False
