"""What was set is used and recorded, whatever its value is; or it is refused in one line."""

import copy
import dataclasses
import json
import pickle
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet import cli
from hapnet.assembly.build import Setup, device_session, device_side, prepare, virtual_mass
from hapnet.assembly.resolve import resolve
from hapnet.assembly.scenes import for_its_scene
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.study.sweep import sweep
from hapnet.param_sources import ASKED, DEFAULT, DEVICE, RULE, SCENE
from hapnet.param_values import Range, flatten
from hapnet.params import DeviceParams, Params, WallParams, WorldParams
from hapnet.realtime.recorder import described
from hapnet.side.endpoint import DeviceEndpoint
from netem import LinkProfile
from tests.conftest import mostly_slow
from tests.support.commands import Capture

HERE = "tests.assembly.own_scenes"
KINDS: dict[str, dict[str, object]] = {
    "wall": {},
    "free": {"scene": "free"},
    "box": {"scene": "box"},
    "named": {"scene": "box?size=0.04&stiffness=900"},
    "paper": {"scene": "paper"},
    "moving": {"scene": "moving", "world.wall.timeline": "at 2s: gone"},
    "joints": {"scene": "joints"},
    "arm": {"scene": "free", "hardware": "omni"},
    "arm by joints": {"scene": "joints", "hardware": "omni?axes=joints"},
    "solid": {"scene": "sphere?radius=20mm + plane"},
    "tool": {"scene": "tool:box + plane"},
    "soft": {"scene": "soft"},
    "mesh": {"scene": "mesh:examples/ring.obj?unit=mm"},
    "mujoco": {"scene": "mujoco:examples/dominoes.xml"},
    "own walls": {"scene": f"{HERE}:corridor"},
    "own hinge": {"scene": f"{HERE}:hinge"},
    "own function": {"scene": f"{HERE}:spring"},
    "own class": {"scene": f"{HERE}:Block"},
    "own device": {"hardware": f"{HERE}:Knob"},
    "follower": {"follower.robot": "simulated"},
    "scaled follower": {"scene": "box", "follower.robot": "simulated", "follower.motion_scale": 0.5},
    "paper's rendering": {"rendering": "paper"},
    "own law": {"coupling": "examples.own_law:Mine"},
    **{law: {"coupling": law} for law in ("zoh", "popc", "tdpa", "eba", "wave", "digital-wave", "pd", "two-layer")},
}
"""Every kind of scene, device, follower and law."""

NEEDED = {"soft": "scipy", "mesh": "scipy", "mujoco": "mujoco"}
NAMES = {"scene", "hardware", "coupling", "follower.robot", "operator"}
"""Their values are not drawn: they name the kind."""

TEXTS: dict[str, list[object]] = {
    "link.up": ["delay 40ms 10ms loss 2%", "", "delay 1ms"], "link.down": ["delay 40ms 10ms loss 2%", "", "delay 1ms"],
    "link.up_timeline": ["", "at 5s: down"], "link.down_timeline": ["", "at 5s: down"], "units": ["auto"],
    "operator_model.columns": ["", "time_ms=stamp x_mm=px"],
    "world.wall.timeline": ["", "at 2s: gone"], "device.dead_man": ["auto", "none"], "device.clutch": ["", "2-3"],
    "device.enable": ["auto", "0-2, 3-6.5"],
}  # fmt: skip
BY_RULE = {("device.stiffness", 0.0), ("dof", 0), ("units", "auto"), ("rendering", "auto")}
"""These values mean that a rule, the scene or the device chooses."""


def values(name: str, default: Any, allowed: Any) -> list[object]:
    """The default itself, what is hardly another, and what clearly is."""
    if isinstance(allowed, tuple):
        return list(allowed)
    if isinstance(default, str):
        return TEXTS[name]
    if isinstance(default, bool):
        return [False, True]
    if isinstance(default, tuple):
        return [default, tuple(2.0 * one for one in default)]
    if isinstance(default, int):
        return [default, default + 1, default + 3]
    found = [default, default * 1.0003, default * 0.5, default * 2.0, 0.0, 0.5]
    return [one for one in found if not isinstance(allowed, Range) or one in allowed]


def cases(kind: str) -> list[tuple[str, object]]:
    leaves = Params().set(KINDS[kind]).leaves()
    return [
        (name, value)
        for name, _, spec in leaves
        if name not in NAMES and name not in KINDS[kind]
        for value in values(name, spec.default, spec.metadata["allowed"])
    ]


