"""The device's servo laws, against cases worked by hand."""

import math

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reserve import ForceGuard
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import Harvest, SampledServo
from hapnet.control.smoothing import Pipeline
from tests.conftest import random_spd

T = 1e-3


def coupling(n: int = 1, K: object = 100.0, ceiling: float = 0.05) -> SetPositionCoupling:
    return SetPositionCoupling(
        SetPositionModulator(stiffness=K, position=np.zeros(n), ceiling=ceiling),  # type: ignore[arg-type]
        stages=Pipeline(),
        silence=Silence("hold", 1.0),
    )


def sampled(
    c: SetPositionCoupling,
    *,
    n: int = 1,
    damping: float = 0.1,
    harvest: Harvest = "measured",
    limit: float | None = None,
    resolution: float = 0.0,
    trusted: float = 0.0,
    position: Vector | None = None,
) -> SampledServo:
    return SampledServo(
        c, damping=(damping,) * n, period=5 * T, position=position or (0.0,) * n, harvest=harvest,
        guard=ForceGuard(limit=limit or math.inf), resolution=resolution, trusted_damping=(trusted,) * n,
    )  # fmt: skip


# -- continuous ------------------------------------------------------------------------------------------------------


def test_continuous_runs_on_its_clock_and_at_once_on_data() -> None:
    """Period 5 ms at ticks of 1 ms: on every fifth tick; data at the seventh: there, and five ticks after."""
    c = coupling()
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    ran = []
    for tick in range(1, 21):
        if tick == 7:
            c.receive((0.001,), 0.0, 0.0)
        if servo.tick(T, (0.0,), lambda: ((0.0,), (0.0,), None), 0.0, 0.0) is not None:
            ran.append(tick)
    assert ran == [5, 7, 12, 17]


def test_ticks_that_rest_are_those_before_the_next_update() -> None:
    """Of five ticks to an update four rest, as long as no data come; a late tick counts for as long as it took."""
    c = coupling()
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    assert servo.skippable_ticks(T) == 4
    servo.rest(2 * T, (0.0,), 0.0, 0.0)
    assert servo.skippable_ticks(T) == 2
    c.receive((0.001,), 0.0, 0.0)
    assert servo.skippable_ticks(T) == 0


def test_continuous_harvests_the_range_over_the_whole_interval() -> None:
    """From an empty reservoir: 0.1 Ns/m (4 mm)^2 / 5 ms = 0.32 mJ; the extremes are asked for once an update."""
    c = coupling(ceiling=0.01)
    c.receive((math.sqrt(2e-4),), 0.0, 0.0)  # takes all 10 mJ
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    asked = []

    def passage() -> tuple[Vector, Vector, None]:
        asked.append(1)
        return (-0.001,), (0.003,), None

    assert servo.tick(T, (0.0,), lambda: ((0.0,), (0.0,), None), 0.0, 0.0) is not None
    assert c.account == pytest.approx(0.0, abs=1e-16)
    for _ in range(5):
        servo.tick(T, (0.0,), passage, 0.0, 0.0)
    assert len(asked) == 1
    assert c.account == pytest.approx(0.1 * 0.004**2 / 0.005)


def test_continuous_harvests_what_was_dissipated_where_a_limit_acted() -> None:
    """The range says 0.32 mJ as above, but a limited damper took 0.05 mJ only."""
    c = coupling(ceiling=0.01)
    c.receive((math.sqrt(2e-4),), 0.0, 0.0)
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    servo.tick(T, (0.0,), lambda: ((0.0,), (0.0,), None), 0.0, 0.0)
    for _ in range(5):
        servo.tick(T, (0.0,), lambda: ((-0.001,), (0.003,), 5e-5), 0.0, 0.0)
    assert c.account == pytest.approx(5e-5)


def test_continuous_books_the_hands_work_and_the_kinetic_energy() -> None:
    """W = 3 mJ, of it 2 mJ kinetic and 1/2 100 (2 mm)^2 = 0.2 mJ in the spring: slack 0.8 mJ."""
    c = coupling()
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    servo.tick(T, (0.002,), lambda: ((0.0,), (0.002,), None), 0.003, 0.002)
    assert c.ledger.slack == pytest.approx(0.0008)
    assert c.ledger.margin == pytest.approx(0.053)


# -- sampled ---------------------------------------------------------------------------------------------------------


