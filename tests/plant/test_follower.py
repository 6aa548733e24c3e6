"""A robot in the virtual mass's place: scaling, start, feedback, and what its environment's account says."""

import math
from pathlib import Path

import numpy as np
import pytest

from hapnet import simulate
from hapnet.assembly.build import prepare
from hapnet.assembly.choices import choosing
from hapnet.assembly.follower import follower_of
from hapnet.checks import Array, Vector
from hapnet.couplings.set_position import servo_of
from hapnet.errors import InvalidParameter
from hapnet.ext.robots.follower import Mechanics, Robot
from hapnet.ext.robots.robot_scene import LeadersPicture, RobotContacts
from hapnet.mechanics.contacts import Step, Surroundings
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES, angle_between, rotation, torques
from hapnet.params import as_params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.picture import Touch
from hapnet.plant.worlds.walls import Contacts, Wall
from hapnet.simulation.result import Result
from tests.conftest import mostly_slow
from tests.support.own_motion import largest_step

LINK = {"link.up": "delay 30ms 5ms loss 5%", "link.down": "delay 30ms 5ms loss 5%"}
FOLLOWS = {"follower.robot": "simulated", "duration_s": 2.0, **LINK}


def run(changes: dict[str, object], seed: int = 3) -> Result:
    return simulate({**FOLLOWS, "device.servo": "sampled", **changes}, seed)