def check(kind: str, changes: dict[str, object]) -> Setup | None:
    """What was set is what is used and recorded; None: it was refused, in one line."""
    try:
        asked = Params().set({**KINDS[kind], **changes})
        setup = prepare(asked)
    except HapnetError as error:
        return refused(error)
    used = setup.params
    recorded = json.loads(json.dumps(described(setup, "device", 1, LinkProfile())))
    flat, sources = dict(flatten(recorded["params"])), recorded["sources"]
    for name in changes:
        value = asked.get(name)
        if (name, value) in BY_RULE and used.source(name) not in ASKED:
            assert used.source(name) in (RULE, SCENE, DEVICE)
            continue
        assert used.get(name) == value, (kind, name)
        assert used.source(name) == sources[name] == "program"
        assert json.dumps(flat[name]) == json.dumps(value)
    assert Params.recorded(flat, sources) == used
    parts(setup, changes)
    return setup


def refused(error: HapnetError) -> None:
    assert "\n" not in str(error), error


def parts(setup: Setup, changes: dict[str, object]) -> None:
    """The walls, and the steps of the world, are those of the parameters."""
    wall, world, robot = setup.params.world.wall, setup.params.world, setup.params.follower
    walls = getattr(setup.scene, "walls", ())
    # a follower's walls are in the leader's units: b times the force per 1 / a of the way
    scale = robot.motion_scale * robot.force_scale if robot.robot != "none" else 1.0
    if "world.wall.stiffness" in changes:
        known = setup.scene.stiffnesses or tuple(one.stiffness for one in walls)
        assert not known or any(one == pytest.approx(scale * wall.stiffness, rel=1e-12) for one in known)
    if "world.wall.damping" in changes:
        assert [one.damping for one in walls] == pytest.approx([scale * wall.damping] * len(walls), rel=1e-12)
    rng = np.random.default_rng(1)
    drawn = [setup.scene.next_step_s(rng) for _ in range(5)]
    assert world.step_min_s <= min(drawn) <= max(drawn) <= world.step_max_s


def is_near(case: tuple[str, object]) -> bool:
    """Is the parameter one of the world, whose own defaults may take its place?"""
    return case[0].startswith(("world.", "dof"))


@pytest.mark.parametrize("kind", KINDS)
def test_some_parameters_of_every_kind_are_used_as_they_were_set(kind: str) -> None:
    near = [case for case in cases(kind) if is_near(case)]
    few = 1 if kind in NEEDED else 3  # they take long to build
    checked(kind, [*random.Random(7).sample(near, few), *random.Random(8).sample(cases(kind), few)])


@pytest.mark.parametrize("nth", mostly_slow([24, 6], 0, 1))
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in NEEDED])
def test_every_parameter_is_used_as_it_was_set(kind: str, nth: int) -> None:
    """One after the other: the world's with every kind, each other value with every sixth, or 24th."""
    turn = list(KINDS).index(kind)
    checked(kind, [case for place, case in enumerate(cases(kind), turn) if place % nth == 0 or is_near(case)])


def checked(kind: str, every: list[tuple[str, object]]) -> None:
    for library in [NEEDED[kind]] if kind in NEEDED else []:
        pytest.importorskip(library)
    kept = [case for case in every if check(kind, dict([case])) is not None]
    assert len(kept) > len(every) / 2


@settings(max_examples=40, derandomize=True)
@given(st.sampled_from([kind for kind in KINDS if kind not in NEEDED and kind != "tool"]), st.randoms())
def test_several_at_once_are_used_as_they_were_set(kind: str, draw: random.Random) -> None:
    check(kind, dict(draw.sample(cases(kind), 4)))


@settings(derandomize=True)
@given(st.randoms(), st.sampled_from(["file", "flag", "page", "program"]))
def test_sources_go_wherever_parameters_go(draw: random.Random, source: str) -> None:
    """Through files for other processes, JSON for the servo's, pickles for workers."""
    params = Params().set(dict(draw.sample(cases("wall"), 3)) | {"world.step_max_s": 1.0}, source)
    again = Params().set(json.loads(json.dumps(params.changes())), dict(params.sources))
    for other in (again, pickle.loads(pickle.dumps(params)), eval(repr(params), {"Params": Params})):
        assert other == params
        assert hash(other) == hash(params)
    assert again.sources == pickle.loads(pickle.dumps(params)).sources == params.sources


