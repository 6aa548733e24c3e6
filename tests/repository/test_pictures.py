"""The pictures of README and the pages: unchanged since they were made, and what they show is what is drawn today.

`python -m examples.pictures NAME` makes a picture again.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from examples.pictures import bilateral, compare
from examples.pictures.__main__ import FILM, RECIPES, Recipe, digest, make, sums
from hapnet.simulation.simulation import simulate
from tests.conftest import ROOT

pytest.importorskip("matplotlib", reason="it draws the pictures")
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo

EXAMPLES = ROOT / "examples"
QUICK = {"run.png", "compare.png", "bilateral.png"}
"""They are drawn again in the default run."""

SECONDS = {"arm.png", "dominoes.png", "grain.png"}
"""They are drawn again in the slow run, the others, which take up to minutes each, in the soak run."""

DRAWN = [recipe for recipe in RECIPES if not set(recipe.pictures) & {compare.FILE.name, bilateral.FILE.name}]


def marks(recipe: Recipe) -> list[pytest.MarkDecorator]:
    names = set(recipe.pictures)
    return [] if names <= QUICK else [pytest.mark.slow] if names <= SECONDS else [pytest.mark.soak]


def changed_by_hand(directory: Path) -> list[str]:
    """The files of a folder that are not as they were made."""
    return [name for name, known in sums().items() if digest(directory / name) != known]


def shown(file: Path) -> dict[str, Any]:
    """What a picture says that it shows."""
    with Image.open(file) as picture:
        text = picture.info.get("Description") or picture.info["comment"].decode()
    found: dict[str, Any] = json.loads(text)
    return found


def older(file: Path, today: Path) -> list[object]:
    """The texts and curves of a picture, and of the same one drawn today, that differ by more than rounding."""
    before, now = shown(file), shown(today)
    texts: list[object] = sorted(set(before["texts"]) ^ set(now["texts"]))
    if len(before["curves"]) != len(now["curves"]):
        return [*texts, len(before["curves"]), len(now["curves"])]
    pairs = zip(before["curves"], now["curves"], strict=True)
    return texts + [pair for pair in pairs if pair[0] != pytest.approx(pair[1], rel=0.01, abs=1e-3)]


def test_no_picture_was_changed_by_hand() -> None:
    assert set(sums()) == {FILM, *(name for recipe in RECIPES for name in recipe.pictures)}
    assert changed_by_hand(EXAMPLES) == []


@pytest.mark.parametrize("name", ["run.png", "play.gif", "compared.csv"])
def test_a_change_by_hand_is_found(name: str, tmp_path: Path) -> None:
    """A dot of one pixel, with all that the file says of itself; or a digit."""
    for known in sums():
        shutil.copyfile(EXAMPLES / known, tmp_path / known)
    assert changed_by_hand(tmp_path) == []
    file = tmp_path / name
    if name.endswith("csv"):
        file.write_text(file.read_text("utf-8").replace("118.92", "118.93", 1), "utf-8")
    elif name.endswith("png"):
        with Image.open(file) as picture:
            about = PngInfo()
            about.add_itxt("Description", picture.info["Description"])
            ImageDraw.Draw(picture).point((5, 5), fill="red")
            picture.save(file, pnginfo=about)
    else:
        with Image.open(file) as film:
            film.save(file, comment=film.info["comment"])
    assert changed_by_hand(tmp_path) == [name]


@pytest.mark.parametrize(
    "recipe",
    [pytest.param(each, id="+".join(each.pictures), marks=marks(each)) for each in DRAWN],
)
def test_a_picture_shows_what_its_commands_draw_today(recipe: Recipe, tmp_path: Path) -> None:
    for module in ("igl", "mujoco", "numba") if "--scene" in " ".join(recipe.commands) else ():
        pytest.importorskip(module, reason=f"{module} is not installed")
    make(recipe, tmp_path)
    for name in recipe.pictures:
        assert older(EXAMPLES / name, tmp_path / name) == []


@pytest.mark.slow
def test_a_picture_of_another_run_or_with_another_label_is_old(tmp_path: Path) -> None:
    today = simulate({"link.up": "4g", "duration_s": 2.0}, seed=1)
    from hapnet.ext.pictures.run import figure
    from hapnet.ext.pictures.style import save_figure

    save_figure(figure(today.recording), tmp_path / "a.png")
    save_figure(figure(today.recording), tmp_path / "b.png")
    assert shown(tmp_path / "a.png")["curves"]
    assert older(tmp_path / "a.png", tmp_path / "b.png") == []
    renamed = figure(today.recording)
    renamed.axes[0].set_ylabel("place [mm]")
    save_figure(renamed, tmp_path / "b.png")
    assert older(tmp_path / "a.png", tmp_path / "b.png") == ["place [mm]", "position [mm]"]
    other = simulate({"link.up": "4g", "duration_s": 2.0, "world.wall.position_m": 0.019}, seed=1)
    save_figure(figure(other.recording), tmp_path / "b.png")
    assert older(tmp_path / "a.png", tmp_path / "b.png") != []


@pytest.mark.soak
@pytest.mark.skipif(not (shutil.which("chromium") or shutil.which("google-chrome")), reason="there is no chromium here")
def test_the_film_shows_the_words_of_todays_page(tmp_path: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")
    from examples.pictures.film import film

    film(tmp_path / FILM, frame_ns=2_000_000_000)
    assert len(shown(tmp_path / FILM)["texts"]) > 20
    assert older(EXAMPLES / FILM, tmp_path / FILM) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_no_label_of_a_scene_is_cut_off(seed: int) -> None:
    """Of an arm that is taller than wide, as the labels of an axis at the bottom were."""
    from hapnet.ext.pictures.scene import scene_figure

    scene = {"scene": "sphere?radius=20mm&at=0,0,-25mm", "hardware": "omni", "operator": "hand-6", "duration_s": 2.0}
    figure = scene_figure(simulate(scene, seed=seed).recording)
    assert figure is not None
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()  # pyright: ignore[reportAttributeAccessIssue]
    axes: Any = figure.axes[0]
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        box = axis.label.get_window_extent(renderer)
        assert axis.label.get_text()
        assert all(figure.bbox.contains(x, y) for x, y in box.corners()), axis.label.get_text()
