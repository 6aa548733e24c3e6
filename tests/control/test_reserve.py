"""A held torque against a device that does its worst: the account, the step, the limit and the greatest speed hold."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.checks import Vector
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reserve import ForceGuard, Holding, maximum, needed, ramp, reserve
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.smoothing import Pipeline
from hapnet.records.vectors import length as measured
from tests.conftest import mostly_slow, random_spd
from tests.support.own_motion import beyond

forces = st.floats(1e-3, 1e3)
steps = st.one_of(st.just(math.inf), st.floats(1e-2, 1e2))


@given(forces, st.floats(1e-2, 1e2))
@pytest.mark.long
def test_the_ramp_is_the_sum_of_all_the_forces_on_the_way_down(force: float, step: float) -> None:
    lengths = force - step * np.arange(math.ceil(force / step) + 1)
    assert ramp(force, step) == pytest.approx(lengths[lengths > 0.0].sum(), rel=1e-9)


@given(forces, steps)
def test_the_longest_force_is_the_one_whose_ramp_costs_as_much(force: float, step: float) -> None:
    assert maximum(ramp(force, step), step) == pytest.approx(force, rel=1e-9)
    assert ramp(maximum(force, step), step) == pytest.approx(force, rel=1e-9)


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    way = rng.normal(size=n)
    return np.asarray(way / np.linalg.norm(way))


@pytest.mark.parametrize("seed", mostly_slow(range(60), 6, 30))
@pytest.mark.long
def test_the_account_pays_for_every_way_that_the_device_can_go(seed: int) -> None:
    """The device always goes with the force, as far as it can: the most that can be given out. Energy comes and goes
    as it likes otherwise, but never less than what the guard says that it needs."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    limit = float(rng.choice([math.inf, 3.0]))
    step = float(rng.choice([math.inf, 10.0 ** rng.uniform(-2.0, 1.0)]))
    reach = float(10.0 ** rng.uniform(-4.0, -1.0))
    guard = ForceGuard(limit=limit, step=step, reach=reach)
    energy, held = 0.0, np.zeros(n)
    limited = 0
    for _ in range(2000):
        wanted = unit(rng, n) * 10.0 ** rng.uniform(-3.0, 2.0)
        caused = unit(rng, n) * float(rng.choice([0.0, 10.0 ** rng.uniform(-3.0, 1.0)]))
        force = np.array(
            guard.admit(tuple(wanted.tolist()), tuple(held.tolist()), tuple(caused.tolist()), (0.0,) * n, energy)
        )
        limited += not np.array_equal(force, wanted)
        assert beyond(force, held, caused) <= step * (1.0 + 1e-12)
        assert np.linalg.norm(force) <= limit * (1.0 + 1e-12)
        length = float(np.linalg.norm(force))
        energy -= length * reach
        assert energy >= 0.0
        held = force
        if rng.random() < 0.3:
            energy += float(10.0 ** rng.uniform(-4.0, 0.0))
        elif rng.random() < 0.3:  # what is not needed is handed on
            energy = max(0.0, min(energy, needed(guard, measured(n, held) - step)))
    assert 20 < limited < 2000


@pytest.mark.parametrize("seed", mostly_slow(range(30), 10))
def test_the_torque_alone_never_exceeds_the_greatest_speed(seed: int) -> None:
    """A free mass, pushed as hard as it may be, any way, from any velocity up to the greatest."""
    rng = np.random.default_rng(seed)
    n, period, speed = 1 + seed % 3, 1e-3, float(10.0 ** rng.uniform(-0.5, 0.5))
    mass = float(10.0 ** rng.uniform(-3.0, 0.0))
    step = float(rng.choice([math.inf, 10.0 ** rng.uniform(-1.0, 1.0)]))
    guard = ForceGuard(step=step, reach=1e-3, speed=speed, inertia=mass / period)
    v = unit(rng, n) * rng.uniform(0.0, speed)
    force: Vector = (0.0,) * n
    wanted = tuple((unit(rng, n) * 100.0).tolist())
    fastest = 0.0
    for _ in range(3000):
        force = guard.admit(wanted, force, (0.0,) * n, tuple(v.tolist()), 1e9)
        v = v + np.array(force) * period / mass
        fastest = max(fastest, float(np.linalg.norm(v)))
    assert fastest <= speed * (1.0 + 1e-9)
    assert fastest > 0.9 * speed  # or nothing would have been tried


