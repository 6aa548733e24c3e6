"""Metrics of long runs and of the virtual world: windows, the worst tenth, contacts, what is modulated, both ports."""

import math

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.metrics.contact import rendered_by_tenths
from hapnet.ext.metrics.force import force_meanwhile, rms_difference
from hapnet.ext.metrics.measured import Measured, Span, first_and_last, tenths
from hapnet.ext.metrics.motion import free_windows
from hapnet.ext.metrics.passivity import energy_out
from hapnet.ext.metrics.world import contact_force_error, modulated_share, visits
from hapnet.ext.study import case
from hapnet.ext.study.case import simulated
from hapnet.params import Params
from tests.support.metric_recordings import RATE_HZ, device, recording, sampled, world

# -- windows ---------------------------------------------------------------------------------------------------------


def test_the_last_minute_ends_when_the_hand_holds_still() -> None:
    assert first_and_last(120.0, 3.0) == ((0.0, 10.0), (57.0, 117.0))
    assert first_and_last(119.9) is None
    assert Span(1.0, 2.0).holds(np.array([0.5, 1.0, 1.9, 2.0])).tolist() == [False, True, True, False]


def test_each_sample_is_in_one_tenth() -> None:
    times = np.array([0.0, 0.99, 1.0, 9.99, 10.02])
    assert [int(np.flatnonzero([part[k] for part in tenths(times, 10.0)])[0]) for k in range(5)] == [0, 0, 1, 9, 9]


