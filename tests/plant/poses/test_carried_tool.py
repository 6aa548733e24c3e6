"""A tool is carried through free space only, and neither its spring nor its motion gains energy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapnet.checks import Array, Vector
from hapnet.ext.solids.rigid_contacts import SEARCHED_M, Solid
from hapnet.ext.solids.shapes import HalfSpace, Sphere
from hapnet.ext.tools.body import settle
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.tool import box
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow

K, B, M = 500.0, 14.0, 0.02
TABLE, BALL = HalfSpace((0.0, 0.0, -1.0), 0.025), Sphere((0.06, 0.0, 0.01), 0.02)
SIZE = (0.06, 0.04, 0.02)


def pose(at: Array, turn: Array) -> Vector:
    q = Rotation.from_rotvec(turn).as_quat()
    return poses.coordinates(at, (q[3], *q[:3]))


def distance(at: Array, turn: Array) -> float:
    """The box's distance from the table and the ball: corners above a plane, and a centre in the box's axes."""
    turned = Rotation.from_rotvec(turn)
    half = 0.5 * np.array(SIZE)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T * half
    above = (turned.apply(corners)[:, 2] + at[2] + 0.025).min()
    centre = turned.inv().apply(np.array(BALL.centre) - at)
    return float(min(above, np.linalg.norm(np.maximum(np.abs(centre) - half, 0.0)) - BALL.radius))


@pytest.mark.parametrize("poses", mostly_slow([30, 150], 1))
def test_a_tool_that_moves_by_less_than_the_clearance_touches_nothing(poses: int) -> None:
    """The tool moves along screws at random, as far as its coordinates' clearance allows."""
    rng = np.random.default_rng(21)
    contacts = ToolContacts(box(SIZE), [Solid(TABLE), Solid(BALL)], ARM_M)
    tried = 0
    for _ in range(poses):
        at, turn = rng.normal(0.0, 0.03, 3), rng.normal(0.0, 0.5, 3)
        x = np.array(pose(at, turn))
        clear, true = contacts.clearance(tuple(x.tolist())), distance(at, turn)
        if true <= 0.0:
            assert clear <= 1e-12
            continue
        tried += 1
        assert 0.7 * true < clear <= true + 1e-12  # a corner is 37 mm from the middle: sqrt(1 + 37^2/40^2) = 1.37
        for _ in range(10):
            along, about = rng.normal(size=3), rng.normal(size=3) / ARM_M
            least, most = 0.0, 1.0
            for _ in range(40):
                share = 0.5 * (least + most)
                end = at + share * along, (Rotation.from_rotvec(share * about) * Rotation.from_rotvec(turn)).as_rotvec()
                if np.linalg.norm(np.array(pose(*end)) - x) < clear:
                    least = share
                    assert distance(*end) > 0.0
                else:
                    most = share
    assert tried > poses // 3
    assert contacts.clearance(pose(np.array([0.0, 0.0, 5.0]), np.zeros(3))) == pytest.approx(SEARCHED_M)


def spinning() -> ToolMass:
    """A box in free space that moves and turns about no principal axis."""
    mass = ToolMass(ToolContacts(box(SIZE), [Solid(TABLE), Solid(BALL)], ARM_M), M, B, K, (0.0,) * AXES)
    mass.place(pose(np.array([0.0, 0.0, 0.08]), np.array([0.3, -0.2, 0.4])))
    mass.body.velocity[:], mass.body.spin[:] = (0.1, -0.05, 0.02), (2.0, -3.0, 1.0)
    settle(mass.body)
    return mass


def test_a_displaced_tool_keeps_its_energy_and_its_spin_in_its_own_axes() -> None:
    mass = spinning()
    end = pose(np.array([-0.03, 0.02, 0.1]), np.array([-0.4, 0.1, 0.9]))
    way = [b - a for a, b in zip(mass.position, end, strict=True)]
    kinetic, spin, velocity = mass.kinetic_J, list(mass.body.spin), mass.velocity[:3]
    assert mass.displace(way, 0.02, mass.contacts)
    assert mass.position == pytest.approx(end, abs=1e-15)
    assert mass.kinetic_J == kinetic
    assert (list(mass.body.spin), mass.velocity[:3]) == (spin, velocity)
    turned = Rotation.from_rotvec([-0.4, 0.1, 0.9])
    rods = np.cross(turned.apply(spin), ARM_M * turned.as_matrix().T)
    assert mass.velocity[3:] == pytest.approx(rods.ravel(), abs=1e-15)


def test_a_way_that_leads_to_no_pose_becomes_the_way_to_the_nearest() -> None:
    """The set-position moves by the same way, so it has to be the one that was done."""
    mass = spinning()
    begun = np.array(mass.position)
    way = [0.003, 0.001, 0.002, *np.random.default_rng(22).normal(0.0, 0.004, 9).tolist()]
    wanted = np.array(poses.nearest(begun + np.array(way)))
    assert mass.displace(way, 0.02, mass.contacts)
    assert np.array(mass.position) == pytest.approx(wanted, abs=1e-15)
    assert begun + np.array(way) == pytest.approx(wanted, abs=1e-15)


def test_a_tool_that_touches_or_would_touch_stays() -> None:
    mass = spinning()
    begun = mass.position
    into = [0.0, 0.0, -0.09, *[0.0] * 9]
    assert not mass.displace(into, 0.02, mass.contacts)
    assert (mass.position, into) == (begun, [0.0, 0.0, -0.09, *[0.0] * 9])
    for _ in range(60):
        step = mass.step(0.02, pose(np.array([0.0, 0.0, -0.03]), np.zeros(3)), mass.contacts)
    assert any(step.force)
    begun = mass.position
    assert not mass.displace([0.0, 0.0, 0.01, *[0.0] * 9], 0.02, mass.contacts)
    assert mass.position == begun


@pytest.mark.parametrize("tool", mostly_slow(["box", "peg"], 0))
def test_a_hand_that_turns_a_tool_in_the_air_is_not_dragged(tool: str) -> None:
    """The world's port has no work, its reservoir stays, and y is never modulated."""
    changes = {
        "scene": f"tool:{tool} + sphere?at=500mm,0,0", "operator": "hand-42", "link.up": "4g", "link.down": "4g",
        "duration_s": 3.0, "record_hz": 200.0,
    }  # fmt: skip
    result = simulate(changes, seed=6)
    world = result.recording.world
    assert np.ptp(world["position_m"], axis=0)[:3].max() > 0.02
    assert not np.any(world["contact_force_N"])
    assert np.abs(world["set_position_m"] - world["target_m"]).max() < 1e-9
    assert np.ptp(world["reservoir_J"]) < 1e-4
    assert result.summary["world"]["ledger"]["slack_J"] == pytest.approx(0.0, abs=1e-15)
    assert result.summary["verdict"]["passive"]
