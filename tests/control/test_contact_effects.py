"""Effects of surfaces at the device's rate: what is felt, what is sent, and what false ones do."""

import math
from typing import Any

import msgpack
import numpy as np
import pytest
from msgspec import structs

from hapnet.assembly.build import prepare
from hapnet.checks import Vector, wrong_effects
from hapnet.control.contact_equations import share
from hapnet.control.contact_model import ContactModel
from hapnet.control.contact_plane import ContactPlane
from hapnet.control.coupling import ProxySample
from hapnet.errors import InvalidParameter
from hapnet.ext.compiled.whole_runs.coverage import why_not
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import HalfSpace
from hapnet.mechanics.effects import Effects, Grain
from hapnet.mechanics.plane import Plane, checked
from hapnet.mechanics.spring import Spring
from hapnet.params import Params
from hapnet.realtime.servo_pipe import kind_of, sample_of
from hapnet.simulation.simulation import Simulation
from hapnet.wire.messages import Proxy as ProxyMessage, decode
from hapnet.wire.stream import PositionStream
from tests.control.test_contact_model import K_WALL, K_WORLD, SOFT, TICK, after, model, reported
from tests.measure.grains import SWEEP, asked, line, slid
from tests.measure.rubbing import FACE_M, K, run, slack_of
from tests.wire.test_messages import A, rejected

DEEP = 0.01
PUSH_N = SOFT * DEEP * K_WORLD
SINE = Grain.sine(2e-4, 2e-3, (0.0, 1.0, 0.0))


def face(effects: Effects | None, mu: float = 0.0) -> Plane:
    return Plane((1.0, 0.0, 0.0), 0.0, K_WALL, 10.0, friction=mu, effects=effects)


def in_touch(effects: Effects, mu: float = 0.0, start: float = -0.001) -> ContactModel:
    m = model((start, 0.0, 0.0))
    m.receive(reported((face(effects, mu),), (start, 0.0, 0.0)), 0.0, 0.0)
    return m


def spring_N(m: ContactModel, x: Vector) -> np.ndarray[Any, Any]:
    """Of the spring on the proxy, after a tick at x."""
    return K_WORLD * (np.array(m.step(TICK, x)) - x)


# -- what is felt ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_grain_is_felt_as_its_height_on_springs_in_series(mu: float) -> None:
    m, along = in_touch(Effects(grain=SINE), mu), 0.0
    for x in np.linspace(-0.001, DEEP, 100):
        m.step(TICK, (float(x), 0.0, 0.0))
    for _ in range(400):
        along += 5e-5
        force = spring_N(m, (DEEP, along, 0.0))
        place = along if mu == 0.0 else m.rubbing.place[1]
        height = 2e-4 * math.sin(2 * math.pi * place / 2e-3)
        late = 0.0 if mu == 0.0 else 2 * math.pi / 2e-3 * 2e-4 * 5e-5 * 1.1  # where it rested a tick ago
        assert abs(-force[0] - SOFT * K_WORLD * (DEEP + height)) <= SOFT * K_WORLD * (late + 3e-6)


def test_a_recorded_grain_is_straight_between_its_samples() -> None:
    grain = Grain.of([0.0, 1e-3, -0.5e-3, 0.25e-3], 0.008, (0.0, 2.0, 0.0))
    assert grain.wave == pytest.approx((0.0, 125.0, 0.0))
    heights = np.interp(np.linspace(0, 4, 41), range(5), [0.0, 1e-3, -0.5e-3, 0.25e-3, 0.0])
    for way, height in zip(np.linspace(0, 1, 41), heights, strict=True):
        for period in (-3, 0, 1):
            assert grain.at((0.3, 0.008 * (way + period), 0.1)) == pytest.approx(height, abs=1e-3 / 254 + 1e-9)


def test_it_sticks_slips_and_sticks_again() -> None:
    """A saw's teeth between both cones; one is as long as the spring takes to be strained from one to the other."""
    m = in_touch(Effects(sticking=0.8), 0.2)
    for x in np.linspace(-0.001, DEEP, 100):
        m.step(TICK, (float(x), 0.0, 0.0))
    ratios = []
    for along in np.arange(1, 900) * 5e-5:
        force = spring_N(m, (DEEP, float(along), 0.0))
        ratios.append(-force[1] / PUSH_N)
    teeth = np.flatnonzero(np.diff(ratios) < -0.3)
    assert np.diff(teeth) * 5e-5 == pytest.approx(0.6 * PUSH_N / K_WORLD, abs=1e-4)
    assert max(ratios) == pytest.approx(0.8, abs=0.01)
    assert min(ratios[teeth[0] :]) == pytest.approx(0.2, abs=0.01)