def test_a_file_keeps_what_is_set_and_from_where(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    params = Params().set({"device.damping": 0.1}, "flag").set({"coupling": "wave", "wave.impedance": 0.0}, "page")
    file.write_text(params.toml(sources=True), "utf-8")
    for before in (Params(), Params().set({"link.up": "", "duration_s": 0.0}, "command")):  # what it begins with
        read = before.load(file)
        assert (read, read.sources) == (params, params.sources)
    file.write_text(params.toml(), "utf-8")
    assert (Params().load(file), {source for _, source in Params().load(file).sources}) == (params, {"file"})
    file.write_text('[sources]\n"dof" = "oracle"\n', "utf-8")
    with pytest.raises(InvalidParameter, match=r"^sources\.dof is 'oracle'; allowed: one of command, "):
        Params().load(file)


def test_what_is_set_to_its_default_is_set() -> None:
    plain, asked = Params(), Params().set({"device.damping": 0.1})
    assert (plain.source("device.damping"), asked.source("device.damping")) == (DEFAULT, "program")
    assert asked != plain
    assert asked.unset("device.damping") == plain
    assert "; set by: program" in next(line for line in asked.toml().splitlines() if line.startswith("damping = 0.1 "))
    assert "# damping = 0.1 " in plain.toml()


@pytest.mark.parametrize(
    ("base", "name", "by_default", "asked"),
    [
        ({"scene": "joints"}, "device.damping", 0.001, (0.1, 0.1001)),
        ({"scene": "joints"}, "world.stiffness", 5.0, (500.0, 501.0)),
        ({"scene": "joints"}, "world.wall.stiffness", 30.0, (3000.0, 3001.0)),
        ({"scene": "joints"}, "device.force_limit_N", 0.33, (3.3, 3.31)),
        ({"scene": f"{HERE}:corridor"}, "world.wall.stiffness", 500.0, (2999.0, 3000.0, 3001.0)),
        ({"scene": f"{HERE}:corridor"}, "world.step_max_s", 0.02, (0.05, 0.051)),
        ({"scene": f"{HERE}:hinge"}, "world.wall.stiffness", 7.0, (3000.0, 30.0)),
    ],
)
def test_defaults_of_a_scene_are_overridden_by_any_value(
    base: dict[str, object], name: str, by_default: float, asked: tuple[float, ...]
) -> None:
    plain = prepare(base).params
    assert plain.get(name) == pytest.approx(by_default, rel=1e-12)
    assert plain.source(name) == SCENE
    assert [prepare({**base, name: value}).params.get(name) for value in asked] == list(asked)


def test_a_ceiling_that_was_set_does_not_follow_a_stiff_spring() -> None:
    device = {"device.own_damping": 3.0, "device.watchdog_s": 0.03}
    plain, asked = prepare(device).params, prepare({**device, "device.ceiling_J": 0.1}).params
    assert plain.device.ceiling_J > 0.1
    assert (plain.source("device.ceiling_J"), asked.device.ceiling_J) == (RULE, 0.1)
    assert asked.device.stiffness < plain.device.stiffness


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scene": "box?size=0.02", "world.wall.half_width_m": 0.03}, "is 0.03; allowed: 0.02, or left out: the scene"),
        (
            {"hardware": "omni", "scene": "free", "device.mass": 0.045},
            "is 0.045; allowed: left out with the device omni",
        ),
        ({"hardware": f"{HERE}:Knob", "device.servo_hz": 1000.0}, "is 1000.0; allowed: at most 500, as the device"),
        ({"follower.robot": "simulated", "world.step_max_s": 0.05}, "is 0.05; allowed: left out with a follower"),
        (
            {"scene": "free", "world.wall.stiffness": 3000.0},
            "3000.0: the scene free does not read it; leave it out",
        ),
        ({"scene": f"{HERE}:hinge", "world.step_max_s": 0.05}, "0.05: the scene tests.assembly"),
        *[
            ({"hardware": f"{HERE}:Knob", name: value}, f"is {value!r}; allowed: left out with the device {HERE}:Knob:")
            for name, value in {
                "device.mass": 0.045,
                "device.own_damping": 0.3,
                "device.substeps": 4,
                "operator": "press",
                "operator_model.mass": 0.554,
                "operator_model.reach_s": 2.0,
            }.items()
        ],
    ],
)
def test_what_would_not_be_used_is_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        prepare(changes)
    name = list(changes)[-1]
    assert str(caught.value).startswith(f"{name} {said}")
    prepare(Params().set(changes).unset(name))


def test_another_scene_gets_what_it_reads_and_the_first_one_all_of_it_again() -> None:
    asked = Params().set({"world.wall.stiffness": 900.0, "world.step_max_s": 0.04})
    free = for_its_scene(asked.set({"scene": "free"}))
    assert free == Params().set({"scene": "free", "world.step_max_s": 0.04})
    prepare(free)
    assert for_its_scene(asked) == asked


