"""Distances from shapes and meshes, against independent methods; files that are read and files that are refused."""

import functools
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.solids import mesh_file
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_file import read_heights, read_mesh
from hapnet.ext.solids.mesh_parts import joined
from hapnet.ext.solids.mesh_surface import volume
from hapnet.plant.worlds.registry import make_scene
from tests.support.solids import SHAPES, stair, torus, write_stl


def nearest_on_triangles(x: Array, corners: Array) -> float:
    """Distance from x (3,) to triangles (F, 3, 3): to the planes where the foot is inside, else to the edges."""
    minimum = np.inf
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        share = np.clip(np.einsum("ij,ij->i", x - a, b - a) / np.einsum("ij,ij->i", b - a, b - a), 0.0, 1.0)
        minimum = min(minimum, np.linalg.norm(x - a - share[:, None] * (b - a), axis=1).min())
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = np.all([
        np.einsum("ij,ij->i", np.cross(corners[:, (i + 1) % 3] - corners[:, i], x - corners[:, i]), normals) >= 0.0
        for i in range(3)
    ], axis=0)  # fmt: skip
    heights = np.abs(np.einsum("ij,ij->i", x - corners[:, 0], normals)) / np.linalg.norm(normals, axis=1)
    return float(min(minimum, heights[inside].min(initial=np.inf)))


def winding(x: Array, corners: Array) -> float:
    """The solid angle of a closed mesh around x over 4 pi (van Oosterom, Strackee 1983): 1 inside, 0 outside."""
    a, b, c = (corners[:, i] - x for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    dots = [np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a))]
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    return float(np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum() / (2.0 * math.pi))


@pytest.mark.parametrize("make", [stair, functools.partial(torus, 10, 7)], ids=["stair", "torus"])
def test_the_distance_from_a_mesh_is_that_of_all_its_triangles(make: Callable[[], tuple[Array, Any]]) -> None:
    vertices, triangles = make()
    mesh, corners = Mesh(vertices, triangles, sharp_deg=0.0), vertices[triangles]
    rng = np.random.default_rng(4)
    places = [rng.uniform(vertices.min(axis=0) - 0.01, vertices.max(axis=0) + 0.01) for _ in range(150)]
    places += [v + 1e-3 * rng.normal(size=3) for v in vertices for _ in range(2)]  # corners and edges are nearest
    inside = 0
    for x in places:
        distance, gradient = mesh.near(tuple(x.tolist()))
        is_inside = winding(x, corners) > 0.5
        assert abs(distance) == pytest.approx(nearest_on_triangles(x, corners), rel=1e-9, abs=1e-12)
        assert (distance < 0.0) is is_inside
        surface = x - distance * np.array(gradient)
        assert nearest_on_triangles(surface, corners) == pytest.approx(0.0, abs=1e-9)
        inside += is_inside
    assert 10 < inside < len(places) - 10


def test_on_its_surface_a_mesh_has_a_normal_too() -> None:
    mesh = Mesh(*stair())
    assert mesh.near((0.005, 0.0, 0.012)).gradient == pytest.approx((0.0, -1.0, 0.0))
    distance, corner = mesh.near((0.0, 0.0, 0.0))
    assert distance == 0.0
    assert corner == pytest.approx((-(3**-0.5),) * 3)


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in ("ripple", "rough sphere")])
def test_a_shape_is_a_distance(name: str) -> None:
    """Its gradient leads to the surface in a straight line, is its slope, and is of unit length."""
    shape, rng = SHAPES[name], np.random.default_rng(6)
    for x in rng.uniform((0.0, -0.06, -0.06), (0.1, 0.06, 0.06), (300, 3)):
        distance, gradient = shape.near(tuple(x.tolist()))
        g = np.array(gradient)
        assert np.linalg.norm(g) == pytest.approx(1.0)
        for share in (0.3, 0.9):  # on the way there
            there = tuple((x - share * distance * g).tolist())
            assert shape.near(there).distance_m == pytest.approx((1.0 - share) * distance, abs=1e-12)
        other = rng.uniform((0.0, -0.06, -0.06), (0.1, 0.06, 0.06))
        assert abs(shape.near(tuple(other.tolist())).distance_m - distance) <= np.linalg.norm(other - x) + 1e-12


