import re
from pathlib import Path

import numpy as np
import pytest

from hapnet.assembly.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.plant.operator import Impedance, Rest
from hapnet.plant.scenes.box import box_walls
from hapnet.plant.worlds.scene import Scene
from hapnet.recording.samples import Sample
from hapnet.side.continuous_device import ContinuousDeviceSide
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.side.world import WorldSide
from netem import LinkProfile
from netem.errors import NetemError
from tests.support.paper import PAPER


def setup_of(default_servo: str = "continuous", /, **changes: object) -> Setup:
    params = PAPER.set({name.replace("__", "."): value for name, value in changes.items()})
    return prepare(params, default_servo)


def discard(sample: Sample) -> None:
    """Nobody records."""


def device(setup: Setup) -> DeviceSide:
    return device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, discard)


def world(setup: Setup) -> WorldSide:
    return world_side(setup, WorldEndpoint(world_session(setup, 2)), np.random.default_rng(0), discard)


class OwnHand(Rest):
    """A hand from outside, as module:Class."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, (0.01,) * dof)


class OwnHandWithoutArguments:
    """Not what module:Class must be."""


class OwnHandWithoutFile:
    """A hand whose recording is gone."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        raise FileNotFoundError("hand.bin is\nnot there")


class OwnHandWithoutReference:
    """Takes what it is given, and is no hand."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance


class OwnHandWithoutImpedance:
    """Knows where to go, and not how."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self._rest = (0.0,) * dof

    def reference(self, time: float) -> Vector:
        return self._rest


def own_scene(*, dof: int = 2, size: float = 0.07, stiffness: float = 800.0, step_max_s: float = 0.02) -> Scene:
    """A scene from outside, with defaults of its own."""
    return Scene("own", dof, box_walls(dof, size, stiffness, 1.0), 0.01, step_max_s)


@pytest.mark.parametrize(
    ("default", "servo", "harvest", "expected"),
    [
        ("continuous", "auto", "auto", ("continuous", "range")),
        ("sampled", "auto", "auto", ("sampled", "measured")),
        ("sampled", "continuous", "auto", ("continuous", "range")),
        ("continuous", "sampled", "auto", ("sampled", "measured")),
        ("continuous", "sampled", "range", ("sampled", "range")),
    ],
)
@pytest.mark.long
def test_auto_stands_for_the_commands_own(default: str, servo: str, harvest: str, expected: tuple[str, str]) -> None:
    setup = setup_of(default, device__servo=servo, device__harvest=harvest)
    assert (setup.servo, setup.harvest) == expected
    assert isinstance(device(setup), ContinuousDeviceSide if setup.servo == "continuous" else SampledDeviceSide)


@pytest.mark.parametrize(("scene", "dof"), [("free", 1), ("wall", 1), ("box", 3), ("paper", 3)])
@pytest.mark.parametrize("operator", ["rest", "sine", "press"])
def test_every_named_operator_fits_every_named_scene(scene: str, dof: int, operator: str) -> None:
    setup = setup_of(scene=scene, operator=operator)
    assert setup.dof == dof
    assert len(device(setup).device.read()[0]) == dof
    assert len(world(setup).mass.position) == dof


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"device__servo": "continuous", "device__harvest": "measured"}, "device.harvest"),
        ({"device__servo": "continuous", "device__resolution_m": 1e-5}, "device.resolution_m"),
        ({"device__servo": "sampled", "device__harvest": "range", "device__trusted_damping": 0.1}, "trusted_damping"),
        ({"device__spring_share": 1.5}, "device.spring_share"),
        ({"scene": "nosuch"}, "scene"),
        ({"dof": 4, "scene": "free"}, "dof"),
        ({"hardware": "tests.assembly.test_user_device:Still"}, "device.servo"),
        ({"scene": "wall", "world__wall__position_m": -0.01}, r"world\.wall\.position_m is -0\.01"),
    ],
)
def test_what_does_not_fit_together_is_named(changes: dict[str, object], name: str) -> None:
    with pytest.raises(InvalidParameter, match=name):
        setup_of(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"device__stiffness": ((100, 0), (0, 100))},
        {"scene": "free", "dof": 2, "device__stiffness": ((1, 2), (2, 1))},
        {"scene": "free", "dof": 2, "device__stiffness": ((1, 2), (0, 1))},
        {"scene": "free", "dof": 2, "device__damping": (0.1, 0.1, 0.1)},
        {"scene": "free", "dof": 2, "device__damping": (0.1, -0.1)},
        {"operator": "nosuch"},
        {"operator": "nosuch.csv"},
        {"operator": "tests.assembly.test_build:Nosuch"},
        {"operator": "tests.assembly.test_build:OwnHandWithoutArguments"},
        {"operator": "tests.assembly.test_build:OwnHandWithoutReference"},
        {"operator": "tests.assembly.test_build:OwnHandWithoutImpedance"},
    ],
)
@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_a_device_that_cannot_be_is_refused_when_it_is_made(changes: dict[str, object], servo: str) -> None:
    with pytest.raises(InvalidParameter):
        device(setup_of(servo, **changes))


