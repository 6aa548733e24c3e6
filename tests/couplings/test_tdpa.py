"""Two-port time-domain passivity: the account, the controllers and the tuning."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.control.coupling import PortSample
from hapnet.control.prediction import MotionPredictor
from hapnet.ext.laws.parts.tdpa_world import PassivityObserver
from hapnet.ext.study.case import measure
from hapnet.params import Params
from tests.support.tdpa_ends import TICK, device, reported, simulated, watched as watched, world

# -- the account -----------------------------------------------------------------------------------------------------


def test_a_passive_wall_makes_both_observers_positive() -> None:
    """Push slowly into a mass that does not move, and come back: a spring K takes K d^2/2 and returns it."""
    hand, far, depth = device(), world(), 0.01
    far.receive(reported(hand))
    far.begin()
    hand.receive(reported(far))
    way = [depth * (1.0 - math.cos(math.pi * k / 10_000)) / 2.0 for k in range(20_001)]
    held: Vector = (0.0,)
    for k, (before, at) in enumerate(pairwise(way), 1):
        held = hand.force(TICK, (at,), ((at - before) / TICK,), held)
        assert held[0] <= 0.02, "a wall pulls"  # but for the drift
        if k % 10 == 0:
            far.impedance(10 * TICK)
            far.moved(10 * TICK, (0.0,), (0.0,), (0.0,))
            hand.receive(reported(far))
            far.receive(reported(hand, (at,)))
            far.begin()
        if k == 10_000:
            assert reported(hand).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)
            assert reported(far).energy == pytest.approx(0.0, abs=1e-5)
    assert reported(hand).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)
    assert reported(far).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=20), st.randoms())
def test_loss_and_reordering_never_grant_more_than_what_went_in(energies: list[float], shuffle: Any) -> None:
    totals = np.cumsum(energies).tolist()
    arriving = [total for total in totals if shuffle.random() < 0.5]
    shuffle.shuffle(arriving)
    observer = PassivityObserver()
    for total in arriving:
        observer.receive(total)
        assert -observer.debt <= totals[-1] * (1.0 + 1e-12)
    first = arriving[0] if arriving else 0.0
    assert -observer.debt == pytest.approx(max(arriving, default=0.0) - first)


def test_what_was_granted_to_one_peer_is_not_granted_to_the_next() -> None:
    observer = PassivityObserver()
    observer.observe(-3.0, 0.0)
    observer.receive(0.0)
    observer.receive(2.0)
    observer.observe(0.5, 0.0)
    observer.on_peer_changed()
    assert observer.put_in == 3.0
    observer.receive(7.0)
    assert observer.debt == 0.5 - 2.0
    observer.receive(7.25)
    observer.receive(7.125)
    assert observer.debt == 0.5 - 2.0 - 0.25
    observer.observe(-1.0, 0.0)
    assert observer.put_in == 4.0


# -- the device ------------------------------------------------------------------------------------------------------


def test_the_device_damps_what_it_owes_and_pays_what_the_damper_took() -> None:
    """f <- f + alpha v with alpha = debt/(T v^2), on the device -f - alpha v; then E_out less the true dissipation."""
    law = device(debt_limit_J=1e6)
    law.receive(PortSample((-2.0,), 0.0))
    assert law.force(TICK, (0.0,), (0.05,), (0.0,)) == (2.0,)
    dx = 4.0e-6
    owed = 2.0 * dx  # moved along with the force, and nothing went in at the other port
    v = 0.05
    alpha = owed / (TICK * v**2)
    assert 0.0 < alpha < 5.0
    held = law.force(TICK, (dx,), (v,), (2.0,))
    assert held[0] == pytest.approx(2.0 - alpha * v, rel=1e-7)
    more = 5.0e-6
    law.force(TICK, (dx + more,), (v,), held)
    assert law.observer.debt == pytest.approx(owed + 2.0 * more - alpha * v * more, rel=1e-6)


@pytest.mark.parametrize(("v", "damping"), [(0.0019, 0.0), (0.0021, 5.0), (-0.1, 5.0)])
def test_the_device_damps_with_at_most_the_cap_and_not_below_the_floor(v: float, damping: float) -> None:
    law = device(debt_limit_J=1e6)
    law.receive(PortSample((-2.0,), 0.0))
    law.force(TICK, (0.001,), (v,), (2.0,))
    assert law.force(TICK, (0.001,), (v,), (2.0,))[0] == pytest.approx(2.0 - damping * v, rel=1e-6)


def test_a_device_that_owes_all_it_may_renders_nothing_until_energy_comes() -> None:
    law = device()
    law.receive(PortSample((-2.0,), 0.0))
    assert law.force(TICK, (0.011,), (0.0,), (2.0,)) == (0.0,)
    law.receive(PortSample((-2.0,), 0.012))
    assert law.force(TICK, (0.011,), (0.0,), (0.0,))[0] == pytest.approx(2.0 * 0.5)
    law.receive(PortSample((-2.0,), 0.022))
    assert law.force(TICK, (0.011,), (0.0,), (0.0,)) == (2.0,)


def test_its_set_position_makes_the_force_so_a_larger_deadband_sends_less() -> None:
    law = device((0.1, 0.0))
    assert law.set_position == (0.1, 0.0)
    law.receive(PortSample((-2.0, 0.5), 0.0))
    assert law.set_position == pytest.approx((0.12, -0.005))
    sent = []
    for fraction in (0.1, 0.5, 1.0):
        _, result = simulated("ideal", "sine", 2.0, {"wire.deadband": fraction})
        sent.append(result.summary["links"]["up"]["offered"])
    assert sent[1] < 0.9 * sent[0]
    assert 2 * 20 < sent[2] < 0.8 * sent[1], "signs of life are sent every 0.1 s, of any fraction"


# -- the world -------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_a_yielding_step_is_the_coupling_in_series_with_a_damper(seed: int) -> None:
    """Against the 3 n linear equations of a step, and the coupling's own balance of energy, for any T and any debt."""
    rng = np.random.default_rng(seed)
    n, R = int(rng.integers(1, 4)), 0.2 * float(rng.integers(2))
    K, B, D = 10.0 ** rng.uniform(0, 3), 10.0 ** rng.uniform(-1, 1), 10.0 ** rng.uniform(-4, 1)
    chosen = {"stiffness_N_m": K, "damping_Ns_m": B, "debt_limit_J": D, "recovery_s": R}
    law = world((0.0,) * n, force_floor_N=1e-9, speed_limit_m_s=1e3, **chosen)
    x = np.zeros(n)
    yielded = 0
    for _ in range(60):
        T = 10.0 ** rng.uniform(-3, -1)
        law.receive(PortSample(tuple(rng.normal(0.0, 0.03, n).tolist()), 10.0 ** rng.uniform(-6, -1) * rng.integers(2)))
        law.begin()
        y, debt = np.array(law.set_position), law.observer.debt
        offset = y + np.array(law.drift) - np.array(law.goal)
        g, p = law.impedance(T)
        vhat = rng.normal(0.0, 0.3, n)
        f = np.array(p) - g * vhat
        v_y_commanded = np.array(law.commanded) / T
        law.moved(T, tuple(vhat.tolist()), tuple((x + T * vhat).tolist()), tuple(vhat.tolist()))
        v_y = (np.array(law.set_position) - y) / T
        a = B + K * T / 2
        beta = (1 / (g / a) - 1) / a
        assert 0.0 <= beta <= 1 / a * (1 + 1e-9)
        yielded += beta > 0.0
        # unknowns f, v_y; f = a (v_y - vhat) + K (y - x),  v_y = commanded - beta f
        matrix = np.block([[np.eye(n), -a * np.eye(n)], [beta * np.eye(n), np.eye(n)]])
        solution = np.linalg.solve(matrix, np.concatenate([K * (y - x) - a * vhat, v_y_commanded]))
        np.testing.assert_allclose(np.concatenate([f, v_y]), solution, rtol=1e-7, atol=1e-9)
        x1, y1 = x + T * vhat, y + T * v_y
        stored = K / 2 * (np.sum((y1 - x1) ** 2) - np.sum((y - x) ** 2))
        balance = stored + B * np.sum((v_y - vhat) ** 2) * T + f @ vhat * T
        assert f @ v_y * T == pytest.approx(balance, rel=1e-9, abs=1e-12)
        out, dissipated = f @ v_y_commanded * T, beta * f @ f * T
        assert law.observer.debt - debt == pytest.approx(max(out, 0.0) - dissipated, rel=1e-6, abs=1e-12)
        np.testing.assert_allclose(reported(law).value, K * (y1 - x1) + B * (v_y - vhat), rtol=1e-7, atol=1e-9)
        # what was commanded is where y is, and what it lost
        np.testing.assert_allclose(y1 + np.array(law.drift) - np.array(law.goal), offset, atol=1e-9)
        x = x1
    assert yielded