@pytest.mark.parametrize("rendering", mostly_slow(["paper", "hapnet"], 1))
@pytest.mark.parametrize(("a", "b"), mostly_slow([(2.0, 0.5), (0.2, 3.0), (4.0, 4.0)], 1))
def test_a_scaled_robot_is_another_robot_in_the_leaders_units(rendering: str, a: float, b: float) -> None:
    """x = x_r/a and F = b F_r make of M x_r'' = F_r the equation of a robot with a b M, and so on for all it has."""
    own = {"mass": 0.08, "own_damping": 0.4, "force_limit_N": 8.0, "step_limit_N": 0.4, "greatest_speed": 1.0}
    wall = {"stiffness": 2000.0, "damping": 8.0, "position_m": 0.02 * a}
    spring = {"stiffness": 400.0, "damping": 11.0}
    scaled = run(
        {f"follower.{name}": value for name, value in own.items()}
        | {f"world.wall.{name}": value for name, value in wall.items()}
        | {f"world.{name}": value for name, value in spring.items()}
        | {"follower.motion_scale": a, "follower.force_scale": b, "world.step_limit_N": 25.0, "rendering": rendering}
    )
    plain = run({
        "rendering": rendering,
        "follower.mass": a * b * own["mass"],
        "follower.own_damping": a * b * own["own_damping"],
        "follower.force_limit_N": b * own["force_limit_N"],
        "follower.step_limit_N": b * own["step_limit_N"],
        "follower.greatest_speed": own["greatest_speed"] / a,
        "world.wall.stiffness": a * b * wall["stiffness"],
        "world.wall.damping": a * b * wall["damping"],
        "world.wall.position_m": wall["position_m"] / a,
        "world.stiffness": a * b * spring["stiffness"],
        "world.damping": a * b * spring["damping"],
        "world.step_limit_N": b * 25.0,
    })  # fmt: skip
    for name in ("position_m", "reservoir_J", "margin_J"):
        np.testing.assert_allclose(scaled.recording.device[name], plain.recording.device[name], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(scaled.recording.world[name], plain.recording.world[name], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("a", "b"), [(1.0, 1.0), (0.3, 2.0)])
def test_without_damping_the_robots_environment_keeps_what_it_gets(a: float, b: float) -> None:
    """Its port is the actuator's: a mass without damping among nothing stores all that its motor does."""
    changes = {"follower.own_damping": 0.0, "follower.motion_scale": a, "follower.force_scale": b}
    result = run({**changes, "scene": "free", "operator": "hand-21"})
    world = result.world
    assert world.environment is not None
    account = world.environment
    put_in = result.world.mass.port_J(0.0)
    assert account.stored_J > 0.0
    assert account.stored_J - account.start_J == pytest.approx(-put_in, abs=1e-14)


@pytest.mark.parametrize(
    ("watchdog_s", "servo_hz", "found"), [(0.02, 1000.0, 0.02), (0.02, 50.0, 0.04), (0.0, 50.0, 0.0)]
)
def test_a_slow_robots_watchdog_waits_for_two_of_its_ticks(watchdog_s: float, servo_hz: float, found: float) -> None:
    params = as_params({"device.watchdog_s": watchdog_s, "follower.servo_hz": servo_hz})
    assert servo_of(params).watchdog_s == found


def test_both_begin_in_the_same_place_wherever_they_stand() -> None:
    """The hand begins at 30 mm, the robot at its origin: what it follows is the motion since then."""
    changes = {"scene": "free", "operator": "press", "operator_model.start_m": 0.03, "operator_model.goal_m": 0.05}
    here, origin = run(changes), run({**changes, "follower.start": "origin"})
    for result, jump in ((here, 0.002), (origin, 0.02)):
        world = result.recording.world
        gap = np.abs(world["position_m"][:20] - 0.03).max()
        assert (gap < jump) == (jump == 0.002)
    force, place = (origin.recording.world[name] for name in ("coupling_force_N", "position_m"))
    assert largest_step(force[1:], place[:-1], 500.0) <= 0.5 + 1e-9  # a tick records where its motion has ended
    assert abs(here.world.mass.body.position[0] - (here.recording.device["position_m"][-1][0] - 0.03)) < 0.004


def test_force_feedback_renders_the_force_on_the_robot() -> None:
    """Half a second into a held press: the leader's spring gives what the wall gives, to the share of the dampers."""
    changes = {"scene": "wall", "rendering": "paper", "follower.feedback": "force", "duration_s": 2.4}
    result = run({**changes, "link.up": "delay 5ms", "link.down": "delay 5ms", "operator_model.goal_m": 0.03})
    wall, felt = result.recording.world["contact_force_N"][-200:, 0], result.recording.device["force_N"][-40:, 0]
    assert wall.mean() < -0.3
    assert felt.mean() == pytest.approx(wall.mean(), rel=0.03)


def test_planes_near_a_scaled_robot_are_where_it_meets_them() -> None:
    frame = Frame(2.0, 0.5, (0.01, 0.0))
    wall = frame.plane(Plane((1.0, 0.0), 0.05, 3000.0, 10.0, 0.2))
    assert wall.depth(frame.coupled((0.05, 0.3))) == pytest.approx(0.0, abs=1e-15)
    assert (wall.stiffness, wall.damping, wall.velocity_mps) == (3000.0, 10.0, 0.1)


def test_a_robots_contacts_are_drawn_from_where_it_truly_is() -> None:
    contacts = Contacts((Wall((1.0,), 0.02, 3000.0, 10.0),), 1)
    body = PassiveIntegrator(0.1, 1.0, 100.0, (0.0,))
    body.set_contacts(contacts)
    frame = Frame(0.5, 3.0, (0.0,))
    robot = Robot(body, contacts, frame, Mechanics(), resolution=1e-3, held=True, engine=False, here=False)
    around = RobotContacts(robot, sees=True)
    work = 0.0
    for _ in range(300):
        before = body.position[0]
        robot.push(1e-3, 0.0, (1.5,), around)
        work += 1.5 / frame.force * (body.position[0] - before)
        assert robot.position[0] * 0.5 == pytest.approx(round(body.position[0] / 1e-3) * 1e-3, abs=1e-12)
    assert body.position[0] > 0.02
    assert robot.port_J(0.0) == pytest.approx(-frame.energy * work, rel=1e-12)
    own = contacts.stored_J(body.position) + body.kinetic_J
    assert around.stored_J((0.0,)) == pytest.approx(6.0 * own, rel=1e-12)


TIP = (0.0, 0.0, -0.04)
"""Of a stick of 80 mm [m]."""

LEANS = (0.3, 0.0, -math.sqrt(1.0 - 0.3**2))
"""The normal into a floor that leans, so that it turns a stick."""


@pytest.mark.parametrize(
    ("feedback", "a", "b"),
    mostly_slow([("planes", 3.0, 2.0), ("force", 0.5, 1.0), ("planes", 0.5, 1.0)], 1, 2),
)
def test_a_wall_that_a_scaled_tool_touches_is_felt_with_b_and_its_torque_with_b_over_a(
    feedback: str, a: float, b: float
) -> None:
    """A press that is held: the robot's force and torque by geometry, from how deep its tip is in 3000 N/m.

    With planes the device renders what the robot's spring holds if that is K/ab in N/m, and (a/b) 2 K l^2 in Nm/rad.
    """
    K = 100.0
    spring = (K / (a * b), 2.0 * ARM_M**2 * K * a / b) if feedback == "planes" else 500.0
    result = run({
        "scene": f"tool:stick + plane?normal={LEANS[0]},0,{LEANS[2]}&at=0,0,{-40.0 - 10.0 * a}mm", "duration_s": 3.0,
        "follower.servo_hz": 500.0,
        "follower.motion_scale": a, "follower.force_scale": b, "follower.feedback": feedback, "device.stiffness": K,
        "operator": "press", "operator_model.goal_m": 0.02, "operator_model.turn_rad": 0.0,
        "operator_model.hold_s": 5.0,
        "world.stiffness": spring, "link.up": "delay 5ms", "link.down": "delay 5ms",
    })  # fmt: skip
    own = result.world.mass.body.position
    lever = rotation(own) @ TIP
    depth = np.dot(LEANS, np.array(own[:3]) + lever - (0.0, 0.0, -0.04 - 0.01 * a))
    force = -3000.0 * depth * np.array(LEANS)
    assert np.linalg.norm(force) > 0.1
    x, felt = result.recording.device["position_m"][-1], result.recording.device["force_N"][-1]
    np.testing.assert_allclose(felt[:3], b * force, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(torques(x, felt), b / a * np.cross(lever, force), rtol=0.02, atol=1e-4)
    world = result.recording.world
    x, of_wall, of_motor = (world[name][-1] for name in ("position_m", "contact_force_N", "coupling_force_N"))
    np.testing.assert_allclose(torques(x, of_wall), b / a * np.cross(lever, force), rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(torques(x, of_motor), -torques(x, of_wall), rtol=0.01, atol=1e-5)


@pytest.mark.parametrize("a", [1.0, 0.1, 3.0])
def test_a_wall_that_a_turn_reaches_is_told_as_early_to_a_scaled_tool(a: float) -> None:
    """Beside a tip at 40 mm, 8 mm away: a turn of 0.2 rad meets it, whatever a is. Unscaled it is told within 10 mm."""
    scene = "tool:stick + plane?normal=1,0,0&at=8mm,0,0"
    given = {**FOLLOWS, "scene": scene, "follower.feedback": "planes", "follower.motion_scale": a}
    world = prepare(as_params(given), "sampled").scene
    world.proxy(0.1, 10.0, 100.0)
    assert world.contacts.planes((0.0,) * AXES, 0.01)


@pytest.mark.parametrize("a", mostly_slow([5.0, 0.1, 0.5], 1, 2))
def test_a_tool_goes_a_times_as_far_as_its_leader_and_turns_as_it_does(a: float) -> None:
    changes = {"scene": "tool:box", "operator": "press", "operator_model.hold_s": 5.0, "duration_s": 2.5}
    result = run({**changes, "follower.motion_scale": a, "follower.start": "origin"})
    device, world = result.recording.device["position_m"], result.recording.world["position_m"]
    own = result.world.mass.body.position
    assert own[:3] == pytest.approx(a * device[-1, :3], abs=a * 1e-4)
    assert angle_between(own, np.zeros(AXES)) > math.radians(1.0)
    assert angle_between(own, device[-1]) < math.radians(0.1)
    np.testing.assert_allclose(world[-1], [*(np.array(own[:3]) / a), *own[3:]], atol=1e-9)
    for name in ("set_position_m", "target_m"):
        assert angle_between(result.recording.world[name][-1], device[-1]) < math.radians(1.5)  # it leads
    half = len(world) // 2  # while it turns
    rate = np.gradient(world[:, 3:], result.recording.world["time_s"], axis=0)[half]
    np.testing.assert_allclose(result.recording.world["velocity_mps"][half, 3:], rate, atol=0.05 * np.abs(rate).max())


def test_the_scene_of_a_scaled_robot_is_drawn_as_its_leader_has_it() -> None:
    """Half as large, where b is 3: a box of 20 mm is one of 40 mm, and a wall at 20 mm stands at 40 mm."""
    changes = {"follower.motion_scale": 0.5, "follower.force_scale": 3.0}
    walled = prepare(as_params({**FOLLOWS, **changes, "scene": "wall"})).scene
    assert [one.position_m for one in walled.surfaces] == pytest.approx([0.04])
    assert walled.stiffnesses == pytest.approx((4500.0,))
    assert [(one.offset, one.stiffness, one.damping) for one in walled.walls] == [pytest.approx((0.04, 4500.0, 15.0))]
    walled.proxy(0.045, 1.0, 100.0).place((0.01,))  # the robot is at 0, so a wall at 20 mm is 40 mm from its leader
    assert [one.position_m for one in walled.surfaces] == pytest.approx([0.05])
    assert [one.offset for one in walled.walls] == pytest.approx([0.05])
    scene = prepare(as_params({**FOLLOWS, **changes, "scene": "tool:box + sphere?at=0,0,-60mm&radius=15mm"})).scene
    mass = scene.proxy(0.045, 1.0, 100.0)
    mass.place((0.01, 0.0, 0.0, *(0.0,) * 9))
    picture = scene.picture()
    tool, ball = picture.parts
    assert np.ptp(tool.vertices[:, 0]) == pytest.approx(0.08)
    assert ball.vertices.mean(axis=0) == pytest.approx((0.01, 0.0, -0.12), abs=2e-3)
    assert np.linalg.norm(ball.vertices - (0.01, 0.0, -0.12), axis=1) == pytest.approx(0.03)
    assert picture.poses()[0] == pytest.approx((0.01, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))


class Soft:
    """A picture of one soft vertex, which its proxy touches."""

    parts = ()

    def poses(self) -> Array:
        return np.zeros((0, 7))

    def soft(self) -> Array:
        return np.array([[0.02, 0.0, 0.01]])

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        return [Touch((position[0], 0.0, 0.01), (0.0, 0.0, 1.0), 0.5, (force[0], 0.0, 0.0))]


def test_what_a_scaled_robot_touches_is_drawn_in_its_leaders_units() -> None:
    picture = LeadersPicture(Soft(), Frame(0.5, 3.0, (0.01, 0.0)))
    np.testing.assert_allclose(picture.soft(), [[0.02, 0.0, 0.02]])
    (touch,) = picture.touches((0.03, 0.0), (6.0, 0.0))
    assert touch.point == pytest.approx((0.03, 0.0, 0.02))
    assert touch.force_N == pytest.approx((6.0, 0.0, 0.0))
    assert picture.poses().shape == (0, 7)


@pytest.mark.parametrize(("a", "b"), [(0.5, 1.0), (3.0, 2.0)])
def test_the_leader_knows_a_scaled_tools_spring(a: float, b: float) -> None:
    """a b K' along the point's coordinates, b/a K' along those of the arms: where K' is 400 N/m, and 600 there."""
    turning = 2.0 * ARM_M**2 * 600.0
    scales = {"follower.motion_scale": a, "follower.force_scale": b, "world.stiffness": (400.0, turning)}
    params = prepare(as_params({**FOLLOWS, **scales, "scene": "tool:box"})).params
    along = [400.0 * a * b] * 3 + [600.0 * b / a] * 9
    np.testing.assert_allclose(choosing(params, *follower_of(params).on_link).world.stiffness, np.diag(along))
    plain = params.set({"follower.motion_scale": 1.0, "follower.force_scale": 1.0})
    assert choosing(plain, *follower_of(plain).on_link).world.stiffness == plain.world.stiffness


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"scene": "tool:box + plane", "follower.servo": "continuous"}, "follower.servo"),
        ({"coupling": "wave", "follower.servo": "sampled"}, "follower.servo"),
        ({"follower.servo": "continuous", "follower.resolution_m": 1e-5}, "follower.resolution_m"),
        ({"follower.servo": "continuous", "follower.feedback": "force"}, "follower.feedback"),
        ({"rendering": "paper", "follower.feedback": "planes"}, "follower.feedback"),
    ],
)
def test_what_does_not_fit_a_robot_is_named(changes: dict[str, object], name: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        simulate({"follower.robot": "simulated", **changes})
    assert caught.value.name == name


@pytest.mark.slow
def test_an_arm_leads_its_twin_joint_by_joint() -> None:
    """Axes in radians, and a follower of 4.5e-4 kg m^2 a joint."""
    result = run({"scene": "joints", "hardware": "omni?axes=joints", "operator": "sine", "duration_s": 3.0})
    summary = result.summary
    assert summary["units"] == "rad"
    assert summary["verdict"]["passive"]
    assert (summary["motion"]["free_rms_m"] or 1.0) < 0.015  # of a sine of 0.3 rad
    for part in (summary["device"], summary["world"]):
        assert (part["ledger"]["slack_J"] or 0.0) >= -1e-12


ARM = """
<mujoco model="arm">
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body name="upper">
      <joint type="hinge" axis="0 1 0" damping="0.02"/>
      <joint type="hinge" axis="0 0 1" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.134 0 0" size="0.01" mass="0.08"/>
      <body name="fore" pos="0.134 0 0">
        <joint type="hinge" axis="0 1 0" damping="0.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.1325" size="0.01" mass="0.06"/>
        <body name="tip" pos="0 0 0.1325"><geom type="sphere" size="0.008" mass="0.02"/></body>
      </body>
    </body>
    <geom type="plane" pos="0.16 0 0" zaxis="-1 0 0" size="1 1 0.1"/>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("scales", [(2.0, 0.5), pytest.param((1.0, 1.0), marks=pytest.mark.slow)])
def test_an_arm_of_an_engine_follows_by_its_tip(scales: tuple[float, float], tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM, "utf-8")
    result = run({
        "scene": f"mujoco:{tmp_path / 'arm.xml'}?proxy=tip", "operator": "hand-21", "duration_s": 4.0,
        "world.stiffness": 200.0, "world.damping": 4.0, "follower.own_damping": 1.0,
        "follower.motion_scale": scales[0], "follower.force_scale": scales[1],
    })  # fmt: skip
    summary = result.summary
    world, device = summary["world"], summary["device"]
    assert summary["verdict"]["passive"]
    assert min(world["ledger"]["slack_J"] or 0.0, device["ledger"]["slack_J"] or 0.0) >= -1e-12
    own = summary["environment"]["env_slack_J"]
    assert own >= -1e-12
    assert (summary["motion"]["free_rms_m"] or 1.0) < 0.01


class Weak(PassiveIntegrator):
    """An engine's body whose motor does 3 mJ over a centimetre, whatever is asked of it."""

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings) -> Step:
        self.x[0] += 0.01
        return Step((0.01 / dt,), (0.0,), -0.003, 0.0, push, (self.x[0],), 0.0)


def test_the_mean_force_of_an_engines_robot_did_its_work_and_its_environment_opposes_it() -> None:
    contacts = Contacts((), 1)
    robot = Robot(
        Weak(0.1, 1.0, 100.0, (0.0,)),
        contacts,
        Frame(1.0, 1.0, (0.0,)),
        Mechanics(),
        0.0,
        held=True,
        engine=True,
        here=False,
    )
    done = robot.push(0.1, 0.0, (0.5,), contacts)
    assert done.coupling_force == pytest.approx((0.3,))
    assert done.force == pytest.approx((-0.3,))
    assert robot.done_J == pytest.approx(-0.003)


def test_an_engine_is_no_robot_of_a_law_that_acts_within_its_step(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM, "utf-8")
    with pytest.raises(InvalidParameter, match=r"follower\.servo is 'continuous'"):
        run({"scene": f"mujoco:{tmp_path / 'arm.xml'}?proxy=tip", "follower.servo": "continuous"})