def test_without_a_wider_cone_sticking_changes_nothing() -> None:
    same, plain = in_touch(Effects(sticking=0.3), 0.5), model((-0.001, 0.0, 0.0))
    plain.receive(reported((face(None, 0.5),), (-0.001, 0.0, 0.0)), 0.0, 0.0)
    for k in range(300):
        x = (min(DEEP, -0.001 + 1e-4 * k), 5e-5 * k, 0.0)
        assert same.step(TICK, x) == plain.step(TICK, x)


def test_viscosity_drags_along_the_surface_only_while_touching() -> None:
    m, speed = in_touch(Effects(viscosity=4.0)), 0.1
    for k in range(200):
        free = spring_N(m, (-0.001, speed * TICK * k, 0.0))
    assert free == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    m = in_touch(Effects(viscosity=4.0))
    for x in np.linspace(-0.001, DEEP, 100):
        m.step(TICK, (float(x), 0.0, 0.0))
    for k in range(200):
        force = spring_N(m, (DEEP, speed * TICK * k, 0.0))
    assert force == pytest.approx((-PUSH_N, -4.0 * speed, 0.0), rel=1e-3, abs=1e-9)


def test_a_snap_attracts_from_its_reach_and_gives_no_energy_on_a_closed_way() -> None:
    m = in_touch(Effects(snap_N=2.0, snap_m=0.004), start=-0.006)
    way = np.concatenate([np.linspace(-0.006, -0.0002, 400), np.linspace(-0.0002, -0.006, 400)])
    forces = [spring_N(m, (float(x), 0.0, 0.0))[0] for x in way]
    for x, force in zip(way, forces, strict=True):
        gap = -x / 0.004
        assert force == pytest.approx(8.0 * gap * (1 - gap) if gap < 1 else 0.0, abs=1e-9)
    assert max(forces) == pytest.approx(2.0, rel=1e-3)


def test_viscosity_leaves_a_push_alone_and_counts_as_the_planes_force() -> None:
    thick, plain = in_touch(Effects(viscosity=4.0)), in_touch(Effects())
    spring, parts, added = Spring(K, 3), [0.0] * 3, [0.0] * 3
    for k in range(100):
        x = (-0.001 + 1e-4 * k, 1e-4 * k, 0.0)
        y, without = thick.step(TICK, x), plain.step(TICK, x)
        assert y[0] == pytest.approx(without[0], abs=1e-12)
    assert y[1] < without[1] - 1e-4
    share(thick, spring, x, y, parts, added)
    assert parts == pytest.approx([K * (b - a) for a, b in zip(x, y, strict=True)])
    assert added == [0.0] * 3


@pytest.mark.parametrize(
    ("effects", "mu", "x", "speed", "felt"),
    [
        (Effects(snap_N=2.0, snap_m=0.04), 0.0, -0.02, 0.0, (2.0, 0.0, 0.0)),
        (Effects(snap_N=2.0, snap_m=0.04), 0.3, -0.02, 0.0, (2.0, 0.0, 0.0)),
        (Effects(viscosity=8.0), 0.0, DEEP, 0.1, (-PUSH_N, -0.8, 0.0)),
    ],
)
def test_effects_come_and_go_with_their_planes_over_some_milliseconds(
    effects: Effects, mu: float, x: float, speed: float, felt: Vector
) -> None:
    """No tick shows more than a fifth of the change."""
    m, place, way = model((x, 0.0, 0.0)), np.array([x, 0.0, 0.0]), np.array([0.0, speed * TICK, 0.0])
    without = (0.0, 0.0, 0.0) if x < 0.0 else (-PUSH_N, 0.0, 0.0)
    for told, start, end in ((None, None, without), (effects, without, felt), (None, felt, without)):
        m.receive(reported((face(told, mu),), tuple(place), tuple(-np.array(without))), 0.0, 0.0)
        forces = []
        for _ in range(200):
            place = place + way
            forces.append(spring_N(m, tuple(place.tolist())))
        if start is not None:
            jump = np.linalg.norm(np.subtract(end, start))
            assert np.linalg.norm(forces[0] - start) <= 0.2 * jump
            assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= 0.2 * jump
        assert forces[-1] == pytest.approx(end, abs=0.01)


