import inspect
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapnet
from hapnet.assembly.build import prepare
from hapnet.errors import InvalidParameter
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scenes import SCENES
from hapnet.plant.worlds.protocol import Surface
from hapnet.plant.worlds.registry import make_scene, scene_parameters
from hapnet.plant.worlds.scene import Scene


class Corridor(Scene):
    """A user's own scene: two dimensions, nothing in the way, steps of one length."""

    def __init__(self, *, step_s: float = 0.02) -> None:
        super().__init__("corridor", 2, (), step_s, step_s)


def not_a_scene() -> str:
    return "scene"


def a_scene_without_its_file() -> Scene:
    raise OSError("walls.stl is not there")


SOMETHING = 3


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_a_world_to_step_in(name: str) -> None:
    rng = np.random.default_rng(1)
    scene = make_scene(name)
    assert scene.name == name
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, scene.start)
    assert scene.contacts.penetration(scene.start) == 0.0
    for _ in range(50):
        integrator.step(scene.next_step_s(rng), tuple(rng.normal(0.0, 0.05, scene.dof).tolist()), scene.contacts)


def test_section_4s_wall() -> None:
    scene = make_scene("wall")
    (wall,) = scene.walls
    assert (scene.dof, wall.normal, wall.offset, wall.stiffness, wall.damping) == (1, (1.0,), 0.02, 3000.0, 10.0)
    assert (scene.min_s, scene.max_s) == (0.010, 0.050)
    assert [len(make_scene("wall", dof=n).walls[0].normal) for n in (1, 2, 3)] == [1, 2, 3]


def test_paper_is_free_above_and_solid_below() -> None:
    scene = make_scene("paper")
    assert scene.contacts.penetration((0.3, -0.2, 0.001)) == 0.0
    assert scene.contacts.penetration((0.3, -0.2, -0.001)) == pytest.approx(0.001)
    raised = make_scene("paper", height=0.05)
    assert raised.contacts.penetration((0.0, 0.0, 0.04)) == pytest.approx(0.01)
    assert raised.start == (0.0, 0.0, 0.05)


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_box_is_closed_on_every_side(dof: int) -> None:
    scene = make_scene("box", dof=dof, size=0.04)
    for axis in range(dof):
        for side in (1.0, -1.0):
            corner = [0.0] * dof
            corner[axis] = side * 0.05
            assert scene.contacts.penetration(corner) == pytest.approx(0.01)
    assert scene.contacts.penetration([0.039] * dof) == 0.0
    assert len(scene.walls) == 2 * dof


def test_surfaces_for_plots() -> None:
    assert make_scene("free").surfaces == ()
    assert make_scene("wall", position=0.01, dof=2).surfaces == (Surface(0, 0.01, 1),)
    assert make_scene("paper", height=-0.02).surfaces == (Surface(2, -0.02, -1),)
    assert make_scene("box", dof=2).surfaces == (
        Surface(0, 0.03, 1),
        Surface(0, -0.03, -1),
        Surface(1, 0.03, 1),
        Surface(1, -0.03, -1),
    )


def test_step_times_are_uniform_in_their_range_and_seeded() -> None:
    scene = make_scene("wall")
    draws = np.array([scene.next_step_s(rng) for rng in [np.random.default_rng(7)] for _ in range(20_000)])
    assert draws.min() >= 0.010
    assert draws.max() <= 0.050
    # Kolmogorov's 1 in 1000 bound on the distance between the empirical and the uniform distribution.
    distance = np.abs(np.sort(draws) - 0.010 - 0.040 * np.arange(draws.size) / draws.size).max() / 0.040
    assert distance < 1.95 / np.sqrt(draws.size)
    again = np.random.default_rng(7)
    assert [scene.next_step_s(again) for _ in range(5)] == draws[:5].tolist()
    fixed = make_scene("wall", step_min_s=0.003, step_max_s=0.003)
    assert fixed.next_step_s(again) == 0.003


def test_scene_of_ones_own() -> None:
    scene = make_scene(f"{__name__}:Corridor", step_s=0.004)
    assert scene.next_step_s(np.random.default_rng(0)) == 0.004
    assert scene_parameters(f"{__name__}:Corridor") == {"step_s": 0.02}


def test_parameters_and_defaults_are_told() -> None:
    assert scene_parameters("wall") == {
        "dof": 1,
        "position": 0.02,
        "stiffness": 3000.0,
        "damping": 10.0,
        "step_min_s": 0.010,
        "step_max_s": 0.050,
    }
    assert scene_parameters("box")["size"] == 0.03
    assert all(p is not inspect.Parameter.empty for name in SCENES for p in scene_parameters(name).values())


