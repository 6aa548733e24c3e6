"""A robot in the virtual mass's place: scaling, start, feedback, and what its environment's account says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hapnet import simulate
from hapnet.errors import InvalidParameter
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.plant.follower import Robot, RobotContacts
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Wall
from hapnet.simulation.result import Result

LINK = {"link.up": "delay 30ms 5ms loss 5%", "link.down": "delay 30ms 5ms loss 5%"}
FOLLOWS = {"follower.robot": "simulated", "duration_s": 2.0, **LINK}


def run(changes: dict[str, object], seed: int = 3) -> Result:
    return simulate({**FOLLOWS, "device.servo": "sampled", **changes}, seed)


@pytest.mark.parametrize("rendering", ["paper", "hapnet"])
@pytest.mark.parametrize(("a", "b"), [(2.0, 0.5), (0.2, 3.0), (4.0, 4.0)])
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


def test_both_begin_in_the_same_place_wherever_they_stand() -> None:
    """The hand begins at 30 mm, the robot at its origin: what it follows is the motion since then."""
    changes = {"scene": "free", "operator": "press", "operator_hand.start_m": 0.03, "operator_hand.goal_m": 0.05}
    here, origin = run(changes), run({**changes, "follower.start": "origin"})
    for result, jump in ((here, 0.002), (origin, 0.02)):
        world = result.recording.world
        gap = np.abs(world["position_m"][:20] - 0.03).max()
        assert (gap < jump) == (jump == 0.002)
    steps = np.diff(origin.recording.world["coupling_force_N"], axis=0)
    assert np.abs(steps).max() <= 0.5 + 1e-9
    assert abs(here.world.mass.body.position[0] - (here.recording.device["position_m"][-1][0] - 0.03)) < 0.004


def test_force_feedback_renders_the_force_on_the_robot() -> None:
    """Half a second into a held press: the leader's spring gives what the wall gives, to the share of the dampers."""
    changes = {"scene": "wall", "rendering": "paper", "follower.feedback": "force", "duration_s": 2.4}
    result = run({**changes, "link.up": "delay 5ms", "link.down": "delay 5ms", "operator_hand.goal_m": 0.03})
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
    body.adopt(contacts)
    frame = Frame(0.5, 3.0, (0.0,))
    robot = Robot(body, contacts, frame, damping=0.0, resolution=1e-3, held=True, engine=False, here=False)
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


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"scene": "tool:box + plane", "follower.servo": "continuous"}, "follower.servo"),
        ({"scene": "tool:box + plane", "follower.motion_scale": 2.0}, "follower.motion_scale"),
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


def test_an_arm_leads_its_twin_joint_by_joint() -> None:
    """Axes in radians, and a follower of 4.5e-4 kg m^2 a joint."""
    result = run({"scene": "joints", "hardware": "omni?axes=joints", "operator": "sine", "duration_s": 3.0})
    summary = result.summary
    assert summary["units"] == "rad"
    assert summary["verdict"]["passive"]
    assert (summary["motion"]["free_rms_m"] or 1.0) < 0.015  # of a sine of 0.3 rad
    for part in (summary["device"], summary["world"]):
        assert part is not None
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


@pytest.mark.parametrize("scales", [(1.0, 1.0), (2.0, 0.5)])
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
    assert world is not None
    assert device is not None
    assert summary["verdict"]["passive"]
    assert min(world["ledger"]["slack_J"] or 0.0, device["ledger"]["slack_J"] or 0.0) >= -1e-12
    own = summary["environment"]["env_slack_J"]
    assert own is not None
    assert own >= -1e-12
    assert (summary["motion"]["free_rms_m"] or 1.0) < 0.01


def test_an_engine_is_no_robot_of_a_law_that_acts_within_its_step(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM, "utf-8")
    with pytest.raises(InvalidParameter, match=r"follower\.servo is 'continuous'"):
        run({"scene": f"mujoco:{tmp_path / 'arm.xml'}?proxy=tip", "follower.servo": "continuous"})