def test_a_law_goes_by_what_is_known_of_a_real_devices_damping() -> None:
    """Not by `device.own_damping`, which is the simulated device's."""
    knob: dict[str, object] = {"hardware": f"{HERE}:Knob", "coupling": "eba"}
    with pytest.raises(InvalidParameter, match=r"^device\.trusted_damping is 0\.0; allowed: above 0 with"):
        prepare(knob)
    assert prepare({**knob, "device.trusted_damping": 0.2}).tuning.damping_Ns_m == 0.2
    assert prepare({"coupling": "eba"}).tuning.damping_Ns_m == 0.3
    held = prepare({**knob, "coupling": "pd", "device.trusted_damping": 0.2}).warnings
    assert any("with 0.2 Ns/m of damping in the device itself" in one for one in held)


def test_a_section_made_by_hand_sets_what_it_is_made_with() -> None:
    """Also to the default; a copy of it by `replace`, which is made with everything, only what is not the default."""
    made = Params(
        device=DeviceParams("auto", damping=0.1), world=WorldParams(wall=WallParams(stiffness=3000.0)), duration_s=10.0
    )
    names = {"device.servo", "device.damping", "world.wall.stiffness", "duration_s"}
    assert made.given == names
    assert {source for _, source in made.sources} == {"program"}
    assert made == Params().set({name: Params().get(name) for name in names})
    assert made.unset(*names) == Params()
    assert made.set({"dof": 2}).given == names | {"dof"}
    for other in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made), dataclasses.replace(made)):
        assert (other, other.given) == (made, names)
    plain = Params()
    assert dataclasses.replace(plain, link=dataclasses.replace(plain.link, up="4g")).given == {"link.up"}
    corridor = Params(scene=f"{HERE}:corridor", world=WorldParams(wall=WallParams(stiffness=3000.0)))
    assert prepare(corridor).params.world.wall.stiffness == 3000.0


@pytest.mark.parametrize(
    "changes",
    [
        {"device.force_limit_N": 3.3}, {"device.resolution_m": 0.0}, {"device.greatest_speed": 1.0},
        {"device.workspace_m": 2.0}, {"device.stiffness_range": (1.0, 1e5)},
    ],
    ids=str,
)  # fmt: skip
def test_what_a_device_declares_cannot_be_set_to_something_else(changes: dict[str, object]) -> None:
    def side(own: dict[str, object]) -> None:
        setup = prepare({"hardware": f"{HERE}:Knob", **own})
        endpoint = DeviceEndpoint(device_session(setup, 1))
        device_side(setup, endpoint, lambda: 0, lambda sample: None)

    side({})
    side({"device.force_limit_N": 1.0, "device.resolution_m": 1e-5})
    with pytest.raises(InvalidParameter, match=f"^{next(iter(changes))} is "):
        side(changes)


@pytest.mark.parametrize("kind", ["wall", "joints", "named", "arm", "own hinge", "own device", "follower", "paper"])
def test_resolved_again_nothing_changes(kind: str) -> None:
    once = resolve(Params().set(KINDS[kind])).params
    again = resolve(once).params
    assert (again, again.sources) == (once, once.sources)
    assert virtual_mass(prepare(once)).position == virtual_mass(prepare(KINDS[kind])).position


def test_a_sweep_tabulates_what_was_run() -> None:
    """Of a world whose own default is 500 N/m: the wall is pressed less deep, the stiffer it is."""
    fixed = {
        "scene": f"{HERE}:corridor", "duration_s": 1.6, "link": "", "device.stiffness": 400.0,
        "operator_model.reach_s": 0.5, "world.damping": 14.0,
    }  # fmt: skip
    stiffnesses = [500.0, 2000.0, 3000.0, 4000.0]
    found = sweep({"fixed": fixed, "vary": {"world.wall.stiffness": stiffnesses}})
    assert found.columns["world.wall.stiffness"] == stiffnesses
    assert found.columns["error"] == [None] * len(stiffnesses)
    peaks = found.columns["peak_force_N"]
    assert peaks == sorted(set(peaks))


def test_the_command_line_overrides_a_scenes_default(capsys: Capture) -> None:
    said = []
    for value in (2999, 3000, 3001):
        words = ["simulate", "--scene", f"{HERE}:corridor", "--set", f"world.wall.stiffness={value}"]
        assert cli.main([*words, "--duration", "0.1", "--no-files", "--json", "-"]) == 0
        said.append(json.loads(capsys.readouterr().out)["environment"]["stiffness_N_m"])
    assert said == [2999.0, 3000.0, 3001.0]