def test_effects_that_are_sent_anew_do_not_lag() -> None:
    """A message each tick about the same surface changes nothing."""
    once, anew = (in_touch(Effects(2.0, 0.0, 2.0, 0.004, SINE), start=-0.006) for _ in range(2))
    for k in range(200):
        x = (-0.006 + 8e-5 * k, 1e-4 * k, 0.0)
        if x[0] < -0.0005:  # before the world's proxy has a force of its own
            anew.receive(reported((face(Effects(2.0, 0.0, 2.0, 0.004, SINE)),), x), 1e-3 * k, 0.0)
        assert anew.step(TICK, x) == pytest.approx(once.step(TICK, x), abs=1e-9)


@pytest.mark.parametrize("height", [0.0, 3e-4])
def test_drag_begins_and_ends_without_a_jump(height: float) -> None:
    """It grows in proportion to the depth up to 0.5 mm, over the middle of a grain."""
    grain = Grain.sine(height, 1e-3, (0.0, 1.0, 0.0)) if height else None
    m, speed, y = in_touch(Effects(viscosity=20.0, grain=grain)), 0.1, 0.0
    for _ in range(200):
        y += speed * TICK
        m.step(TICK, (-0.001, y, 0.0))
    depths = np.concatenate([np.linspace(-0.001, 0.001, 200), np.linspace(0.001, -0.001, 200)])
    for deep in depths:
        y += speed * TICK
        drag = -spring_N(m, (float(deep), y, 0.0))[1]
        assert drag == pytest.approx(20.0 * speed * min(max(0.0, deep) / 5e-4, 1.0), abs=1e-3)


LIFT = Grain((0.0, 0.0, 0.0), 1e-3, bytes([127, 127]))
"""1 mm, everywhere."""


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_on_a_ball_a_grain_is_a_larger_ball(mu: float) -> None:
    """Its plane was told 5 mm aside."""
    told, place = (-0.001, 0.0, 0.0), (DEEP, 0.005, 0.0)
    lifted, larger = model(told), model(told)
    for m, radius, effects in ((lifted, 0.03, Effects(grain=LIFT)), (larger, 0.031, None)):
        plane = Plane.of_ball(told, (0.03, 0.0, 0.0), radius, K_WALL)._replace(friction=mu, effects=effects)
        m.receive(reported((plane,), told), 0.0, 0.0)
    assert after(lifted, place, 0.1) == pytest.approx(after(larger, place, 0.1), abs=1e-6)


def test_a_ball_sticks_too() -> None:
    told = (-0.001, 0.0, 0.0)
    m = model(told)
    plane = Plane.of_ball(told, (0.03, 0.0, 0.0), 0.03, K_WALL)._replace(effects=Effects(sticking=0.8))
    m.receive(reported((plane,), told), 0.0, 0.0)
    after(m, (DEEP, 0.0, 0.0), 0.02)
    assert abs(after(m, (DEEP, 0.002, 0.0), 0.02)[1]) <= 2e-4  # 0.23 times the push; without it 1.7 mm


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_ball_attracts_from_where_it_is_seen_now(mu: float) -> None:
    told, place = (-0.001, 0.0, 0.0), (-0.001, 0.006, 0.0)
    m = model(told)
    ball = Plane.of_ball(told, (0.03, 0.0, 0.0), 0.03, K_WALL)
    plane = ball._replace(friction=mu, effects=Effects(snap_N=2.0, snap_m=0.004))
    m.receive(reported((plane,), told), 0.0, 0.0)
    gap = (math.hypot(0.031, 0.006) - 0.03) / 0.004
    after(m, place, 0.1)
    assert math.hypot(*spring_N(m, place)) == pytest.approx(8.0 * gap * (1.0 - gap), rel=1e-3)


