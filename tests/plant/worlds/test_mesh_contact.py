"""Contact with meshes, beside the solid itself: thin layers, long steps, concave edges, and curved surfaces."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.checks import Array
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_surface import volume
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import Cuboid, HalfSpace, Shape
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow
from tests.measure import curved
from tests.metrics.test_contact import random_spd
from tests.support.mesh_runs import ball, boxes, extruded, felt, pressed, words
from tests.support.solids import Account, torus

STEPS_S = {"1 ms": (0.001, 0.001), "10 to 50 ms": (0.010, 0.050), "50 ms": (0.050, 0.050)}
FRONT_M, DEEP_M, BACK_M, HOLD_S = 0.02, 0.033, -0.01, 0.3


def steps(first: int = len(STEPS_S)) -> Any:
    """All steps; of these the `first` by default, the longest first."""
    return pytest.mark.parametrize(
        "steps_s", mostly_slow([(one,) for one in reversed(STEPS_S.values())], first), ids=reversed(STEPS_S.keys())
    )


# -- a proxy that is drawn in and out ---------------------------------------------------------------------------------


class Pressed:
    """A proxy on a spring of 500 N/m that a hand draws in along x at one speed, holds, and draws out."""

    def __init__(
        self, shapes: Sequence[Shape], speed: float, steps_s: tuple[float, float], aside: Sequence[float],
        deep_m: float = DEEP_M, friction: float = 0.0,
    ) -> None:  # fmt: skip
        M, B, K = (scale * np.eye(3) for scale in (0.02, 14.0, 500.0))
        contacts = RigidContacts([Solid(shape, 3000.0, 10.0, friction) for shape in shapes], 3)
        account = Account(contacts, M, B, K)
        mass = PassiveIntegrator(M, B, K, (0.0, *aside))
        rng, t, within = np.random.default_rng(0), 0.0, deep_m / speed
        places, self.scale = [], 1.0
        self.held_N = 0.0
        while t < 2.0 * within + HOLD_S + 0.3:
            dt = rng.uniform(*steps_s)
            t += dt
            back = deep_m - speed * (t - within - HOLD_S)
            step = mass.step(dt, (max(BACK_M, min(speed * t, deep_m, back)), *aside), contacts)
            places.append(step.position)
            self.scale = min(self.scale, contacts.scale)
            if t <= within + HOLD_S:
                self.held_N = -step.force[0]
        account.close()
        self.places = np.array(places)
        self.forces = np.array(account.forces)
        assert not np.any(self.forces[-1])


PLATES = [((0.02025, 0.0, 0.0), (0.0005, 0.06, 0.06)), ((0.02175, 0.0, 0.0), (0.0005, 0.06, 0.06))]
"""0.5 mm thick, 1 mm apart."""


@steps()
@pytest.mark.parametrize("speed", [0.1, 0.7])
def test_two_thin_layers_stop_the_proxy_and_let_it_go(speed: float, steps_s: tuple[float, float]) -> None:
    """As a solid without an end does, whose face is that of the first one: at rest the springs are in series."""
    thin, thick = (
        Pressed([shape], speed, steps_s, (0.001, 0.002))
        for shape in (Mesh(*boxes(*PLATES)), HalfSpace((1.0, 0.0, 0.0), FRONT_M))
    )
    series = 0.013 / (1.0 / 500.0 + 1.0 / 3000.0)
    if steps_s[1] == 0.001:
        assert thin.held_N == pytest.approx(series, rel=1e-3)
    assert thin.forces == pytest.approx(thick.forces, abs=1e-9)
    assert thin.scale == 1.0


@steps()
@pytest.mark.parametrize("mesh", [boxes(*PLATES, ((0.04, 0.0, 0.0), (0.0005, 0.06, 0.06))), torus()],
                         ids=["plates", "tube"])  # fmt: skip
def test_nothing_is_crossed_in_one_step(mesh: tuple[Array, Any], steps_s: tuple[float, float]) -> None:
    """0.7 m/s and 50 ms are 35 mm, a torus's tube is 24 mm thick. The proxy stops as in front of an endless solid."""
    thin, thick = (
        Pressed([shape], 0.7, steps_s, (0.0, 0.0), deep_m=0.042)
        for shape in (Mesh(*mesh), HalfSpace((1.0, 0.0, 0.0), FRONT_M))
    )
    assert thin.places == pytest.approx(thick.places, abs=2e-6)
    assert thin.forces == pytest.approx(thick.forces, abs=0.01)