def test_sampled_renders_spring_and_damper() -> None:
    """-100 N/m 3 mm - 0.1 Ns/m 0.2 m/s = -0.32 N."""
    servo = sampled(coupling())
    servo.tick(T, (0.003,), (0.2,))
    assert servo.force == pytest.approx((-0.32,))


def test_sampled_cuts_the_whole_force_at_the_limit() -> None:
    """(-3, -4) N cut to 2 N keeps its direction."""
    servo = sampled(coupling(2), n=2, limit=2.0)
    servo.tick(T, (0.03, 0.04), (0.0, 0.0))
    assert servo.force == pytest.approx((-1.2, -1.6))


def test_measured_charges_the_holds_leak() -> None:
    """ybar = 0, x: 0, 2, 4, 4 mm. Held 0 N then -0.2 N then -0.4 N: port 0 + 0.4 + 0 mJ, spring 0.8 mJ: D = -0.4 mJ.

    A tick's torque acts on the travel after it; the account with the running interval closes at every tick.
    """
    c = coupling(ceiling=0.01)
    servo = sampled(c, damping=0.0)
    for x, work, account in ((0.002, 0.0, -0.0002), (0.004, 0.0004, -0.0004), (0.004, 0.0004, -0.0004)):
        assert servo.tick(T, (x,), (0.0,)) is None
        assert c.ledger.work == pytest.approx(work, abs=1e-15)
        assert servo.account == pytest.approx(0.01 + account)
        assert c.ledger.slack == pytest.approx(0.0, abs=1e-16)
    servo.tick(T, (0.004,), (0.0,))
    result = servo.tick(T, (0.004,), (0.0,))
    assert result is not None
    assert servo.coupling.reservoir == pytest.approx(0.0096)
    assert servo.account == servo.coupling.reservoir


def test_measured_carries_a_deficit_when_the_leak_exceeds_the_reservoir() -> None:
    c = coupling(ceiling=0.0)
    servo = sampled(c, damping=0.0)
    servo.tick(T, (0.002,), (0.0,))
    c.receive((0.05,), 0.0, 0.0)
    result = servo.tick(T, (0.0,), (0.0,))  # back: port -0.2 N 2 mm -> -0.4 mJ, spring 0 -> 0: D = -0.4 mJ
    assert result is not None
    assert servo.coupling.reservoir == 0.0
    assert servo.coupling.deficit == pytest.approx(0.0004)
    assert servo.coupling.set_position == (0.0,)
    assert c.ledger.slack == pytest.approx(0.0, abs=1e-16)


def test_trusted_damping_is_harvested_but_not_on_chatter() -> None:
    """0.3 Ns/m over 2 mm in a tick: 0.3 (2 mm)^2 / 1 ms = 1.2 mJ. With a count of 0.5 mm only 1.5 mm are sure;
    between two neighbouring counts nothing is."""
    for resolution, travel, expected in ((0.0, 0.002, 1.2e-3), (5e-4, 0.002, 0.3 * 0.0015**2 / T), (5e-4, 5e-4, 0.0)):
        c = coupling(K=1e-6)
        servo = sampled(c, damping=0.0, trusted=0.3, resolution=resolution)
        servo.tick(T, (travel,), (0.0,))
        assert servo.account - 0.05 == pytest.approx(expected, abs=1e-11)


def test_range_harvest_takes_a_count_off_and_nothing_where_the_force_was_cut() -> None:
    """0.1 Ns/m over 3 mm less a count of 1 mm, in 5 ms: 0.08 mJ. Cut at 0.1 N, nothing; uncut again, as before."""
    for limit, expected in ((None, 0.1 * 0.002**2 / 0.005), (0.1, 0.0)):
        c = coupling()
        c.receive((0.01,), 0.0, 0.0)  # 5 mJ, so that there is room below the ceiling
        servo = sampled(c, harvest="range", limit=limit, resolution=1e-3)
        servo.tick(T, (0.0,), (0.0,))
        energy = c.account
        for x in (0.001, 0.002, 0.003, 0.002, 0.0):
            result = servo.tick(T, (x,), (0.0,))
        assert result is not None
        assert servo.coupling.reservoir - energy == pytest.approx(expected, abs=1e-15)


