"""Passivity observer and controller: the observer is exact, the controller takes back what was given out."""

import math

import numpy as np
import pytest

from hapnet.ext.laws.parts.virtual_coupling import NEVER, Reset
from hapnet.ext.laws.popc import PassivityController, damping_cap
from hapnet.mechanics.spring import Spring
from tests.support.hand_port import LIGHT_HAND, lowest_energies
from tests.support.paper import PAPER

T = 0.001


def controller(
    dof: int = 1, K: float = 500.0, cap: float = 1e30, floor: float = 1e-30, reset: Reset = NEVER
) -> PassivityController:
    """Without limits by default."""
    zero = (0.0,) * dof
    return PassivityController(Spring(K, dof), (0.1,) * dof, zero, velocity_floor=floor, damping_cap=cap, reset=reset)


def test_a_passive_wall_makes_the_observer_positive() -> None:
    """The sign first: pushed 10 mm into a spring of 500 N/m the port has taken 25 mJ, and a little more by the hold."""
    law = controller()
    force: tuple[float, ...] = (0.0,)
    for n in range(1, 1001):
        force = law.force(T, (0.01 * n / 1000,), (0.01,), force)
    # the force lags by a tick: less by 1/2 K (dx)^2 a tick; the damper adds 0.1 0.01 0.01
    assert law.energy[0] == pytest.approx(0.025 - 1000 * 250 * 1e-10 + 999 * 0.1 * 0.01 * 1e-5, rel=1e-9)
    assert force[0] == pytest.approx(-5.0 - 0.001)  # and nothing was added to it


