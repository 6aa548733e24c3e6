"""Spring and damper together keep to the actuators' limit, and the account stays exact: seen from outside of the code.

The observer knows positions, velocities, the hand's force and the device's mass and own damping: what else acted on the
device is the actuators' force, ``m (v1 - v0)/h + b (x1 - x0)/h - f``.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet import Params, simulate
from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.limited_coupling import LimitedCoupling
from hapnet.plant.operator import Impedance, Sine
from tests.conftest import random_spd

OVER = 1.0 + 1e-12


class Case(NamedTuple):
    """A device in a fast hand, stiff and heavily damped for what its actuators can give."""

    device: SimulatedDevice
    hand: Impedance
    spring: Spring
    damping: Array
    limit: float
    set_position: Array


def any_case(seed: int, substeps: int = 1, own_damping: tuple[float, ...] = (0.0, 0.3)) -> Case:
    """K from 10 to 1e5 N/m in any direction, B to 100 Ns/m, a hand of up to 10 m/s, 1 to 3 axes, 100 to 5,000 Hz."""
    rng = np.random.default_rng([seed, 13])

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    n = int(rng.integers(1, 4))
    K = random_spd(rng, n, 10.0, 1e5)
    if rng.random() < 0.3:
        K = np.diag(np.diagonal(K))
    damping = np.array([spread(0.01, 100.0) for _ in range(n)])
    limit, share = spread(0.05, 20.0), float(rng.choice([0.5, 0.9, 1.0]))
    hand = Impedance(mass=spread(1e-3, 1.0), damping=spread(0.1, 10.0), stiffness=spread(10.0, 1000.0))
    device = SimulatedDevice(
        Sine(n, hand, amplitude=spread(0.005, 0.1), frequency=spread(0.5, 15.0)),
        mass=spread(0.01, 1.0),
        damping=float(rng.choice(own_damping)),
        period=1.0 / spread(100.0, 5000.0),
        substeps=substeps,
        force_limit=limit,
    )
    ybar = rng.normal(size=n) * spread(1e-4, 0.05)
    spring = Spring(K, n, share * limit)
    device.couple(K, damping, tuple(ybar.tolist()), spring.force_limit)
    device.passage()
    return Case(device, hand, spring, damping, limit, ybar)


class Seen(NamedTuple):
    """A substep from outside; energies in J."""

    force: Array
    middle: Array
    noise: float
    """How far rounding may put the observer's force off [N]."""
    potential_change: float
    scale: float
    """Of the energies that were added up [J]."""
    dissipated: float | None


