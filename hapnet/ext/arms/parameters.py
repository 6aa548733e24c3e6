"""Simulated arms by their names: ``omni``, and ``arm:FILE.urdf?tip=LINK&base=LINK&home=0,0.5,...``.

``&armature=`` is what the motors' rotors add to the joints' inertia, for all or for each [kg m^2].
With ``?axes=joints`` an arm is coupled joint by joint, in rad and Nm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hapnet import checks
from hapnet.assembly.choices import Choice, Contribution
from hapnet.assembly.own_parts import named_section
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.device import TIP_AXES, SimulatedArm, require_hinges
from hapnet.ext.arms.home import remarks
from hapnet.ext.arms.picture import ArmPicture, described
from hapnet.ext.arms.table import ArmTable, apparent_masses, at_home, felt_damping, omni
from hapnet.ext.arms.urdf import table_from
from hapnet.file_content import read_text
from hapnet.param_sources import DEVICE
from hapnet.params import Params, arm_file, is_arm, is_tool
from hapnet.plant.operator import Operator
from hapnet.records.machine_code import no_compiler
from hapnet.units import METRES, RADIANS

AXES = ("tip", "joints")
"""The choices of axes for hand and coupling: the tip in three axes in metres, or each joint in radians."""


def table_of(hardware: str) -> ArmTable:
    """The arm that `hardware` names.

    Raises InvalidParameter: there is none, or its file cannot be used.
    """
    given, file = _options(hardware), arm_file(hardware)
    if not file:
        return omni()
    try:
        text = read_text(file)
    except (OSError, UnicodeDecodeError) as error:
        why = f"{error.strerror}: {Path(file).absolute()}" if isinstance(error, OSError) else error
        raise InvalidParameter("hardware", hardware, f"a URDF file that can be read ({why})") from None
    home = checks.vector("home", given["home"].split(",")) if "home" in given else ()
    table = table_from(text, Path(file).name, given.get("tip", ""), given.get("base", ""), home)
    return _with_rotors(table, given["armature"]) if "armature" in given else table


def _with_rotors(table: ArmTable, armature: str) -> ArmTable:
    values, n = checks.vector("armature", armature.split(",")), len(table.free)
    if len(values) == 1:
        values *= n
    if len(values) != n:
        raise InvalidParameter(f"armature of {table.name}", armature, f"one number, or {n}, one for each joint")
    own = iter(values)
    joints = [replace(joint, armature=0.0 if joint.leader else next(own)) for joint in table.joints]
    return replace(table, joints=tuple(joints))


def by_joints(hardware: str) -> bool:
    """Whether `hardware` is an arm that is coupled joint by joint. Raises InvalidParameter: as `table_of`."""
    return is_arm(hardware) and _options(hardware).get("axes") == "joints"


def _options(hardware: str) -> dict[str, str]:
    """The options behind an arm's name. Raises InvalidParameter."""
    is_file = hardware.startswith("arm:")
    known = {"tip", "base", "home", "axes", "armature"} if is_file else {"axes"}
    parts = [part.partition("=")[::2] for part in hardware.partition("?")[2].split("&") if part]
    given = dict(parts)
    named = arm_file(hardware) if is_file else hardware.partition("?")[0] == "omni"
    if not named or len(given) < len(parts) or not given.keys() <= known or given.get("axes", "tip") not in AXES:
        words = "arm:FILE.urdf?tip=LINK, also &base=LINK, &home=RAD,RAD,..., &armature=KGM2, &axes=joints, each once"
        raise InvalidParameter("hardware", hardware, words if is_file else "omni, or omni?axes=joints")
    return given


def arm_values(params: Params) -> Choice:
    """An arm's axes, and its apparent mass and damping at home.

    Raises InvalidParameter: a parameter does not fit an arm.
    """
    if is_tool(params.scene):
        raise InvalidParameter("hardware", params.hardware, "simulated, or a device that turns, in a scene with a tool")
    table, device = table_of(params.hardware), params.device
    if by_joints(params.hardware):
        require_hinges(table)
        dof = len(table.free)
        own = {"mass": float(np.linalg.eigvalsh(at_home(table)[1])[0])}
        own["own_damping"] = min(joint.damping for joint in table.free)
    else:
        dof, own = TIP_AXES, {"mass": min(apparent_masses(table)), "own_damping": felt_damping(table)}
        if own["mass"] == math.inf:
            raise InvalidParameter("hardware", params.hardware, "a tip that moves: at home no joint moves this one")
    if params.dof not in (0, dof):
        raise InvalidParameter("dof", params.dof, f"0 or {dof} with the device {params.hardware}")
    for name, plain in (("servo", "sampled"), ("harvest", "measured")):
        if (value := getattr(device, name)) not in ("auto", plain):
            raise InvalidParameter(f"device.{name}", value, f"auto or {plain} with the device {params.hardware}")
    for name, value in own.items():
        params.require(f"device.{name}", value, f"left out with the device {params.hardware}: its links determine it")
    return Choice({"dof": dof, **{f"device.{name}": value for name, value in own.items()}}, DEVICE)


def unit_of(hardware: str) -> str:
    """The unit of the arm's axes. Raises InvalidParameter: as `table_of`."""
    return RADIANS if by_joints(hardware) else METRES


def description(params: Params) -> dict[str, Any]:
    """The arm's frames, for its picture."""
    return {"arm": described(table_of(params.hardware), by_joints(params.hardware))}


def simulated_arm(params: Params, hand: Operator) -> SimulatedArm:
    """The arm of these parameters in a hand. Raises InvalidParameter."""
    device = params.device
    with named_section("device"):
        return SimulatedArm(
            table_of(params.hardware), hand, period=1.0 / device.servo_hz, substeps=device.substeps,
            resolution=device.resolution_m, force_limit=device.force_limit_N or None,
            by_joints=by_joints(params.hardware),
        )  # fmt: skip


def warnings(params: Params) -> tuple[str, ...]:
    """Lines for the user on the arm's file and its home. Raises InvalidParameter: as `table_of`."""
    table = table_of(params.hardware)
    return table.remarks if by_joints(params.hardware) else table.remarks + remarks(table)


def real_time_warnings(params: Params) -> tuple[str, ...]:
    """Warnings for the user of an arm, shown before control starts."""
    why = no_compiler()
    if why is None or params.device.substeps == 1:
        return ()
    return (f"{why}: at 1 kHz an arm needs the extra fast, or --set device.substeps=1",)


def picture(meta: Mapping[str, Any]) -> ArmPicture | None:
    """The picture of the arm in a recording's description; None: there is no arm."""
    return ArmPicture.of(meta)


CONTRIBUTION = Contribution(before_scene=(arm_values,), sampled_only=True)
