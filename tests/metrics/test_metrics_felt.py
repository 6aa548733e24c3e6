"""What a person feels of a wall and of free space: when a contact is felt, drag, swing, and the true environment."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.commands.output import write_csv
from hapnet.ext.metrics import METRICS
from hapnet.ext.metrics.contact import Latency, WallContact, contact_force, latency, pressed_wall, touches
from hapnet.ext.metrics.force import residual_oscillation, rms_difference
from hapnet.ext.metrics.measured import quantile, value_of
from hapnet.ext.metrics.motion import DRAG_MPS, drag_by_speed, free_force, free_windows
from hapnet.ext.metrics.obstacles import WallOrSolid, environment_force
from hapnet.ext.study import case
from hapnet.ext.study.compare import Plan, RunMeasures, groups
from hapnet.ext.study.tables import as_rows
from hapnet.params import Params
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import DeviceSample, MemoryRecorder, Recording, WorldSample

TICK_S = 2.0**-6
"""Exact in binary, so that what is just as long as a limit can be had."""
UNKNOWN = (math.nan,) * 7
SURFACE = Wall((1.0,), 0.0, 3000.0)


def drag(recording: Recording, walls: Sequence[WallOrSolid], settling_s: float) -> float | None:
    found = free_windows(recording, walls, settling_s)
    return None if found is None else found.drag()


def recorded(
    x: Array, force: Array, step_s: float, *, target: Array | None = None, proxy_depth: Array | None = None
) -> Recording:
    """Positions (N, n) [m] and forces on the device (N, n) [N] every `step_s`, and a world step at each of them."""
    recorder = MemoryRecorder({"origin_ns": 0, "device_origin_ns": 0})
    for k in range(len(x)):
        at_ns = round(k * step_s * 1e9)
        place, aim = tuple(x[k].tolist()), None if target is None else tuple(target[k].tolist())
        on_device = tuple(force[k].tolist())
        recorder.write(DeviceSample(at_ns, place, place, place, on_device, None, *UNKNOWN, operator_target_m=aim))
        depth = -1.0 if proxy_depth is None else float(proxy_depth[k])
        recorder.write(WorldSample(at_ns, step_s, place, place, place, place, place, place, depth, *UNKNOWN[1:]))
    return recorder.recording()


def visit(depth: Array, resistance: Array, stiffness: float = 1.0, round_trip_s: float = 0.0) -> list[WallContact]:
    """The touches of a run sampled every `TICK_S`: depths in `SURFACE` [m], and the force outwards [N]."""
    run = recorded(depth[:, None], -resistance[:, None], TICK_S)
    return touches(run, [SURFACE], stiffness, round_trip_s)


def inside(*spans: tuple[int, int], ticks: int = 96) -> Array:
    """A depth of 1 m in these spans of ticks, else 0: on the surface, which is outside."""
    depth = np.zeros(ticks)
    for first, end in spans:
        depth[first:end] = 1.0
    return depth


# -- touch -----------------------------------------------------------------------------------------------------------


def test_felt_is_more_than_a_tenth_and_a_tenth_of_a_newton_more_than_just_before() -> None:
    """Drag of 2 N: 2.2 N is not felt, what is more is. Of 0.5 N: not 0.6. A strong force earlier does not count."""
    for drag_N, same, more in ((2.0, 2.0 + 0.1 * 2.0, 2.21), (0.5, 0.5 + 0.1, 0.61)):
        depth, force = inside((24, 64)), np.full(96, drag_N)
        force[:16] = 9.0  # the 100 ms before the crossing at tick 24 begin with tick 18
        force[28:] = same
        force[40:] = more
        assert visit(depth, force) == [WallContact(24 * TICK_S, 24 * TICK_S, 40 * TICK_S)]
        force[40:] = same
        assert visit(depth, force) == [WallContact(24 * TICK_S, 24 * TICK_S, None)]
        force[18], force[40:] = 9.0, more
        assert visit(depth, force)[0].felt_s is None


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False).tolist())
def test_a_swing_is_not_felt_as_a_wall(phase: float) -> None:
    """2 N at 6 Hz: at some phases it exceeds all of the last 100 ms, but not for long. A wall is."""
    t = np.arange(0.0, 2.0, 0.002)
    depth = np.where((t > 1.0) & (t < 1.8), 0.01, -0.01)
    swing = 2.0 * np.sin(12.0 * math.pi * t + phase)
    for wall_N, felt in ((0.0, False), (5.0, True)):
        run = recorded(depth[:, None], -(swing + wall_N * (t > 1.1))[:, None], 0.002)
        (touch,) = touches(run, [SURFACE], 100.0, 0.05)
        assert (touch.felt_s is not None) is felt
        assert touch.felt_s is None or 0.95 < touch.felt_s < 1.2


def test_a_contact_may_be_felt_before_word_of_it_is_back() -> None:
    """A local model can do that: felt 4 ticks after the crossing, over a round trip of 6."""
    force = np.where(np.arange(96) >= 28, 5.0, 0.0)
    found = visit(inside((24, 64)), force, round_trip_s=6 * TICK_S)
    assert latency(found, 6 * TICK_S) == Latency(-2 * TICK_S, None, 0, 0)


def test_it_is_looked_for_until_a_round_trip_after_the_visit_or_the_next_one() -> None:
    """A visit from tick 24 to 31 over a round trip of 4: felt until tick 34, not from 35 on."""
    for begin, felt in ((24, 24), (34, 34), (35, None)):
        force = np.where(np.arange(96) >= begin, 5.0, 0.0)
        (found,) = visit(inside((24, 32)), force, round_trip_s=4 * TICK_S)
        assert found.felt_s == (None if felt is None else felt * TICK_S)
    force = np.where(np.arange(96) >= 50, 5.0, 0.0)
    first, second = visit(inside((24, 32), (48, 60)), force, round_trip_s=30 * TICK_S)
    assert first.felt_s is None  # what comes in the second visit is the second's
    assert second.felt_s == 50 * TICK_S


def test_a_device_that_comes_back_within_a_tenth_of_a_second_has_not_left() -> None:
    """Six ticks away, 94 ms, are a tremble. Seven, 109 ms, are not."""
    force = np.where(np.arange(96) >= 46, 5.0, 0.0)
    assert len(visit(inside((24, 28), (33, 60)), force)) == 1
    assert len(visit(inside((24, 28), (34, 60)), force)) == 2


def test_what_no_spring_would_let_be_felt_is_no_touch() -> None:
    """An ideal spring takes 0.1 N at 0.1 N / K of depth: that is the time from which a later touch counts."""
    depth = 0.01 * inside((24, 32)) + np.clip(np.arange(96) - 60.0, 0.0, 20.0) * 1e-3
    ticks = [touch.ideal_s / TICK_S for touch in visit(depth, np.zeros(96), stiffness=8.0)]
    assert ticks == [73]  # 13 mm; the first visit was 10 mm deep
    assert [touch.ideal_s / TICK_S for touch in visit(depth, np.zeros(96), stiffness=10.5)] == [24, 70]
    assert visit(depth, np.zeros(96), stiffness=4.9) == []


def test_no_touch_without_a_wall_or_where_the_device_began() -> None:
    run = recorded(inside((0, 96))[:, None], np.zeros((96, 1)), TICK_S)
    assert touches(run, [SURFACE], 1.0, 0.0) == touches(run, [], 1.0, 0.0) == []
    untouched = recorded(np.zeros((96, 1)), np.ones((96, 1)), TICK_S)  # it only lies on the surface
    assert pressed_wall(untouched.device, [SURFACE]) is None
    assert touches(untouched, [SURFACE], 1.0, 0.0) == []


def test_a_miss_is_infinitely_late() -> None:
    felt, missed = WallContact(1.0, 1.25, 1.5), WallContact(1.0, 1.25, None)
    assert latency([], 0.25) == Latency(None, None, 0, 0)
    assert latency([felt], 0.25) == Latency(0.25, None, 0, 0)
    assert latency([missed, felt, felt, missed], 0.25) == Latency(math.inf, 0.25, 3, 2)
    assert latency([felt, felt, missed], 0.25).later_s == math.inf
    assert latency([felt, WallContact(2.0, 2.0, 2.5), felt], 0.25).later_s == 0.375


def test_quantiles_with_misses() -> None:
    """numpy's where all is finite; infinite from the first quantile on that reaches a miss."""
    values = [3.0, -1.0, 4.0, 1.5, 9.0, 2.0]
    for share in (0.0, 0.1, 0.25, 0.5, 0.75, 1.0):
        assert quantile(values, share) == pytest.approx(float(np.percentile(values, 100.0 * share)), rel=1e-12)
    assert quantile([1.0, math.inf, 2.0], 0.5) == 2.0
    assert quantile([1.0, math.inf, 2.0], 0.51) == math.inf
    assert quantile([math.inf] * 2, 0.5) == math.inf
    assert quantile([7.0], 0.3) == 7.0


