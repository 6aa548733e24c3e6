"""Build the side of a real follower robot: a driver with the follower's servo, in the world's place."""

from __future__ import annotations

import dataclasses

from hapnet.assembly.build import Setup, drive, follower_servo
from hapnet.assembly.choices import choosing
from hapnet.assembly.fixture import Fixture
from hapnet.assembly.own_parts import closed_if_refused, named_section
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling
from hapnet.couplings.set_position import servo_of
from hapnet.errors import InvalidParameter
from hapnet.ext.robots.following import frame_of, held_warnings, require_contact_force
from hapnet.ext.robots.robot import RobotSide
from hapnet.params import DeviceParams
from hapnet.recording.samples import DeviceSample, Event, Sample, WorldSample
from hapnet.side.clutch import Clutch
from hapnet.side.contact_force import ContactForce
from hapnet.side.device import Clock, Write
from hapnet.side.endpoint import DeviceControl
from hapnet.units import within


def robot_side(setup: Setup, endpoint: DeviceControl, clock: Clock, write: Write) -> RobotSide:
    """The robot with its servo, for an endpoint or its control half; its samples are those of a world.

    Raises InvalidParameter, HapnetError: there is no such driver, it cannot be opened, or it does not fit the run.
    """
    params = setup.params
    robot = params.follower
    servo = dataclasses.replace(servo_of(params), self_test_N=0.0)
    try:
        device = UserDevice(robot.robot, setup.dof, servo, setup.units, setup.scene.jaw)
    except InvalidParameter as error:
        if error.name not in ("hardware", "device.servo_hz"):
            raise
        name = "follower.robot" if error.name == "hardware" else "follower.servo_hz"
        raise error.renamed(name, robot.robot) from error
    with closed_if_refused(device):
        return _following(device, servo, setup, endpoint, clock, write)


def _following(
    device: UserDevice, servo: DeviceParams, setup: Setup, endpoint: DeviceControl, clock: Clock, write: Write
) -> RobotSide:
    """Build the side from an open driver. servo : the parameters of its servo."""
    params = setup.params
    robot = params.follower
    if robot.fixtures:
        if setup.scene.contacts.planes(setup.scene.start, 0.0) is None:
            raise InvalidParameter(
                "follower.fixtures", "yes", "", why=f"the scene {params.scene} has no planes for fixtures"
            )
        device.device = Fixture(device.device, setup.scene.contacts)
    frame = frame_of(params, setup.scene)
    sensor: ContactForce | None = None
    if robot.feedback == "force" or setup.coupling.senses:
        require_contact_force(robot.robot, device, params.coupling if setup.coupling.senses else "")
        sensor = ContactForce(device.contact_force, setup.dof, robot.robot, clock, write)
    device.declared.check_stiffness("world.stiffness", params.world.stiffness, setup.dof, within(setup.units, "N/m"))
    device.check_damping("world.damping", params.world.damping)
    own = dataclasses.replace(device.declares(robot), own_damping=0.0)
    at_robot = dataclasses.replace(setup, params=dataclasses.replace(params, follower=own, device=servo))
    leads = dataclasses.replace(setup, params=dataclasses.replace(params, follower=own))

    if setup.coupling.guards:
        for common, params_in in ((False, leads.params), (True, choosing(leads.params, *setup.follower.seen))):
            for warning in held_warnings(servo_of(params_in), setup.dof):
                if warning.startswith("world.ceiling_J") == common:  # joules are in the leader's units
                    write(Event(clock(), "warning", warning, "warning"))

    def hold(position: Vector, empty: bool) -> DeviceCoupling:
        servo = follower_servo(leads, position, empty)
        if servo.reporter is not None:
            servo.reporter.know_nothing()
        return servo

    with named_section("follower"):
        hold((0.0,) * setup.dof, False)
    period_s = 1.0 / robot.servo_hz
    nothing = (0.0,) * setup.dof
    follower = setup.follower
    endpoint.arms = follower.arms(params)
    endpoint.reindexing = follower.reindexing(params, setup.coupling, setup.scene)
    on_link = follower.writes_on_link(params, write, endpoint.reindexing)

    def record(sample: Sample) -> None:
        felt = nothing if sensor is None else frame.coupled_force(sensor.force)
        on_link(_as_world(sample, period_s, felt))

    side = RobotSide(
        endpoint, device, hold, drive(at_robot, clock, record), device.declared, device.limiter(servo), contact=sensor,
        releases=robot.on_stop == "release",
    )  # fmt: skip
    side.clutch = Clutch(frame, meets=robot.start == "here")
    return side


def _as_world(sample: Sample, step_s: float, felt: Vector) -> Sample:
    """Convert a sample of the robot to a world's. felt : its measured contact force [N]; 0 if it is not measured."""
    if not isinstance(sample, DeviceSample):
        return sample
    nothing = (0.0,) * len(sample.position_m)
    return WorldSample(
        time_ns=sample.time_ns, step_s=step_s, position_m=sample.position_m,
        velocity_mps=sample.velocity_mps or nothing, set_position_m=sample.set_position_m, target_m=sample.target_m,
        coupling_force_N=sample.force_N, contact_force_N=felt, penetration_m=0.0, reservoir_J=sample.reservoir_J,
        potential_J=sample.potential_J, sent_J=sample.sent_J, credited_J=sample.credited_J, margin_J=sample.margin_J,
        slack_J=sample.slack_J, age_s=sample.age_s, transit_s=sample.transit_s, bound_J=sample.bound_J,
        work_J=sample.work_J, stored_J=sample.stored_J, account_J=sample.account_J,
    )  # fmt: skip
