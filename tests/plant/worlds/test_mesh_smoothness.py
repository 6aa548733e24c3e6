"""Which faces of a mesh are felt as curved, beside the true shapes: cones, drafts, chamfers, ramps, round solids."""

import re
from pathlib import Path

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_surface import MeshSurface
from hapnet.ext.solids.rigid import builder
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow
from tests.support.mesh_runs import ball, extruded
from tests.support.solids import torus

trimesh = pytest.importorskip("trimesh")
RADIUS, HEIGHT = 0.01, 0.04
SPRING, WALL, DEEP_M = 500.0, 3000.0, 0.004


def mesh_of(made: object, at: tuple[float, float, float] = (0.05, 0.0, 0.0)) -> Mesh:
    return Mesh(np.array(made.vertices) + at, np.array(made.faces))  # type: ignore[attr-defined]


def drafted(degrees: float, subdivided: int = 0, wide_m: float = 0.01) -> Mesh:
    """A flat top of 30 x 30 mm in the plane z = 0, whose sides fall off by this angle, then by 90 degrees."""
    fall, inner = wide_m * np.tan(np.radians(degrees)), 0.015
    outer = inner + wide_m
    rings = ((inner, 0.0), (outer, -fall), (outer, -0.02))
    corners = [(s * r, t * r, z) for r, z in rings for s in (-1, 1) for t in (-1, 1)]
    hull = trimesh.convex.convex_hull(np.array(corners))
    for _ in range(subdivided):
        hull = hull.subdivide()
    return mesh_of(hull)


def pressed(mesh: Mesh, place: Array, normal: Array, deep_m: float = DEEP_M) -> Array:
    """The force after a spring of `SPRING` has been pulled `deep_m` behind `place`, along the normal."""
    start = place + 0.006 * normal
    contacts = RigidContacts([Solid(mesh, WALL, 0.0)], 3)
    mass = PassiveIntegrator(0.02, 14.0, SPRING, tuple(start.tolist()))
    contacts.stored_J(tuple(start.tolist()))
    for k in range(60):
        goal = start + (place - deep_m * normal - start) * min(1.0, k / 20.0)
        step = mass.step(0.02, tuple(goal.tolist()), contacts)
    return np.array(step.force)


def degrees_between(one: Array, other: Array) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


IN_SERIES = SPRING * WALL / (SPRING + WALL)


@pytest.mark.parametrize("sides", mostly_slow([12, 32, 64, 256], 2))
@pytest.mark.parametrize("height", [0.1, 0.5, 0.75])
@pytest.mark.parametrize("turned", [0.0, 0.25, 0.5])
def test_a_cone_is_felt_as_a_cone(sides: int, height: float, turned: float) -> None:
    """Long triangles from the base to the apex, as CAD programs write them; at an edge, and beside it."""
    mesh = mesh_of(trimesh.creation.cone(RADIUS, HEIGHT, sections=sides))
    turn = np.pi + 2.0 * np.pi * turned / sides
    out = np.array([np.cos(turn), np.sin(turn), RADIUS / HEIGHT]) / np.hypot(1.0, RADIUS / HEIGHT)
    ring = RADIUS * (1.0 - height)
    place = np.array([0.05 + ring * np.cos(turn), ring * np.sin(turn), HEIGHT * height])
    near = mesh.near(tuple((place + 1e-4 * out).tolist()))
    sagitta = ring * (1.0 - np.cos(np.pi / sides))
    assert near.distance_m == pytest.approx(1e-4, abs=1e-7 + 0.25 * sagitta)
    deep_m = min(DEEP_M, 0.3 * ring)  # deeper, near the axis, the goal itself decides about the direction
    force = pressed(mesh, place, out, deep_m)
    assert np.linalg.norm(force) == pytest.approx(IN_SERIES * deep_m, rel=0.03)
    assert degrees_between(force, out) < 3.0