def test_the_reserve_by_hand() -> None:
    """100 N/m, no damper, 1 m/s, held for 21 ms: the dearest stretch is the way itself, K (v h)^2 / 2 = 22.05 mJ.

    A limit of 1 N is reached before, at 10 mm: 1 N 21 mm - 5 mJ = 16 mJ.
    """
    asked = {"damping": 1e-12, "speed": 1.0, "period": 1e-3, "hold": 0.021}
    assert reserve(stiffness=100.0, **asked) == pytest.approx(0.02205)
    assert reserve(stiffness=100.0, limit=1.0, **asked) == pytest.approx(0.016)
    assert reserve(stiffness=3000.0, step=0.1, **asked) == math.inf  # a millimetre: 3 N, and 0.1 N are allowed


@pytest.mark.parametrize("seed", mostly_slow(range(40), 20))
def test_no_stretch_needs_more_than_the_reserve(seed: int) -> None:
    rng = np.random.default_rng(seed)
    K, B, v = (float(10.0 ** rng.uniform(low, high)) for low, high in ((0.0, 5.0), (-2.0, 2.0), (-1.0, 1.0)))
    period = float(10.0 ** rng.uniform(-3.7, -2.0))
    hold = period + float(rng.choice([0.0, 0.02]))
    limit = float(rng.choice([math.inf, 10.0 ** rng.uniform(-1.0, 2.0)]))
    step = float(rng.choice([math.inf, 10.0 ** rng.uniform(-2.0, 1.0)]))
    found = reserve(stiffness=K, damping=B, speed=v, period=period, hold=hold, limit=limit, step=step)
    most = 0.0
    for spring in np.linspace(0.0, min(1e4, limit), 3000).tolist():
        total = min(spring + B * v, limit)
        paid = spring * spring / (2.0 * K)
        most = max(most, v * period * ramp(total, step) - paid, v * hold * total - paid)
    assert most <= found * (1.0 + 1e-12)
    if found < math.inf and min(1e4, limit) == limit:
        assert found <= 2.0 * most + v * period * step if step < math.inf else found == pytest.approx(most, rel=1e-3)