def test_a_miss_is_a_value_of_its_metric_only() -> None:
    assert value_of({"first_contact_ms": None, "first_contact_missed": 1.0}, "first_contact_ms") == math.inf
    assert value_of({"first_contact_ms": None, "first_contact_missed": 0.0}, "first_contact_ms") is None
    assert value_of({"first_contact_ms": None}, "first_contact_ms") is None  # an older journal
    assert value_of({"first_contact_missed": 1.0}, "first_contact_missed") == 1.0
    assert all(metric.missed in {"", *METRICS} for metric in METRICS.values())


def test_a_comparison_counts_misses_into_its_quartiles() -> None:
    """Of eight cases three are felt, four are missed, one touched nothing: the median of seven is a miss."""
    params = Params().set({"device.servo": "sampled"})
    plan = Plan(params, ("pspm",), {"lan": ("", "")}, ("press",), tuple(range(8)))
    felt: Sequence[tuple[float | None, float | None]] = [(10.0, 0.0), (30.0, 0.0), (20.0, 0.0), *[(None, 1.0)] * 4]
    outcomes = [
        RunMeasures(one, {**dict.fromkeys(METRICS), "first_contact_ms": ms, "first_contact_missed": missed})
        for one, (ms, missed) in zip(plan.cases(), [*felt, (None, None)], strict=True)
    ]
    (group,) = groups(plan, outcomes)
    spread = group.spreads["first_contact_ms"]
    assert (spread.count, spread.missed, spread.least, spread.most) == (3, 4, 10.0, 30.0)
    assert (spread.q1, spread.median, spread.q3) == (25.0, math.inf, math.inf)


