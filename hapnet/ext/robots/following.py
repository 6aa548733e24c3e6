"""A robot in the virtual mass's place: its derived parameters, and the check that its driver measures contacts."""

from __future__ import annotations

import math
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.assembly.choices import Choice, Contribution, Refusal, refuse
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
from hapnet.ext.engines.engine_world import EngineMass, EngineWorld
from hapnet.ext.robots import following_positions
from hapnet.ext.robots.follower import Mechanics, Robot
from hapnet.ext.robots.robot_scene import RobotScene
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


def in_leaders_units(params: Params) -> Choice:
    """The robot's parameters in the leader's units, where these differ from its own."""
    robot, world = params.follower, params.world
    a, b = robot.motion_scale, robot.force_scale
    scaled = {
        "world.stiffness": _times(a * b, world.stiffness),
        "world.damping": _times(a * b, world.damping),
        "world.step_limit_N": b * world.step_limit_N,
        "follower.mass": a * b * robot.mass,
        "follower.own_damping": a * b * robot.own_damping,
        "follower.friction_N": b * robot.friction_N,
        "follower.resolution_m": robot.resolution_m / a,
        "follower.force_limit_N": b * robot.force_limit_N,
        "follower.step_limit_N": b * robot.step_limit_N,
        "follower.greatest_speed": robot.greatest_speed / a,
    }
    return Choice({} if a == b == 1.0 else scaled, DEVICE)


def spring_on_link(params: Params) -> Choice:
    """The spring of a tool along the coordinates of the link, where these differ from its servo's."""
    turned: dict[str, object] = {}
    if (arms := _arms(params)) is not None:
        K = checks.spd("world.stiffness", params.world.stiffness, POSE_AXES)
        for _ in range(2):  # rows, then columns
            K = np.array([arms.force(tuple(row)) for row in K.T.tolist()])
        turned["world.stiffness"] = K.tolist()
    return Choice(turned, DEVICE)


def _arms(params: Params) -> Arms | None:
    a = params.follower.motion_scale
    return Arms(a) if params.units == POSE and a != 1.0 else None


class RobotFollower(Follower):
    """A follower robot, simulated or with a driver."""

    seen = (in_leaders_units,)
    on_link = (in_leaders_units, spring_on_link)

    def warnings(self, params: Params, spec: CouplingSpec[Any], dof: int) -> list[str]:
        if not self.is_held(params, spec) or not spec.guards or is_real_robot(params):
            return []
        return [one for one in held_warnings(servo_of(params), dof) if one.startswith("world.damping")]

    def is_held(self, params: Params, spec: CouplingSpec[Any]) -> bool:
        return params.follower.servo != "continuous" and spec.follower is not None

    def is_driven(self, params: Params) -> bool:
        return is_real_robot(params)

    def arms(self, params: Params) -> Arms | None:
        return _arms(params)

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


def follower_of(params: Params) -> Follower:
    """The follower of these parameters: of forces, or of positions."""
    return following_positions.POSITIONS if following_positions.takes_positions(params) else ROBOT


def runs_in_virtual_time(params: Params) -> bool:
    """Whether the user's robot that follows is simulated, so that it needs no real time."""
    return following_positions.is_simulated(params)


def check(params: Params, spec: CouplingSpec[Any], scene: World) -> None:
    """Raise InvalidParameter for a parameter that does not fit a follower."""
    if following_positions.takes_positions(params):
        following_positions.check(params, spec, scene)
        return
    robot, is_posed, is_real = params.follower, scene.units == POSE, is_real_robot(params)
    held, given = ROBOT.is_held(params, spec), f"in the scene {params.scene}, with pspm or zoh"
    law = f"with the coupling {params.coupling}"

    def refusal(applies: bool, name: str, allowed: str) -> Refusal:
        return Refusal(applies, f"follower.{name}", getattr(robot, name), allowed)

    refuse((
        refusal(robot.servo == "sampled" and spec.follower is None, "servo",
               f"continuous {law}: this coupling cannot hold a force between ticks"),
        refusal(scene.moves_proxy and not held, "servo", f"sampled {given}"),
        refusal(is_posed and not held, "servo", f"sampled {given}: a tool is moved by a held force"),
        refusal(robot.resolution_m > 0.0 and not held, "resolution_m", "0 with a continuous servo"),
        refusal(robot.feedback == "force" and not held, "feedback", "position or planes with a continuous servo"),
        refusal(robot.feedback == "planes" and not spec.staged(params), "feedback",
               "position or force: without the stages of rendering hapnet no planes are sent"),
        refusal(robot.fixtures and not is_real, "fixtures", "no with a simulated robot, which meets the scene itself"),
        refusal(is_real and not held, "robot", f"simulated {law} and a continuous servo: a driver holds its force"),
        refusal(is_real and robot.feedback == "planes", "feedback",
               "position or force with a real robot, whose surroundings are not known"),
        refusal(robot.feedback != "position" and spec.between_robots, "feedback",
               f"left out {law}, which says itself what the leader feels"),
        refusal(is_posed and spec.between_robots, "robot",
               f"none in the scene {params.scene} {law}: its positions are no poses"),
        refusal(robot.friction_N > 0.0 and not held, "friction_N", "0 with a continuous servo"),
        refusal(robot.position_servo and not held, "position_servo", "no with a continuous servo"),
        refusal(robot.position_servo and not isinstance(params.world.stiffness, float), "position_servo",
               "no with a world.stiffness that is not a number"),
        refusal(is_real and robot.feedback == "force" and is_posed, "feedback",
               f"position in the scene {params.scene}: drivers measure no torque on their tool"),
    ))  # fmt: skip
    if is_real and (robot.feedback == "force" or spec.senses):
        require_contact_force(robot.robot, law=params.coupling if spec.senses else "")