@pytest.mark.parametrize("name", ["stiffness", "damping", "mass"])
def test_a_world_that_cannot_be_is_refused_when_it_is_made(name: str) -> None:
    with pytest.raises(InvalidParameter, match=rf"^world\.{name} is"):
        world(setup_of(**{f"world__{name}": ((1, 2), (2, 1)), "scene": "free", "dof": 2}))


@pytest.mark.parametrize("servo", ["continuous", "sampled"])
@pytest.mark.parametrize("name", ["stiffness", "damping"])
def test_a_device_that_cannot_be_is_named_as_its_user_knows_it(name: str, servo: str) -> None:
    with pytest.raises(InvalidParameter, match=rf"^device\.{name} is"):
        device(setup_of(servo, **{f"device__{name}": ((1, 2), (2, 1)), "scene": "free", "dof": 2}))


def test_a_hand_that_raises_is_one_line_with_the_cause() -> None:
    name = "tests.assembly.test_build:OwnHandWithoutFile"
    with pytest.raises(InvalidParameter) as caught:
        device(setup_of(operator=name))
    assert str(caught.value).startswith(f"operator is '{name}'")
    assert str(caught.value).endswith("(FileNotFoundError: hand.bin is not there)")


def test_a_scene_from_outside_keeps_its_own_defaults() -> None:
    name = "tests.assembly.test_build:own_scene"
    setup = setup_of(scene=name)
    wall = setup.scene.walls[0]
    assert (setup.dof, wall.offset, wall.stiffness, setup.scene.max_s) == (2, 0.07, 800.0, 0.02)
    assert setup.warnings == ()
    setup = setup_of(scene=name, dof=1, world__wall__stiffness=900.0, world__wall__half_width_m=0.05)
    wall = setup.scene.walls[0]
    assert (setup.dof, wall.offset, wall.stiffness, setup.scene.max_s) == (1, 0.05, 900.0, 0.02)


@pytest.mark.parametrize(
    ("scene", "name", "read"),
    [
        ("free", "wall.stiffness", False),
        ("free", "wall.position_m", False),
        ("free", "step_max_s", True),
        ("wall", "wall.half_width_m", False),
        ("wall", "wall.position_m", True),
        ("box", "wall.position_m", False),
        ("box", "wall.half_width_m", True),
        ("paper", "wall.position_m", False),
        ("paper", "wall.damping", True),
        ("tests.assembly.test_build:own_scene", "wall.damping", False),
        ("tests.assembly.test_build:own_scene", "step_max_s", True),
        ("tests.assembly.test_build:Steps", "step_max_s", True),
        ("tests.assembly.test_build:OwnSteps", "step_max_s", False),
    ],
)
def test_parameters_that_the_scene_does_not_read_are_refused(scene: str, name: str, read: bool) -> None:
    if read:
        assert setup_of(scene=scene, **{f"world.{name}": 0.06}).warnings == ()
    else:
        said = f"^world.{name} 0.06: the scene {scene} does not read it; leave it out$"
        with pytest.raises(InvalidParameter, match=said):
            setup_of(scene=scene, **{f"world.{name}": 0.06})
    assert setup_of(scene=scene).warnings == ()


class Steps:
    """A world that steps, with three axes of its own."""

    dof = 3

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        return (0.0, 0.0, 0.0)


class OwnSteps(Steps):
    min_s, max_s = 0.01, 0.02


@pytest.mark.parametrize(
    ("name", "asked", "longest"),
    [("Steps", {"world__step_min_s": 0.05, "world__step_max_s": 0.06}, 0.06), ("OwnSteps", {}, 0.02)],
)
def test_steps_are_as_asked_unless_the_object_says_its_own(name: str, asked: dict[str, float], longest: float) -> None:
    scene = setup_of(scene=f"tests.assembly.test_build:{name}", **asked).scene
    rng = np.random.default_rng(1)
    drawn = [scene.next_step_s(rng) for _ in range(200)]
    assert longest - 0.01 <= min(drawn) <= max(drawn) <= longest
    assert max(drawn) > longest - 0.001


def test_axes_may_be_asked_for_that_a_scene_has_anyway() -> None:
    assert setup_of(scene="tests.assembly.test_build:Steps", dof=3).dof == 3
    with pytest.raises(InvalidParameter, match=r"0 or 3: the scene .* sets its own"):
        setup_of(scene="tests.assembly.test_build:Steps", dof=2)


def test_an_operator_from_outside() -> None:
    made = device(setup_of(operator="tests.assembly.test_build:OwnHand", scene="free", dof=2))
    position: Vector = made.device.read()[0]
    assert position == (0.01, 0.01)


def test_a_recording_that_is_not_there_is_named_as_a_file() -> None:
    for name, words in (("nowhere.csv", "No such file"), ("nowhere.txt", "a recording's path")):
        with pytest.raises(InvalidParameter) as caught:
            device(setup_of(operator=name))
        assert words in str(caught.value)


