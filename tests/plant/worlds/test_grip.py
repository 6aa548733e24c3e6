"""A jaw that grips an object: its scenes, the felt force over a network, and what the jaw does when the link goes."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.build import prepare
from hapnet.control.coupling import PositionSample, ProxySample
from hapnet.errors import InvalidParameter
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.force_probe import Agreement
from hapnet.plant.worlds.registry import make_scene
from hapnet.side.reindexing import Reindexing
from tests.conftest import mostly_slow
from tests.measure.grips import KINDS, OBJECTS, cut, expected_N, felt, run, statics_N


@pytest.mark.parametrize(
    ("text", "dof", "units", "start", "walls"),
    [
        ("grip", 1, "m", (0.05,), [((-1.0,), -0.03, 3000.0)]),
        ("grip:soft?size=15mm&gap=5mm", 1, "m", (0.02,), [((-1.0,), -0.015, 500.0)]),
        ("grip:empty", 1, "m", (0.05,), []),
        ("wall?position=0.01 + grip:hard", 2, "m", (0.0, 0.05),
         [((1.0, 0.0), 0.01, 3000.0), ((0.0, -1.0), -0.03, 5000.0)]),
        ("paper + grip?stiffness=800", 4, "m", (0.0, 0.0, 0.0, 0.05),
         [((0.0, 0.0, -1.0, 0.0), 0.0, 3000.0), ((0.0, 0.0, 0.0, -1.0), -0.03, 800.0)]),
        ("joints?dof=1 + grip:hard?size=0.4", 2, "rad", (0.0, 0.6),
         [((1.0, 0.0), 0.03, 30.0), ((-1.0, 0.0), 0.03, 30.0), ((0.0, -1.0), -0.4, 50.0)]),
    ],
)  # fmt: skip
def test_the_opening_is_the_last_axis(text: str, dof: int, units: str, start: Any, walls: Any) -> None:
    """An object is solid where the opening is below its size; stiffness in Nm/rad is N/m times 0.1 m squared."""
    scene = make_scene(text)
    assert (scene.dof, scene.units, scene.jaw) == (dof, units, True)
    assert scene.start == pytest.approx(start)
    assert [(one.normal, one.offset, pytest.approx(one.stiffness)) for one in scene.walls] == walls


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"scene": "grip + wall"}, "a scene and the jaw last, as in wall"),
        ({"scene": "wall + grip + grip"}, "a scene and the jaw last"),
        ({"scene": "sphere + grip"}, "flat walls at rest before"),
        ({"scene": "grip:firm"}, "one of soft, hard, empty"),
        ({"scene": "grip?size=30"}, "a length with its unit, such as 20mm"),
        ({"scene": "grip?size=0"}, "size: above 0"),
        ({"scene": "grip?stiffness=-1"}, "stiffness: above 0"),
        ({"scene": "grip?width=30mm"}, "one of this solid: size=30mm"),
        ({"scene": "grip", "dof": 2}, "more with a scene, as in wall"),
        ({"scene": "free + grip", "dof": 5}, "the axes of free, and one more for the jaw"),
        ({"scene": "paper + grip", "dof": 3}, "the axes of paper, and one more for the jaw"),
        ({"scene": "grip?stiffness=300", "world.wall.stiffness": 500.0}, "300, or left out"),
        ({"scene": "free + grip", "world.wall.position_m": 0.01}, "does not read it"),
    ],
)
def test_bad_input_is_one_clear_line(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidParameter, match=said) as caught:
        prepare(Params().set(changes))
    assert "\n" not in str(caught.value)


def test_the_objects_stiffness_is_that_of_the_scene() -> None:
    """So the rule for the device's spring knows it: no object feels stiffer than it is (K at most K' + K_w)."""
    setup = prepare(Params().set({"scene": "grip:soft", "world.stiffness": 50.0}))
    assert setup.params.world.wall.stiffness == 500.0
    assert setup.params.device.stiffness == 550.0
    assert prepare(Params().set({"scene": "grip", "world.wall.stiffness": 700.0})).scene.stiffnesses == (700.0,)


def test_the_statics_of_springs_in_series() -> None:
    """By hand: 135, 600 and 500 N/m at 20 mm, with the world's spring of 500 N/m: 300 N/m are felt."""
    assert statics_N(600.0, 500.0, 500.0) == pytest.approx(0.02 / (1 / 135 + 1 / 300))


CASES = [(kind, scene) for scene in ("grip:soft", "grip:hard") for kind in ("virtual", "follower")]


