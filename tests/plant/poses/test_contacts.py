"""A tool among solids: (13) and the environment's account for any step, and statics beside formulas."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from hapnet.checks import MOST_TOOL_PLANES, Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import HalfSpace, Shape, Sphere
from hapnet.ext.tools.contacts import ToolContacts, different
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.scene import ToolPicture, ToolScene, builder
from hapnet.ext.tools.tool import Tool, box, peg, place
from hapnet.mechanics import pose as poses
from hapnet.mechanics.contacts import doing
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES
from tests.conftest import mostly_slow

HOME: Vector = (0.0,) * AXES
K, B, M = 500.0, 14.0, 0.02


def mass_among(tool: Tool, *solids: Solid) -> ToolMass:
    mass = ToolMass(ToolContacts(tool, solids, ARM_M), M, B, K, HOME)
    mass.set_contacts(mass.contacts)
    return mass


def spring_J(x: Vector, y: Vector) -> float:
    return 0.5 * K * float(np.sum((np.array(x) - np.array(y)) ** 2))


def wandering(rng: np.random.Generator, rubbish: float) -> Vector:
    """A set-position: near home, or one of no sense."""
    if rng.random() < rubbish:
        return poses.coordinates(rng.normal(0.0, 0.03, 3), rng.normal(size=4))
    q = Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)).as_quat()
    return poses.coordinates(rng.normal(0.0, 0.02, 3), (q[3], *q[:3]))


WALLS = (HalfSpace((0.0, 0.0, -1.0), 0.025), Sphere((0.06, 0.0, 0.0), 0.02))
CORNER = (Hole((0.0, 0.0, -0.016), (0.0, 0.0, -1.0), 0.0052, 0.001), Sphere((0.03, 0.0, 0.02), 0.02))


BOX, PEG = (box((0.06, 0.04, 0.02)), WALLS), (peg(0.005, 0.03), CORNER)
STEPS_S = ((0.01, 0.05), (1e-3, 1e-3), (0.1, 0.1))


@pytest.mark.parametrize(
    ("tool", "shapes", "friction", "shortest", "longest", "share"),
    mostly_slow(
        [
            (*BOX, 0.5, *STEPS_S[0], 0.2), (*BOX, 0.0, *STEPS_S[0], 1.0),
            (*BOX, 0.5, *STEPS_S[1], 1.0), (*BOX, 0.5, *STEPS_S[2], 0.3), (*PEG, 0.5, *STEPS_S[0], 0.2),
            (*PEG, 0.0, *STEPS_S[1], 1.0), (*PEG, 0.5, *STEPS_S[2], 0.1),
            *((*one, friction, *steps, 1.0) for one in (BOX, PEG) for steps in STEPS_S for friction in (0.0, 0.5)),
        ],
        1, 7,
    ),
)  # fmt: skip
@pytest.mark.long
def test_every_step_obeys_13_and_the_solids_give_nothing(
    tool: Tool, shapes: tuple[Shape, ...], friction: float, shortest: float, longest: float, share: float
) -> None:
    """A fifth of the set-positions are rubbish orientations; no step takes more out of the solids than they had."""
    rng = np.random.default_rng(7)
    solids = [Solid(shape, 3000.0, 10.0, friction) for shape in shapes]
    touched = 0
    for _ in range(2):
        mass = mass_among(tool, *solids)
        stored, y = 0.0, HOME
        for k in range(round(share * (60 if longest > 1e-3 else 240))):
            y = wandering(rng, 0.2) if k % (4 if longest > 1e-3 else 40) == 0 else y
            before = mass.kinetic_J + spring_J(mass.position, y)
            dt = float(rng.uniform(shortest, longest))
            step = mass.step(dt, y, mass.contacts)
            after = mass.kinetic_J + spring_J(mass.position, y)
            moved = dt * np.array(step.velocity)
            assert step.work_J - step.dissipated_J == pytest.approx(after - before, abs=3e-15 + 1e-15 * before)
            assert step.work_J == pytest.approx(float(np.dot(step.force, moved)), abs=1e-12)
            damped = spring_J(begun(mass, moved), y) - spring_J(mass.position, y) - np.dot(step.coupling_force, moved)
            # the mean velocity dissipates least; beside the damper only the spin loses energy
            assert B * float(moved @ moved) / dt <= damped + 1e-12
            assert damped <= step.dissipated_J + 1e-12
            held = mass.contacts.stored_J(mass.position)
            assert held <= stored - step.work_J + 1e-15
            stored = held
            touched += any(step.force)
    assert touched > share * 30


def begun(mass: ToolMass, moved: Array) -> Vector:
    """Where the step began."""
    return tuple((np.array(mass.position) - moved).tolist())


@pytest.mark.long
def test_all_points_of_a_plate_count() -> None:
    """As many as a tool may have, on one plane: it carries the load, and does not tilt."""
    points = tuple((0.004 * a - 0.03, 0.006 * b - 0.021, -0.005) for a in range(16) for b in range(8))
    mass = mass_among(Tool("plate", points, (0.06, 0.042, 0.01)), Solid(HalfSpace((0.0, 0.0, -1.0), 0.015)))
    y = poses.coordinates((0.0, 0.0, -0.03), (1.0, 0.0, 0.0, 0.0))
    pushes = [mass.step(0.02, y, mass.contacts).force[2] for _ in range(80)]
    assert np.mean(pushes[40:]) == pytest.approx(K * 0.02, rel=0.01)
    assert 0.0 < -0.01 - mass.position[2] < 1e-4
    assert poses.angle_between(mass.position, HOME) < 1e-6


def test_a_start_is_a_pose_whatever_is_sent() -> None:
    """Arms of another length, mirrored or none: the nearest rotation, as scipy finds it where there is one."""
    rng = np.random.default_rng(10)
    mass = mass_among(box((0.04, 0.03, 0.02)))
    for factor in (1.5, 0.3, -1.0, 0.0):
        x = np.array(poses.coordinates((0.01, 0.0, 0.0), rng.normal(size=4)))
        home = np.concatenate([np.zeros(3), (ARM_M * np.eye(3)).ravel()])
        mass.place(tuple(np.concatenate([x[:3], (factor * (x + home) - home)[3:]]).tolist()))
        arms = np.reshape(np.array(mass.position)[3:], (3, 3)) / ARM_M + np.eye(3)
        assert np.abs(arms @ arms.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(arms) == pytest.approx(1.0)
        if factor > 0.0:
            assert np.array(mass.position) == pytest.approx(x, abs=1e-12)


def test_a_world_begins_as_near_as_it_may() -> None:
    """A box that is sent 0.1 mm inside a table begins a little above it, and beside: not at home."""
    scene = ToolScene("table", box((0.06, 0.04, 0.02)), (Solid(HalfSpace((0.0, 0.0, -1.0), 0.03)),))
    free, inside = (poses.coordinates((0.05, 0.0, z), (1.0, 0.0, 0.0, 0.0)) for z in (-0.015, -0.0201))
    assert scene.towards(free) == pytest.approx(free, abs=1e-12)
    found = scene.towards(inside)
    assert scene.contacts.penetration(found) == 0.0
    assert found[2] == pytest.approx(-0.02, abs=2e-5)
    assert found[0] == pytest.approx(0.05 * 0.02 / 0.0201, abs=5e-5)


@pytest.mark.long
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
        true = sorted(-0.012 - place(moved, point, ARM_M)[2] for point in tool.points)[4:]
        said = sorted(plane.depth(moved) * np.sqrt(plane.stiffness / 3000.0) for plane in planes)
        assert said == pytest.approx(true, abs=2e-8)


def _depth_of(point: Vector, normal: Vector, x: Array) -> float:
    return -0.012 - point[2]


def test_a_hole_is_what_its_peg_says() -> None:
    """Distances to plane, side and chamfer by hand, and gradients by differences."""
    hole = Hole((0.0, 0.0, -0.02), (0.0, 0.0, -1.0), 0.005, 0.001)
    for spot, distance in {
        (0.0, 0.0, 0.0): 0.02,  # above the mouth: in front of the plane
        (0.03, 0.0, -0.021): -0.001,
        (0.004, 0.0, -0.03): 0.001,
        (0.0, -0.0052, -0.03): -0.0002,
        (0.0055, 0.0, -0.0202): 0.0003 / np.sqrt(2.0),
    }.items():
        assert hole.near(spot).distance_m == pytest.approx(distance, abs=1e-12), spot
    rng = np.random.default_rng(9)
    for _ in range(200):
        p = rng.uniform((-0.01, -0.01, -0.03), (0.01, 0.01, -0.018))
        gradient = [
            (hole.near(tuple(p + 1e-7 * e)).distance_m - hole.near(tuple(p - 1e-7 * e)).distance_m) / 2e-7
            for e in np.eye(3)
        ]
        if np.linalg.norm(gradient) > 0.999:  # else an edge lies between
            assert hole.near(tuple(p)).gradient == pytest.approx(gradient, abs=1e-6)


@pytest.mark.long
@pytest.mark.slow
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


def test_touches_are_shown_on_the_surface_with_normals_out_of_the_solid() -> None:
    """A box a millimetre inside the floor lies on its four lower corners."""
    floor = Solid(HalfSpace((0.0, 0.0, -1.0), 0.025), 3000.0)
    picture = ToolPicture(ToolContacts(box((0.06, 0.04, 0.02)), [floor], ARM_M))
    touches = picture.touches((0.0, 0.0, -0.016, *HOME[3:]), (0.0, 0.0, 2.0, *HOME[3:]))
    corners = sorted((x, y, -0.025) for x in (-0.03, 0.03) for y in (-0.02, 0.02))
    assert np.array(sorted(touch.point for touch in touches)) == pytest.approx(np.array(corners), abs=1e-15)
    assert {touch.normal for touch in touches} == {(0.0, 0.0, 1.0)}
    assert np.sum([touch.force_N for touch in touches], axis=0) == pytest.approx([0.0, 0.0, 2.0])


def test_a_peg_touches_with_three_rings_of_eight_points_and_the_middle_of_its_end() -> None:
    middle, *rings = np.array(peg(0.005, 0.03).points)
    assert middle.tolist() == [0.0, 0.0, -0.015]
    for ring, z in zip(np.reshape(rings, (3, 8, 3)), (-0.015, 0.0, 0.015), strict=True):
        assert ring[:, 2].tolist() == [z] * 8
        assert np.hypot(ring[:, 0], ring[:, 1]) == pytest.approx(np.full(8, 0.005))
        sides = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1)
        assert sides == pytest.approx(np.full(8, 0.01 * np.sin(np.pi / 8)))


@pytest.mark.parametrize(
    "wrong", [(0, 501.0), (2, 499.0), (3, 21.0), (11, 19.0), (slice(0, 3), 0.0), (slice(3, 12), -1.0)]
)
def test_a_tools_spring_is_one_number_for_the_point_and_one_for_turning(wrong: tuple[int | slice, float]) -> None:
    stiffness = np.array([500.0] * 3 + [20.0] * 9)
    contacts = ToolContacts(box((0.06, 0.04, 0.02)), [], ARM_M)
    ToolMass(contacts, M, B, stiffness, HOME)
    stiffness[wrong[0]] = wrong[1]
    with pytest.raises(InvalidParameter, match="one number above 0 for the point"):
        ToolMass(contacts, M, B, stiffness, HOME)


@pytest.mark.parametrize("step_ms", mostly_slow([10.0, 50.0, 30.0, 20.0, 7.0, 3.0, 1.0], 2, 5))
@pytest.mark.long
def test_a_tool_at_rest_reports_its_load(step_ms: float) -> None:
    """A box on a plane, its goal 10 mm deeper: K = 500 N/m in series with four corners of 3000 N/m are 4.8 N."""
    scene = builder("tool:box + plane?normal=0,0,-1&at=0,0,-20mm&friction=0.3")()
    mass, dt = ToolMass(scene.contacts, 0.02, 14.0, 500.0, tuple(scene.start)), 1e-3 * step_ms
    goal = (0.0, 0.0, -0.02, *(0.0,) * 9)
    for k in range(round(6.0 / dt)):
        step = mass.step(dt, goal, scene.contacts)
        if k * dt > 4.0 + 20.0 * dt:  # at rest; longer steps damp less
            assert step.force[2] == pytest.approx(4.8, rel=0.01)
            assert step.coupling_force[2] == pytest.approx(-4.8, rel=0.01)


def test_a_cut_step_reports_the_mean_force_that_does_its_work() -> None:
    """The nearest force with this work; a way of a rounding error tells nothing of it."""
    assert doing(0.3, (1.0, 2.0), (0.1, 0.0)) == pytest.approx((3.0, 2.0))
    assert doing(1e-17, (4.8, 0.0), (1e-16, 0.0)) == (4.8, 0.0)


def test_planes_of_other_directions_come_first() -> None:
    """Nine planes of one direction and one of another: the first, the other, then the rest as far as there is room."""
    alike = [Plane((1.0, 0.0, *(0.0,) * 10), 1e-3 * k, 3e3, 0.0) for k in range(9)]
    other = Plane((0.0, 1.0, *(0.0,) * 10), 0.1, 3e3, 0.0)
    assert different([*alike, other]) == (alike[0], other, *alike[1 : MOST_TOOL_PLANES - 1])


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_depths_cost_the_energy_that_is_there(share: float) -> None:
    """Four points 1 mm deep in a spring of 3 kN/m cost 4 K d^2/2; with less the depths are as deep as that pays for."""
    corners = tuple((x, y, -0.002) for x in (-0.02, 0.02) for y in (-0.02, 0.02))
    tool = Tool("plate", corners, (0.04, 0.04, 0.004))
    mass = mass_among(tool, Solid(HalfSpace((0.0, 0.0, -1.0), 0.002), 3000.0, 10.0, 0.0))
    mass.body.x[2] = -1e-3
    mass.contacts.energy_J = share * 4.0 * 0.5 * 3000.0 * 1e-6
    mass.step(1e-3, mass.position, mass.contacts)
    assert mass.contacts.scale == pytest.approx(share**0.5, rel=1e-9)