@pytest.mark.parametrize("degrees", [5, 15, 20, 25, 28, 35, 39, 45])
@pytest.mark.parametrize("subdivided", [0, 2])
def test_a_flat_top_with_drafted_sides_is_flat(degrees: float, subdivided: int) -> None:
    mesh, up = drafted(degrees, subdivided), np.array([0.0, 0.0, 1.0])
    for x, y in ((0.0, 0.0), (0.0075, 0.003), (0.012, 0.0), (-0.014, 0.014)):
        place = np.array([0.05 + x, y, 0.0])
        near = mesh.near(tuple((place + 1e-4 * up).tolist()))
        assert near.distance_m == pytest.approx(1e-4, abs=1e-9)
        force = pressed(mesh, place, up)
        assert np.linalg.norm(force) == pytest.approx(IN_SERIES * DEEP_M, rel=0.03)
        assert degrees_between(force, up) < 0.1
    slope = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    middle = np.array([0.05 + 0.02, 0.0, -0.005 * np.tan(np.radians(degrees))])
    near = mesh.near(tuple((middle + 1e-4 * slope).tolist()))
    assert near.distance_m == pytest.approx(1e-4, abs=1e-9)
    assert degrees_between(np.array(near.gradient), slope) < 0.1


def test_a_roof_a_ramp_and_a_chamfer_are_flat() -> None:
    """Two planes at 30 degrees; a ramp of 30 degrees between two levels; a chamfer of 1 mm at 35 degrees."""
    rise = 0.015 * np.tan(np.radians(15.0))
    for outline in (
        [(0.0, 0.0), (0.03, 0.0), (0.03, 0.01), (0.015, 0.01 + rise), (0.0, 0.01)],
        [(0.0, 0.0), (0.03, 0.0), (0.03, 0.015), (0.02, 0.015), (0.01, 0.009), (0.0, 0.009)],
    ):
        fan = [(0, k, k + 1) for k in range(1, len(outline) - 1)]
        vertices, triangles = extruded(outline, fan, 0.02)
        assert MeshSurface.of(vertices, np.asarray(triangles), 40.0).flat.all()
    assert drafted(35.0, wide_m=0.001)._surface.flat.all()


@pytest.mark.parametrize("sections", [10, 16, 32, 128])
def test_a_cylinder_and_a_rounded_edge_are_round(sections: int) -> None:
    """Its vertices are on the circle, so is the felt surface: to a tenth of the sagitta of its sides."""
    mesh = mesh_of(trimesh.creation.cylinder(radius=RADIUS, height=HEIGHT, sections=sections), (0.05, 0.0, 0.0))
    sagitta = RADIUS * (1.0 - np.cos(np.pi / sections))
    for turn in np.linspace(0.0, 2.0 * np.pi, 37):
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        near = mesh.near(tuple((np.array([0.05, 0.0, 0.003]) + (RADIUS + 1e-4) * out).tolist()))
        assert near.distance_m == pytest.approx(1e-4, abs=0.1 * sagitta)
        assert degrees_between(np.array(near.gradient), out) < 0.1 * 360.0 / sections


def test_round_solids_have_no_edges() -> None:
    for vertices, triangles in (ball(2, 0.02, (0.05, 0.0, 0.0)), torus(40, 20), torus(60, 30)):
        surface = MeshSurface.of(np.array(vertices), np.array(triangles), 40.0)
        assert not surface.rims.any()
        assert surface.curved()[0] == pytest.approx(1.0)


