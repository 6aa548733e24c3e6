"""The triangles of a solid's picture lie on its surface, and the report shows them with the ways around them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapnet import Params, simulate
from hapnet.ext.pictures.page import page
from hapnet.ext.pictures.pictures import pictures
from hapnet.ext.pictures.scene import scene_figure
from hapnet.ext.solids.outlines import outline
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere
from tests.support.solids import torus, write_stl

AROUND = np.array([0.01, -0.02, 0.03])


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        (Sphere((0.01, 0.02, 0.03), 0.03), 4.0 * np.pi * 0.03**2),
        (Cuboid((0.05, 0.0, 0.01), (0.02, 0.03, 0.04)), 2.0 * (0.02 * 0.03 + 0.03 * 0.04 + 0.02 * 0.04)),
        (Cylinder((0.0, 0.05, 0.01), 0.02, 0.05, 1), 2.0 * np.pi * 0.02 * (0.02 + 0.05)),
        (HalfSpace((0.0, 0.6, 0.8), 0.01), 0.1**2),
    ],
    ids=lambda value: type(value).__name__,
)
def test_its_corners_lie_on_the_surface_which_has_its_area(shape: Shape, area: float) -> None:
    found = outline(shape, AROUND, 0.05)
    assert found is not None
    vertices, triangles = found
    assert [shape.near(tuple(corner)).distance_m for corner in vertices.tolist()] == pytest.approx(
        [0.0] * len(vertices), abs=1e-12
    )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0 == pytest.approx(area, rel=0.01)


@pytest.mark.slow
def test_the_report_shows_solids_and_only_those() -> None:
    params = Params().set({"scene": "sphere?radius=20mm + plane?normal=0,0,-1&at=0,0,-30mm", "duration_s": 1.0})
    recording = simulate(params, seed=1).recording
    drawn = pictures(recording)
    assert drawn["scene"].png.startswith(b"\x89PNG")
    assert drawn["scene"].alternative in page(recording, drawn, [])
    assert "scene" not in pictures(simulate(Params().set({"duration_s": 0.5}), seed=1).recording)
    flat = Params().set({"scene": "sphere", "dof": 2, "duration_s": 0.5})
    assert scene_figure(simulate(flat, seed=1).recording) is None


def test_the_largest_force_is_in_its_friction_cone() -> None:
    """At the middle of the sphere's front, where the hand presses: mu is the cone's slope."""
    words = {"scene": "sphere?friction=0.4", "operator_model.start_periods": 0.0, "duration_s": 1.5}
    figure = scene_figure(simulate(Params().set(words), seed=1).recording)
    assert figure is not None
    lines = [np.transpose(line.get_data_3d()) for line in figure.axes[0].get_lines()]
    (rim,) = (line for line in lines if len(line) == 49)
    apex, top = np.array((20.0, 0.0, 0.0)), rim[:-1].mean(axis=0)  # [mm]
    assert apex - top == pytest.approx(np.array((np.linalg.norm(top - apex), 0.0, 0.0)), abs=0.1)
    slopes = np.linalg.norm(rim - top, axis=1) / np.linalg.norm(top - apex)
    assert slopes == pytest.approx([0.4] * 49)
    assert sum(len(line) == 2 and line[1] in rim for line in lines) >= 8


def test_a_recording_holds_its_mesh_and_an_older_one_needs_the_file(tmp_path: Path) -> None:
    file = tmp_path / "ring.stl"
    write_stl(file, *torus())
    recording = simulate(Params().set({"scene": f"mesh:{file}?unit=mm", "duration_s": 0.5}), seed=1).recording
    older = replace(recording, drawing=None, scene=())
    assert scene_figure(older) is not None
    file.unlink()
    assert scene_figure(recording) is not None
    assert scene_figure(older) is None
