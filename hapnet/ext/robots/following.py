"""A robot in the virtual mass's place: what its parameters become, and which drivers measure its contact force."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.assembly.device_class import load_class, servo_rate
from hapnet.assembly.follower import Follower
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.couplings import held_torque
from hapnet.couplings.rendering import largest
from hapnet.couplings.set_position import servo_of
from hapnet.couplings.spec import CouplingSpec
from hapnet.devices.driver import Driver
from hapnet.devices.registry import known
from hapnet.errors import DeviceSilent, InvalidParameter
from hapnet.ext.engines.engine_world import EngineMass
from hapnet.ext.robots.follower import Robot, RobotScene
from hapnet.mechanics.contacts import Mass
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.pose_frame import Arms, PoseFrame
from hapnet.param_sources import DEVICE, RULE
from hapnet.params import DeviceParams, Params, is_real_robot
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.protocol import World
from hapnet.recording.samples import WorldSample
from hapnet.side.device import Write
from hapnet.side.reindexing import Reindexing
from hapnet.units import POSE, POSE_AXES


class RobotFollower(Follower):
    """A robot follows: simulated, or a driver's."""

    def place(self, params: Params, spec: CouplingSpec[Any], scene: World) -> tuple[Params, World]:
        robot = params.follower
        if robot.servo == "sampled" and spec.follower is None:
            allowed = f"continuous with the coupling {params.coupling}: it is not known how it holds a force there"
            raise InvalidParameter("follower.servo", robot.servo, allowed)
        held = self.is_held(params, spec)
        if scene.moves_proxy and not held:
            raise InvalidParameter(
                "follower.servo", robot.servo, f"sampled in the scene {params.scene}, with pspm or zoh"
            )
        if scene.units == POSE and not held:
            allowed = f"sampled in the scene {params.scene}, with pspm or zoh: a tool is moved by a held force"
            raise InvalidParameter("follower.servo", robot.servo, allowed)
        if robot.resolution_m and not held:
            raise InvalidParameter("follower.resolution_m", robot.resolution_m, "0 with a continuous servo")
        if robot.feedback == "force" and not held:
            raise InvalidParameter("follower.feedback", robot.feedback, "position or planes with a continuous servo")
        if robot.feedback == "planes" and not spec.staged(params):
            allowed = "position or force: without the stages of rendering hapnet no planes are sent"
            raise InvalidParameter("follower.feedback", robot.feedback, allowed)
        if robot.fixtures and not is_real_robot(params):
            raise InvalidParameter("follower.fixtures", robot.fixtures, "no with a robot that meets the scene itself")
        if is_real_robot(params):
            if not held:
                allowed = (
                    f"simulated with the coupling {params.coupling} and a continuous servo: a driver holds its force"
                )
                raise InvalidParameter("follower.robot", robot.robot, allowed)
            if robot.feedback == "planes":
                allowed = "position or force with a robot whose surroundings nobody knows"
                raise InvalidParameter("follower.feedback", robot.feedback, allowed)
            if robot.feedback == "force":
                if scene.units == POSE:
                    allowed = f"position in the scene {params.scene}: no driver says which torque its tool meets"
                    raise InvalidParameter("follower.feedback", robot.feedback, allowed)
                require_contact_force(robot.robot)
            at_most = robot.servo_hz
            with suppress(InvalidParameter):  # the driver may be on the other host only
                at_most = servo_rate(params.set({"hardware": robot.robot, "device.servo_hz": robot.servo_hz}))
            if at_most < robot.servo_hz:
                params.require("follower.servo_hz", at_most, f"at most {at_most:g}, as the robot {robot.robot}")
                params = params.set({"follower.servo_hz": at_most}, DEVICE)
        period_s = 1.0 / params.follower.servo_hz
        steps = dict.fromkeys(("world.step_min_s", "world.step_max_s"), period_s)
        for name in steps:
            params.require(
                name, period_s, f"left out with a follower: its steps are those of its servo, {period_s:g} s"
            )
        params = params.set(steps, RULE)

        def made(damping: ArrayLike, stiffness: ArrayLike) -> Robot:
            body: Mass | None = scene.proxy(robot.mass, damping, stiffness)
            if body is None:
                body = PassiveIntegrator(robot.mass, damping, stiffness, scene.start)
            engine = isinstance(body, EngineMass)  # it knows its own damping
            return Robot(
                body,
                scene.contacts,
                frame_of(params, scene.units, scene.dof),
                robot.own_damping if held and not engine else 0.0,
                robot.resolution_m,
                held=held,
                engine=engine,
                here=robot.start == "here",
            )

        frame = frame_of(params, scene.units, scene.dof)
        return params, RobotScene(scene, made, period_s, frame, sees=robot.feedback == "planes")

    def warnings(self, params: Params, spec: CouplingSpec[Any], dof: int) -> list[str]:
        if not self.is_held(params, spec) or not spec.limited or is_real_robot(params):
            return []
        return [one for one in held_warnings(servo_of(params), dof) if one.startswith("world.damping")]

    def is_held(self, params: Params, spec: CouplingSpec[Any]) -> bool:
        return params.follower.servo != "continuous" and spec.follower is not None

    def seen(self, params: Params) -> Params:
        robot, world = params.follower, params.world
        a, b = robot.motion_scale, robot.force_scale
        if a == b == 1.0:
            return params
        return params.set({
            "world.stiffness": _times(a * b, world.stiffness),
            "world.damping": _times(a * b, world.damping),
            "world.step_limit_N": b * world.step_limit_N,
            "follower.mass": a * b * robot.mass,
            "follower.own_damping": a * b * robot.own_damping,
            "follower.resolution_m": robot.resolution_m / a,
            "follower.force_limit_N": b * robot.force_limit_N,
            "follower.step_limit_N": b * robot.step_limit_N,
            "follower.greatest_speed": robot.greatest_speed / a,
        })  # fmt: skip

    def on_link(self, params: Params) -> Params:
        found, arms = self.seen(params), self.arms(params)
        if arms is None:
            return found
        K = checks.spd("world.stiffness", found.world.stiffness, POSE_AXES)
        for _ in range(2):  # rows, then columns
            K = np.array([arms.force(tuple(row)) for row in K.T.tolist()])
        return found.set({"world.stiffness": K.tolist()})

    def arms(self, params: Params) -> Arms | None:
        a = params.follower.motion_scale
        return Arms(a) if params.units == POSE and a != 1.0 else None

    def meets_here(self, params: Params) -> bool:
        return params.follower.start == "here"

    def leaders_stiffness(self, params: Params, dof: int) -> Vector:
        K, arms = (largest(params.device.stiffness),) * dof, self.arms(params)
        return K if arms is None else arms.back.force(arms.back.force(K))

    def writes_on_link(self, params: Params, write: Write, moved: Reindexing | None = None) -> Write:
        arms = self.arms(params)
        if arms is None and moved is None:
            return write

        def changed(sample: Any) -> None:
            if moved is not None:
                sample = moved.recorded(sample)
            if arms is not None and isinstance(sample, WorldSample):
                sample = sample.moved(arms.place, arms.place, arms.force)
            write(sample)

        return changed