def test_a_step_gives_just_what_it_may_if_the_mass_does_as_it_did() -> None:
    """A mass held fast, a device that has put in a known energy: what comes out is that energy."""
    law = world(force_floor_N=1e-6, speed_limit_m_s=10.0)
    law.receive(PortSample((0.0,), 0.0))
    law.begin()
    law.impedance(0.03)
    law.moved(0.03, (0.0,), (0.0,), (0.0,))
    energy = 0.0
    for k in range(1, 30):
        energy += 1e-4
        law.receive(PortSample((0.002 * k,), energy))
        law.begin()
        y = law.set_position[0]
        _, (p,) = law.impedance(0.03)
        law.moved(0.03, (0.0,), (0.0,), (0.0,))
        if k > 3:  # the first step has no force yet, and so no brake: what it owes must be paid back first
            assert p * (law.set_position[0] - y) <= 1e-4 * (1 + 1e-6) + 1e-9
    assert law.observer.debt == pytest.approx(0.0, abs=1e-9)
    assert law.drift[0] > 0.005


def test_the_first_position_is_where_the_set_position_is() -> None:
    law = world((0.1,))
    law.receive(PortSample((0.5,), 0.0))
    for _ in range(5):
        law.begin()
        assert law.impedance(0.02)[1] == (0.0,)
        law.moved(0.02, (0.0,), (0.1,), (0.0,))
    assert law.set_position == (0.1,)
    law.on_peer_changed()
    law.receive(PortSample((-0.3,), 0.0))
    law.begin()
    assert law.impedance(0.02)[1] == (0.0,)


