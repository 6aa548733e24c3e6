"""Meshes of several parts: what they are as one solid, from volumes and from the same solid made of cuboids."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_parts import joined
from hapnet.ext.solids.mesh_surface import require_closed, volume
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import Cuboid, Shape
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.registry import make_scene
from tests.conftest import mostly_slow
from tests.support.mesh_runs import ball, boxes, words
from tests.support.solids import torus

pytest.importorskip("manifold3d")

BLOCK = ((0.03, 0.0, 0.0), (0.02, 0.02, 0.02))  # 8 cm^3
ASIDE = ((0.04, 0.005, 0.0), (0.02, 0.02, 0.02))  # shares 10 x 15 x 20 mm with it
INSIDE = ((0.03, 0.0, 0.0), (0.01, 0.01, 0.01))
WITHIN = ((0.03, 0.0, 0.0), (0.004, 0.004, 0.004))
ACROSS = ((0.04, 0.0, 0.0), (0.01, 0.008, 0.008))  # half in the block, touching the cavity
FAR = ((0.09, 0.0, 0.0), (0.02, 0.02, 0.02))
BESIDE = ((0.05, 0.0, 0.0), (0.02, 0.02, 0.02))  # has a face in common with the block
AT_AN_EDGE = ((0.05, 0.02, 0.0), (0.02, 0.02, 0.02))
AT_A_CORNER = ((0.05, 0.02, 0.02), (0.02, 0.02, 0.02))

Box = tuple[Sequence[float], Sequence[float]]


def assembly(parts: Sequence[Box], inverted: Sequence[int] = ()) -> tuple[Array, Any]:
    vertices, triangles = boxes(*parts)
    triangles = triangles.copy()
    for i in inverted:
        triangles[12 * i : 12 * i + 12] = triangles[12 * i : 12 * i + 12, ::-1]
    return vertices, triangles


def welded(vertices: Array, triangles: Any) -> tuple[Array, Any]:
    """Vertices at the same place are one, as in a file that is read."""
    _, first, number = np.unique(np.round(vertices, 8), axis=0, return_index=True, return_inverse=True)
    return vertices[first], number.reshape(-1)[triangles]


@pytest.mark.parametrize(("parts", "inverted", "cm3", "said"), [
    ([BLOCK], [], 8.0, []), ([BLOCK], [0], 8.0, ["1 turned"]),
    ([BLOCK, ASIDE], [], 13.0, ["2 that overlap or touch joined into 1"]),
    ([BLOCK, ASIDE], [1], 13.0, ["1 turned", "2 that overlap or touch joined into 1"]),
    ([BLOCK, FAR], [1], 16.0, ["1 turned"]), ([BLOCK, FAR], [], 16.0, []),
    ([BLOCK, INSIDE], [], 8.0, ["2 that overlap or touch joined into 1"]),
    ([BLOCK, INSIDE], [1], 7.0, []), ([BLOCK, INSIDE], [0], 7.0, ["2 turned", "1 kept as a cavity"]),
    ([BLOCK, INSIDE, WITHIN], [1], 7.064, []),
    ([BLOCK, INSIDE, ACROSS], [1], 7.32, ["2 that overlap or touch joined into 1", "1 kept as a cavity"]),
    ([BLOCK, BESIDE], [], 16.0, ["2 that overlap or touch joined into 1"]),
    ([BLOCK, AT_AN_EDGE], [], 16.0, []), ([BLOCK, AT_A_CORNER], [], 16.0, []),
])  # fmt: skip
def test_parts_are_one_solid(parts: Sequence[Box], inverted: Sequence[int], cm3: float, said: list[str]) -> None:
    vertices, triangles, words = joined(*welded(*assembly(parts, inverted)))
    require_closed(triangles)
    assert volume(vertices, triangles) == pytest.approx(1e-6 * cm3)
    assert all(part in words for part in said)
    assert bool(said) is bool(words)
    assert "\n" not in words
    Mesh(vertices, triangles)


def test_a_part_without_volume_is_left_out() -> None:
    vertices, triangles = boxes(BLOCK)
    sheet = np.array([(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0)])
    both = np.concatenate([vertices, sheet]), np.concatenate([triangles, [(8, 9, 10), (8, 10, 9)]])
    _, corners, said = joined(*both)
    assert len(corners) == 12
    assert "1 without volume left out" in said
    with pytest.raises(InvalidParameter, match="none of them encloses a volume"):
        joined(sheet, np.array([(0, 1, 2), (0, 2, 1)]))


def test_without_manifold3d_it_says_what_is_to_be_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    joined(*boxes(BLOCK, FAR))
    with pytest.raises(MissingLibrary, match=r"parts that overlap.* install manifold3d"):
        joined(*boxes(BLOCK, ASIDE))


def test_an_open_mesh_is_refused() -> None:
    vertices, triangles = boxes(BLOCK, ASIDE)
    with pytest.raises(InvalidParameter, match="3 edges that do not fit"):
        joined(vertices, triangles[1:])


def test_it_is_said_in_one_line(tmp_path: Path) -> None:
    scene = make_scene(words(tmp_path, assembly([BLOCK, ASIDE], [1])))
    (line,) = scene.warnings
    assert line.endswith(
        "mesh.stl: of 2 parts: 1 turned, inside out in the file; 2 that overlap or touch joined into 1"
    )
    assert not make_scene(words(tmp_path, boxes(BLOCK))).warnings


# -- as they are felt -------------------------------------------------------------------------------------------------


def forces(shapes: Sequence[Shape], steps_s: tuple[float, float], places: Sequence[Sequence[float]]) -> Array:
    """Of a proxy on a spring of 500 N/m that is held at some places one after the other, and drawn out [N]."""
    contacts = RigidContacts([Solid(shape, 3000.0, 10.0) for shape in shapes], 3)
    mass, rng = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0)), np.random.default_rng(1)
    found = []
    for place in [*places, (-0.01, 0.0, 0.0)]:
        t = 0.0
        while t < 0.6:
            dt = rng.uniform(*steps_s)
            t += dt
            step = mass.step(dt, tuple(place), contacts)
        found.append(step.force)
    assert not np.any(found[-1])
    return np.array(found)


@pytest.mark.parametrize("steps_s", [(0.001, 0.001), (0.010, 0.050)], ids=["1 ms", "10 to 50 ms"])
@pytest.mark.parametrize("inverted", mostly_slow([[], [0], [1]], 1))
def test_overlapping_boxes_are_felt_as_cuboids(inverted: list[int], steps_s: tuple[float, float]) -> None:
    """A ground and a block on it that reaches into it: pressed on the ground, then into the corner, then aside."""
    ground, block = ((0.04, 0.0, 0.0), (0.04, 0.1, 0.1)), ((0.025, 0.02, 0.0), (0.04, 0.02, 0.1))
    vertices, triangles, _ = joined(*assembly([ground, block], inverted))
    places = [(0.026, 0.0, 0.0), (0.026, 0.016, 0.001), (0.015, 0.016, 0.002), (0.026, -0.005, 0.0)]
    one, two = (
        forces([Mesh(vertices, triangles)], steps_s, places),
        forces([Cuboid(*ground), Cuboid(*block)], steps_s, places),
    )
    assert np.abs(one[1, 1]) > 1.0  # sideways
    assert one == pytest.approx(two, abs=0.03 * np.abs(two).max())


def test_a_cavity_is_felt_from_inside() -> None:
    """A hand in a hollow block, whose walls it presses."""
    hollow = assembly([((0.0, 0.0, 0.0), (0.06, 0.06, 0.06)), ((0.0, 0.0, 0.0), (0.03, 0.03, 0.03))], [1])
    vertices, triangles, _ = joined(*hollow)
    contacts = RigidContacts([Solid(Mesh(vertices, triangles), 3000.0, 10.0)], 3)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    for _ in range(600):
        force = mass.step(0.001, (0.022, -0.019, 0.0), contacts).force
    series = 1.0 / (1.0 / 500.0 + 1.0 / 3000.0)
    assert force == pytest.approx((-0.007 * series, 0.004 * series, 0.0), rel=1e-3, abs=1e-6)


@pytest.mark.slow
def test_large_meshes_are_joined_soon() -> None:
    """200,000 triangles: a ring and a ball that overlap."""
    import time

    ring, globe = torus(440, 160), ball(6, 0.02, (0.062, 0.03, 0.0))
    vertices = np.concatenate([ring[0], globe[0]])
    triangles = np.concatenate([ring[1], globe[1] + len(ring[0])])
    assert len(triangles) > 200_000
    began = time.process_time()
    found, corners, said = joined(vertices, triangles)
    Mesh(found, corners)
    assert "2 that overlap or touch joined into 1" in said
    assert time.process_time() - began < 10.0  # a second or two; CPU time of all threads
