"""Solids as functions of the position and as voxels: beside analytic balls, in space and in runs over links."""

from math import cos, dist, hypot, inf, nan, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.solids.field import DistanceFunction, VoxelGrid
from hapnet.ext.solids.rigid import RigidScene, rigid
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import Offset, Shape, Sphere
from hapnet.loading import shared_with_children
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow

CENTRE, RADIUS = (0.05, 0.0, 0.0), 0.03
BALL = Sphere(CENTRE, RADIUS)
PLACES = [(0.0, 0.0, 0.0), (0.021, 0.003, 0.002), (0.0205, 0.001, 0.01), (0.03, 0.01, 0.01), (0.05, 0.031, 0.0)]


def ball(position: Vector) -> float:
    return dist(position, CENTRE) - RADIUS


def quadric(position: Vector) -> float:
    """No distance: its gradient is 2 r."""
    return dist(position, CENTRE) ** 2 - RADIUS**2


def voxels(spacing: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    axis = np.arange(-0.045, 0.0451, spacing)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.sqrt(x * x + y * y + z * z) - RADIUS


def grid(spacing: float = 0.0015) -> VoxelGrid:
    return VoxelGrid(voxels(spacing), [spacing] * 3, [c - 0.045 for c in CENTRE])


@pytest.mark.parametrize("place", PLACES)
def test_a_distance_function_is_the_analytic_ball(place: Vector) -> None:
    """Central differences of 20 um: f'' h^2/6 of a direction, 1e-7."""
    shape = DistanceFunction(ball, "ball")
    here, there = shape.near(place), BALL.near(place)
    assert here.distance_m == pytest.approx(there.distance_m, abs=1e-9)
    assert here.gradient == pytest.approx(there.gradient, abs=2e-7)
    assert hypot(*here.gradient) == pytest.approx(1.0, rel=1e-14)
    assert [one.per_m for one in shape.curvatures(place)] == pytest.approx([1.0 / RADIUS] * 2, rel=1e-4)
    assert shape.slope == 1.0


@pytest.mark.parametrize("place", PLACES[1:3])
def test_what_is_no_distance_is_one_to_first_order(place: Vector) -> None:
    """f/|grad f| = (r^2 - R^2)/2r: wrong by e^2/2r at e from the surface."""
    shape = DistanceFunction(quadric, "quadric")
    e = BALL.near(place).distance_m
    assert shape.near(place).distance_m == pytest.approx(e - e * e / (2.0 * (RADIUS + e)), abs=1e-9)
    assert [one.per_m for one in shape.curvatures(place)] == pytest.approx([1.0 / RADIUS] * 2, rel=0.01)
    assert shape.slope == 2.0


@pytest.mark.parametrize("place", [*PLACES, (-0.05, 0.02, 0.01)])
def test_a_grid_is_the_ball_within_a_share_of_its_voxels(place: Vector) -> None:
    """Linear interpolation is wrong by f'' s^2/8 along each axis, s^2/(4 r) in all; beyond the grid it is a bound."""
    shape, spacing = grid(), 0.0015
    here, there = shape.near(place), BALL.near(place)
    wrong = spacing**2 / (4.0 * dist(place, CENTRE))
    if place[0] < CENTRE[0] - 0.045:
        assert here.distance_m <= there.distance_m
    else:
        assert abs(here.distance_m - there.distance_m) <= wrong
        assert dist(here.gradient, there.gradient) < 2.0 * spacing**2 / RADIUS**2
    assert hypot(*here.gradient) == pytest.approx(1.0, rel=1e-12)


def test_the_middle_of_a_ball_has_no_direction_and_no_number_is_lost() -> None:
    for shape in (DistanceFunction(ball, "ball"), DistanceFunction(quadric, "quadric"), grid()):
        distance, gradient = shape.near(CENTRE)
        assert -2.0 * RADIUS < distance < 0.0
        assert hypot(*gradient) == pytest.approx(1.0)


def test_a_layer_begins_so_deep_and_bends_as_a_smaller_ball() -> None:
    layer = Offset(BALL, 0.01)
    inner = Sphere(CENTRE, RADIUS - 0.01)
    for place in PLACES:
        assert layer.near(place).distance_m == pytest.approx(inner.near(place).distance_m, abs=1e-15)
        expected = [one.per_m for one in inner.curvatures(place)]
        assert [one.per_m for one in layer.curvatures(place)] == pytest.approx(expected, rel=1e-12)


def test_the_force_of_layers_is_the_sum_of_their_springs() -> None:
    """A proxy held at a depth of 8 mm with layers at 0 (500 N/m) and 5 mm (2000 N/m): 4 N and 6 N."""
    solids = [Solid(BALL, 500.0, 0.0), Solid(Offset(BALL, 0.005), 2000.0, 0.0)]
    contacts = RigidContacts(solids, 3)
    force: Any = ()
    for depth in np.linspace(0.0, 0.008, 200):
        x = (CENTRE[0] - RADIUS + depth, 0.0, 0.0)
        force, _ = contacts.solve(1e-3, x, [0.008 / 200 / 1e-3, 0.0, 0.0], lambda v: [1e-9 * one for one in v])
    assert force[0] == pytest.approx(-10.0, rel=0.01)


# -- runs --------------------------------------------------------------------------------------------------------------


def scene(shape: Shape) -> RigidScene:
    return RigidScene("ball", 3, [Solid(shape)])


def pressed(shape: Shape, speed: float) -> list[Vector]:
    """The forces on a proxy of 20 g that is drawn over the ball, 2 mm inside, in steps of 10 ms."""
    world = scene(shape)
    mass = PassiveIntegrator(0.02 * np.eye(3), 14.0 * np.eye(3), 500.0 * np.eye(3), (0.0, 0.0, 0.0))
    forces, work, least = [], 0.0, inf
    for k in range(100):
        angle = min(0.0, -0.5 + speed * max(0, k - 20) * 0.01 / RADIUS)
        r = RADIUS - 0.002
        goal = (CENTRE[0] - r * cos(angle), r * sin(angle), 0.0) if k < 90 else (0.0, 0.0, 0.0)
        step = mass.step(0.01, goal, world.contacts)
        work -= step.work_J
        least = min(least, work - world.contacts.stored_J(step.position))
        forces.append(step.force)
    assert least >= -1e-15  # the account of the solid
    return forces


@pytest.mark.parametrize("speed", [0.05, 0.1])
@pytest.mark.parametrize("kind", ["function", "quadric", "voxels"])
def test_the_force_is_that_of_the_analytic_ball(kind: str, speed: float) -> None:
    """Within 1 % of the largest force, also where the ball is voxels of 1.5 mm or no distance at all."""
    function = DistanceFunction(quadric if kind == "quadric" else ball, kind)
    expected = np.array(pressed(BALL, speed))
    wrong = np.abs(np.array(pressed(grid() if kind == "voxels" else function, speed)) - expected)
    assert float(wrong.max()) <= (0.01 if kind == "function" else 0.03) * float(np.abs(expected).max())


@pytest.mark.parametrize("field", mostly_slow(["gyroid?friction=0.2", "head?layers=6mm,3000"], 1))
def test_the_examples_run_over_a_link(field: str, capsys: pytest.CaptureFixture[str]) -> None:
    scene = f"sdf:examples.fields:{field}"
    argv = ["simulate", "--scene", scene, "--operator", "hand-6", "--link", "4g", "--duration", "2", "--no-files"]
    assert cli.main(argv) == 0
    assert capsys.readouterr().out.startswith("PASSIVE")


# -- words -------------------------------------------------------------------------------------------------------------


def nowhere(position: Vector) -> float:
    return 1.0


def broken(position: Vector) -> float:
    return 1.0 / 0.0


def undefined(position: Vector) -> float:
    return nan


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (nowhere, "below 0 somewhere within 0.12 m"),
        (broken, "a number for each place (the scene sdf:mine failed: ZeroDivisionError"),
        (undefined, "it gave nan at"),
    ],
)
def test_a_function_that_is_no_solid_is_refused(function: Any, words: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        DistanceFunction(function, "mine")
    assert words in str(caught.value)


def test_a_function_that_fails_later_names_the_scene() -> None:
    def fails_inside(position: Vector) -> float:
        return nan if ball(position) < -0.0299 else ball(position)

    shape = DistanceFunction(fails_inside, "mine")
    with pytest.raises(HapnetError, match="the scene sdf:mine failed: it gave nan"):
        shape.near(CENTRE)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sdf", "a file, as in sdf:FILE?unit=mm, or a function of the position"),
        ("sdf:nothing", "a function of the position that is below 0 inside, as module:name"),
        ("sdf:math:pi", "a function of the position"),
        ("sdf:nowhere.npy?unit=mm&spacing=1mm", "No such file"),
        ("sdf:{}?spacing=1mm", "the file's unit after its name"),
        ("sdf:{}?unit=mm", "the distance between two voxels: &spacing=1mm"),
        ("sdf:{}?unit=mm&spacing=1m", "are unit and spacing right?"),
        ("sdf:{}?unit=mm&spacing=1.5mm&iso=much", "iso= and a number"),
        ("sdf:{}?unit=mm&spacing=1.5mm&iso=1e9", "a surface: iso= between"),
        ("sdf:{}?unit=mm&spacing=1.5mm&layers=3", "a depth with its unit and a stiffness for each"),
        ("sdf:{}?unit=mm&spacing=1.5mm&layers=3,500", "a depth with its unit and a stiffness for each"),
    ],
)
def test_what_is_no_field_is_one_line(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "ball.npy", voxels(0.0015) * 1e3)
    given = text.format(tmp_path / "ball.npy")
    assert cli.main(["simulate", "--scene", given, "--duration", "1", "--no-files"]) == 2
    complaint = capsys.readouterr().err
    assert words in complaint
    assert complaint.count("\n") == 1