def observed(case: Case, substeps: int) -> Iterator[Seen]:
    device, h = case.device, case.device.period
    for _ in range(substeps):
        x, v = np.array(device.position), np.array(device.velocity)
        work = device.advance()
        x1, v1, hand = np.array(device.position), np.array(device.velocity), np.array(device.hand_force)
        middle = (v + v1) / 2.0
        force = device.mass * (v1 - v) / h + device.damping * middle - hand
        speed = float(np.abs(v).max() + np.abs(v1).max())
        moved = (device.mass + case.hand.mass) / h + case.hand.damping + case.hand.stiffness * h + device.damping
        ends = [case.spring.potential(tuple((p - case.set_position).tolist())) for p in (x, x1)]
        heavy = moved * speed + case.hand.stiffness * (0.1 + float(np.abs(x).max()))
        scale = abs(work) + sum(ends) + heavy * speed * h
        noise = 3e-14 * heavy + 1e-15 * float(np.abs(case.spring.K).max() * np.abs(x).max())
        yield Seen(force, middle, noise, ends[1] - ends[0], scale, device.passage()[2])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_the_whole_force_keeps_to_its_limit_and_the_damper_only_dissipates(seed: int) -> None:
    case = any_case(seed)
    K, B, h = case.spring.K, case.damping, case.device.period
    offset = np.array(case.device.position) - case.set_position
    for seen in observed(case, 25):
        force = np.array(case.device.actuator_force)
        assert np.linalg.norm(seen.force) <= case.limit * OVER + seen.noise
        assert np.linalg.norm(force) <= case.limit * OVER
        assert np.abs(force - seen.force).max() <= seen.noise
        full = float(B @ seen.middle**2) * h
        lost = full if seen.dissipated is None else seen.dissipated
        assert -force @ seen.middle * h - seen.potential_change == pytest.approx(lost, abs=1e-13 * seen.scale)
        assert 0.0 <= lost <= full + 1e-13 * seen.scale
        if seen.dissipated is not None:  # with no more of the damper than the limit demands
            assert np.linalg.norm(force) >= case.limit * (1.0 - 1e-6)
        # The spring's part is along K e_mid and does the work that its potential says; the rest is a share of B vhat.
        before, offset = offset, np.array(case.device.position) - case.set_position
        middle_pull = K @ (before + offset) / 2.0
        share = 0.0 if full == 0.0 else lost / full
        rest = force + share * B * seen.middle
        across = rest - (rest @ middle_pull) / (middle_pull @ middle_pull) * middle_pull
        assert np.linalg.norm(across) <= 1e-6 * case.limit + seen.noise


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32))
def test_over_an_interval_in_which_the_limit_acted_the_harvest_is_all_that_was_dissipated(seed: int) -> None:
    """Intervals of 5 ticks of 4 substeps, no own damping: what the hand put in and nobody stored. Else (10) is less."""
    case = any_case(seed, substeps=4, own_damping=(0.0,))
    device = case.device
    device.couple(case.spring.K, case.damping / 10.0, tuple(case.set_position.tolist()), case.spring.force_limit)

    def stored() -> float:
        x = np.array(device.position) - case.set_position
        return device.kinetic + case.spring.potential(tuple(x.tolist()))

    scale = 1e-3
    for _ in range(12):
        work, before = 0.0, stored()
        for _ in range(5):
            work += device.advance()
            assert math.hypot(*device.actuator_force) <= case.limit * OVER
            heavy = (device.mass + case.hand.mass) * float(np.dot(device.velocity, device.velocity))
            scale = max(scale, abs(work), stored(), heavy)
        low, high, dissipated = device.passage()
        lost = work - (stored() - before)
        if dissipated is None:
            by_range = float(case.damping / 10.0 @ np.subtract(high, low) ** 2) / (5.0 * device.period)
            assert by_range <= lost + 1e-12 * scale
        else:
            assert dissipated == pytest.approx(lost, abs=1e-12 * scale)


@pytest.mark.parametrize("K", [100.0, [[100.0, 30.0], [30.0, 60.0]]], ids=["decoupled", "full K"])
def test_what_was_dissipated_before_the_limit_acted_counts_too(K: object) -> None:
    """From rest a hand of 1 m/s takes the device along: within 0.2 m/s the damper of 5 Ns/m acts in full, then not."""
    n = 1 if isinstance(K, float) else 2
    device = SimulatedDevice(Sine(n, Impedance(), amplitude=0.1, frequency=1.6), damping=0.0, force_limit=1.0)
    start = device.position
    device.couple(np.array(K), 5.0, start, 0.9)
    spring = Spring(np.array(K), n, 0.9)
    work, limited_at = 0.0, None
    for tick in range(60):
        work += device.advance()
        if limited_at is None and math.hypot(*device.actuator_force) >= 1.0 - 1e-6:
            limited_at = tick
    assert 5 <= limited_at < 50
    stored = device.kinetic + spring.between(start, device.position)
    assert device.passage()[2] == pytest.approx(work - stored, abs=1e-14)