# -- free motion -----------------------------------------------------------------------------------------------------

RATE_HZ = 500.0
T = np.arange(0.0, 6.0, 1.0 / RATE_HZ)


def swept(t: Array) -> tuple[Array, Array]:
    """Position [m] and velocity [m/s] of a hand that moves by 30 mm at 0.5 Hz."""
    return 0.03 * np.sin(math.pi * t), 0.03 * math.pi * np.cos(math.pi * t)


def test_drag_is_a_dampers() -> None:
    """c v of a damper at 67 mm/s; a spring's and a mass's force, in quadrature, add nothing."""
    x, v = swept(T)
    force = -6.0 * v + 20.0 * x
    found = drag(recorded(x[:, None], force[:, None], 1.0 / RATE_HZ), [], 0.05)
    assert found == pytest.approx(6.0 * DRAG_MPS, rel=0.02)
    circle = np.column_stack([x, swept(T + 0.5)[0]])
    across = np.column_stack([-6.0 * v, -6.0 * swept(T + 0.5)[1]])
    assert drag(recorded(circle, across, 1.0 / RATE_HZ), [], 0.05) == pytest.approx(6.0 * DRAG_MPS, rel=1e-3)


def test_a_swing_does_not_hide_the_drag() -> None:
    """10 mm at 6 Hz that the coupling drives: the device is faster than by the hand, the force is with it."""
    x, v = swept(T)
    swing, its_v = 0.01 * np.sin(12.0 * math.pi * T), 0.12 * math.pi * np.cos(12.0 * math.pi * T)
    found = drag(recorded((x + swing)[:, None], (-6.0 * v + 4.0 * its_v)[:, None], 1.0 / RATE_HZ), [], 0.05)
    assert found == pytest.approx(6.0 * DRAG_MPS, rel=0.03)


def test_contact_and_its_aftermath_are_no_free_motion() -> None:
    """A wall from 20 mm on, felt 0.1 s late: with 0.1 s of settling none of its force is in the drag."""
    x, v = swept(T)
    late = swept(T - 0.1)[0]
    force = -6.0 * v - 900.0 * np.maximum(late - 0.02, 0.0)
    run = recorded(x[:, None], force[:, None], 1.0 / RATE_HZ)
    wall = Wall((1.0,), 0.02, 3000.0)
    assert drag(run, [wall], 0.1) == pytest.approx(6.0 * DRAG_MPS, rel=0.02)
    assert drag(run, [wall], 0.0) != pytest.approx(6.0 * DRAG_MPS, rel=0.05)
    by_proxy = recorded(x[:, None], force[:, None], 1.0 / RATE_HZ, proxy_depth=x - 0.02)
    assert drag(by_proxy, [], 0.1) == drag(run, [wall], 0.1)