def test_a_surface_found_in_a_volume_has_few_edges() -> None:
    """Marching cubes leave slivers, whose normals mean nothing: the true ball's normals are met as well as before."""
    igl = pytest.importorskip("igl")
    n, reach, radius = 24, 0.0251, 0.02
    axis = np.linspace(-reach, reach, n)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    vertices, triangles = igl.marching_cubes(np.linalg.norm(places, axis=1) - radius, places, n, n, n, 0.0)[:2]
    if trimesh.Trimesh(vertices, triangles, process=False).volume < 0.0:
        triangles = triangles[:, ::-1]
    mesh, rng = Mesh(vertices, triangles), np.random.default_rng(4)
    off = []
    for out in rng.normal(size=(300, 3)):
        out /= np.linalg.norm(out)
        off.append(degrees_between(np.array(mesh.near(tuple(((radius + 2e-4) * out).tolist())).gradient), out))
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def test_zero_degrees_leave_every_triangle_as_it_is() -> None:
    made = trimesh.creation.cone(RADIUS, HEIGHT, sections=32)
    surface = MeshSurface.of(np.array(made.vertices), np.array(made.faces, dtype=np.int64), 0.0)
    assert surface.flat.all()
    assert surface.curved() == (0.0, 0.0)


def test_one_line_says_what_is_felt_as_curved(tmp_path: Path) -> None:
    """The sides of a cone, without its base; nothing of a box."""
    cone, box = tmp_path / "cone.stl", tmp_path / "box.stl"
    trimesh.creation.cone(1e3 * RADIUS, 1e3 * HEIGHT, sections=32).export(cone)
    trimesh.creation.box((30.0, 30.0, 30.0)).export(box)
    told = builder(f"mesh:{cone}?unit=mm")(dof=3).warnings
    half = np.pi / 32
    sides = 32 * RADIUS * np.sin(half) * np.hypot(HEIGHT, RADIUS * np.cos(half))
    share = sides / (sides + 16 * RADIUS**2 * np.sin(2.0 * half))
    line = re.fullmatch(r"mesh \S+: (\d+)% of its surface is felt as curved, at most ([\d.]+) mm .*", "; ".join(told))
    assert line is not None
    assert int(line[1]) == pytest.approx(100.0 * share, abs=0.6)
    assert 0.5 < float(line[2]) / (1e3 * RADIUS * (1.0 - np.cos(half))) <= 1.0  # of the sagitta at the base
    assert builder(f"mesh:{box}?unit=mm")(dof=3).warnings == ()


def ridge(turns: tuple[float, ...], wide_m: float) -> MeshSurface:
    """A bar whose top has faces of one width that fall off by these angles more and more [rad]."""
    slope, outline = 0.0, [(0.0, 0.0)]
    for turn in (0.0, *turns):
        slope -= turn
        x, z = outline[-1]
        outline.append((x + wide_m * np.cos(slope), z + wide_m * np.sin(slope)))
    (far, low), count = outline[-1], len(outline)
    outline = [(0.0, low - 0.05), (far, low - 0.05), *outline[::-1]]
    fan = [(0, k, k + 1) for k in range(1, count + 1)]
    vertices, triangles = extruded(outline, fan, 0.01)
    return MeshSurface.of(vertices, np.asarray(triangles), 40.0)


def flat_with(surface: MeshSurface, turn: float) -> bool:
    """Whether the triangles whose normal is z turned by this angle about y are flat."""
    at = np.abs(surface.facets @ np.array([np.sin(turn), np.cos(turn), 0.0]) - 1.0) < 1e-9
    assert at.any()
    return bool(surface.flat[at].all())


def test_unlike_angles_make_no_curve() -> None:
    """Faces of 40 mm that meet at 2.9 and 30 degrees in turn are no sample of a curve; at 9 and 20 they are."""
    for angles, flat in (((0.05, 0.52, 0.05, 0.52), True), ((0.16, 0.35, 0.16, 0.35), False)):
        assert flat_with(ridge(angles, 0.04), angles[0]) is flat
        assert flat_with(ridge(angles, 0.04), angles[0] + angles[1]) is flat


@pytest.mark.parametrize(("sagitta_m", "flat"), [(4e-5, False), (6e-5, True)])
def test_an_edge_is_smooth_if_that_moves_the_surface_by_less_than_50_um(sagitta_m: float, flat: bool) -> None:
    """Two faces of 10 mm: an arc that meets both in their middles is a h/8 in front of their edge."""
    assert flat_with(ridge((8.0 * sagitta_m / 0.01,), 0.01), 0.0) is flat