def circling(speed: float, seconds: float = 4.0) -> tuple[Array, Array]:
    """Positions and velocities (N, 2) on a circle so wide that a third of a second of it is straight."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    phase = speed / 0.5 * t
    return 0.5 * np.column_stack([np.cos(phase), np.sin(phase)]), speed * np.column_stack(
        [-np.sin(phase), np.cos(phase)]
    )


def test_the_greatest_drag_is_that_of_the_worst_twentieth_near_67_mm_per_s() -> None:
    """2 Ns/m, for the last fifth of the time 9: more than a twentieth of the windows. Too slow or fast: none."""
    x, v = circling(0.07)
    damping = np.where(np.arange(len(x)) < 0.8 * len(x), 2.0, 9.0)[:, None]
    found = free_windows(sampled(x, -damping * v), [], 0.05)
    assert found.greatest_drag() == pytest.approx(9.0 * 0.07, rel=1e-3)
    assert found.greatest_drag(0.5) == pytest.approx(2.0 * 0.07, rel=1e-3)
    early = found.during(Span(0.0, 3.0))
    assert early.greatest_drag() == pytest.approx(2.0 * 0.07, rel=1e-3)
    assert early.drag() == pytest.approx(2.0 * 0.067, rel=1e-3)
    for speed in (0.04, 0.1):
        x, v = circling(speed)
        other = free_windows(sampled(x, -2.0 * v), [], 0.05)
        assert other.greatest_drag() is None
        assert other.drag() == pytest.approx(2.0 * 0.067, rel=1e-3)


# -- the worst tenth -------------------------------------------------------------------------------------------------


def pressing(period_s: float, share: float) -> tuple[Array, Array]:
    """Times [s] of 10 s, and what the true environment gives: 1 N in this share of each period, else nothing."""
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    return t, -np.where((t % period_s) > (1.0 - share) * period_s, 1.0, 0.0)[:, None]


def test_the_stiffness_of_each_tenth_is_that_of_its_settled_contact() -> None:
    """Each second has half a second of contact: 100 % but for 40 % in the fourth; the first 0.12 s do not count."""
    t, wanted = pressing(1.0, 0.5)
    share = np.where(t.astype(int) == 3, 0.4, 1.0)[:, None]
    force = np.where((t % 1.0 < 0.62)[:, None], 7.0, share) * wanted
    run = sampled(np.zeros_like(wanted), force)
    found = rendered_by_tenths(run, wanted, 0.1, 10.0)
    assert found == pytest.approx([1.0, 1.0, 1.0, 0.4, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], rel=1e-6)
    assert max(rendered_by_tenths(run, wanted, 0.0, 10.0)) > 2.0  # settled after 0.02 s, it would
    only = np.where((t < 2.0)[:, None], wanted, 0.0)
    assert len(rendered_by_tenths(run, only, 0.1, 10.0)) == 2


def test_a_contact_that_goes_on_from_the_tenth_before_has_settled() -> None:
    t, _ = pressing(1.0, 0.5)
    wanted = -np.where((t > 0.5) & (t < 1.3), 1.0, 0.0)[:, None]
    run = sampled(np.zeros_like(wanted), np.where((t < 1.0)[:, None], 1.0, 0.25) * wanted)
    assert rendered_by_tenths(run, wanted, 0.1, 10.0) == pytest.approx([1.0, 0.25], rel=1e-6)


def test_taps_shorter_than_a_round_trip_count_whole_if_there_is_nothing_else() -> None:
    """Taps of 0.2 s over a round trip of 0.3 s."""
    t, wanted = pressing(1.0, 0.2)
    run = sampled(np.zeros_like(wanted), np.where(t < 5.0, 1.0, 0.5)[:, None] * wanted)
    found = rendered_by_tenths(run, wanted, 0.3, 10.0)
    assert found == pytest.approx([1.0] * 5 + [0.5] * 5, rel=1e-6)
    held = np.where(((t > 9.2) & (t < 9.9))[:, None], -1.0, wanted)  # one long contact: then the taps do not count
    assert rendered_by_tenths(run, held, 0.3, 10.0) != pytest.approx(found)
    assert len(rendered_by_tenths(run, held, 0.3, 10.0)) == 1


# -- the world -------------------------------------------------------------------------------------------------------


def test_visits_are_counted_as_they_are() -> None:
    assert visits(np.array([0, 1, 1, 0, 1, 0, 0, 1], dtype=bool)) == 3
    assert visits(np.array([1, 0], dtype=bool)) == 1
    assert visits(np.array([], dtype=bool)) == 0


def test_the_contact_force_is_compared_in_the_middle_of_its_step_and_weighted_by_its_length() -> None:
    """The device moves at 1 m/s, the true force is 2 N/m times its position. A step of 2 s until 4 s: at 3 s 6 N."""
    run = recording(
        device(0.0, (0.0,), (0.0,)),
        device(10.0, (10.0,), (0.0,)),
        world(4.0, (0.0,), 0.0)._replace(step_s=2.0, contact_force_N=(7.0,)),  # 1 N off for 2 s
        world(8.0, (0.0,), 0.0)._replace(step_s=4.0, contact_force_N=(12.0,)),  # at 6 s: 12 N
        world(12.0, (0.0,), 0.0)._replace(step_s=4.0, contact_force_N=(23.0,)),  # at 10 s: 20 N, 3 N off for 4 s
        world(14.0, (0.0,), 0.0)._replace(step_s=2.0, contact_force_N=(99.0,)),  # the device is no more
    )
    error = math.sqrt((2.0 * 1.0 + 4.0 * 9.0) / 10.0)
    assert contact_force_error(run, lambda x, t: 2.0 * x) == pytest.approx(100.0 * error / 20.0)
    assert contact_force_error(run, lambda x, t: 2.0 * t[:, None]) == pytest.approx(100.0 * error / 20.0)
    assert contact_force_error(run, lambda x, t: 0.0 * x) is None
    assert contact_force_error(run, lambda x, t: None) is None


def test_modulated_is_what_differs_by_more_than_a_nanometre() -> None:
    at = world(0.0, (0.0, 0.0), 0.0)
    run = recording(
        at._replace(set_position_m=(0.001, 0.0), target_m=(0.001, 5e-10)),
        at._replace(set_position_m=(0.001, 0.0), target_m=(0.001, 1.1e-9)),
        at._replace(set_position_m=(0.0, 0.0), target_m=(0.001, 0.0)),
        at,
    )
    assert run.world is not None
    assert modulated_share(run.world) == 0.5


# -- of a run --------------------------------------------------------------------------------------------------------

LONG: dict[str, object] = {
    "device.servo": "sampled", "duration_s": 120.0, "operator": "hand-11", "operator_model.end_hold_s": 3.0,
    "link.up": "4g", "link.down": "4g", "device.stiffness": 200.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def long_run() -> tuple[Measured, case.Measures]:
    params = Params().set(LONG)
    return simulated(params, 3), case.measure(params, 3)


@pytest.mark.slow
def test_the_windows_of_a_long_run_again_in_other_words(long_run: tuple[Measured, case.Measures]) -> None:
    run, found = long_run
    t, x = run.device["time_s"], run.device["position_m"][:, 0]
    proxy = np.interp(t, run.world["time_s"], run.world["position_m"][:, 0])
    depth = np.maximum(x - 0.02, 0.0)
    for name, since_s, until_s in (("free_first_mm", 0.0, 10.0), ("free_last_mm", 57.0, 117.0)):
        chosen = (t >= max(since_s, run.world["time_s"][0])) & (t < until_s) & (depth == 0.0)
        assert found[name] == pytest.approx(1e3 * math.sqrt(np.mean((x - proxy)[chosen] ** 2)), rel=1e-9)
    true = -200.0 * 3000.0 / 3500.0 * depth
    last = (t >= 57.0) & (t < 117.0)
    apart = (run.device["force_N"][:, 0] - true)[last]
    assert found["true_force_error_last_percent"] == pytest.approx(
        100.0 * math.sqrt(np.mean(apart**2)) / np.abs(true).max(), rel=1e-9
    )
    assert found["stiffness_worst_percent"] == pytest.approx(100.0, abs=5.0)
    assert found["drag_last_N"] == pytest.approx(found["drag_N"] or 0.0, rel=0.5)


def test_the_worlds_figures_of_a_long_run_again_in_other_words(long_run: tuple[Measured, case.Measures]) -> None:
    """The force on a proxy at rest is K'/(K' + K_w) of K_w times the device's depth; the port's work is that of f."""
    run, found = long_run
    t, x = run.device["time_s"], run.device["position_m"][:, 0]
    world, step_s = run.world, run.world["step_s"]
    middle_s = world["time_s"] - 0.5 * step_s
    true = -500.0 * 3000.0 / 3500.0 * np.maximum(np.interp(middle_s, t, x) - 0.02, 0.0)
    apart = world["contact_force_N"][:, 0] - true
    known = (middle_s >= t[0]) & (middle_s <= t[-1])
    rms = math.sqrt(np.sum((step_s * apart**2)[known]) / np.sum(step_s[known]))
    assert found["world_force_error_percent"] == pytest.approx(100.0 * rms / np.abs(true).max(), rel=1e-2)
    entries = [int(np.count_nonzero(np.diff((p > 0.0).astype(int)) == 1)) for p in (world["penetration_m"], x - 0.02)]
    assert found["contacts_ratio"] == entries[0] / entries[1] > 1.0
    moved = np.diff(world["position_m"][:, 0])
    work = np.cumsum(world["contact_force_N"][1:, 0] * moved)
    assert found["world_energy_out_J"] == pytest.approx(-work.min(), rel=1e-6)
    assert found["hand_energy_out_J"] == 0.0
    assert found["world_reservoir_min_J"] == run.result.summary["world"]["reservoir_min_J"]  # type: ignore[index]
    assert 0.0 < (found["modulated_percent"] or 0.0) < 100.0


def test_without_reservoirs_nothing_is_modulated_and_the_energy_still_counts() -> None:
    """What both ports gave out together came out at the world's, less what the hand has put in."""
    run = simulated(Params().set({**LONG, "duration_s": 30.0, "coupling": "zoh"}), 3)
    found = case.measures(run)
    assert found["modulated_percent"] is found["world_reservoir_min_J"] is found["device_reservoir_min_J"] is None
    world_J, both_J = found["world_energy_out_J"], found["energy_out_J"]
    assert world_J >= both_J > 0.0
    bound = run.sides[1]["ledger"]["bound_J"]
    assert run.world is not None
    assert bound is not None
    assert energy_out(run.world, bound) == world_J


def test_where_walls_rub_the_force_is_compared_with_that_of_an_ideal_link_and_a_fast_world() -> None:
    """A hand that moves along a rough plane: friction of 0.3 is no error of the coupling, but no spring has it."""
    given = Params().set({**LONG, "scene": "plane?friction=0.3", "duration_s": 2.0, "operator_model.end_hold_s": 0.0})
    found = case.measure(given, 3)
    run = simulated(given, 3)
    nothing = {"link.up": "", "link.down": "", "world.step_min_s": 0.001, "world.step_max_s": 0.001}
    local = simulated(given.set(nothing), 3)
    wanted = force_meanwhile(run.recording, local.recording)
    assert found["true_force_error_N"] == pytest.approx(rms_difference(run.device, wanted)[0])
    assert run.wanted is not None
    by_springs = rms_difference(run.device, run.wanted)[0]
    assert (found["true_force_error_N"] or math.inf) < 0.3 * by_springs