def test_a_relief_has_its_own_gradient_and_slope() -> None:
    shape, rng, h = SHAPES["rough sphere"], np.random.default_rng(7), 1e-7
    for x in rng.uniform(-0.02, 0.12, (200, 3)):
        distance, gradient = shape.near(tuple(x.tolist()))
        for axis in range(3):
            ends = [shape.near(tuple((x + side * h * np.eye(3)[axis]).tolist())).distance_m for side in (1.0, -1.0)]
            assert gradient[axis] == pytest.approx((ends[0] - ends[1]) / (2.0 * h), abs=1e-5)
        other = x + rng.normal(0.0, 1e-3, 3)
        change = abs(shape.near(tuple(other.tolist())).distance_m - distance)
        assert change <= shape.slope * np.linalg.norm(other - x)


# -- files ------------------------------------------------------------------------------------------------------------


def export(file: Path, vertices: Array, triangles: Any) -> Path:
    """By the library's own writers, in millimetres."""
    import trimesh

    trimesh.Trimesh(1e3 * vertices, triangles, process=False).export(str(file))
    return file


@pytest.mark.parametrize("kind", ["text.stl", "binary.stl", "some.obj", "some.ply"])
def test_the_formats(tmp_path: Path, kind: str) -> None:
    vertices, triangles = torus(24, 12)
    file = (
        write_stl(tmp_path / kind, vertices, triangles)
        if kind == "text.stl"
        else export(tmp_path / kind, vertices, triangles)
    )
    found, corners = read_mesh(str(file), 1e-3)
    assert len(found) == len(vertices)  # those at the same place are one
    assert len(corners) == len(triangles)
    assert volume(found, corners) == pytest.approx(volume(vertices, triangles), rel=1e-5)
    Mesh(found, corners)


def test_what_is_inside_out_or_degenerate_is_mended(tmp_path: Path) -> None:
    vertices, triangles = stair()
    flipped = np.concatenate([triangles[:, ::-1], [[0, 0, 1]]])
    found, corners, _ = joined(*read_mesh(str(write_stl(tmp_path / "a.stl", vertices, flipped)), 1e-3))
    assert len(corners) == len(triangles)
    assert volume(found, corners) == pytest.approx(5 * 0.01 * 0.01 * 0.02)


def test_a_triangle_without_area_is_no_harm() -> None:
    """A corner in the middle of an edge: the triangle between is flat, and its edges are those of two others."""
    vertices, triangles = stair()
    vertices = np.vstack([vertices, 0.5 * (vertices[0] + vertices[1])])
    new = len(vertices) - 1
    halves = []
    for one in triangles.tolist():
        if {0, 1} <= set(one) and 2 in one:  # of the bottom: split; the side keeps the whole edge
            i = one.index(next(k for k in one if k not in (0, 1)))
            a, b, c = one[i], one[i - 2], one[i - 1]
            halves += [[a, b, new], [a, new, c], [b, c, new]]
        else:
            halves.append(one)
    mesh, plain = Mesh(vertices, np.array(halves)), Mesh(*stair())
    rng = np.random.default_rng(1)
    for x in [*rng.uniform(-0.01, 0.04, (300, 3)), *(vertices[new] + rng.normal(0.0, 1e-3, (100, 3)))]:
        place: Vector = tuple(x.tolist())
        assert mesh.near(place).distance_m == pytest.approx(plain.near(place).distance_m, abs=1e-12)


