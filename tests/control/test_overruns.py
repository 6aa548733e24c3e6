"""A servo that is away again and again, for long, on a device without a watchdog: the bound holds, and all is counted.

Judged by forces and positions alone, or by what the simulated actuator put out in each of its own periods.
"""

import math

import numpy as np
import pytest

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.checks import Vector
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reserve import ForceGuard, Holding, HoldTime
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.smoothing import Pipeline
from hapnet.params import Params
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.summary.run import device_summary
from tests.conftest import mostly_slow, random_spd
from tests.support.own_motion import beyond

MS = 1_000_000


@pytest.mark.parametrize("seed", range(40))
def test_a_force_costs_the_dearest_moment_at_which_an_overrun_can_begin(seed: int) -> None:
    """For k ticks the force is reduced by D, each over a; then it is held over A."""
    rng = np.random.default_rng([seed, 3])
    a, D, F = (float(10.0 ** rng.uniform(low, high)) for low, high in ((-4.0, -2.0), (-2.0, 0.5), (-1.0, 1.0)))
    A = a * float(rng.uniform(1.0, 300.0))
    forces = np.maximum(0.0, F - D * np.arange(math.ceil(F / D) + 2))
    dearest = float(np.max(A * forces + a * (np.cumsum(forces) - forces)))
    guard = ForceGuard(step=D, reach=a)
    guard.cover(A)
    assert dearest * (1.0 - 1e-12) <= guard.cost(F) <= dearest + a * D
    energy = guard.needed((F,))
    assert guard.admit((F,), (F,), (0.0,), (0.0,), energy) == pytest.approx((F,), rel=1e-9)
    shorter = guard.admit((F,), (F - 0.9 * D,), (0.0,), (0.0,), 0.999 * energy)[0]
    assert F - 1.9 * D <= shorter < F
    guard.cover(0.0)
    assert guard.cost(F) == pytest.approx(a * forces.sum())


@pytest.mark.long
def test_an_absence_is_expected_for_ten_seconds_and_then_half_as_long() -> None:
    rng = np.random.default_rng(1)
    hold, past, now = HoldTime(0.02, 2.0), [(0.0, 0.02)], 0.0
    for _ in range(3000):
        dt = float(rng.choice([1e-3, 0.5, 10.0 ** rng.uniform(-2.0, 0.5)], p=[0.9, 0.09, 0.01]))
        before, now = hold.expected, now + dt
        held = dt if rng.random() < 0.1 else 0.0
        past.append((now, min(held, 2.0)))
        hold.tick(dt, held)
        assert hold.expected >= max(length for at, length in past if at > now - 10.0 + 1e-9)
        assert hold.expected <= max(before, min(held, 2.0))  # it never grows by itself
    for _ in range(60):
        hold.tick(1.0, 0.0)
    assert hold.expected <= max(0.02, 2.0 / 2.0**3)
    for _ in range(60):
        hold.tick(1.0, 0.0)
    assert hold.expected == 0.02


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    way = rng.normal(size=n)
    return np.asarray(way / np.linalg.norm(way))


