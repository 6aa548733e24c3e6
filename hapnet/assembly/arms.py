"""Simulated arms by their names: ``omni``, and ``arm:FILE.urdf?tip=LINK&base=LINK&home=0,0.5,...``."""

from __future__ import annotations

import math
from pathlib import Path

from hapnet import checks
from hapnet.assembly.own_parts import named_section
from hapnet.errors import InvalidParameter
from hapnet.params import DeviceParams, Params, arm_file, is_arm
from hapnet.plant.arms.device import SimulatedArm
from hapnet.plant.arms.omni import omni
from hapnet.plant.arms.table import ArmTable, apparent_masses, felt_damping
from hapnet.plant.arms.urdf import table_from
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Operator
from hapnet.plant.poses.device import SimulatedHandle
from hapnet.plant.poses.scene import ToolScene
from hapnet.plant.worlds.protocol import World
from hapnet.records.machine_code import no_compiler

_DEFAULTS = DeviceParams()


def table_of(hardware: str) -> ArmTable:
    """The arm that `hardware` names.

    Raises InvalidParameter: there is none, or its file cannot be used.
    """
    name, _, behind = hardware.partition(":")
    if name == "omni":
        if behind:
            raise InvalidParameter("hardware", hardware, "omni, which takes no options")
        return omni()
    file, options = arm_file(hardware), behind.partition("?")[2]
    parts = [part.partition("=")[::2] for part in options.split("&") if part]
    given = dict(parts)
    if not file or len(given) < len(parts) or not given.keys() <= {"tip", "base", "home"}:
        raise InvalidParameter(
            "hardware", hardware, "arm:FILE.urdf?tip=LINK, also with &base=LINK and &home=RAD,RAD,..., each once"
        )
    try:
        text = Path(file).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = f"{error.strerror}: {Path(file).absolute()}" if isinstance(error, OSError) else error
        raise InvalidParameter("hardware", hardware, f"a URDF file that can be read ({why})") from None
    home = checks.vector("home", given["home"].split(",")) if "home" in given else ()
    return table_from(text, Path(file).name, given.get("tip", ""), given.get("base", ""), home)


def with_arm(params: Params) -> Params:
    """The parameters as an arm needs them, if the device is one: three axes, and what its tip weighs and damps at home.

    Raises InvalidParameter: a parameter does not go with an arm.
    """
    if not is_arm(params.hardware):
        return params
    table, device = table_of(params.hardware), params.device
    if params.dof not in (0, 3):
        raise InvalidParameter("dof", params.dof, f"0 or 3 with the device {params.hardware}")
    for name, plain in (("servo", "sampled"), ("harvest", "measured")):
        if (value := getattr(device, name)) not in ("auto", plain):
            raise InvalidParameter(f"device.{name}", value, f"auto or {plain} with the device {params.hardware}")
    own = {"mass": min(apparent_masses(table)), "own_damping": felt_damping(table)}
    if own["mass"] == math.inf:
        raise InvalidParameter("hardware", params.hardware, "a tip that moves: at home no joint moves this one")
    for name, value in own.items():
        if (given := getattr(device, name)) not in (getattr(_DEFAULTS, name), value):
            raise InvalidParameter(
                f"device.{name}", given, f"left out with the device {params.hardware}: its links have it"
            )
    return params.set({"dof": 3, **{f"device.{name}": value for name, value in own.items()}})


def simulated_device(params: Params, scene: World, hand: Operator) -> SimulatedDevice:
    """The simulated device of these parameters in a hand: a mass, an arm, or a handle that turns, as the scene's tool.

    Raises InvalidParameter.
    """
    device = params.device
    period, limit = 1.0 / device.servo_hz, device.force_limit_N or None
    if isinstance(scene, ToolScene) and not is_arm(params.hardware):
        return SimulatedHandle(
            hand, mass=device.mass, damping=device.own_damping, period=period, substeps=device.substeps,
            resolution=device.resolution_m, force_limit=limit, arm_m=scene.arm_m,
        )  # fmt: skip
    if not is_arm(params.hardware):
        return SimulatedDevice(
            hand, mass=device.mass, damping=device.own_damping, period=period, substeps=device.substeps,
            resolution=device.resolution_m, force_limit=limit,
        )  # fmt: skip
    with named_section("device"):
        return SimulatedArm(
            table_of(params.hardware), hand, period=period, substeps=device.substeps, resolution=device.resolution_m,
            force_limit=limit,
        )  # fmt: skip


def real_time_warnings(params: Params) -> tuple[str, ...]:
    """What the user of a device's side is told before control starts."""
    why = no_compiler()
    if why is None or not is_arm(params.hardware) or params.device.substeps == 1:
        return ()
    return (f"{why}: at 1 kHz an arm needs the extra fast, or --set device.substeps=1",)