def servo_hz(params: Params) -> Choice:
    """The rate of a driver's robot, where that is below the servo's. Raises InvalidParameter: more was set."""
    robot, at_most = params.follower, math.inf
    if is_real_robot(params) and not following_positions.takes_positions(params):
        with suppress(InvalidParameter):  # the driver may be on the other host only
            at_most = servo_rate(robot.robot, robot.servo_hz)
    if at_most >= robot.servo_hz:
        return Choice()
    params.require("follower.servo_hz", at_most, f"at most {at_most:g}, as the robot {robot.robot}")
    return Choice({"follower.servo_hz": at_most}, DEVICE)


def steps(params: Params) -> Choice:
    """The world's steps, which are the ticks of the robot's servo. Raises InvalidParameter: others were set."""
    if following_positions.takes_positions(params):
        return Choice()
    period_s = 1.0 / params.follower.servo_hz
    names = ("world.step_min_s", "world.step_max_s")
    for name in names:
        params.require(name, period_s, f"left out with a follower: its steps are those of its servo, {period_s:g} s")
    return Choice(dict.fromkeys(names, period_s), RULE)


def place(params: Params, spec: CouplingSpec[Any], scene: World) -> World:
    """The scene with the robot in it."""
    if following_positions.takes_positions(params):
        return following_positions.place(params, scene)
    robot, held = params.follower, ROBOT.is_held(params, spec)

    def made(scene: World, damping: ArrayLike, stiffness: ArrayLike) -> Robot:
        # a robot that turns a tool has its mass along all coordinates, as a handle has: its damping is held for a tick
        turns = scene.units == POSE and not isinstance(scene, EngineWorld)
        body: Mass | None = scene.proxy((robot.mass,) * scene.dof if turns else robot.mass, damping, stiffness)
        if body is None:
            body = PassiveIntegrator(robot.mass, damping, stiffness, scene.start)
        engine = isinstance(body, EngineMass)  # it has its own damping
        for name in ("friction_N", "position_servo"):
            if engine and getattr(robot, name):
                allowed = f"{'no' if name == 'position_servo' else 0} in the scene {params.scene}: a model has its own"
                raise InvalidParameter(f"follower.{name}", getattr(robot, name), allowed)
        return Robot(
            body,
            scene.contacts,
            frame_of(params, scene),
            mechanics(params) if held and not engine else Mechanics(),
            robot.resolution_m,
            held=held,
            engine=engine,
            here=robot.start == "here",
        )

    frame = frame_of(params, scene)
    return RobotScene(scene, made, 1.0 / robot.servo_hz, frame, sees=robot.feedback == "planes")


def mechanics(params: Params) -> Mechanics:
    """The friction and the position servo of the simulated robot of these parameters."""
    robot = params.follower
    servo = (largest(params.world.stiffness), largest(params.world.damping)) if robot.position_servo else (0.0, 0.0)
    return Mechanics(robot.own_damping, robot.friction_N, robot.mass, *servo)


CONTRIBUTION = Contribution(in_scene=(servo_hz, steps), check=check, place=place)


def frame_of(params: Params, scene: World) -> Frame:
    """The frame of a robot in this scene, before it meets its leader."""
    robot = params.follower
    if scene.units == POSE:
        return PoseFrame(robot.motion_scale, robot.force_scale)
    return Frame(robot.motion_scale, robot.force_scale, (0.0,) * scene.dof, scene.jaw)


def held_warnings(servo: DeviceParams, dof: int) -> list[str]:
    """The warnings of `hapnet.couplings.held_torque.check` on a robot's servo, with the names of its parameters."""
    warnings = held_torque.check(servo, "measured", dof)
    return [warning.replace("device.", "world.").replace("this device", "this robot") for warning in warnings]


def _times(factor: float, value: ArrayLike) -> Any:
    return (factor * np.asarray(value, dtype=float)).tolist()


def require_contact_force(hardware: str, device: UserDevice | None = None, law: str = "") -> None:
    """Raise InvalidParameter if this driver measures no contact force, which `law` or `follower.feedback` needs.

    device : the open driver, whose reading must have a force; None: it is not open yet. Then only its class is checked;
    a function that makes drivers, or a driver on the other host, passes.
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
        if law:
            allowed = (
                f"pp or pspm with {hardware}, which measures no contact force: contact_force() is for that ({have})"
            )
            raise InvalidParameter("coupling", law, allowed)
        allowed = f"position with {hardware}, which measures no contact force: contact_force() is for that ({have})"
        raise InvalidParameter("follower.feedback", "force", allowed)


def _measures(device: UserDevice) -> bool:
    with suppress(DeviceSilent):
        device.read()
    return device.contact_force() is not None


def _may_measure(hardware: str) -> bool:
    driver = load_class(hardware)
    driver = driver.func if isinstance(driver, partial) else driver
    return not isinstance(driver, type) or getattr(driver, "contact_force", None) not in (None, Driver.contact_force)


def _named(hardware: str) -> bool:
    with suppress(InvalidParameter):
        return _may_measure(hardware)
    return False