def test_stop_takes_the_force_away_and_keeps_the_account() -> None:
    """Stopped at 3 mm under -0.3 N: the next tick's travel does no work, the last one's did 0.3 N 1 mm."""
    c = coupling()
    servo = sampled(c, damping=0.0)
    servo.tick(T, (0.003,), (0.0,))
    servo.tick(T, (0.004,), (0.0,))
    assert c.ledger.work == pytest.approx(0.0003)
    servo.stop()
    assert servo.force == (0.0,)
    servo.tick(T, (0.009,), (0.0,))
    assert c.ledger.work == pytest.approx(0.0003)
    assert c.ledger.slack == pytest.approx(0.0, abs=1e-16)


# -- what encoders may hide ------------------------------------------------------------------------------------------


def test_quantisation_by_hand() -> None:
    """r = 1 mm, K = 100, B = 0: torques 0, -0.1, -0.3, then stop: path 0.1 + 0.2 + 0.3 N; the end at 3 mm, where the
    spring alone is 0.3 N from the torque: r/2 0.9 N + r^2/8 100 N/m = 0.4625 mJ."""
    servo = sampled(coupling(), damping=0.0, resolution=1e-3)
    for x in (0.001, 0.003):
        servo.tick(T, (x,), (0.0,))
    assert servo.quantisation == pytest.approx(0.5e-3 * 0.3 + 1e-6 / 8 * 100)
    servo.stop()
    assert servo.quantisation == pytest.approx(0.5e-3 * 0.9 + 1e-6 / 8 * 100)
    assert sampled(coupling()).quantisation == 0.0


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.long
def test_the_true_slack_stays_within_the_quantisation_at_every_tick(seed: int) -> None:
    """Random motions with a worst-case error of up to half a count: W and phi of the true positions, by hand.

    The true slack less the measured one is at least -quantisation at each tick, not only at the end.
    """
    rng = np.random.default_rng(seed)
    n, r = 1 + seed % 3, float(10.0 ** rng.uniform(-5.0, -3.0))
    K = random_spd(rng, n, 50.0, 500.0)
    c = coupling(n, K)
    servo = sampled(c, n=n, damping=0.2, resolution=r, limit=2.0 if seed % 2 else None)

    def phi(at: np.ndarray) -> float:
        e = at - np.array(c.set_position)
        return float(0.5 * e @ K @ e)

    true = rng.uniform(-r / 2, r / 2, n)
    counted = np.zeros(n)
    start = phi(true)
    work = 0.0
    for k in range(400):
        force = np.array(servo.force)
        new_counted = np.round((counted + rng.normal(size=n) * 3 * r) / r) * r
        # what the torque will change by, but for PSPM: the error against it is the worst there is
        change = -K @ (new_counted - c.set_position) - 0.2 * (new_counted - counted) / T - force
        error = np.sign(change) if seed % 4 else rng.uniform(-1.0, 1.0, n)
        new = new_counted - error * r / 2
        work -= float(force @ (new - true))
        if k % 7 == 0:
            c.receive(tuple((rng.normal(size=n) * 3 * r).tolist()), 0.0, 0.0)
        servo.tick(T, tuple(new_counted.tolist()), tuple(((new_counted - counted) / T).tolist()))
        true, counted = new, new_counted
        slack = work + start - phi(true) + 0.05 - servo.account + c.ledger.credited - c.ledger.sent
        assert slack >= -servo.quantisation - 1e-12, k
        assert c.ledger.slack >= -1e-12
    if seed % 4 and not seed % 2:  # not cut, so that the guess of the change is right: the bound is nearly reached
        assert slack < -0.5 * servo.quantisation


# -- release: what the watchdog asks for -------------------------------------------------------------------------------


@pytest.mark.parametrize("harvest", ["measured", "range"])
def test_release_lets_the_spring_go_and_keeps_the_account(harvest: Harvest) -> None:
    """K 100, y 20 mm off: 20 mJ paid, 30 mJ left. Held at -2 N over 5 mm the hand puts in 10 mJ.

    On release the spring is empty: what is in the reservoir and above it is the 50 mJ of the start and the measured
    10 mJ; so with the other harvest too, since (10) holds for no torque that is held for long.
    """
    c = coupling(ceiling=0.05)
    servo = sampled(c, damping=0.0001, harvest=harvest)
    c.receive((-0.02,), 0.0, 0.0)
    servo.tick(T, (0.0,), (0.0,))
    assert servo.force == pytest.approx((-2.0,))
    assert c.account == pytest.approx(0.03)
    result = servo.tick(T, (0.005,), (5.0,), release=True)
    assert servo.force == (0.0,)
    assert c.set_position == (0.005,)
    assert c.potential((0.005,)) == 0.0
    assert servo.coupling.reservoir == 0.05
    assert result.shuffled + servo.coupling.discarded == pytest.approx(0.01)
    assert c.ledger.slack >= -1e-15
    servo.tick(T, (0.005,), (0.0,))
    assert servo.force == pytest.approx((0.0,))  # and from there it begins anew: y stays until something arrives
    assert c.target == (0.005,)