# -- files -------------------------------------------------------------------------------------------------------------


def test_distances_from_a_file_begin_in_front_of_the_start(tmp_path: Path) -> None:
    np.save(tmp_path / "ball.npy", voxels(0.0015) * 1e3)
    shape = rigid(f"sdf:{tmp_path / 'ball.npy'}?unit=mm&spacing=1.5mm").contacts.solids[0].shape
    assert shape.near((0.02, 0.0, 0.0)).distance_m == pytest.approx(0.0, abs=1e-4)
    assert 0.01 < shape.near((0.0, 0.0, 0.0)).distance_m <= 0.02  # outside the grid: no more than it is


@pytest.mark.parametrize("kind", ["nrrd", "npy"])
def test_an_image_is_cut_at_a_level(kind: str, tmp_path: Path) -> None:
    """A blurred ball of 30 mm, as a scanner sees it: the distance is right to a seventh of a voxel at the surface."""
    spacing = 0.0015
    away = voxels(spacing)
    image = 1000.0 / (1.0 + np.exp(np.clip(away / 0.002, -50.0, 50.0)))  # 500 at the surface
    file = tmp_path / f"ball.{kind}"
    if kind == "nrrd":
        sitk: Any = pytest.importorskip("SimpleITK", reason="the extra volume is not installed")
        made = sitk.GetImageFromArray(image.T)
        made.SetSpacing([1e3 * spacing] * 3)
        sitk.WriteImage(made, str(file))
        text = f"sdf:{file}?iso=500"
    else:
        np.save(file, image)
        text = f"sdf:{file}?unit=mm&spacing=1.5mm&iso=500"
    shape = rigid(text).contacts.solids[0].shape
    assert isinstance(shape, VoxelGrid)
    close = np.abs(away) < spacing
    assert float(np.abs(shape.distances - away)[close].max()) < spacing / 7.0
    far = np.abs(away) > 3.0 * spacing
    assert float(np.abs(shape.distances - away)[far].max()) < spacing
    centre = [low + 0.045 for low in shape.low]
    assert centre == pytest.approx(CENTRE, abs=spacing)


def test_a_function_of_a_notebook_is_a_scene_too() -> None:
    with shared_with_children(lambda position: ball(position), "ball") as name:
        assert rigid(f"sdf:{name}").contacts.solids[0].shape.near((0.0, 0.0, 0.0)).distance_m == pytest.approx(0.02)