@given(st.lists(st.tuples(st.floats(0.01, 0.05), st.booleans()), min_size=5, max_size=40))
@settings(max_examples=25, deadline=None)
def test_without_force_nothing_is_lost_of_the_way_whatever_the_link_loses(steps: list[tuple[float, bool]]) -> None:
    """A free mass that goes along: at rest again, y has moved as far as the device has."""
    law, x = world(), 0.0
    law.receive(PortSample((0.0,), 0.0))
    law.begin()
    at = 0.0
    for dt, lost in [*steps, *[(0.03, False)] * 60]:
        at = at + 0.1 * dt if len(steps) and at < 0.1 * sum(s for s, _ in steps) - 1e-12 else at
        y = law.set_position[0]
        law.impedance(dt)
        vhat = law.commanded[0] / dt
        x = y + vhat * dt
        law.moved(dt, (vhat,), (x,), (vhat,))
        if not lost:
            law.receive(PortSample((at,), 0.0))
        law.begin()
    assert law.set_position[0] == pytest.approx(at, abs=1e-6)
    assert law.drift[0] == pytest.approx(0.0, abs=1e-12)


def test_a_step_between_two_messages_goes_on_as_the_device_did_and_not_for_longer_than_a_tenth_of_a_second() -> None:
    """A device of constant speed, sent every 5 ms and then no more, to a world of 1 ms steps."""
    law, v, way = world(force_floor_N=1e9, debt_limit_J=1e9), 0.1, []
    for k in range(600):
        if k % 5 == 0 and k < 400:
            law.receive(PortSample((v * k * TICK,), 0.0))
        law.begin()
        y = law.set_position[0]
        law.impedance(TICK)
        law.moved(TICK, (v,), (law.set_position[0],), (v,))
        way.append(law.set_position[0] - y)
    assert way[300:400] == pytest.approx([v * TICK] * 100, rel=1e-3)
    assert law.set_position[0] == pytest.approx(v * (395 * TICK + 0.1), rel=1e-3)
    assert way[500:] == pytest.approx([0.0] * 100, abs=1e-15)


def test_a_fast_world_renders_as_stiff_a_wall_as_a_slow_one() -> None:
    """Steps of 1 to 2 ms have a new position of the device in every third step, those of 10 to 50 ms in each."""
    case = Params().set({"coupling": "tdpa", "operator": "press", "duration_s": 4.0, "link.up": "", "link.down": ""})
    slow, fast = (
        measure(case.set({"world.step_min_s": minimum, "world.step_max_s": most}), 0)["stiffness_percent"]
        for minimum, most in ((0.010, 0.050), (0.001, 0.002))
    )
    assert fast > 0.95 * slow > 60.0


# -- the tuning ------------------------------------------------------------------------------------------------------


def test_the_rule_damps_critically_and_what_the_user_gives_overrides_it() -> None:
    tuning = prepare(Params().set({"coupling": "tdpa"})).tuning
    assert tuning.stiffness_N_m == 100.0
    assert tuning.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.02))
    assert tuning.damping_cap_Ns_m == 5.0
    heavy = prepare(Params().set({"coupling": "tdpa", "world.mass": 2.0, "device.mass": 0.003})).tuning
    assert heavy.damping_Ns_m == 5.0
    assert heavy.damping_cap_Ns_m == pytest.approx(3.0)
    axes = prepare(Params().set({"coupling": "tdpa", "dof": 3, "world.mass": (0.01, 0.03, 0.02)})).tuning
    assert axes.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.03))
    rotated = ((0.02, 0.01, 0.0), (0.01, 0.02, 0.0), (0.0, 0.0, 0.01))  # 0.03 kg along (1, 1, 0)
    matrix = prepare(Params().set({"coupling": "tdpa", "dof": 3, "world.mass": rotated})).tuning
    assert matrix.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.03))
    own = prepare(
        Params().set({"coupling": "tdpa", "tdpa.stiffness": 50.0, "tdpa.damping": 1.0, "tdpa.damping_cap": 2.0})
    ).tuning
    assert (own.stiffness_N_m, own.damping_Ns_m, own.damping_cap_Ns_m) == (50.0, 1.0, 2.0)


def test_the_age_that_counts_is_that_of_the_newest_position() -> None:
    far = world(predictor=MotionPredictor())
    for sent_s, age_s, counts_s in ((0.01, 0.05, 0.05), (0.03, 0.04, 0.04), (0.02, 0.07, 0.04), (0.04, 0.06, 0.06)):
        far.stamped(reported(device()), sent_s, age_s)
        assert far.newest_age == counts_s