def test_a_known_case_by_hand() -> None:
    """1-DOF, e = 0, spring 0.9 N of 1 N, p = 102 N, a = 100 Ns/m, B = 10, K h tiny: F = -1 N, vhat = 1.01 m/s.

    The spring gives -K h vhat/2 = -0.0101 N, the damper the other 0.9899 N of the 10.1 N that it would.
    """
    knee = Spring(200.0, 1, 0.9).knee
    coupling = LimitedCoupling(np.array([[200.0]]), (10.0,), 100.0, 1e-4, knee, 1.0)
    step, limited = coupling.substep((102.0,), (0.0,), (0.0,))
    assert limited
    assert (step.velocity, step.force) == ((1.01,), (-1.0,))
    assert step.dissipated == pytest.approx((1.0 - 200.0 * 1e-4 * 1.01 / 2.0) * 1.01, rel=1e-12)
    free, limited = coupling.substep((5.0,), (0.0,), (0.0,))
    assert not limited
    assert free.velocity[0] == pytest.approx(5.0 / (110.0 + 200.0 * 0.5e-4), rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_a_coarse_substep_of_a_stiff_spring_is_exact_too(seed: int) -> None:
    """K h^2 / 4M = 125 with 1e5 N/m, 5 g and 10 ms steps (a = 2 Ns/m): c's fixed point does not contract any more."""
    rng = np.random.default_rng(seed)
    h, spring = 1e-2, Spring(1e5, 1, 1.0)
    coupling = LimitedCoupling(spring.K, (0.0,), 2.0, h, spring.knee, math.inf)
    for _ in range(20):
        e, push = float(rng.uniform(-1e-5, 1e-5)), float(rng.normal() * 3.0)
        step, limited = coupling.substep((push,), (e,), (1e5 * e,))
        assert not limited
        assert 2.0 * step.velocity[0] == pytest.approx(push + step.force[0], abs=1e-12)
        change = spring.potential(step.offset) - spring.potential((e,))
        assert -step.force[0] * step.velocity[0] * h == pytest.approx(change, abs=1e-13)


@pytest.mark.parametrize("seed", range(12))
def test_a_light_device_that_its_damper_nearly_stops(seed: int) -> None:
    """Where a vhat is not above the limit the force's direction may have no fixed point, and lambda is searched for."""
    rng = np.random.default_rng(seed)
    n, h, limit, resistance = 3, 2e-3, 2.0, 0.5
    K, B = random_spd(rng, n, 10.0, 1e4), (0.3, 5.0, 90.0)
    spring = Spring(K, n, limit)
    coupling = LimitedCoupling(K, B, resistance, h, spring.knee, limit)
    e = rng.normal(size=n) * 0.01
    push = tuple((rng.normal(size=n) * 8.0).tolist())
    step, _ = coupling.substep(push, tuple(e.tolist()), tuple((K @ e).tolist()))
    assert math.hypot(*step.force) <= limit * OVER
    assert np.array(step.velocity) * resistance == pytest.approx(np.add(push, step.force), abs=1e-12)
    change = spring.potential(step.offset) - spring.potential(tuple(e.tolist()))
    work = -h * float(np.dot(step.force, step.velocity))
    assert work - change == pytest.approx(h * step.dissipated, abs=1e-13)
    assert 0.0 <= step.dissipated <= sum(b * m * m for b, m in zip(B, step.velocity, strict=True)) * (1.0 + 1e-12)


SHAKEN: dict[str, object] = {
    "duration_s": 0.8,
    "scene": "free",
    "operator": "sine",
    "operator_model.frequency_hz": 5.0,
    "device.servo": "continuous",
    "device.own_damping": 0.0,
    "device.stiffness": 800.0,
    "device.damping": 20.0,
    "device.force_limit_N": 1.0,
    "device.ceiling_J": 0.002,
    "link.up": "delay 40ms 10ms loss 5%",
    "link.down": "delay 40ms 10ms loss 5%",
}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"dof": 3},
        {"dof": 2, "device.stiffness": [[900.0, 200.0], [200.0, 300.0]], "device.damping": [20.0, 3.0]},
        {"operator_model.mass": 0.01, "operator_model.damping": 0.5, "device.damping": 100.0, "device.servo_hz": 200.0},
        {"device.stiffness": 1e5, "device.spring_share": 1.0, "device.step_limit_N": 0.0},
    ],
    ids=str,
)
def test_a_run_at_its_limit_keeps_force_and_bound(changes: dict[str, object]) -> None:
    """What is recorded is what acted: at the limit, never above. Without own damping, (10) would break the bound."""
    result = simulate(Params().set({**SHAKEN, **changes}), 3)
    device = result.recording.device
    forces = np.linalg.norm(device["force_N"], axis=1)
    assert forces.max() <= OVER
    assert (forces > 1.0 - 1e-6).mean() > 0.2
    assert result.summary["device"]["ledger"]["slack_J"] >= -1e-12
    assert result.summary["theorem"]["margin_J"] >= 0.0


def test_a_spring_beyond_the_devices_limit_is_refused() -> None:
    device = SimulatedDevice(Sine(1, Impedance()), force_limit=2.0)
    for limit in (2.1, None):
        with pytest.raises(InvalidParameter, match="at most the device's own, 2 N"):
            device.couple(100.0, 0.1, (0.0,), limit)
    device.couple(100.0, 0.1, (0.0,), 2.0)
