"""A tool of a driver that follows with scales: it goes a times as far, turns as its leader does, and is recorded so."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.control.coupling import PositionSample, ProxySample
from hapnet.devices.driver import Driver
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES, coordinates, pose
from hapnet.mechanics.pose_frame import Arms
from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.side.content import with_arms
from tests.conftest import mostly_slow
from tests.side.test_contact_force import Pair


class Tool(Driver):
    """45 g in the air that a force moves and a torque turns, with a sensor at its tip."""

    rate_hz = 1000.0
    force_limit, greatest_speed, workspace, smallest_mass = 10.0, 2.0, (1.0,) * 3, 0.045
    wall = 0.0

    def __init__(self, dof: int) -> None:
        self.dof, self.begun = dof, False
        self.x, self.v, self.w, self.force, self.torque = np.zeros((5, 3))
        self.q: Array = np.array([1.0, 0.0, 0.0, 0.0])

    def begin(self) -> None:
        self.begun = True

    def read(self) -> tuple[Vector, Vector]:
        if self.begun:
            self.v = self.v + 1e-3 * self.force / 0.045
            self.w = self.w + 1e-3 * self.torque / (2.0 * 0.045 * ARM_M**2)
            self.x = self.x + 1e-3 * self.v
            (w, *u), (p, *r) = self.q, (1.0, *(0.5e-3 * self.w))
            q = np.array([p * w - np.dot(r, u), *(p * np.array(u) + w * np.array(r) + np.cross(r, u))])
            self.q = q / np.linalg.norm(q)
        return tuple(self.x.tolist()), tuple(self.v.tolist())

    def orientation(self) -> Vector:
        return tuple(self.q.tolist())

    def apply(self, force: Vector) -> Vector:
        raise AssertionError("a driver with torque is asked for both")

    def apply_wrench(self, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        self.force, self.torque = np.array(force), np.array(torque)
        return force, torque

    def contact_force(self) -> Vector:
        return (1.0, 2.0, 3.0)


class ToolPair(Pair):
    def _take(self, sample: Any) -> None:
        match sample:
            case DeviceSample():
                self.device = sample
            case WorldSample():
                self.world = sample


@pytest.mark.parametrize(("a", "b"), mostly_slow([(0.3, 2.0), (3.0, 1.0), (1.0, 1.0)], 1))
@pytest.mark.slow
def test_a_drivers_tool_goes_a_times_as_far_and_turns_as_its_leader_does(a: float, b: float) -> None:
    pair = ToolPair(
        scene="tool:box", follower__robot="tests.side.test_scaled_tool:Tool", follower__feedback="position",
        follower__motion_scale=a, follower__force_scale=b, follower__start="origin", record_hz=1000.0,
    )  # fmt: skip
    pair.run(1500)
    tool: Any = pair.robot
    led = pose(pair.device.position_m)
    assert np.linalg.norm(led.position) > 0.005
    assert 2.0 * math.acos(led.quaternion[0]) > math.radians(1.0)
    assert tool._device.x == pytest.approx(a * np.array(led.position), abs=a * 5e-4)
    assert tool._device.q == pytest.approx(led.quaternion, abs=0.005)
    on_link = coordinates((tool._device.x / a).tolist(), tool._device.q.tolist())
    assert pair.world.position_m == pytest.approx(on_link, abs=1e-9)
    for side in (pair.leader, pair.follower):
        assert side.coupling.ledger.slack_min >= -1e-12
        assert side.coupling.ledger.margin_min >= 0.0


@pytest.mark.parametrize("a", [0.1, 5.0])
def test_no_plane_that_was_not_sent_is_within_the_reach_that_is_said(a: float) -> None:
    """Whatever its normal: a plane farther away than the reach, as the servo has it, is farther on the link too."""
    rng, nowhere = np.random.default_rng(1), (0.0,) * AXES
    reach_m = 0.02
    said = with_arms(Arms(a), ProxySample(nowhere, 0.0, nowhere, (), reach_m, None))
    assert type(said) is ProxySample
    for _ in range(50):
        normal = rng.normal(size=AXES) * rng.choice([0.0, 1.0], size=AXES)
        normal[rng.integers(AXES)] = 1.0
        plane = Plane(tuple((normal / np.linalg.norm(normal)).tolist()), reach_m * 1.001, 1000.0, 1.0)
        assert Arms(a).plane(plane).depth(nowhere) < -said.reach_m
    assert with_arms(Arms(a), PositionSample(nowhere, 0.5)) == PositionSample(nowhere, 0.5)
