"""A tool among solids: (13) and the environment's account for any step, and statics beside formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.plant.poses.contacts import ToolContacts
from hapnet.plant.poses.mass import ToolMass
from hapnet.plant.poses.tool import Tool, box, peg
from hapnet.plant.worlds.hole import Hole
from hapnet.plant.worlds.rigid_contacts import Solid
from hapnet.plant.worlds.shapes import HalfSpace, Sphere

HOME: Vector = (0.0,) * AXES
K, B, M = 500.0, 14.0, 0.02


def mass_among(tool: Tool, *solids: Solid) -> ToolMass:
    mass = ToolMass(ToolContacts(tool, solids, ARM_M), M, B, K, HOME)
    mass.adopt(mass.contacts)
    return mass


def spring_J(x: Vector, y: Vector) -> float:
    return 0.5 * K * float(np.sum((np.array(x) - np.array(y)) ** 2))


def wandering(rng: np.random.Generator, rubbish: float) -> Vector:
    """A set-position: near home, or one of no sense."""
    if rng.random() < rubbish:
        return poses.coordinates(rng.normal(0.0, 0.03, 3), rng.normal(size=4))
    q = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)).as_quat()
    return poses.coordinates(rng.normal(0.0, 0.02, 3), (q[3], *q[:3]))


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize(("shortest", "longest"), [(1e-3, 1e-3), (0.01, 0.05), (0.1, 0.1)])
def test_every_step_obeys_13_and_the_solids_give_nothing(friction: float, shortest: float, longest: float) -> None:
    """A fifth of the set-positions are rubbish orientations."""
    rng = np.random.default_rng(7)
    solids = (
        Solid(HalfSpace((0.0, 0.0, -1.0), 0.025), 3000.0, 10.0, friction),
        Solid(Sphere((0.06, 0.0, 0.0), 0.02), 3000.0, 10.0, friction),
    )
    touched = 0
    for _ in range(4):
        mass = mass_among(box((0.06, 0.04, 0.02)), *solids)
        stored, y = 0.0, HOME
        for k in range(80 if longest > 1e-3 else 400):
            y = wandering(rng, 0.2) if k % (4 if longest > 1e-3 else 40) == 0 else y
            before = mass.kinetic_J + spring_J(mass.position, y)
            dt = float(rng.uniform(shortest, longest))
            step = mass.step(dt, y, mass.contacts)
            after = mass.kinetic_J + spring_J(mass.position, y)
            assert step.work_J - step.dissipated_J == pytest.approx(after - before, abs=2e-15 + 1e-15 * before)
            assert step.work_J == pytest.approx(dt * float(np.dot(step.force, step.velocity)), abs=1e-9)
            stored -= step.work_J
            assert stored - mass.contacts.stored_J(mass.position) >= -1e-15
            touched += any(step.force)
    assert touched > 60


def test_a_box_on_a_table_rests_where_its_energy_is_least() -> None:
    """Four corners on a plane, pushed down off its middle and tilted: scipy's minimum of the same potentials."""
    tool, level, stiffness = box((0.06, 0.04, 0.02)), 0.03, 3000.0
    mass = mass_among(tool, Solid(HalfSpace((0.0, 0.0, -1.0), level), stiffness, 10.0))
    q = Rotation.from_rotvec([0.05, 0.08, 0.1]).as_quat()
    y = poses.coordinates((0.004, 0.0, -0.035), (q[3], *q[:3]))
    for _ in range(400):
        mass.step(0.02, y, mass.contacts)

    def energy(z: Array) -> float:
        turn = Rotation.from_rotvec(z[3:])
        q = turn.as_quat()
        x = poses.coordinates(z[:3], (q[3], *q[:3]))
        deep = np.maximum(0.0, -level - (turn.apply(tool.points)[:, 2] + z[2]))
        return 1e4 * (spring_J(x, y) + 0.5 * stiffness * float(deep @ deep))

    least = minimize(energy, [0.004, 0.0, -0.025, 0.0, 0.0, 0.1], method="BFGS", options={"gtol": 1e-9})
    found = poses.pose(mass.position)
    assert found.position == pytest.approx(least.x[:3], abs=2e-6)
    turn = Rotation.from_quat([*found.quaternion[1:], found.quaternion[0]]) * Rotation.from_rotvec(least.x[3:]).inv()
    assert turn.magnitude() < 1e-4