@pytest.mark.parametrize("followed", mostly_slow([False, True], 1), ids=["ends", "way"])
@pytest.mark.parametrize("seed", mostly_slow(range(60), 6, 30))
@pytest.mark.long
def test_what_was_once_as_long_costs_no_more_than_the_account(seed: int, followed: bool) -> None:
    """The servo is away for long while the device stands still; from then on up to as long, again and again, while the
    device goes with the force as fast as it may. Springs up to 10 kN/m, any step limit, any ceiling.

    With `followed` the device comes halfway back within the same absence, and what it gave out before counts.
    """
    rng = np.random.default_rng([seed, 17])
    n, period = 1 + seed % 3, 1e-3
    speed, upper = float(10.0 ** rng.uniform(-0.7, 0.3)), float(10.0 ** rng.uniform(-1.5, -0.3))
    K, B = random_spd(rng, n, 10.0, 1e4), float(10.0 ** rng.uniform(-2.0, 1.0))
    step = float(rng.choice([math.inf, 10.0 ** rng.uniform(-2.0, 0.5)]))
    ceiling = float(rng.choice([0.1, 10.0 ** rng.uniform(-4.0, 0.0)]))
    coupling = SetPositionCoupling(
        SetPositionModulator(stiffness=K, position=np.zeros(n), ceiling=ceiling, force_limit=3.0,
                             reserve=ceiling / 2.0, held_m=speed * 0.021),
        stages=Pipeline(), silence=Silence("hold", 1.0),
    )  # fmt: skip
    servo = SampledServo(
        coupling, damping=(B,) * n, period=period, position=(0.0,) * n,
        guard=ForceGuard(limit=3.3, step=step, reach=speed * period),
        holding=Holding(speed, 0.021, math.inf, ceiling / 2.0, speed * 0.021, speed * B),
    )  # fmt: skip
    x, work, strongest, minimum = np.zeros(n), 0.0, 0.0, math.inf
    ledger = coupling.ledger

    def go(way: np.ndarray) -> Vector:
        nonlocal x, work, minimum
        x, work = x + way, work - float(np.array(servo.force) @ way)
        minimum = min(minimum, work + ceiling + ledger.credited - ledger.sent)
        return tuple(x.tolist())

    servo.tick(upper, go(np.zeros(n)), (0.0,) * n, release=True)
    for _ in range(25):
        for _ in range(int(rng.integers(1, 80))):
            force = np.array(servo.force)
            pushes = rng.random() < 0.3 and force.any()
            way = (force / np.linalg.norm(force) if pushes else unit(rng, n) * rng.uniform(0.0, 0.3)) * speed * period
            if rng.random() < 0.2:
                coupling.receive(tuple((x + unit(rng, n) * 10.0 ** rng.uniform(-4.0, -1.0)).tolist()), 0.0, 0.0)
            if rng.random() < 0.02:
                coupling.credit(float(10.0 ** rng.uniform(-5.0, -1.0)))
            servo.tick(period, go(way), tuple((way / period).tolist()))
            pull = [np.array(coupling.spring.force(coupling.set_position, tuple(at.tolist()))) for at in (x, x - way)]
            assert beyond(servo.force, force, pull[0] - pull[1]) <= step * (1.0 + 1e-9)
            strongest = max(strongest, float(np.linalg.norm(servo.force)))
        away = float(rng.uniform(0.021, upper))
        force = np.array(servo.force)
        way = (force / np.linalg.norm(force) if force.any() else unit(rng, n)) * speed * away
        if followed:
            servo.follow(0.6 * away, go(0.6 * way))
            way = -0.3 * way
        servo.tick(away, go(way), (0.0,) * n, release=True)
        assert not any(servo.force)
    assert minimum >= -1e-12
    assert ledger.margin_min == pytest.approx(minimum, abs=1e-9)  # of the way, too
    assert (servo.overrun_leak, coupling.deficit_max) == (0.0, 0.0)
    assert strongest > 0.1 * min(3.0, ceiling / (speed * upper))  # a force came back


def away(words: dict[str, object], seed: int, shortest_ms: int, longest_ms: int, *, known: bool) -> tuple[float, dict]:
    """A light hand shakes the handle at up to 0.7 m/s in contact, and the servo is away 60 times.

    Returns the least of d^2, less what the actuator put out in each of its periods, and the device's part of the
    summary. known : the servo was away for as long once before, when there was no force.
    """
    rng = np.random.default_rng([seed, 23])
    setup = prepare(
        Params().set({"operator": "sine", "operator_model.frequency_hz": 2.0, "rendering": "paper", **words})
    )
    now_ns = 0
    side = device_side(setup, DeviceEndpoint(device_session(setup, 7)), lambda: now_ns, lambda sample: None)
    device = side.device
    side.endpoint.paired = True
    side.tick(0)
    ledger = side.coupling.ledger
    bound = minimum = ledger.bound
    put_out = 0.0
    advance = device.advance

    def counted() -> float:
        nonlocal put_out, minimum
        torque, before = device.state.torque, device.position
        work = advance()
        put_out += sum(t * (b - a) for t, a, b in zip(torque, before, device.position, strict=True))
        minimum = min(minimum, bound - put_out + ledger.credited - ledger.sent)
        return work

    device.advance = counted  # type: ignore[method-assign]
    start = device.position[0]

    def tick(after_ns: int) -> None:
        nonlocal now_ns
        now_ns += after_ns
        side.tick(now_ns)

    if known:
        tick(longest_ms * MS)
    for _ in range(60):
        for _ in range(int(rng.integers(50, 400))):
            if rng.random() < 0.05:
                side.coupling.receive((min(device.position[0], start + rng.uniform(-0.003, 0.007)),), 0.0, 0.0)
            if rng.random() < 0.01:
                side.coupling.credit(1e-3)
            tick(MS)
        tick(int(rng.uniform(shortest_ms, longest_ms) * MS))
    return minimum, dict(device_summary(side, "pspm"))