ROBOT = RobotFollower()


def frame_of(params: Params, units: str, dof: int) -> Frame:
    """The frame of a robot of these parameters, before it meets its leader."""
    robot = params.follower
    if units == POSE:
        return PoseFrame(robot.motion_scale, robot.force_scale)
    return Frame(robot.motion_scale, robot.force_scale, (0.0,) * dof)


def held_warnings(servo: DeviceParams, dof: int) -> list[str]:
    """`hapnet.couplings.held_torque.check` of a robot's servo, in the words of its parameters."""
    found = held_torque.check(servo, "measured", dof)
    return [one.replace("device.", "world.").replace("this device", "this robot") for one in found]


def _times(factor: float, value: ArrayLike) -> Any:
    return (factor * np.asarray(value, dtype=float)).tolist()


def require_contact_force(hardware: str, device: UserDevice | None = None) -> None:
    """Raise InvalidParameter if this driver measures no contact force.

    device : the open driver, of which a reading must have a force; None: it is not open yet. Then only its class can be
    asked, and nothing is known of a function that makes drivers, or of a driver on the other host.
    """
    if device is not None:
        measured = _measures(device)
    else:
        try:
            measured = _may_measure(hardware)
        except InvalidParameter:
            return
    if not measured:
        have = ", ".join(filter(_named, known()))
        allowed = f"position with {hardware}, which measures no contact force: contact_force() is for that ({have})"
        raise InvalidParameter("follower.feedback", "force", allowed)


def _measures(device: UserDevice) -> bool:
    with suppress(DeviceSilent):
        device.read()
    return device.contact_force() is not None


def _may_measure(hardware: str) -> bool:
    made = load_class(hardware)
    made = made.func if isinstance(made, partial) else made
    return not isinstance(made, type) or getattr(made, "contact_force", None) not in (None, Driver.contact_force)


def _named(hardware: str) -> bool:
    with suppress(InvalidParameter):
        return _may_measure(hardware)
    return False