# -- concave edges ----------------------------------------------------------------------------------------------------

CORNER = extruded(
    [(-0.03, 0.01), (0.02, 0.01), (0.02, -0.06), (0.04, -0.06), (0.04, 0.03), (-0.03, 0.03)],
    [(0, 1, 5), (1, 4, 5), (1, 2, 3), (1, 3, 4)], 0.12,
)  # fmt: skip
"""Solid beyond x = 20 mm, and beyond y = 10 mm."""

SLOT = extruded(
    [(0.0, 0.005), (0.03, 0.005), (0.03, -0.005), (0.0, -0.005),
     (0.0, -0.03), (0.05, -0.03), (0.05, 0.03), (0.0, 0.03)],
    [(0, 1, 7), (1, 6, 7), (1, 2, 6), (2, 5, 6), (2, 3, 4), (2, 4, 5)], 0.12,
)  # fmt: skip
"""10 mm wide, with its ground at x = 30 mm."""


OVERLAP = ((0.03, 0.0, 0.0), (0.02, 0.04, 0.04)), ((0.04, 0.01, 0.0), (0.03, 0.04, 0.04))
INVERTED = (boxes(*OVERLAP)[0], np.concatenate([boxes(OVERLAP[0])[1], boxes(OVERLAP[0])[1][:, ::-1] + 8]))


@steps()
@pytest.mark.parametrize("speed", mostly_slow([0.7, 0.05, 0.2], 0, 1))
@pytest.mark.parametrize("mesh", [boxes(*PLATES), boxes(*OVERLAP), INVERTED, torus(), CORNER],
                         ids=["plates", "overlapping", "inverted", "tube", "corner"])  # fmt: skip
def test_over_4g_a_solid_stops_the_hand(
    mesh: tuple[Array, Any], speed: float, steps_s: tuple[float, float], tmp_path: Path
) -> None:
    """As a plane does where the solid begins: what is felt while the hand holds, the world's largest and last force.

    The hand stops before the middle of the tube: behind it the proxy would slide off to one side. How far a proxy is
    carried before a fast hand hits depends on the free way, of which a mesh knows a lower bound: it never hits harder.
    """
    pytest.importorskip("manifold3d")
    deep_m = 0.03 if len(mesh[1]) == len(torus()[1]) else 0.038
    of, plane = (pressed(scene, speed, steps_s, (0.0, 0.0), deep_m) for scene in (words(tmp_path, mesh), "plane"))
    assert of.held_N == pytest.approx(plane.held_N, rel=0.01)
    assert (0.9 if speed > 0.5 else 0.97) < of.most_N / plane.most_N < 1.03
    assert of.most_N <= 12.0
    assert of.last_N == 0.0


def within(t: float) -> float:
    t = min(1.0, t / 0.6)
    return t * t * (3.0 - 2.0 * t)


def across_ground(deep_m: float, aside_m: float, speed: float) -> Callable[[float], Sequence[float]]:
    """In along x, and then to and fro along y."""
    return lambda t: (deep_m * within(t), aside_m * math.sin(max(0.0, t - 0.7) * speed / aside_m), 0.0)


def in_corner(x: Array) -> Array:
    return np.stack([np.minimum(0.0, 0.02 - x[:, 0]), np.minimum(0.0, 0.01 - x[:, 1]), 0.0 * x[:, 2]], axis=1)


def in_slot(x: Array) -> Array:
    sideways = np.maximum(0.0, -0.005 - x[:, 1]) + np.minimum(0.0, 0.005 - x[:, 1])
    return np.stack([np.minimum(0.0, 0.03 - x[:, 0]), sideways, 0.0 * x[:, 2]], axis=1)