def test_the_force_in_free_air_is_a_quantile_over_time() -> None:
    """1 N for the fastest 2 % of the time; contact and the 0.1 s after it do not count, however strong its force."""
    x, v = swept(T)
    fast = np.abs(v) > np.quantile(np.abs(v), 0.98)
    force = np.where(fast, 1.0, 0.2)[:, None]
    run = recorded(x[:, None], force, 1.0 / RATE_HZ)
    assert free_force(run, [], 0.1) == 1.0
    assert free_force(run, [], 0.1, 0.97) == 0.2
    late = 9.0 * (swept(T - 0.1)[0] > 0.02)[:, None]
    touching = recorded(x[:, None], np.maximum(force, late), 1.0 / RATE_HZ)
    wall = Wall((1.0,), 0.02, 3000.0)
    assert free_force(touching, [wall], 0.1, 0.999) == 1.0
    assert free_force(touching, [wall], 0.0, 0.999) == 9.0


def test_the_drag_in_each_range_of_speed() -> None:
    """A damper of 2 Ns/m and a force that only pushes forward and back; a range without motion has no drag."""
    v = np.concatenate([np.full(200, 0.1), np.full(200, -0.5), np.full(20, 0.9)])
    force = (-2.0 * v + np.where(np.arange(420) % 2, 0.3, -0.3))[:, None]
    run = recorded(np.cumsum(v)[:, None] * TICK_S, force, TICK_S)
    run.device["velocity_mps"][:, 0] = v
    drags = drag_by_speed(run, [], 0.0, (0.05, 0.2, 0.4, 0.7, 1.0))
    assert drags == [pytest.approx(0.2), None, pytest.approx(1.0), pytest.approx(1.8)]


def test_no_drag_where_nothing_moves_freely() -> None:
    x, v = swept(T)
    still = recorded(0.0001 * x[:, None], -6.0 * v[:, None], 1.0 / RATE_HZ)
    assert drag(still, [], 0.05) is None
    pressed = recorded(x[:, None], -6.0 * v[:, None], 1.0 / RATE_HZ, proxy_depth=np.ones(len(T)))
    assert drag(pressed, [], 0.05) is None
    assert drag(recorded(x[:100, None], -v[:100, None], 1.0 / RATE_HZ), [], 0.05) is None


def test_the_force_of_a_settled_contact() -> None:
    """The median of what is felt from a round trip and two steps after the entry on."""
    depth = inside((8, 40))
    force = np.where(np.arange(96) >= 30, 3.0, np.where(np.arange(96) >= 20, 2.0, 50.0))
    run = recorded(depth[:, None], -force[:, None], TICK_S)
    assert contact_force(run, [SURFACE], 10 * TICK_S) == 2.5
    assert contact_force(run, [], 0.0) is None


# -- holding still ---------------------------------------------------------------------------------------------------


def test_the_swing_after_the_hand_has_stopped() -> None:
    """A sine of amplitude a has a/sqrt(2) without its mean; what comes in the first second does not count."""
    aim = np.where(T < 2.0, 0.01 * T, 0.02)[:, None]
    force = 1.7 + 0.5 * np.sin(2.0 * math.pi * 6.0 * T) + np.where(T < 3.0, 9.0 * np.sin(31.0 * T), 0.0)
    x = np.zeros((len(T), 1))
    found = residual_oscillation(recorded(x, force[:, None], 1.0 / RATE_HZ, target=aim))
    assert found == pytest.approx(0.5 / math.sqrt(2.0), rel=0.01)
    both = np.column_stack([force, 0.5 * np.cos(2.0 * math.pi * 6.0 * T)])
    aims = np.column_stack([aim, aim])
    assert residual_oscillation(recorded(np.zeros_like(both), both, 1.0 / RATE_HZ, target=aims)) == pytest.approx(
        0.5, 0.01
    )


def test_no_swing_where_the_hand_never_holds_still() -> None:
    """Less than 3 s after the stop, a hand that creeps, and a hand that nobody knows."""
    x = np.zeros((len(T), 1))
    for aim in (np.where(T < 3.1, 0.01 * T, 0.031), 1e-5 * T):
        assert residual_oscillation(recorded(x, x, 1.0 / RATE_HZ, target=aim[:, None])) is None
    assert residual_oscillation(recorded(x, x, 1.0 / RATE_HZ)) is None
    assert residual_oscillation(recorded(x, x, 1.0 / RATE_HZ, target=x)) == 0.0  # at rest from the start


def test_of_several_stops_the_worst_counts() -> None:
    aim = np.where(T < 3.0, 0.0, 0.01)[:, None]
    force = np.where(T < 3.0, 0.1, 0.4) * np.sin(2.0 * math.pi * 5.0 * T)
    t = np.arange(0.0, 6.2, 1.0 / RATE_HZ)
    aim, force = (np.interp(t, T, values.ravel())[:, None] for values in (aim, force))
    found = residual_oscillation(recorded(np.zeros((len(t), 1)), force, 1.0 / RATE_HZ, target=aim))
    assert found == pytest.approx(0.4 / math.sqrt(2.0), rel=0.03)