def bad_files(tmp_path: Path) -> dict[str, str]:
    """Words of scenes that are refused, and what the line says."""
    vertices, triangles = stair()
    solid = write_stl(tmp_path / "solid.stl", vertices, triangles)
    write_stl(tmp_path / "open.stl", vertices, triangles[:-1])
    fin = [*triangles[0, :2], len(vertices)]  # a third triangle at an edge
    write_stl(tmp_path / "fin.stl", np.vstack([vertices, [[0.01, 0.02, 0.5]]]), np.vstack([triangles, [fin]]))
    write_stl(tmp_path / "nan.stl", np.where(vertices == 0.03, np.nan, vertices), triangles)
    contents: dict[str, bytes] = {
        "empty.stl": b"", "words.stl": b"solid x\nno facets\n", "cut.ply": b"ply\nformat binary",
        "far.obj": b"v 1 2 3\nf 1 2 9\n",
        "points.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "uneven.csv": b"1,2\n3\n", "text.csv": b"a,b\nc,d\n",
        "row.csv": b"1,2,3\n",
    }  # fmt: skip
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    mesh = {
        "solid.stl": "the file's unit", "solid.stl?unit=ell": "the file's unit",
        "solid.stl?unit=m": "is the unit right",
        "solid.stl?unit=um": "is the unit right", "open.stl?unit=mm": "a closed mesh",
        "fin.stl?unit=mm": "a closed mesh",
        "nan.stl?unit=mm": "finite", "empty.stl?unit=mm": "not empty", "words.stl?unit=mm": "mesh",
        "cut.ply?unit=mm": "mesh",
        "far.obj?unit=mm": "mesh", "points.obj?unit=mm": "triangles", "none.stl?unit=mm": "can be read",
        "solid.xyz?unit=mm": ".stl, .obj, .ply", "?unit=mm": "a file",
    }  # fmt: skip
    heights = {
        "uneven.csv?unit=mm&spacing=1mm": "rows of numbers", "text.csv?unit=mm&spacing=1mm": "rows of numbers",
        "row.csv?unit=mm&spacing=1mm": "2 rows", "row.csv?unit=mm": "spacing",
        "row.csv?unit=mm&spacing=1mm&facing=y": "facing",
    }  # fmt: skip
    assert solid.exists()
    return {
        **{f"mesh:{tmp_path / words if words[0] != '?' else words}": line for words, line in mesh.items()},
        **{f"heights:{tmp_path / words}": line for words, line in heights.items()},
    }


def test_a_bad_file_is_refused_in_one_line(tmp_path: Path) -> None:
    for words, line in bad_files(tmp_path).items():
        with pytest.raises(InvalidParameter, match="scene ") as caught:
            make_scene(words)
        assert line in str(caught.value), words
        assert "\n" not in str(caught.value)


def test_a_huge_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_stl(tmp_path / "solid.stl", *stair())
    monkeypatch.setattr(mesh_file, "MOST_TRIANGLES", 19)
    with pytest.raises(InvalidParameter, match=r"20 triangles.*19 at most"):
        read_mesh(str(file), 1e-3)
    monkeypatch.setattr(mesh_file, "LARGEST_BYTES", 100)
    with pytest.raises(InvalidParameter, match="MB"):
        read_mesh(str(file), 1e-3)


def test_a_height_field_is_a_solid(tmp_path: Path) -> None:
    """Its surface is at the heights, towards -x, and it is closed behind."""
    file = tmp_path / "heights.csv"
    file.write_text("0, 1, 0\n1, 3, 1\n0 1 2\n")
    vertices, triangles = read_heights(str(file), 1e-3, 0.002)
    mesh = Mesh(vertices, triangles)
    assert mesh.near((-0.003, 0.002, 0.002)).distance_m == pytest.approx(0.0, abs=1e-12)
    assert mesh.near((-0.002, 0.002, 0.002)).distance_m < 0.0
    assert mesh.near((0.009, 0.001, 0.001)).distance_m == pytest.approx(-0.001)  # the back is flat
    # Between the grid's points two triangles: the volume is that of the mean heights over them, and of the back.
    cells = [(0, 1, 1, 3), (1, 0, 3, 1), (1, 3, 0, 1), (3, 1, 1, 2)]  # corners 00, 01, 10, 11
    mean = sum((a + b + d) / 6.0 + (a + c + d) / 6.0 for a, b, c, d in cells)
    assert volume(vertices, triangles) == pytest.approx(4e-6 * (1e-3 * mean + 4 * 0.01))


# -- the words of a scene ---------------------------------------------------------------------------------------------


def shapes_of(words: str) -> list[Any]:
    return [solid.shape for solid in make_scene(words).contacts.solids]  # type: ignore[attr-defined]


