"""Doubled and flipped triangles: the solid is that of the clean mesh, and a line says what was done."""

from pathlib import Path

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.mesh_mending import mended
from hapnet.ext.solids.mesh_parts import joined
from hapnet.ext.solids.mesh_surface import Triangles, require_closed, volume
from hapnet.plant.worlds.registry import make_scene
from tests.support.mesh_runs import ball, boxes

BLOCK = ((0.03, 0.0, 0.0), (0.02, 0.02, 0.02))  # 8 cm^3
FAR = ((0.09, 0.0, 0.0), (0.02, 0.02, 0.02))


def of(kind: str) -> tuple[Array, Triangles]:
    if kind == "ball":
        return ball(2, 0.02, (0.0, 0.0, 0.0))
    return boxes(BLOCK, FAR) if kind == "two blocks" else boxes(BLOCK)


def same(one: Triangles, other: Triangles) -> bool:
    """Whether the triangles are the same, in any order, and face the same ways."""

    def rows(triangles: Triangles) -> set[tuple[int, ...]]:
        return {tuple(np.roll(row, -int(row.argmin())).tolist()) for row in triangles}

    return len(one) == len(other) and rows(one) == rows(other)


@pytest.mark.parametrize("kind", ["block", "two blocks", "ball"])
def test_doubled_triangles_are_left_out(kind: str) -> None:
    _, triangles = of(kind)
    some = triangles[[0, 3, 5]]
    found, notes = mended(np.concatenate([triangles, np.roll(some, 1, axis=1), some]))
    assert same(found, triangles)
    assert notes == ["6 doubled triangles left out"]


@pytest.mark.parametrize("kind", ["block", "two blocks", "ball"])
def test_of_a_double_sided_surface_one_side_stays(kind: str) -> None:
    vertices, triangles = of(kind)
    found, notes = mended(np.concatenate([triangles, triangles[:, ::-1]]))
    assert same(found, triangles)
    assert notes == [f"{len(triangles)} doubled triangles left out"]
    shuffled = np.concatenate([triangles[::2], triangles[:, ::-1], triangles[1::2]])
    again, parts, _ = joined(vertices, shuffled)
    require_closed(parts)
    assert volume(again, parts) == pytest.approx(volume(vertices, triangles))


@pytest.mark.parametrize("kind", ["block", "two blocks", "ball"])
@pytest.mark.parametrize("flipped", [[1], [0, 4, 7, 9]])
def test_flipped_triangles_are_turned(kind: str, flipped: list[int]) -> None:
    _, triangles = of(kind)
    wrong = triangles.copy()
    wrong[flipped] = wrong[flipped, ::-1]
    with pytest.raises(InvalidParameter, match="edges that do not fit"):
        require_closed(wrong)
    found, notes = mended(wrong)
    assert same(found, triangles)
    assert notes == [f"{len(flipped)} triangles turned, inside out in the file"]


def test_a_clean_mesh_stays_as_it_is() -> None:
    _, triangles = boxes(BLOCK, ((0.05, 0.0, 0.0), (0.02, 0.02, 0.02)))  # they have a face in common
    found, notes = mended(triangles)
    assert np.array_equal(found, triangles)
    assert notes == []


def test_an_open_mesh_is_still_refused() -> None:
    vertices, triangles = of("block")
    with pytest.raises(InvalidParameter, match="3 edges that do not fit"):
        joined(vertices, triangles[1:])


def test_a_scene_says_what_was_mended(tmp_path: Path) -> None:
    vertices, triangles = of("block")
    wrong = np.concatenate([triangles, triangles[:1]])
    wrong[3] = wrong[3, ::-1]
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (wrong + 1).tolist()]
    file = tmp_path / "block.obj"
    file.write_text("\n".join(lines))
    scene = make_scene(f"mesh:{file}?unit=m&at=file")
    assert any("1 doubled triangles left out; 1 triangles turned" in line for line in scene.warnings)
    assert scene.contacts.penetration((0.03, 0.0, 0.0)) == pytest.approx(0.01)