@steps()
@pytest.mark.parametrize("speed", [pytest.param(0.05, marks=pytest.mark.soak), 0.2], ids=["50 mm/s", "200 mm/s"])
@pytest.mark.parametrize(("mesh", "deep_m", "aside_m", "own"),
                         mostly_slow([(CORNER, 0.03, 0.02, in_corner), (SLOT, 0.04, 0.012, in_slot)], 1),
                         ids=["corner", "slot"])  # fmt: skip
def test_a_corner_and_a_slot_are_felt_as_their_walls(
    mesh: tuple[Array, Any], deep_m: float, aside_m: float, own: Callable[[Array], Array], speed: float,
    steps_s: tuple[float, float], tmp_path: Path,
) -> None:  # fmt: skip
    """Over 4G, pressed 10 mm into the ground and drawn into the walls: the flat walls' springs, felt without delay."""
    path = across_ground(deep_m, aside_m, speed)
    run = felt(words(tmp_path, mesh), path, own, steps_s, seconds=1.5 if steps_s[1] == 0.001 else 3.0)
    assert run.error <= 0.02
    assert run.most_N <= 12.0


@pytest.mark.parametrize("dof", [1, 2])
def test_with_fewer_axes_a_mesh_is_cut(dof: int) -> None:
    """A tube, cut where its middle is: pressed on its front, the springs are in series, also where it rubs."""
    contacts = RigidContacts([Solid(Mesh(*torus()), 3000.0, 10.0, 0.3)], dof)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,) * dof)
    contacts.require_separate(lambda vector: tuple(0.1 * part for part in vector))
    for _ in range(400):
        force = mass.step(0.001, (0.025, *(0.0,) * (dof - 1)), contacts).force
        planes = contacts.planes(mass.position, 0.05)
    assert force[0] == pytest.approx(-0.005 / (1.0 / 500.0 + 1.0 / 3000.0), rel=1e-3)
    assert planes[0].normal == pytest.approx((1.0, 0.0)[:dof], abs=1e-6)
    assert len(planes[0].curvatures) == dof - 1
    assert all(abs(bend.per_m - 1.0 / 0.042) < 1.0 for bend in planes[0].curvatures)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(["corner", "slot", "plates"]), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.4, 1.5]))
def test_whatever_the_hand_does_faces_give_no_more_than_they_have(name: str, seed: int, friction: float) -> None:
    """Steps of 1 to 60 ms, a general A, and goals anywhere near, also behind several faces and beyond the solid."""
    mesh = Mesh(*{"corner": CORNER, "slot": SLOT, "plates": boxes(*PLATES)}[name])
    rng = np.random.default_rng(seed)
    M, B, K = random_spd(rng, 3, 0.005, 0.2), random_spd(rng, 3, 3.0, 30.0), random_spd(rng, 3, 200.0, 2000.0)
    contacts = RigidContacts([Solid(mesh, 3000.0, 10.0, friction)], 3)
    account = Account(contacts, M, B, K)
    mass, goal = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.0)), (0.03, 0.012, 0.0)
    for _ in range(200):
        if rng.random() < 0.2:
            goal = tuple(rng.uniform((-0.02, -0.03, -0.01), (0.05, 0.03, 0.01)).tolist())
        mass.step(float(rng.choice([0.001, rng.uniform(0.005, 0.06)])), goal, contacts)
    account.close()


def test_a_step_that_cuts_a_corner_is_no_step_without_energy() -> None:
    """Steps of 50 ms at 0.7 m/s past and through an icosahedron: where they enter one face and end behind another one,
    the depth at the next onset has been paid for.
    """
    mesh, rng, met = Mesh(*ball(0, 0.012, (0.0, 0.0, 0.0))), np.random.default_rng(4), 0
    for _ in range(160):
        contacts = RigidContacts([Solid(mesh, 3000.0, 10.0)], 3)
        out, aside = rng.normal(size=(2, 3))
        out /= np.linalg.norm(out)
        aside -= out * (aside @ out)
        aside *= rng.uniform(0.0, 0.012) / np.linalg.norm(aside)
        start = rng.uniform(0.05, 0.09)
        mass = PassiveIntegrator(0.02, 14.0, 500.0, tuple((start * out + aside).tolist()))
        for k in range(1, 7):
            mass.step(0.05, tuple(((start - 0.035 * k) * out + aside).tolist()), contacts)
            met += contacts.touching > 0
            assert contacts.scale >= 0.5
    assert met > 160