def test_a_recorded_hand_without_enough_axes_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "hand.csv"
    file.write_text("time_s,x_m\n" + "".join(f"{i / 100},{i / 1000}\n" for i in range(50)), "utf-8")
    assert device(setup_of(scene="free", dof=1, operator=str(file))).device.dof == 1
    with pytest.raises(InvalidParameter, match=r"hand\.csv"):
        device(setup_of(scene="free", dof=3, operator=str(file)))


def test_links_are_words_or_the_name_of_a_profile() -> None:
    setup = setup_of(link__up="wifi", link__down="delay 3ms")
    assert setup.up == LinkProfile.preset("wifi")
    assert str(setup.down) == "delay 3ms"
    with pytest.raises(NetemError, match="jiggle"):
        setup_of(link__up="jiggle 3")


@pytest.mark.parametrize(
    ("own_damping", "words"),
    # K T/2 = 100 * 0.001 / 2 = 0.05 is necessary, K T/2 + 2 B = 0.05 + 0.2 = 0.25 is sufficient [Ns/m]
    [(0.051, "may not be passive"), (0.251, None)],
)
def test_range_harvest_on_a_sampled_servo_is_warned_of(own_damping: float, words: str | None) -> None:
    setup = setup_of("sampled", device__harvest="range", device__own_damping=own_damping)
    if words is None:
        assert setup.warnings == ()
    else:
        (warning,) = setup.warnings
        assert words in warning
        assert "0.25 Ns/m" in warning


@pytest.mark.parametrize("own_damping", [0.0, 0.049])
def test_range_harvest_on_a_sampled_servo_is_refused_where_no_spring_can_be_held(own_damping: float) -> None:
    """K T/2 = 0.05 Ns/m: with less of the device's own the range harvest takes energy that is not there."""
    with pytest.raises(InvalidParameter, match=r"device\.harvest.*more than K T/2 = 0\.05"):
        setup_of("sampled", device__harvest="range", device__own_damping=own_damping)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # 1 m/s for 21 ms with up to 3.3 N: 69.3 mJ, less (3.2 N)^2 / 2K that the spring holds: 67 mJ at 2,268 N/m
        ({"device__stiffness": 2268.0, "device__ceiling_J": 0.09}, r"ceiling_J 0\.09 keeps 0\.063 J"),
        # 21 mm (3.15 N + 0.1 N) - (3.15 N)^2 / 300 N/m = 35.2 mJ, more than 0.7 of 50 mJ
        (
            {"device__stiffness": 150.0, "device__ceiling_J": 0.05},
            r"ceiling_J 0\.05 keeps 0\.035 J in reserve.*device\.ceiling_J=0\.0503 would do",
        ),
        ({"device__ceiling_J": 0.0}, r"ceiling_J 0 keeps 0 J"),
        # B T / 2 = 0.05 kg
        ({"device__damping": 100.0, "device__ceiling_J": 10.0}, r"device\.damping 100 .* above 0\.05 kg"),
    ],
)
def test_what_a_held_torque_cannot_do_as_asked_is_warned_of(changes: dict[str, object], words: str) -> None:
    (warning,) = setup_of("sampled", **changes).warnings
    assert re.search(words, warning)
    assert setup_of("continuous", **changes).warnings == ()


@pytest.mark.parametrize(
    "changes",
    [
        {"device__servo": "continuous", "device__own_damping": 0.0},
        {"device__servo": "sampled", "device__own_damping": 0.0},
        {"device__servo": "sampled", "device__harvest": "range", "device__own_damping": 0.0, "coupling": "zoh"},
    ],
)
def test_no_warning_where_nothing_is_wrong(changes: dict[str, object]) -> None:
    assert setup_of(**changes).warnings == ()


def test_sessions_tell_the_peer_what_this_side_runs() -> None:
    setup = setup_of(scene="paper", coupling="zoh")
    sessions = (device_session(setup, 5), "device", 0.1), (world_session(setup, 6), "world", 0.05)
    for session, role, ceiling_J in sessions:
        assert session.identity.role == role
        assert session.identity.dof == 3
        assert session.identity.about == {
            "scene": "paper",
            "coupling": "zoh",
            "reservoir_J": ceiling_J,
            "shared.contact_model": False,
        }


def test_a_corrupting_link_is_refused_since_checksums_make_it_loss() -> None:
    with pytest.raises(InvalidParameter, match=r"link\.down.*checksums"):
        prepare(PAPER.set({"link.down": "delay 1ms corrupt 1%"}), "continuous")


@pytest.mark.parametrize("name", ["device.smoothing_s", "device.predict_s"])
def test_a_filter_of_set_positions_is_refused_where_a_law_takes_something_else(name: str) -> None:
    with pytest.raises(InvalidParameter, match=rf"{name} is 0\.01; allowed: 0\.0 with the coupling eba"):
        prepare(PAPER.set({"coupling": "eba", name: 0.01}))
    prepare(PAPER.set({"coupling": "eba", name.replace("device", "world"): 0.01}))  # its world takes set-positions
    with pytest.raises(InvalidParameter, match=r"world\..*with the coupling pd"):
        prepare(PAPER.set({"coupling": "pd", name.replace("device", "world"): 0.01}))