@pytest.mark.parametrize("coarse", mostly_slow([False, True], 1), ids=["exact", "encoders"])
@pytest.mark.parametrize("seed", mostly_slow(range(60), 6, 24))
@pytest.mark.long
def test_a_sampled_servo_never_overdraws_its_account_nor_steps_too_far(seed: int, coarse: bool) -> None:
    """Any motion within the declared speed, half of the time the worst; set-positions, energy and peers at random.

    Judged by forces and measured positions alone: W + d^2 + credited - sent stays above zero, with any ceiling, at any
    rate, though each axis is rounded to whole counts of the encoders.
    """
    rng = np.random.default_rng([seed, 13])
    n, period = 1 + seed % 3, float(10.0 ** rng.uniform(-3.7, -2.0))
    speed = float(10.0 ** rng.uniform(-1.0, 1.0))
    K, B = random_spd(rng, n, 1.0, 1e4), float(10.0 ** rng.uniform(-2.0, 2.0))
    limit = float(rng.choice([math.inf, 10.0 ** rng.uniform(-1.0, 1.0)]))
    step = float(rng.choice([math.inf, 10.0 ** rng.uniform(-2.0, 1.0)]))
    ceiling = float(rng.choice([0.0, 10.0 ** rng.uniform(-5.0, 0.0)]))
    resolution = speed * period * float(10.0 ** rng.uniform(-1.0, 0.5)) if coarse else 0.0
    count = resolution * math.sqrt(n)
    needed = reserve(
        stiffness=float(np.linalg.eigvalsh(K)[-1]), damping=B, speed=speed, period=period, hold=period,
        limit=limit, step=step, rounding=count,
    )  # fmt: skip
    coupling = SetPositionCoupling(
        SetPositionModulator(
            stiffness=K, position=np.zeros(n), ceiling=ceiling, shuffle="all" if seed % 2 else "harvested",
            force_limit=None if limit == math.inf else 0.9 * limit, reserve=min(needed, ceiling / 2.0),
        ),
        stages=Pipeline(), silence=Silence("hold", 1.0),
    )  # fmt: skip
    servo = SampledServo(
        coupling, damping=(B,) * n, period=5 * period, position=(0.0,) * n,
        guard=ForceGuard(limit=limit, step=step, reach=speed * period + count),
        holding=Holding(speed, period, needed, min(needed, ceiling / 2.0), speed * period + count, speed * B),
        resolution=resolution,
    )  # fmt: skip
    x, read, force = np.zeros(n), np.zeros(n), np.zeros(n)
    work = 0.0
    for k in range(1500):
        way = unit(rng, n) * rng.uniform(0.0, 1.0)
        if rng.random() < 0.5 and force.any():
            way = force / np.linalg.norm(force)
        way = way * speed * period
        x = x + way
        before, read = read, np.round(x / resolution) * resolution if coarse else x
        work -= float(force @ (read - before))
        if rng.random() < 0.1:
            coupling.receive(tuple((x + unit(rng, n) * 10.0 ** rng.uniform(-4.0, 0.0)).tolist()), 0.0, 0.0)
        if rng.random() < 0.05:
            coupling.credit(float(10.0 ** rng.uniform(-6.0, -1.0)))
        if rng.random() < 0.01:
            coupling.on_peer_changed()
        servo.tick(period, tuple(read.tolist()), tuple((way / period).tolist()))
        new = np.array(servo.force)
        pull = [np.array(coupling.spring.force(coupling.set_position, tuple(at.tolist()))) for at in (read, before)]
        assert beyond(new, force, pull[0] - pull[1]) <= step * (1.0 + 1e-9), k
        assert np.linalg.norm(new) <= limit * (1.0 + 1e-12), k
        force = new
        ledger = coupling.ledger
        assert work + ceiling + ledger.credited - ledger.sent >= -1e-12, k
        assert coupling.deficit == 0.0, k
        assert abs(ledger.slack) <= 1e-12 * max(1.0, abs(ledger.work)) or coupling.discarded, k
    assert servo.overrun_leak == 0.0
    assert servo.speed_max <= speed * (1.0 + 1e-9)


@pytest.mark.parametrize("credited_J", [0.0, 1e-6])
def test_an_empty_account_needs_a_microjoule_to_render_a_force_again(credited_J: float) -> None:
    """The hand goes at 0.2 m/s from a set-position that stays, K = 600 N/m, a limit of 3 N, 1 kHz, 1 m/s at most.

    Each tick a force of P over 1 mm may be held, and the hand works 0.2 mm against it: P grows by a fifth. From 1 uJ it
    holds 3 N, which takes 3 mJ, after 44 ticks. With nothing the set-position comes along, and there is no force.
    """
    guard = ForceGuard(limit=3.0, reach=1e-3)
    coupling = SetPositionCoupling(
        SetPositionModulator(stiffness=600.0, position=[0.0], ceiling=0.05, energy=0.0, force_limit=2.7),
        stages=Pipeline(), silence=Silence("hold", 1.0),
    )  # fmt: skip
    servo = SampledServo(coupling, damping=(2.0,), period=0.005, position=(0.0,), guard=guard)
    coupling.credit(credited_J)
    forces = []
    for tick in range(1, 100):
        servo.tick(1e-3, (2e-4 * tick,), (0.2,))
        forces.append(-servo.force[0])
    assert coupling.ledger.margin_min >= 0.0
    if credited_J:
        assert max(forces[:40]) < 3.0
        assert forces[-1] == pytest.approx(3.0)
        assert np.diff(forces)[20:30] == pytest.approx(np.array(forces[20:30]) * 0.2, rel=0.1)
    else:
        assert not any(forces)
        assert coupling.set_position == pytest.approx((2e-4 * 99,), abs=1e-3)