def test_the_observer_counts_what_was_really_held() -> None:
    law = controller(dof=2)
    law.receive((0.01, 0.01))
    law.force(T, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    law.force(T, (0.001, -0.002), (0.0, 0.0), (3.0, 2.0))  # the actuator could do no more than 3 N
    assert law.energy == pytest.approx((-0.003, 0.004))
    law.release(0.05, (0.002, -0.002), (1.0, 1.0))
    assert law.energy == pytest.approx((-0.004, 0.004))
    assert law.set_position == (0.002, -0.002)


def test_the_controller_damps_what_is_missing_away_axis_by_axis() -> None:
    """alpha = -W / (T v^2): 1 mJ at 0.2 m/s over 1 ms asks for 25 Ns/m, 5 N; an axis above zero is left alone."""
    law = controller(dof=2, K=1e-9)
    law.force(T, (0.001, 0.001), (0.0, 0.0), (1.0, -1.0))
    assert law.energy == pytest.approx((-0.001, 0.001))
    assert law.force(T, (0.001, 0.001), (0.2, 0.2), (0.0, 0.0)) == pytest.approx((-5.0 - 0.02, -0.02))


def test_what_its_limits_leave_is_not_forgotten() -> None:
    """Capped at 5 Ns/m, 1 mJ at 0.1 m/s goes at 50 uJ a tick: 20 ticks; at rest it waits."""
    law = controller(K=1e-9, cap=5.0, floor=0.002)
    law.force(T, (0.001,), (0.0,), (1.0,))
    force: tuple[float, ...] = (0.0,)
    for _ in range(50):
        force = law.force(T, (0.001,), (0.0019,), force)
        assert force == pytest.approx((-0.1 * 0.0019,))
        law.release(T, (0.001,), (0.0,))
    assert law.energy[0] == pytest.approx(-0.001)
    x, ticks = 0.001, 0
    force = (0.0,)
    while law.energy[0] < -1e-12:
        force = (law.force(T, (x,), (0.1,), force)[0] + 0.1 * 0.1,)  # without the coupling's own damper
        x += 0.1 * T
        ticks += 1
        assert ticks <= 22
        assert force[0] >= -0.5 - 1e-9
    assert ticks >= 20


def test_a_surplus_is_forgotten_where_no_force_was_rendered_and_a_debt_is_not() -> None:
    """Each axis by itself, when there was none for longer than 8 ticks; 50 mN are a force if less is none."""
    law = controller(dof=3, reset=Reset(0.05, 8 * 2.0**-10))
    at, rest = (0.001, 0.001, 0.001), (0.0, 0.0, 0.0)
    law.force(2.0**-10, at, rest, (-1.0, 1.0, -1.0))
    for _ in range(8):
        law.force(2.0**-10, at, rest, (-0.049, 0.0, 0.05))
    assert law.energy == pytest.approx((0.001, -0.001, 0.001))
    law.release(2.0**-10, at, (0.0, 0.0, 0.05))
    assert law.energy == pytest.approx((0.0, -0.001, 0.001))


@pytest.mark.parametrize(("reset", "damps"), [(NEVER, False), (Reset(0.05, 0.1), True)], ids=["never", "after 0.1 s"])
def test_what_was_paid_for_one_wall_does_not_pay_for_the_next_pull(reset: Reset, damps: bool) -> None:
    """Pressed 10 mm into 500 N/m, 25 mJ; the wall vanishes, 0.2 s pass, and 1 N pulls over 20 mm, so 20 mJ come out."""
    law = controller(K=1e-9, reset=reset)
    for n in range(1, 101):
        law.force(T, (1e-4 * n,), (0.1,), (-0.05 * n,))
    for _ in range(200):
        law.force(T, (0.01,), (0.0,), (0.0,))
    assert law.energy[0] == pytest.approx(0.0 if damps else 0.025 * 1.01)
    added = 0.0
    for n in range(1, 201):
        added = min(added, law.force(T, (0.01 + 1e-4 * n,), (0.1,), (1.0,))[0] + 0.1 * 0.1)
        if n == 1:
            assert added == pytest.approx(-1.0 if damps else 0.0, abs=1e-9)  # 0.1 mJ in 1 ms at 0.1 m/s
    assert (added < -1e-6) is damps


def test_at_the_speed_of_the_floor_it_damps_and_below_not_and_nothing_without_a_deficit() -> None:
    """1/8 J missing, at 1/4 m/s, for a tick of 1/1024 s: 2048 Ns/m, also where that is the cap; just below 1/4 none.

    With W = 0 exactly nothing is missing: the force is the coupling's own (a controller that took part there would add
    W/unit = 0 Ns/m; and where cap and need agree either is the other, to rounding).
    """
    tick, floor = 2.0**-10, 0.25
    for speed, cap, alpha in ((0.25, 1e9, 2048.0), (0.25, 2048.0, 2048.0), (0.25, 2047.0, 2047.0), (0.2499, 1e9, 0.0)):
        law = PassivityController(Spring(1e-9, 1), (1e-9,), (0.0,), velocity_floor=floor, damping_cap=cap)
        force = law.force(tick, (0.125,), (speed,), (1.0,))  # 1 N over 1/8 m
        assert law.energy == (-0.125,)
        assert force[0] == pytest.approx(-alpha * speed, rel=1e-9, abs=1e-9)
    law = PassivityController(Spring(1e-9, 1), (1e-9,), (0.0,), velocity_floor=floor, damping_cap=1e9)
    assert law.force(tick, (0.0,), (0.25,), (1.0,)) == law.coupled((0.0,), (0.25,))
    assert law.energy == (0.0,)


@pytest.mark.parametrize("limits", [(1e30, 1e-30), (5.0, 0.002)], ids=["without limits", "with"])
@pytest.mark.parametrize("seed", range(5))
def test_the_port_gives_out_what_the_limits_left_and_one_tick(limits: tuple[float, float], seed: int) -> None:
    """W_{n+1} = -L_n - f_n v_n T, the work summed here; positions from the network and the hand's motion are random."""
    rng = np.random.default_rng(seed)
    cap, floor = limits
    law = controller(cap=cap, floor=floor)
    x = held = W = without = lowest = most = 0.0
    for n in range(3000):
        if n % 30 == 0:
            ahead = 0.02 if math.cos(0.031 * n) > 0.0 else -0.02  # the network pulls on the whole
            law.receive((x + float(rng.normal(0.5 * ahead, 0.01)),))
        v = 0.05 * math.cos(0.031 * n) + float(rng.normal(0.0, 0.02))
        dt = float(rng.uniform(0.5e-3, 2e-3))
        coupled = law.coupled((x,), (v,))[0]
        held = law.force(dt, (x,), (v,), (held,))[0]
        damped, own = (coupled - held) * v * dt, -coupled * v * dt
        assert 0.0 <= damped <= cap * v * v * dt * (1.0 + 1e-9)
        assert damped <= max(0.0, -W) * (1.0 + 1e-9) + 1e-15
        left = max(0.0, -W - damped)
        if cap > 1e6:
            assert left <= 1e-12
        W -= held * v * dt
        without += own
        x += v * dt
        assert min(0.0, own - left) - 1e-12 <= W
        lowest, most = min(lowest, W), max(most, abs(own))
    if cap > 1e6:
        assert lowest >= -most - 1e-12
    law.release(T, (x,), (held,))
    assert law.energy[0] == pytest.approx(W, abs=1e-12)
    assert without < -0.3


def test_the_cap_is_what_may_be_held() -> None:
    """A free mass, damped by a force under zero-order hold: more energy goes up to m/T, none at 2m/T."""

    def dissipated(alpha: float, mass: float, v: float = 0.3) -> float:
        after = v - alpha * v * T / mass
        return 0.5 * mass * (v * v - after * after)

    assert damping_cap(0.002, T, 5.0) == 2.0
    assert damping_cap(0.045, T, 5.0) == 5.0
    at = np.linspace(0.0, 4.0, 401)
    assert at[np.argmax([dissipated(alpha, 0.002) for alpha in at])] == pytest.approx(2.0)
    assert dissipated(4.0, 0.002) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("K", [100.0, 300.0])
def test_on_a_bad_link_it_keeps_the_port_where_the_plain_coupling_does_not(K: float) -> None:
    """The plain coupling shakes the hand with joules; the controller leaves hundredths."""
    params = PAPER.set({**LIGHT_HAND, "device.stiffness": K, "world.stiffness": 5 * K})
    hand, actuator, _ = lowest_energies(params.set({"coupling": "popc"}), seed=1)
    plain_hand, plain_actuator, _ = lowest_energies(params.set({"coupling": "zoh"}), seed=1)
    assert plain_hand < -0.5
    assert plain_actuator < -0.5
    assert hand > -0.02
    assert actuator > -0.06


def test_its_limits_show() -> None:
    """With hardly any damping to inject it is not passive: the claim is the controller's, not the observer's."""
    params = PAPER.set({**LIGHT_HAND, "coupling": "popc", "popc.damping_cap": 0.5})
    assert lowest_energies(params, seed=1)[1] < -0.5
