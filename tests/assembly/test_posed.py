"""Devices of three axes that turn, as devices of a pose."""

import numpy as np
import pytest

from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.tools.posed import Posed
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.params import DeviceParams

QUARTER = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


class Stylus:
    """Turns, and gives no torque."""

    force_limit = 3.0
    resolution = 0.0
    workspace = (0.1, 0.1, 0.1)

    def __init__(self, dof: int) -> None:
        self.dof, self.turned, self.held = dof, (1.0, 0.0, 0.0, 0.0), (0.0,) * dof

    def read(self) -> tuple[Vector, Vector]:
        return (0.01, 0.02, 0.03), (0.1, 0.0, 0.0)

    def orientation(self) -> Vector:
        return self.turned

    def apply(self, force: Vector) -> Vector:
        self.held = force
        return force


class Handle(Stylus):
    """Gives torque too, but at most 50 mNm about an axis."""

    def apply_wrench(self, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        self.held, self.torque = force, tuple(np.clip(torque, -0.05, 0.05).tolist())
        return force, self.torque


class Straight:
    """Does not turn."""

    force_limit, resolution, closed = 3.0, 0.0, 0

    def __init__(self, dof: int) -> None:
        self.dof = dof

    def read(self) -> tuple[Vector, Vector]:
        return (0.0,) * self.dof, (0.0,) * self.dof

    def apply(self, force: Vector) -> None:
        return None

    def close(self) -> None:
        Straight.closed += 1


def test_a_turn_is_seen_in_the_coordinates_and_their_velocity() -> None:
    times, stylus = iter([0.0, 0.001]), Stylus(3)
    device = Posed(stylus, "stylus", lambda: next(times))
    x, v = device.read()
    assert x == (0.01, 0.02, 0.03, *(0.0,) * 9)
    assert v == (0.1, *(0.0,) * 11)
    stylus.turned = (np.cos(0.001), 0.0, 0.0, np.sin(0.001))
    x, v = device.read()
    assert poses.pose(x).quaternion == pytest.approx(stylus.turned, abs=1e-12)
    assert v[4] == pytest.approx(ARM_M * 2.0, rel=1e-5)  # the arm along x moves along y with 2 rad/s


def test_a_device_without_torque_is_asked_for_none_and_the_account_gets_none() -> None:
    device = UserDevice("tests.assembly.test_posed:Stylus", AXES, DeviceParams(), "pose")
    f = tuple(np.random.default_rng(1).normal(0.0, 0.3, AXES).tolist())
    permitted = device.limiter(DeviceParams(force_ramp_s=0.0)).permit(0.001, f, ())
    assert permitted == (*f[:3], *(0.0,) * 9)
    assert device.apply(permitted) == permitted


def test_a_device_with_torque_says_what_it_applied() -> None:
    made = Handle(3)
    made.turned = QUARTER
    device = Posed(made, "handle")
    x, _ = device.read()
    applied = device.apply(poses.along_coordinates(x, (1.0, 0.0, 0.0), (0.0, 0.02, 0.3), ARM_M))
    assert applied is not None
    assert made.torque == pytest.approx((0.0, 0.02, 0.05))
    force, torque = poses.wrench(x, applied)
    assert force == pytest.approx((1.0, 0.0, 0.0))
    assert torque == pytest.approx((0.0, 0.02, 0.05))


def test_the_work_of_a_torque_held_in_the_worlds_axes() -> None:
    """Counted along the coordinates it is off by angle^2/6: tau . axis sin(angle) for tau . axis angle."""
    rng = np.random.default_rng(2)
    for angle in (5e-3, 0.05):
        axis, torque = rng.normal(size=3), rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        x = poses.coordinates((0, 0, 0), rng.normal(size=4))
        turn = _rotated(x, angle * axis)
        counted = float(np.dot(poses.along_coordinates(x, (0, 0, 0), torque.tolist(), ARM_M), turn - np.array(x)))
        true = angle * float(torque @ axis)
        assert counted - true == pytest.approx(-true * angle**2 / 6.0, rel=1e-2, abs=1e-14)


def _rotated(x: Vector, by: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    q = (Rotation.from_rotvec(by) * Rotation.from_matrix(poses.rotation(x))).as_quat()
    return np.array(poses.coordinates(x[:3], (q[3], *q[:3])))


@pytest.mark.parametrize(
    ("declared", "point"),
    [(0.1, (0.1,) * 3), (np.float64(0.1), (0.1,) * 3), ((0.1,), (0.1,) * 3), ((0.1, 0.2, 0.3), (0.1, 0.2, 0.3))],
)
def test_a_workspace_may_be_a_number_or_three(declared: object, point: Vector, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ends of the arms, 40 mm long, are at most 80 mm from home."""
    monkeypatch.setattr(Stylus, "workspace", declared)
    device = UserDevice("tests.assembly.test_posed:Stylus", AXES, DeviceParams(), "pose")
    reach = device.device.workspace
    assert reach[:3] == point
    assert len(reach) == AXES
    assert min(reach[3:]) >= 2.0 * ARM_M


def test_a_workspace_that_is_known_later_is_the_present_one() -> None:
    stylus = Stylus(3)
    device = Posed(stylus, "stylus")
    stylus.workspace = (0.05, 0.05, 0.05)
    assert device.workspace[:3] == (0.05, 0.05, 0.05)
    stylus.workspace = None  # type: ignore[assignment]
    assert device.workspace is None


def test_a_device_that_does_not_turn_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="a device that turns"):
        UserDevice("tests.assembly.test_posed:Straight", AXES, DeviceParams(), "pose")
    assert Straight.closed == 1