def test_a_plane_that_moves_takes_its_grain_along() -> None:
    found = []
    for offset, effects in ((0.0, Effects(grain=LIFT)), (-1e-3, None)):
        m = model((-0.001, 0.0, 0.0))
        plane = Plane((1.0, 0.0, 0.0), offset, K_WALL, 10.0, velocity_mps=-0.05, effects=effects)
        m.receive(reported((plane,), (-0.001, 0.0, 0.0)), 0.0, 0.0)
        found.append(after(m, (DEEP, 0.0, 0.0), 0.1))
    assert found[0] == pytest.approx(found[1], abs=1e-9)
    assert found[1][0] == pytest.approx(DEEP - SOFT * (DEEP + 1e-3 + 0.05 * 0.099), rel=1e-9)


def test_compiled_servos_ask_python_for_y() -> None:
    m = in_touch(Effects(viscosity=1.0))
    m.step(TICK, (0.0, 0.0, 0.0))
    assert not m.goes_on
    m.receive(reported((face(None),), (-0.001, 0.0, 0.0)), 0.1, 0.0)
    m.step(TICK, (0.0, 0.0, 0.0))
    assert m.goes_on


# -- whole runs --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hz", "speed_mps"), [SWEEP[0], SWEEP[-1], *[
    pytest.param(*one, marks=pytest.mark.slow) for one in SWEEP[1:-1]
]])  # fmt: skip
def test_over_4g_the_line_at_the_device_is_what_was_asked(hz: float, speed_mps: float) -> None:
    felt = slid(hz, speed_mps)
    assert line(felt, hz, speed_mps).force_N == pytest.approx(asked(hz), rel=0.01)
    assert slack_of(felt.summary) >= -1e-12
    assert felt.summary["verdict"]["passive"] is True
    assert felt.summary["device"]["reservoir_min_J"] >= 0.0


def test_over_4g_a_saw_has_the_teeth_of_its_cones() -> None:
    """Its spring is strained from one cone to the other: 0.6 times the push over K'."""
    felt = run("plane?friction=0.2&stick=0.8", "4g", seconds=2.0)
    slips = np.flatnonzero(np.abs(np.diff(felt.rub())) > 0.15)
    tooth = 0.6 * felt.push()[slips].mean() / K  # which is the proxy's over K'
    assert np.abs(np.diff(felt.x[slips, 1]))[:3] == pytest.approx(tooth, rel=0.02)
    ratio = -felt.rub()[700:1200] / felt.push()[700:1200]
    assert ratio.max() == pytest.approx(0.8, rel=0.02)
    assert slack_of(felt.summary) >= -1e-12


def test_over_4g_drag_and_attraction_are_those_of_the_proxy_as_the_hand_feels_them() -> None:
    felt = run("plane?viscosity=5&snap=2,5mm", "4g", seconds=2.0)
    assert -felt.rub()[1000:1200] == pytest.approx(5.0 * 0.05 * K / K_WORLD, rel=0.02)
    gap = (FACE_M - felt.x[:, 0]) / 0.005
    near = (gap > 0.0) & (gap < 1.0)
    assert near.sum() > 50
    drag = felt.force[near, 0] - 8.0 * gap[near] * (1.0 - gap[near]) * K / K_WORLD
    assert np.sqrt(np.mean(drag**2)) <= 0.02  # of 0.4 N: the rest is the dampers'
    assert slack_of(felt.summary) >= -1e-12


def test_compiled_code_says_that_it_does_not_run_effects() -> None:
    params = Params().set({"scene": "plane?viscosity=1", "duration_s": 0.1})
    assert why_not(Simulation(params, 1).setup) == "effects of a surface"


@pytest.mark.parametrize(("coupling", "rendering", "says"), [
    ("pspm", "auto", False), ("pspm", "paper", True), ("wave", "auto", True), ("popc", "paper", True),
])  # fmt: skip
def test_a_run_that_cannot_render_them_says_so(coupling: str, rendering: str, says: bool) -> None:
    chosen = Params().set({"scene": "plane?viscosity=1", "coupling": coupling, "rendering": rendering})
    assert any("effects are not felt" in one for one in prepare(chosen).warnings) is says
    plain = chosen.set({"scene": "plane"})
    assert not any("effects" in one for one in prepare(plain).warnings)


# -- what is sent ------------------------------------------------------------------------------------------------------


ALL = Effects(2.0, 0.5, 1.0, 0.005, SINE)