# -- curved surfaces --------------------------------------------------------------------------------------------------


@steps(1)
def test_a_ball_of_triangles_is_felt_as_a_ball(steps_s: tuple[float, float], tmp_path: Path) -> None:
    """5,120 triangles, at 100 mm/s over 4G. As facets it was 32 % wrong."""
    mesh = ball(4, curved.RADIUS, curved.CENTRE.tolist())
    assert len(mesh[1]) == 5120
    links = {"link.up": "4g", "link.down": "4g"}
    error, own = curved.error_N(0.1, steps_s, scene=words(tmp_path, mesh), seconds=2.2, **links)
    assert error <= 0.01 * own


def test_a_smooth_patch_is_the_torus_that_the_triangles_stand_for() -> None:
    """Distance, gradient and curvature, by the formulas of a torus; the triangles' middles are up to 28 um inside."""
    mesh, rng, centre = Mesh(*torus()), np.random.default_rng(5), np.array((0.062, 0.0, 0.0))
    for around, over, height in zip(
        rng.uniform(0.0, 2.0 * math.pi, 200), rng.uniform(0.0, 2.0 * math.pi, 200), rng.uniform(-0.003, 0.004, 200),
        strict=True,
    ):  # fmt: skip
        out = np.array((math.cos(around), math.sin(around), 0.0))
        normal = math.cos(over) * out + np.array((0.0, 0.0, math.sin(over)))
        foot = mesh.foot(tuple((centre + 0.03 * out + (0.012 + height) * normal).tolist()))
        assert foot.near.distance_m == pytest.approx(height, abs=1e-6)
        assert foot.near.gradient == pytest.approx(tuple(normal.tolist()), abs=0.004)
        bends = sorted(per_m for _, per_m in mesh.curvatures_at(foot))
        wanted = sorted((1.0 / 0.012, math.cos(over) / (0.03 + 0.012 * math.cos(over))))
        if len(bends) == 2:
            assert bends == pytest.approx(wanted, abs=4.0)
        else:
            assert bends == pytest.approx(wanted[1:], abs=4.0)
            assert abs(wanted[0]) < 4.0


def test_there_are_no_spikes_where_facets_meet() -> None:
    """A proxy that is drawn 8 mm around a ball at 50 mm/s, in steps of 1 ms: its force turns by 1/600 a step."""
    mesh = Mesh(*ball(4, 0.03, (0.05, 0.0, 0.0)))
    contacts = RigidContacts([Solid(mesh, 3000.0, 10.0)], 3)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.02, 0.0, 0.0))
    forces = []
    for k in range(700):
        angle = max(0.0, k - 400) * 0.001 * 0.05 / 0.03
        out = (-math.cos(angle), math.sin(angle), 0.1 * math.sin(angle))
        forces.append(mass.step(0.001, (0.05 + 0.022 * out[0], 0.022 * out[1], 0.022 * out[2]), contacts).force)
    jumps = np.linalg.norm(np.diff(np.array(forces[350:]), axis=0), axis=1)
    assert np.linalg.norm(forces[-1]) == pytest.approx(0.008 / (1.0 / 500.0 + 1.0 / 3000.0), rel=0.02)
    assert jumps.max() <= 0.03