@pytest.mark.parametrize(
    ("name", "parameters", "says"),
    [
        (
            "nothing",
            {},
            "free, wall, .*, plane, tool, shared:block, soft, grip, mujoco:FILE.xml, or module:Name",
        ),
        ("nowhere:Scene", {}, "nowhere"),
        (f"{__name__}:Missing", {}, "Missing"),
        (f"{__name__}:", {}, "module:Name"),
        (f"{__name__}:SOMETHING", {}, "class or function"),
        (f"{__name__}:not_a_scene", {}, "a world, such as hapnet.Scene"),
        ("free", {"stiffness": 3.0}, "stiffness"),
        ("wall", {"dof": 0}, "dof is 0"),
        ("wall", {"dof": 4}, "dof is 4"),
        ("wall", {"dof": 1.0}, "dof is 1.0"),
        ("wall", {"stiffness": -1.0}, "stiffness is -1.0"),
        ("wall", {"damping": -1.0}, "damping is -1.0"),
        ("wall", {"position": -0.01}, r"outside walls\[0\]"),
        ("wall", {"position": float("nan")}, "position is nan"),
        ("paper", {"height": "low"}, "height is 'low'"),
        ("free", {"step_min_s": "10ms"}, "step_min_s is '10ms'"),
        ("box", {"size": 0.0}, "size is 0.0"),
        ("paper", {"dof": 2}, "dof is 2"),
        ("wall", {"step_min_s": 0.0}, "step_min_s is 0.0"),
        ("wall", {"step_min_s": 0.06}, "step_max_s is 0.05"),
        ("wall", {"step_max_s": float("inf")}, "step_max_s is inf"),
    ],
)
def test_bad_input_is_one_clear_line(name: str, parameters: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidParameter, match=says) as caught:
        make_scene(name, **parameters)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("tests.plant.worlds.test_scene:a_scene_without_its_file", "OSError: walls.stl is not there"),
        ("broken_scene:walls", "SyntaxError"),
        ("builtins:dict", "named parameters"),
    ],
)
def test_a_scene_of_the_users_that_raises_is_one_line(
    name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_scene.py").write_text("def walls(:\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidParameter) as caught:
        make_scene(name)
    assert str(caught.value).startswith(f"scene is '{name}'")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", SCENES)
def test_a_mass_may_begin_towards_any_place_and_only_a_wall_stops_it(name: str) -> None:
    """Never inside a wall, always on the way, and no sooner than a step of 1 um more would be inside one."""
    rng = np.random.default_rng(2)
    scene = make_scene(name)
    start = np.array(scene.start)
    stopped = 0
    for _ in range(300):
        goal = start + rng.normal(size=scene.dof) * 10.0 ** rng.uniform(-6, 6)
        place = np.array(scene.towards(tuple(goal.tolist())))
        assert scene.contacts.penetration(tuple(place.tolist())) <= 0.0
        way = goal - start
        share = (place - start) @ way / (way @ way)
        assert place == pytest.approx(start + share * way, rel=1e-9, abs=1e-12)
        if scene.contacts.penetration(tuple(goal.tolist())) > 0.0:
            stopped += 1
            beyond = place + way / np.linalg.norm(way) * max(1e-6, 1e-8 * np.linalg.norm(place))
            assert any(wall.penetration(tuple(beyond.tolist())) > -1e-6 for wall in scene.walls)
        else:
            assert share == pytest.approx(1.0)
    assert (stopped > 0) == bool(scene.walls)


@pytest.mark.slow
def test_the_pages_example_is_a_world_once_it_is_in_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "hapnet"
    shutil.copytree(Path(hapnet.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
    page = (folder / "README.md").read_text("utf-8").partition("**A world.**")[2]
    (folder / "plant/scenes/corridor.py").write_text(page.partition("```python\n")[2].partition("```")[0], "utf-8")

    def run(scene: str, code: int = 0) -> str:
        words = ["simulate", "--no-files", "--scene", scene, "--operator", "sine", "--duration", "2", "--json", "-"]
        command = [sys.executable, "-m", "hapnet", *words, "--set", "world.wall.stiffness=800"]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert ended.returncode == code, ended.stderr
        return ended.stdout or ended.stderr

    narrow, wide = (json.loads(run(f"corridor{words}")) for words in ("?width=0.01", "?width=0.9"))
    assert narrow["verdict"]["passive"] is True
    assert (narrow["motion"]["contacts"] > 0) > wide["motion"]["contacts"]
    assert "did you mean width?" in run("corridor?with=0.01", 2)
    assert "a number, such as width=0.04" in run("corridor?width=narrow", 2)
    code = "from hapnet.commands.complete import scenes; print(dict(scenes())['corridor'])"
    said = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert said.stdout == "A corridor along the last axis, `width` [m] wide.\n"


def test_what_stands_behind_a_name_is_used_and_another_set_value_is_refused() -> None:
    given = {"scene": "wall?position=0.015&dof=2", "world.wall.stiffness": 500.0}
    for setup in (prepare(given), prepare({**given, "world.wall.position_m": 0.015})):
        (wall,) = setup.scene.walls
        assert (setup.dof, wall.offset, wall.stiffness) == (2, 0.015, 500.0)
        assert not setup.warnings
    with pytest.raises(
        InvalidParameter, match=r"^world\.wall\.position_m is 0\.03; allowed: 0\.015, or left out: the scene"
    ):
        prepare({**given, "world.wall.position_m": 0.03})