def test_release_of_a_stretched_spring_that_cannot_pay_is_zero_all_the_same() -> None:
    """The held torque gave out more than there is: a deficit remains, ybar = x, no force."""
    c = coupling(ceiling=0.02)
    servo = sampled(c)
    c.receive((0.02,), 0.0, 0.0)
    servo.tick(T, (0.0,), (0.0,))
    assert servo.force == pytest.approx((2.0,))
    result = servo.tick(1.0, (0.06,), (0.0,), release=True)  # 2 N over 60 mm: 120 mJ given, 20 stored
    assert result is not None
    assert (servo.force, c.set_position, servo.coupling.reservoir) == ((0.0,), (0.06,), 0.0)
    assert servo.coupling.deficit == pytest.approx(0.12 - 0.02)
    assert c.ledger.slack >= -1e-15


def test_a_continuous_servo_releases_too() -> None:
    c = coupling()
    servo = ContinuousServo(c, damping=(0.1,), period=5 * T)
    c.receive((0.02,), 0.0, 0.0)
    servo.tick(T, (0.0,), lambda: ((0.0,), (0.0,), None), 0.0, 0.0)
    assert c.set_position == (0.02,)
    assert servo.tick(T, (0.001,), lambda: ((0.0,), (0.001,), None), 0.0, 0.0, release=True) is not None
    assert c.set_position == (0.001,)


# -- boundaries that mutants crossed -----------------------------------------------------------------------------------


def test_a_release_under_the_range_harvest_counts_its_own_interval_only() -> None:
    """Three updates of (10) from an empty reservoir, the handle out by 2 mm and back in each; then 1 mm, and a release.

    K = 100, B = 0.1: each harvests 0.1 (2 mm)^2 / 5 ms = 0.08 mJ, whatever the held torque's work was. The last
    interval is measured: -0.1 N, held at 1 mm, over no way, and the spring gives back what the way out put in.
    """
    c = coupling(ceiling=0.01)
    c.receive((math.sqrt(2e-4),), 0.0, 0.0)  # takes all 10 mJ
    servo = sampled(c, harvest="range")
    servo.tick(T, (0.0,), (0.0,))
    account = c.account
    for _ in range(3):
        for x in (0.001, 0.002, 0.001, 0.0, 0.0):
            result = servo.tick(T, (x,), (0.0,))
        assert result is not None
        account += 0.1 * 0.002**2 / 0.005
        assert c.account == pytest.approx(account, abs=1e-12)
    ybar = c.set_position[0]
    before, discarded = c.potential((0.0,)), c.discarded
    servo.tick(T, (0.001,), (0.0,))  # the force held over this way is the one at 0: 100 N/m ybar
    result = servo.tick(T, (0.001,), (0.0,), release=True)
    measured = -100.0 * ybar * 0.001 - (0.5 * 100.0 * (ybar - 0.001) ** 2 - before)
    left = account + measured + 0.5 * 100.0 * (ybar - 0.001) ** 2
    assert c.account + result.shuffled + c.discarded - discarded == pytest.approx(left, abs=1e-12)


@pytest.mark.parametrize("kind", ["sampled", "continuous"])
def test_a_period_that_a_clock_calls_a_nanosecond_short_is_one(kind: str) -> None:
    """Five ticks of 1 ms, one of them 999,999 ns: PSPM runs on the fifth."""
    for short in range(5):
        c = coupling()
        ran = []
        if kind == "sampled":
            servo = sampled(c)
        else:
            continuous = ContinuousServo(c, damping=(0.1,), period=5 * T)
        for k in range(5):
            dt = 999_999e-9 if k == short else T
            if kind == "sampled":
                ran.append(servo.tick(dt, (0.0,), (0.0,)) is not None)
            else:
                ran.append(continuous.tick(dt, (0.0,), lambda: ((0.0,), (0.0,), None), 0.0, 0.0) is not None)
        assert ran == [False] * 4 + [True]