@pytest.mark.parametrize(
    ("kind", "scene"), mostly_slow([CASES[0], CASES[3], CASES[1], CASES[2], ("  force", "grip:soft")], 1)
)
def test_the_felt_force_over_4g_is_that_of_an_ideal_link(kind: str, scene: str) -> None:
    result = run(scene, KINDS[kind])
    params: Any = result.recording.meta["params"]
    wanted = expected_N(kind, float(params["device"]["stiffness"]), OBJECTS[scene])
    one = felt(result)
    assert one.force == pytest.approx(wanted, rel=0.05)
    assert one.deviation < 0.05 * wanted, "it does not shake"
    assert one.passive
    assert one.slack >= -1e-12
    assert one.margin > 0.0
    assert _given_J(result) <= 0.15, "100 and 50 mJ of the reservoirs"


def _given_J(result: Any) -> float:
    """The most that the jaw's actuator gave to the hand, of recorded forces and positions every 5 ms [J]."""
    device = result.recording.device
    x, force = device["position_m"], device["force_N"]
    return float(np.cumsum(np.sum(force[:-1] * np.diff(x, axis=0), axis=1)).max())


@pytest.mark.slow
def test_a_point_at_a_wall_and_a_jaw_at_an_object_are_felt_at_once() -> None:
    """Each axis has its own force; both are pressed by 20 mm, the wall with 3000 N/m."""
    result = run("wall + grip:soft", {"device.force_limit_N": 0.0})
    device: Any = result.recording.device
    at = (device["time_s"] % 5.5 > 3.0) & (device["time_s"] % 5.5 < 4.4)
    params: Any = result.recording.meta["params"]
    K = float(params["device"]["stiffness"])
    wall, grip = device["force_N"][at].mean(axis=0)
    assert wall == pytest.approx(-statics_N(K, 500.0, 3000.0), rel=0.05)
    assert grip == pytest.approx(statics_N(K, 500.0, 500.0), rel=0.05)
    assert result.summary["verdict"]["passive"]


def _springs(scene: str) -> float:
    """The opening of a follower's jaw by springs in series: the hand and the leader's 100 N/m pull K' into it."""
    force = expected_N("follower", 0.0, OBJECTS[scene])
    return 0.03 - (0.02 - force / 135.0) * 500.0 / (500.0 + OBJECTS[scene])


@pytest.mark.parametrize(("scene", "opens"), mostly_slow(
    [("grip:hard", True), ("grip:soft", False), ("grip:hard", False), ("grip:soft", True)], 1,
))  # fmt: skip
def test_a_closed_jaw_stays_closed_while_the_link_is_down(scene: str, opens: bool) -> None:
    """And after it, until the hand has closed again: a hand that let go does not drop the object. The steps of the
    forces are at most those of `step_limit_N`."""
    found = cut(scene, opens)
    assert found.moved < 1e-4
    assert found.share > 0.99
    assert found.leaders_step < (0.5 if opens else 0.01)
    assert found.jaws_step < (0.5 if opens else 0.01)
    assert found.waited == pytest.approx(_springs(scene), abs=1.5e-3), "closed"
    assert found.last == pytest.approx(0.05 if opens else found.waited, abs=1e-3), "the hand opens it"
    assert found.passive
    assert found.slack >= -1e-12


@pytest.mark.slow
def test_with_the_same_origin_it_follows_the_hand_at_once() -> None:
    found = cut("grip:hard", True, {"follower.start": "origin"})
    assert found.moved < 1e-4
    assert found.waited > 0.04, "the hand is open"


class Held:
    """A robot's coupling, as far as re-indexing needs it."""

    set_position = (0.1, 0.01)


def test_a_jaw_waits_until_the_leaders_opening_has_come_to_it() -> None:
    """The point is re-indexed for good, the jaw only until its leader has closed to 10 mm; meanwhile that is free."""
    moved = Reindexing(Frame(1.0, 1.0, (0.0, 0.0), jaw=True), 500_000_000, meets=True)
    coupling: Any = Held()

    def robots(opening: float, at_ms: int) -> Any:
        return moved.led(coupling, PositionSample((0.0, opening), 0.0), at_ms * 1_000_000)

    moved.due = True
    assert robots(0.05, 0).position == pytest.approx((0.1, 0.01))
    wall = Plane((1.0, 0.0), 0.2, 500.0, 1.0)
    planes = (wall, Plane((0.0, -1.0), -0.03, 500.0, 1.0))
    proxy = ProxySample((0.1, 0.03), 0.0, (1.0, 2.0), planes, 0.1, 0.0)
    seen: Any = moved.outward(proxy)
    assert seen.position == pytest.approx((0.0, 0.05)), "its own opening"
    assert seen.force == (1.0, 0.0)
    assert [one.normal for one in seen.planes] == [(1.0, 0.0)]
    assert robots(0.03, 5).position == pytest.approx((0.1, 0.01))
    assert robots(0.012, 10).position == pytest.approx((0.1, 0.01))
    assert robots(0.007, 15).position == pytest.approx((0.1, 0.01)), "it has crossed, by 3 mm"
    assert robots(0.006, 20).position == pytest.approx((0.1, 0.008)), "these shrink as it closes further"
    assert robots(0.004, 25).position == pytest.approx((0.1, 0.004))
    assert robots(0.05, 30).position == pytest.approx((0.1, 0.05))
    again: Any = moved.outward(proxy)
    assert again.position == pytest.approx((0.0, 0.03))
    assert again.force == (1.0, 2.0)
    assert len(again.planes) == 2
    assert robots(0.05, 1000).position == pytest.approx((0.1, 0.01)), "it was silent for a second"