def test_what_is_flat_stays_flat_beside_what_is_round() -> None:
    """A cylinder of 48 sides: its caps are planes up to the edge, its side has the cylinder's normals."""
    turn = 2.0 * np.pi * np.arange(48) / 48
    outline = [(0.03 * math.cos(a), 0.03 * math.sin(a)) for a in turn]
    mesh = Mesh(*extruded(outline, [(0, i, i + 1) for i in range(1, 47)], 0.06))
    assert mesh.near((0.0295, 0.001, 0.0299)).gradient == (0.0, 0.0, 1.0)
    assert mesh.near((0.0295, 0.001, 0.0299)).distance_m == pytest.approx(-0.0001, abs=1e-12)
    for angle in np.linspace(0.0, 0.3, 13):
        place = (0.031 * math.cos(angle), 0.031 * math.sin(angle), 0.01)
        foot = mesh.foot(place)
        assert foot.near.distance_m == pytest.approx(0.001, abs=2e-6)
        assert foot.near.gradient == pytest.approx((math.cos(angle), math.sin(angle), 0.0), abs=1e-3)
        (bend,) = mesh.curvatures_at(foot)
        assert bend.per_m == pytest.approx(1.0 / 0.03, rel=0.02)
        assert abs(bend.direction[2]) < 1e-6


def test_a_flat_face_stays_flat_beside_a_fillet() -> None:
    """A bar of 60 x 40 mm whose edges are rounded to 3 mm, in six triangles' pairs each: flat faces and cylinders."""
    outline = [
        (x + 0.003 * math.cos(angle), y + 0.003 * math.sin(angle))
        for x, y, first in ((0.027, 0.017, 0), (-0.027, 0.017, 6), (-0.027, -0.017, 12), (0.027, -0.017, 18))
        for angle in np.radians(15.0 * np.arange(first, first + 7))
    ]
    mesh = Mesh(*extruded(outline, [(0, i, i + 1) for i in range(1, 27)], 0.05))
    for y in np.linspace(-0.0165, 0.0165, 12):
        foot = mesh.foot((0.031, float(y), 0.002))
        assert foot.near.distance_m == pytest.approx(0.001, abs=1e-9)
        assert foot.near.gradient == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
        assert mesh.curvatures_at(foot) == ()
    for angle in np.radians(np.linspace(2.0, 88.0, 20)):
        out = (math.cos(angle), math.sin(angle), 0.0)
        foot = mesh.foot((0.027 + 0.004 * out[0], 0.017 + 0.004 * out[1], 0.003))
        assert foot.near.distance_m == pytest.approx(0.001, abs=1e-6)
        assert foot.near.gradient == pytest.approx(out, abs=0.002)
        assert [bend.per_m for bend in mesh.curvatures_at(foot)] == pytest.approx([1.0 / 0.003], rel=0.05)


# -- what is told -----------------------------------------------------------------------------------------------------


def told(mesh: tuple[Array, Any], place: Sequence[float]) -> list[tuple[Array, float]]:
    planes = RigidContacts([Solid(Mesh(*mesh))], 3).planes(place, 0.05)
    return [(np.array(plane.normal), plane.offset_m) for plane in planes]


def test_the_planes_around_a_slot_are_its_walls() -> None:
    for place in ((0.028, 0.0, 0.0), (0.015, 0.002, 0.0), (0.0295, 0.0045, 0.01)):
        found = {tuple(np.round(normal, 9).tolist()): offset for normal, offset in told(SLOT, place)}
        walls = {(0.0, 1.0, 0.0): 0.005, (0.0, -1.0, 0.0): 0.005}
        if place[0] > 0.02:
            walls[(1.0, 0.0, 0.0)] = 0.03
        assert found == pytest.approx(walls)


def test_what_is_beside_is_told_in_time_while_the_proxy_moves_on() -> None:
    """Towards the wall of a corner over one triangle of its ground, by 0.1 mm: the wall, once it is near."""
    contacts = RigidContacts([Solid(Mesh(*CORNER))], 3)
    for y in np.arange(-0.02, 0.0095, 0.0001).tolist():
        walls = [one.offset_m for one in contacts.planes((0.0195, y, 0.003), 0.05) if one.normal[1] > 0.9]
        assert walls == pytest.approx([0.01] if y > -0.0044 else [] if y < -0.0051 else walls)


