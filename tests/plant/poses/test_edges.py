"""Edges of solids and balls at the faces of a tool: where none of the tool's points is near."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapnet.checks import Vector
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.device import turned
from hapnet.ext.tools.edges import edge_points, points_of
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.tool import Tool, box, peg, place
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES

HOME: Vector = (0.0,) * AXES
K, STIFF = 500.0, 3000.0
PLATE = box((0.06, 0.04, 0.02))


def settled(tool: Tool, shape: Shape, y: Vector, count: int = 300) -> ToolMass:
    mass = ToolMass(ToolContacts(tool, [Solid(shape, STIFF, 10.0)], ARM_M), 0.02, 14.0, K, HOME)
    for _ in range(count):
        mass.step(0.02, y, mass.contacts)
    return mass


@pytest.mark.parametrize(
    ("shape", "count"),
    [
        (Cuboid((0.0, 0.0, 0.1), (0.01, 0.02, 0.03)), 8 + 4 * (1 + 3 + 5)),
        (Cylinder((0.0, 0.0, 0.0), 0.01, 0.02, 1), 48),
        (Hole((0.01, 0.0, -0.02), (0.0, 0.0, -1.0), 0.005, 0.001), 48),
        (HalfSpace((0.0, 0.0, -1.0), 0.1), 0),
    ],
)
def test_points_lie_on_edges(shape: Shape, count: int) -> None:
    found = points_of(shape)
    assert len(found) == len(set(found)) == count
    for at in found:
        assert shape.near(at).distance_m == pytest.approx(0.0, abs=1e-12)
        around = [shape.near(tuple(np.add(at, side).tolist())) for side in 1e-6 * np.vstack([np.eye(3), -np.eye(3)])]
        assert np.ptp([one.gradient for one in around], axis=0).max() > 0.5, at  # faces meet there


def test_a_plate_rests_on_a_ball_under_its_middle() -> None:
    """Two springs in a row. A corner or an edge is pressed by the ball as often as a face: once."""
    low = poses.coordinates((0.0, 0.0, -0.001), (1.0, 0.0, 0.0, 0.0))
    for x in (0.0, 0.02, 0.03):
        contacts = ToolContacts(PLATE, [Solid(Sphere((x, 0.5 * x, -0.03), 0.02), STIFF, 10.0)], ARM_M)
        (found,) = contacts.within(low, 0.0)
        assert found[0] == pytest.approx(-0.001, abs=1e-12)
    mass = settled(PLATE, Sphere((0.0, 0.0, -0.035), 0.02), poses.coordinates((0.0, 0.0, -0.015), (1.0, 0.0, 0.0, 0.0)))
    assert -0.005 - mass.position[2] == pytest.approx(0.01 * K / (K + STIFF), rel=1e-6)


@pytest.mark.long
def test_a_plate_rests_on_a_ridge_between_its_corners() -> None:
    """A ridge of 10 mm: its edge's points under the plate, of 8 parts of 120 mm, are two on each side."""
    ridge = Cuboid((0.0, 0.0, -0.035), (0.01, 0.12, 0.04))
    mass = settled(PLATE, ridge, poses.coordinates((0.0, 0.0, -0.015), (1.0, 0.0, 0.0, 0.0)))
    under = [at for at in points_of(ridge) if abs(at[1]) < 0.02 and at[2] > -0.02]
    assert -0.005 - mass.position[2] == pytest.approx(0.01 * K / (K + len(under) * STIFF), rel=1e-6)
    assert len(under) >= 6


@pytest.mark.long
def test_a_peg_leans_on_the_rim() -> None:
    """Its deepest points say how far: 25 mm deep with 0.2 mm of play on each side it may tilt by 0.9 degrees, and by
    what four contacts yield. With its own points alone it would go through the rim, to 2.5 degrees."""
    tool, tilt = peg(0.005, 0.03), 0.05
    hole = Hole((0.0, 0.0, -0.02), (0.0, 0.0, -1.0), 0.0052)
    deep = turned((0.0, 0.0, -0.03), (0.0, 0.0, 0.0))
    angles = {}
    for closed in (True, False):
        one = Tool("peg", tool.points, tool.size, round=True, closed=closed)
        mass = ToolMass(ToolContacts(one, [Solid(hole, STIFF, 10.0)], ARM_M), 0.02, 14.0, K, HOME)
        for k in range(100):
            mass.step(0.02, turned((0.0, 0.0, -0.0003 * k), (0.0, 0.0, 0.0)), mass.contacts)
        mass.step(0.02, deep, mass.contacts)
        for _ in range(150):
            mass.step(0.02, turned((0.0, 0.0, -0.03), (tilt, 0.0, 0.0)), mass.contacts)
        angles[closed] = np.degrees(poses.angle_between(mass.position, HOME))
    assert 0.9 < angles[True] < 1.9
    assert angles[False] > 2.3


def test_how_deep_an_edge_is_changes_as_its_plane_says() -> None:
    """For any small rigid motion of the tool, from any pose: the normal times the way of the tool's point."""
    rng = np.random.default_rng(5)
    shapes = (Cuboid((0.0, 0.0, -0.03), (0.01, 0.05, 0.02)), Sphere((0.03, 0.0, 0.0), 0.01))
    for tool in (PLATE, peg(0.02, 0.04)):
        edges = edge_points(tool, [Solid(shape, STIFF, 10.0) for shape in shapes], ARM_M)
        seen = 0
        for _ in range(30):
            x = turned(tuple(rng.normal(0.0, 0.01, 3).tolist()), tuple(rng.normal(0.0, 0.5, 3).tolist()))
            small, way = rng.normal(size=3) * 1e-6, rng.normal(size=3) * 1e-7
            q = poses.pose(x).quaternion
            after = (Rotation.from_rotvec(small) * Rotation.from_quat([*q[1:], q[0]])).as_quat()
            moved = poses.coordinates((np.array(x[:3]) + way).tolist(), (after[3], *after[:3]))
            for edge in edges:
                point, start = edge.begin(x)
                distance, gradient = edge.near(start)
                if abs(distance) > 0.008:
                    continue
                _, start_after = edge.begin(moved)
                told = float(np.dot(gradient, np.subtract(place(moved, point, ARM_M), start)))
                found = edge.near(start_after).distance_m
                seen += abs(found - distance - told) < 2e-11
                assert found - distance == pytest.approx(told, abs=5e-9)  # two faces may be as near
        assert seen > 300


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_edges_of_a_cylinder_are_its_two_rims(axis: int) -> None:
    centre = np.array((0.01, -0.02, 0.03))
    away = np.array(points_of(Cylinder(centre.tolist(), 0.02, 0.06, axis))) - centre
    lower, upper = away[: len(away) // 2], away[len(away) // 2 :]
    for rim, end in ((lower, -0.03), (upper, 0.03)):
        assert rim[:, axis] == pytest.approx(np.full(len(rim), end))
        assert np.linalg.norm(np.delete(rim, axis, axis=1), axis=1) == pytest.approx(np.full(len(rim), 0.02))
        sides = np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1)
        assert sides == pytest.approx(np.full(len(rim), 0.04 * np.sin(np.pi / len(rim))))