def test_a_jaw_that_is_more_open_than_its_leaders_closes_with_it() -> None:
    """Never by itself: 4 mm of the hand's closing motion are 8 mm of the jaw's, until both are as open."""
    moved = Reindexing(Frame(1.0, 1.0, (0.0, 0.0), jaw=True), 500_000_000, meets=True)
    coupling: Any = Held()
    found = [
        moved.led(coupling, PositionSample((0.1, opening), 0.0), k).position[1]  # type: ignore[union-attr]
        for k, opening in enumerate((0.004, 0.004, 0.006, 0.002, 0.001, 0.0, 0.02))
    ]
    assert found == pytest.approx([0.010, 0.010, 0.012, 0.004, 0.002, 0.0, 0.02])
    seen: Any = moved.outward(ProxySample((0.1, 0.03), 0.0, (1.0, 2.0), None, 0.1, 0.0))
    assert seen.position == pytest.approx((0.1, 0.03))


def test_without_a_jaw_nothing_is_shifted_before_it_is_re_indexed() -> None:
    moved = Reindexing(Frame(1.0, 1.0, (0.0, 0.0)), 500_000_000, meets=True)
    sample, coupling = PositionSample((0.3, 0.2), 0.0), Held()
    assert moved.led(coupling, sample, 0) is sample  # type: ignore[arg-type]


def test_a_jaw_has_no_offset() -> None:
    frame = Frame(2.0, 1.0, (0.0, 0.0), jaw=True)
    frame.meet((0.3, 0.04), (0.1, 0.05))
    assert frame.offset == pytest.approx((0.1, 0.0))
    assert dataclasses.replace(frame, jaw=False).coupled((0.3, 0.04)) == pytest.approx((0.1, 0.02))


@pytest.mark.parametrize(("axes", "still"), [(None, True), (1, False), (0, False)])
def test_a_jaw_may_stand_still_on_a_stiff_object(axes: int | None, still: bool) -> None:
    """The handle moves, or there is none; only the jaw's force changes."""
    watch, said = Agreement(axes), ""
    for k in range(500):
        said = said or watch.wrong(1e-3, (0.0, 3.0 * math.sin(0.02 * k)), (0.01, 0.03))
    assert bool(said) == still


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_both_ends_are_passive_over_any_link(seed: int) -> None:
    """Random delays to 200 ms, jitter, 40 % of loss and cuts; scales, a clutch, encoders; with and without a robot."""
    rng = np.random.default_rng([seed, 51])
    scenes = ("grip:soft", "grip:hard", "wall + grip:hard", "free?dof=2 + grip?stiffness=20000")
    link = f"delay {rng.integers(0, 200)}ms {rng.integers(1, 30)}ms loss {rng.integers(0, 40)}%"
    down_s = float(rng.uniform(1.0, 2.0))
    timeline = f"at {down_s:.3f}s: down; at {down_s + 0.8:.3f}s: up"
    robot: dict[str, object] = {
        "follower.robot": "simulated", "follower.motion_scale": float(rng.uniform(0.3, 3.0)),
        "follower.force_scale": float(rng.uniform(0.3, 3.0)), "follower.resolution_m": float(rng.choice([0.0, 5e-5])),
        "follower.feedback": str(rng.choice(["position", "force", "planes"])),
        "follower.start": str(rng.choice(["here", "origin"])),
        "follower.on_stop": str(rng.choice(["freeze", "release"])), "device.enable": "0-2.2, 2.6-9",
    }  # fmt: skip
    result = run(
        str(rng.choice(scenes)),
        {
            "duration_s": 5.0, "operator_model.hold_s": 1.0, "operator_model.reach_s": 0.4,
            "link.up_timeline": timeline, "link.down_timeline": timeline, "device.clutch": "3.0-3.4",
            "device.resolution_m": float(rng.choice([0.0, 5e-5])), **(robot if seed % 3 else {}),
        },
        link,
        seed,
    )  # fmt: skip
    sides: list[Any] = [result.summary["device"], result.summary["world"]]
    margin: Any = result.summary["theorem"]["margin_J"]
    assert min(one["ledger"]["slack_J"] for one in sides) >= -1e-12
    assert margin >= 0.0
    assert result.summary["verdict"]["passive"] is not False