def test_the_words_of_a_scene(tmp_path: Path) -> None:
    sphere, plane, cuboid = shapes_of("sphere?radius=20mm + plane?normal=0,0,-2&at=0,0,-3cm + cuboid?size=1cm,2cm,3cm")
    assert (sphere.centre, sphere.radius) == (pytest.approx((0.04, 0.0, 0.0)), 0.02)
    assert (plane.normal, plane.offset) == ((0.0, 0.0, -1.0), pytest.approx(0.03))
    assert (cuboid.centre, cuboid.size) == (pytest.approx((0.025, 0.0, 0.0)), (0.01, 0.02, 0.03))
    (rod,) = shapes_of("cylinder?axis=y&radius=5mm&at=30mm,0,10mm")
    assert (rod.axis, rod.radius, rod.length, rod.centre) == (1, 0.005, 0.06, (0.03, 0.0, 0.01))
    (material,) = make_scene("sphere?stiffness=500&damping=2&friction=0.4", stiffness=100.0).contacts.solids  # type: ignore[attr-defined]
    assert (material.stiffness, material.damping, material.friction) == (500.0, 2.0, 0.4)
    file = write_stl(tmp_path / "a.stl", *stair())
    (placed,), (as_it_is,) = shapes_of(f"mesh:{file}?unit=mm"), shapes_of(f"mesh:{file}?unit=cm&at=file + sphere")[:1]
    assert placed.vertices.min(axis=0) == pytest.approx((0.02, -0.015, -0.01))
    assert as_it_is.vertices.max(axis=0) == pytest.approx((0.3, 0.3, 0.2))


@pytest.mark.parametrize(("words", "line"), [
    ("sphere?radius=20", "a length with its unit"), ("sphere?radius=-3mm", "above 0"),
    ("sphere?at=1mm,2mm", "3 with commas"),
    ("sphere?radius", "KEY=VALUE"), ("sphere?radius=1mm&radius=2mm", "each once"), ("sphere?colour=red", "radius=30mm"),
    ("sphere?friction=-1", "0 or above"), ("sphere + ball", "one of sphere"), ("cylinder?axis=w", "x, y or z"),
    ("plane?normal=0,0,0", "non-zero"), ("sphere?relief=3mm,4mm", "a relief that rises by"),
    ("sphere:a.stl", "no file"), ("sphere?texture=0.8,4mm", "such as friction=0.5&texture=0.8,4mm"),
    ("sphere?friction=0.5&texture=0.8", "such as friction"), ("sphere?friction=0.5&texture=2,4mm", "from 0 to 1"),
    ("sphere?friction=0.5&texture=0.8,4", "a length with its unit"),
    ("sphere?friction=0.5&texture=0.8,0mm", "wavelength"),
    ("sphere?at=0,0,0", "outside all solids"),
])  # fmt: skip
def test_bad_words_are_refused_in_one_line(words: str, line: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        make_scene(words)
    assert line in str(caught.value)


def test_the_command_says_it_with_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_stl(tmp_path / "a.stl", *stair())
    for words in (f"mesh:{file}", f"mesh:{tmp_path}/none.stl?unit=mm", "sphere?radius=3", "sphere?at=0,0,0"):
        assert cli.main(["simulate", "--scene", words, "--duration", "1", "--no-files"]) == 2
        said = capsys.readouterr()
        assert said.err.startswith("hapnet: --scene")
        assert said.err.count("\n") == 1
        assert not said.out


@pytest.mark.parametrize(
    ("absent", "missing"),
    [
        (["igl"], "libigl"),
        (["trimesh"], "trimesh"),
        (["igl", "trimesh", "scipy"], "libigl trimesh scipy"),
    ],
)
def test_without_the_extra_it_says_all_that_is_to_be_installed(
    absent: list[str], missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And nothing that is there."""
    file = write_stl(tmp_path / "a.stl", *stair())
    for module in absent:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibrary, match=rf"of the extra `mesh`.* install {missing}$"):
        make_scene(f"mesh:{file}?unit=mm")


def test_a_run_in_front_of_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_stl(tmp_path / "torus.stl", *torus(24, 12))
    words = f"mesh:{file}?unit=mm&friction=0.3 + sphere?at=0,0,60mm"
    assert cli.main(["simulate", "--scene", words, "--operator", "press", "--duration", "2", "--no-files", "-v"]) == 0
    assert "1 contact" in capsys.readouterr().out