def test_planes_of_a_pose_say_how_deep_a_rigid_motion_leads() -> None:
    """A plane in the coordinates, to first order: its depth, and its stiffness along any rigid motion."""
    rng = np.random.default_rng(8)
    tool = box((0.06, 0.04, 0.02))
    contacts = ToolContacts(tool, [Solid(HalfSpace((0.0, 0.0, -1.0), 0.012), 3000.0, 10.0)], ARM_M)
    x = np.array(HOME)
    planes = contacts.planes(HOME, 0.01)
    assert len(planes) == 4
    for plane in planes:
        size = np.sqrt(plane.stiffness / 3000.0)
        assert plane.depth(HOME) * size == pytest.approx(-0.002)
        point = min(tool.points, key=lambda a: abs(_depth_of(a, plane.normal, x) - plane.depth(HOME)))
        assert point[2] < 0.0
    for _ in range(20):
        small = 1e-5
        q = Rotation.from_rotvec(small * rng.normal(size=3)).as_quat()
        moved = poses.coordinates(small * rng.normal(size=3), (q[3], *q[:3]))
        true = sorted(-0.012 - contacts.place_of(moved, point)[2] for point in tool.points)[4:]
        said = sorted(plane.depth(moved) * np.sqrt(plane.stiffness / 3000.0) for plane in planes)
        assert said == pytest.approx(true, abs=2e-8)


def _depth_of(point: Vector, normal: Vector, x: Array) -> float:
    return -0.012 - point[2]


def test_a_hole_is_what_its_peg_says() -> None:
    """Distances to plane, side and chamfer by hand, and gradients by differences."""
    hole = Hole((0.0, 0.0, -0.02), (0.0, 0.0, -1.0), 0.005, 0.001)
    for place, distance in {
        (0.0, 0.0, 0.0): 0.02,  # above the mouth: in front of the plane
        (0.03, 0.0, -0.021): -0.001,
        (0.004, 0.0, -0.03): 0.001,
        (0.0, -0.0052, -0.03): -0.0002,
        (0.0055, 0.0, -0.0202): 0.0003 / np.sqrt(2.0),
    }.items():
        assert hole.near(place).distance_m == pytest.approx(distance, abs=1e-12), place
    rng = np.random.default_rng(9)
    for _ in range(200):
        p = rng.uniform((-0.01, -0.01, -0.03), (0.01, 0.01, -0.018))
        gradient = [
            (hole.near(tuple(p + 1e-7 * e)).distance_m - hole.near(tuple(p - 1e-7 * e)).distance_m) / 2e-7
            for e in np.eye(3)
        ]
        if np.linalg.norm(gradient) > 0.999:  # else an edge lies between
            assert hole.near(tuple(p)).gradient == pytest.approx(gradient, abs=1e-6)


def test_a_peg_in_its_hole_is_held_across_and_free_along() -> None:
    mass = mass_among(peg(0.005, 0.03), Solid(Hole((0.0, 0.0, -0.016), (0.0, 0.0, -1.0), 0.0052, 0.001)))
    for k in range(200):
        y = poses.coordinates((0.0, 0.0, -0.02 * min(1.0, k / 100)), (1.0, 0.0, 0.0, 0.0))
        step = mass.step(0.02, y, mass.contacts)
    assert mass.position[2] == pytest.approx(-0.02, abs=1e-6)
    assert np.abs(step.force).max() < 1e-6
    for _ in range(200):
        step = mass.step(0.02, poses.coordinates((0.004, 0.0, -0.02), (1.0, 0.0, 0.0, 0.0)), mass.contacts)
    assert 0.0002 < mass.position[0] < 0.0008
    assert -2.2 < step.force[0] < -1.6


def test_a_start_inside_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="no point of the tool is inside"):
        mass_among(box((0.06, 0.04, 0.02)), Solid(HalfSpace((0.0, 0.0, -1.0), 0.009)))