# -- the true environment --------------------------------------------------------------------------------------------


def test_the_force_of_the_true_environment_is_each_walls_spring_at_that_place() -> None:
    oblique = Wall((0.6, 0.8), 0.02, 3000.0)
    place = np.array([[0.0, 0.0], [0.06, 0.08], [0.0, 0.03]])
    found = environment_force(place, [0.0, 1.0, 2.0], lambda t: [oblique], lambda wall: wall.stiffness / 30.0)
    assert found == pytest.approx(np.array([[0.0, 0.0], [-0.6 * 8.0, -0.8 * 8.0], [-0.6 * 0.4, -0.8 * 0.4]]))
    gone = environment_force(
        place, [0.0, 1.0, 2.0], lambda t: [oblique] if t > 1.5 else [], lambda wall: wall.stiffness / 30.0
    )
    assert np.array_equal(gone, found * np.array([[0.0], [0.0], [1.0]]))


def test_the_error_against_it_by_hand() -> None:
    run = recorded(np.zeros((4, 1)), np.array([[1.0], [2.0], [-1.0], [0.0]]), TICK_S)
    assert run.device is not None
    assert rms_difference(run.device, np.array([[1.0], [0.0], [-1.0], [-4.0]])) == pytest.approx(
        (math.sqrt(5.0), 25.0 * math.sqrt(5.0))
    )
    assert rms_difference(run.device, np.zeros((4, 1)))[1] is None


# -- together --------------------------------------------------------------------------------------------------------

SLOW: dict[str, object] = {
    "device.servo": "sampled", "duration_s": 5.2, "link.up": "", "link.down": "", "operator_model.hold_s": 9.0,
    "operator_model.reach_s": 1.5, "world.step_min_s": 0.002, "world.step_max_s": 0.002, "world.damping": 0.2,
    "device.step_limit_N": 0.0,
}  # fmt: skip


def test_a_nearly_ideal_coupling_is_nearly_the_true_environment() -> None:
    """No link, steps of 2 ms, hardly any damping: felt at once, true to a few percent, and calm.

    What drags is B of 0.1 Ns/m and K of 100 N/m times a lag of some 5 ms: about 0.04 N at 67 mm/s.
    """
    found = case.measure(Params(rendering="paper").set(SLOW), 1)
    drag_N, ratio, error, late = (
        found[name] for name in ("drag_N", "contact_to_drag", "true_force_error_percent", "first_contact_ms")
    )
    assert drag_N == pytest.approx(0.04, abs=0.02)
    assert ratio > 20.0
    assert error == pytest.approx(0.0, abs=4.0)
    assert late < 60.0  # 0.1 N are 1.2 mm deep
    assert found["first_contact_missed"] == found["later_contacts"] == 0.0
    assert found["swing_N"] == pytest.approx(0.0, abs=0.01)


def test_a_wall_that_moved_is_true_where_it_is_then() -> None:
    """The wall vanishes under half of the contact: were it still true, the error would be that of its whole force."""
    moved = Params().set({**SLOW, "scene": "moving", "world.wall.timeline": "at 2.5s: gone", "duration_s": 3.5})
    found = case.measure(moved, 1)
    error = found["true_force_error_percent"]
    assert error < 15.0
    assert found["stiffness_percent"] is None  # of walls at rest only


def test_a_comparison_as_rows_has_medians_and_quartiles(tmp_path: Path) -> None:
    """One row per group; each metric with its quartiles, and misses where it can be missed; a miss is ``inf``."""
    plan = Plan(Params(), ("pspm",), {"lan": ("", "")}, ("press",), (0, 1, 2))
    outcomes = [
        RunMeasures(
            one, {**dict.fromkeys(METRICS), "drag_N": 0.1 * one.seed, "first_contact_missed": float(one.seed > 0)}
        )
        for one in plan.cases()
    ]
    write_csv(as_rows(groups(plan, outcomes)), tmp_path / "compare.csv")
    with (tmp_path / "compare.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert (row["coupling"], row["link"], row["cases"]) == ("pspm", "lan", "3")
    assert [float(row[f"drag_N{end}"]) for end in ("", "_q1", "_q3")] == pytest.approx([0.1, 0.05, 0.15])
    assert (row["first_contact_ms"], row["first_contact_ms_missed"]) == ("inf", "2")
    assert row["swing_N"] == row["swing_N_q1"] == ""
    assert all(name + end in row for name in METRICS for end in ("", "_q1", "_q3"))