def test_solids_tell_the_effects_of_their_surface() -> None:
    solids = [Solid(HalfSpace((1.0, 0.0, 0.0), 0.01), effects=ALL), Solid(HalfSpace((0.0, 0.0, 1.0), 0.01))]
    planes = RigidContacts(solids, 3).planes((0.0, 0.0, 0.0), 0.1)
    assert {plane.normal: plane.effects for plane in planes} == {(1.0, 0.0, 0.0): ALL, (0.0, 0.0, 1.0): None}
    (plane,) = RigidContacts(solids[:1], 2).planes((0.0, 0.0), 0.1)
    assert plane.effects == ALL._replace(grain=SINE._replace(wave=SINE.wave[:2]))


def test_a_peer_of_before_feels_the_plane_alone() -> None:
    still = (0.0, 0.0, 0.0)
    new, old = (decode(PositionStream(1).proxy(3, still, 4, still, (face(one),))) for one in (ALL, None))
    assert isinstance(new, ProxyMessage)
    assert structs.replace(new, more=None) == old
    assert Plane.all_of(new.planes, None, None, new.more["effects"]) == (face(ALL),)


def test_a_servo_in_a_process_of_its_own_gets_them() -> None:
    proxy = reported((face(ALL, 0.3),), (0.0, 0.0, 0.0))
    kind, values = msgpack.unpackb(msgpack.packb((kind_of(proxy), proxy)), use_list=False)
    came = sample_of(kind, values)
    assert isinstance(came, ProxySample)
    compliance = [[1.0 if i == j else 0.0 for j in range(3)] for i in range(3)]
    assert ContactPlane(came.planes[0], compliance, came.position).effects == ALL


WRONG = [
    ALL._replace(viscosity=-1.0),
    ALL._replace(viscosity=1001.0),
    ALL._replace(sticking=math.nan),
    ALL._replace(snap_N=math.inf),
    ALL._replace(snap_m=0.2),
    ALL._replace(grain=SINE._replace(height_m=0.2)),
    ALL._replace(grain=SINE._replace(height_m=-1e-3)),
    ALL._replace(grain=SINE._replace(height_m=math.nan)),
    ALL._replace(grain=SINE._replace(wave=(0.0, 0.0))),
    ALL._replace(grain=SINE._replace(wave=(0.0, math.nan, 0.0))),
    ALL._replace(grain=SINE._replace(wave=(0.0, 2e5, 0.0))),
    ALL._replace(grain=SINE._replace(shape=b"1")),
    ALL._replace(grain=SINE._replace(shape=bytes(257))),
]


@pytest.mark.parametrize("wrong", WRONG)
def test_effects_that_a_device_would_drop_are_refused(wrong: Effects) -> None:
    with pytest.raises(InvalidParameter, match="effects"):
        checked([face(wrong)], 3)
    with pytest.raises(InvalidParameter, match="effects"):
        Solid(HalfSpace((1.0, 0.0, 0.0), 0.01), effects=wrong)


def test_a_wave_of_thousands_of_numbers_is_refused_with_few_words() -> None:
    wave = ALL._replace(grain=SINE._replace(wave=(1.0 / 3.0,) * 7000))
    assert wrong_effects(wave, 3) == "a grain's wave of 7000 numbers; allowed: 3"
    assert len(str(rejected(acting([wave])))) < 200


def acting(effects: object) -> list[object]:
    plane = [[1.0, 0.0, 0.0], 0.02, 3000.0, 10.0, 0.0]
    still = [0.0, 0.0, 0.0]
    return [2, 10, A, 0, 0, still, 0, still, [plane], 0, 0, {"effects": effects}]


@pytest.mark.parametrize("frame", [acting([wrong]) for wrong in WRONG])
def test_effects_of_no_surface_are_dropped(frame: object) -> None:
    assert rejected(frame).kind == "range"
    assert isinstance(decode(msgpack.packb(acting([ALL]))), ProxyMessage)


@pytest.mark.parametrize(
    "effects",
    [[], [None, None], 1, [1], [[1.0, 0.5, 1.0, 0.005]], [[1, 0.5, 1.0, 0.005, None]],
     [[0.0] * 4 + [[[0.0] * 3, 1e-3]]], [[0.0] * 4 + [[[0.0] * 3, 1e-3, "text"]]],
     [[0.0] * 4 + [[[0, 0, 0], 1e-3, b"12"]]]],
)  # fmt: skip
def test_what_is_no_effect_is_dropped(effects: object) -> None:
    assert rejected(acting(effects)).kind == "type"