def test_no_plane_is_a_ghost() -> None:
    """Nowhere near is a place in free space behind a plane: beside a low step, on a bar, between thin plates."""
    step = boxes(((0.03, 0.0, 0.0), (0.02, 0.06, 0.06)), ((0.0198, 0.006, 0.0), (0.0008, 0.004, 0.004)))
    for mesh in (boxes(((0.05, 0.0, 0.0), (0.06, 0.012, 0.012))), boxes(*PLATES), step):
        shape, rng = Mesh(*mesh), np.random.default_rng(8)
        for x in rng.uniform((0.0, -0.02, -0.02), (0.0199, 0.02, 0.02), (60, 3)):
            planes = told(mesh, tuple(x.tolist()))
            assert planes
            for y in x + rng.uniform(-0.002, 0.002, (10, 3)):
                free = shape.near(tuple(y.tolist())).distance_m > 0.001
                if free and shape.near(tuple(x.tolist())).distance_m > 0.0:
                    assert max(float(n @ y) - offset for n, offset in planes) <= 0.0005


def test_a_cuboid_of_triangles_is_the_cuboid() -> None:
    """Pressed on its face, and drawn over its edge: the same forces, bit for bit but for rounding."""
    centre, size = (0.05, 0.0, 0.0), (0.06, 0.06, 0.06)
    for friction in (0.0, 0.4):
        runs = [
            Pressed([shape], 0.1, STEPS_S["10 to 50 ms"], (0.011, 0.007), friction=friction)
            for shape in (Mesh(*boxes((centre, size))), Cuboid(centre, size))
        ]
        assert runs[0].forces == pytest.approx(runs[1].forces, abs=1e-9)


# -- a sheet that winds -----------------------------------------------------------------------------------------------


def gyroid(points: int = 37, size_m: float = 0.06, cell_m: float = 0.02) -> tuple[Array, Any]:
    """A sheet of about 3 mm that parts space in two, cut by a box; the origin is in the middle of a channel."""
    import igl

    grid = size_m * np.linspace(-0.5, 0.5, points)
    z, y, x = np.meshgrid(grid, grid, grid, indexing="ij")
    outside = np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z)) - 0.46 * size_m
    values = np.maximum((np.abs(labyrinth(np.stack([x, y, z], -1), cell_m)) - 0.7) * cell_m / (3.0 * np.pi), outside)
    places = np.stack([x, y, z], -1).reshape(-1, 3)
    vertices, triangles, _ = igl.marching_cubes(values.reshape(-1), places, points, points, points, 0.0)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    return vertices - cell_m / 8.0, triangles if volume(vertices, triangles) > 0.0 else triangles[:, ::-1]


def labyrinth(places: Array, cell_m: float = 0.02) -> Array:
    """Above 0 on one side of the sheet, below 0 on the other."""
    s, c = np.sin(2.0 * np.pi / cell_m * places), np.cos(2.0 * np.pi / cell_m * places)
    return s[..., 0] * c[..., 1] + s[..., 1] * c[..., 2] + s[..., 2] * c[..., 0]


@steps(1)
@pytest.mark.parametrize("aside", mostly_slow([((0.001, 0.0015),), ((0.0, 0.0),), ((0.0005, -0.0015),)], 1, 1))
def test_a_sheet_that_winds_is_not_crossed(aside: Sequence[float], steps_s: tuple[float, float]) -> None:
    """57,000 triangles. At 0.7 m/s and 50 ms a step leads through several of its layers. Where the proxy is free, it
    is in the channel in which it began.
    """
    mesh = Mesh(*gyroid())
    assert len(mesh.triangles) > 50_000
    contacts = RigidContacts([Solid(mesh, 3000.0, 10.0)], 3)
    account = Account(contacts, *[scale * np.eye(3) for scale in (0.02, 14.0, 500.0)])
    mass, rng, t, free = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0)), np.random.default_rng(0), 0.0, 0
    while t < 0.5:
        dt = rng.uniform(*steps_s)
        t += dt
        goal = (0.012 * math.sin(0.7 / 0.012 * t), *aside)
        place = mass.step(dt, goal, contacts).position
        if mesh.near(place).distance_m > 2e-4:
            assert float(labyrinth(np.array(place) + 0.0025)) > 0.0
            free += 1
    account.close()
    assert np.linalg.norm(account.forces, axis=1).max() <= 12.0
    assert free