@pytest.mark.parametrize("seed", mostly_slow(range(10), 1, 2))
@pytest.mark.parametrize("stiffness", mostly_slow([3000.0, 100.0, 1000.0], 1, 2))
@pytest.mark.parametrize(
    ("shortest_ms", "longest_ms", "known"), mostly_slow([(22, 60, False), (25, 250, True), (200, 600, True)], 1)
)
@pytest.mark.long
def test_a_simulated_hand_never_gets_more_than_the_bound(
    stiffness: float, shortest_ms: int, longest_ms: int, known: bool, seed: int
) -> None:
    minimum, part = away({"device.stiffness": stiffness}, seed, shortest_ms, longest_ms, known=known)
    assert minimum >= 0.0
    assert part["ledger"]["margin_J"] == pytest.approx(minimum, abs=1e-9)
    assert (part["overrun_leak_J"], part["deficit_max_J"]) == (0.0, 0.0)
    assert part["speed_max_mps"] > 0.4  # or nothing would have been tried


@pytest.mark.long
def test_the_first_long_absence_of_a_device_without_a_watchdog_is_counted_to_the_last_joule() -> None:
    """Nothing foretells it, so it may break the bound: by what is then called the servo's."""
    minimum, part = away({"device.stiffness": 3000.0}, 3, 200, 600, known=False)
    assert minimum < -0.01
    assert part["ledger"]["margin_J"] == pytest.approx(minimum, abs=1e-9)
    assert part["overrun_leak_J"] >= -minimum - 1e-9
    assert part["overrun_leak_J"] <= -minimum + 0.01
    assert part["overrun_risk_J"] == 0.0  # all of the way was seen
    assert abs(part["true_slack_J"]) <= 1e-9


@pytest.mark.long
def test_a_force_comes_back_by_degrees_after_the_last_of_them() -> None:
    """100 N/m, 20 mm off, 0.1 J, 1 m/s: after ten minutes away 0.1 N, as no device moves farther than a metre.

    From 20 s on at the latest it doubles in 10 s: after 50 s it is 0.8 N. It never steps, up to the spring's 2 N.
    """
    coupling = SetPositionCoupling(
        SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=0.1), stages=Pipeline(),
        silence=Silence("hold", 1.0),
    )  # fmt: skip
    servo = SampledServo(
        coupling, damping=(0.1,), period=0.01, position=(0.0,), guard=ForceGuard(reach=0.01),
        holding=Holding(1.0, 0.03, 0.05, 0.05, 0.03, 0.1),
    )  # fmt: skip
    servo.tick(600.0, (0.0,), (0.0,), release=True)
    coupling.receive((0.02,), 0.0, 0.0)
    forces = []
    for _ in range(12_000):
        servo.tick(0.01, (0.0,), (0.0,))
        forces.append(servo.force[0])
    assert forces[:900] == pytest.approx([0.1] * 900, rel=1e-3)
    assert forces[5009] >= 0.8
    assert forces[-1] == pytest.approx(2.0)
    assert max(np.diff(forces)) <= 2.0 * (2.0**0.001 - 1.0) * 1.01
    assert min(np.diff(forces)) >= -1e-9
