"""What every law is driven by: the device's servo, the couplings' accounts, and the way through a pipe."""

import math

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.control.coupling import (
    CouplingSample,
    LawServo,
    LawState,
    LawSteps,
    MotionSample,
    PortSample,
    Update,
    WaveSample,
    counted,
)
from hapnet.control.ledger import Ledger

T = 1e-3


class Spring:
    """A law of the device: a spring and damper to what was heard last. It says its position."""

    def __init__(self, K: float, B: float, n: int = 1) -> None:
        self.K, self.B = K, B
        self.set_position: Vector = (0.0,) * n
        self.reported: list[Vector] = []
        """What was held, as the law received it."""
        self.releases = 0
        self.renewals = 0

    def receive(self, sample: CouplingSample) -> None:
        assert not isinstance(sample, MotionSample | PortSample | WaveSample)
        self.set_position = sample

    def on_peer_changed(self) -> None:
        self.renewals += 1

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        self.reported.append(held)
        return tuple(-self.K * (a - y) - self.B * b for a, b, y in zip(x, v, self.set_position, strict=True))

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        return MotionSample(x, v)

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self.reported.append(held)
        self.releases += 1


def servo(law: Spring, *, period: float = 5 * T, limit: float = math.inf, bound: float = 0.05, n: int = 1) -> LawServo:
    return LawServo(law, period=period, position=(0.0,) * n, initial_energy=bound, force_limit=limit)


def test_the_account_is_the_work_of_what_was_held() -> None:
    """Over random positions, with a limit that often holds and releases: against the sum of -f . dx done apart."""
    rng = np.random.default_rng(2)
    law = Spring(400.0, 2.0, n=2)
    subject = servo(law, limit=3.0, n=2)
    x = np.vstack([np.zeros(2), np.cumsum(rng.normal(0.0, 2e-3, (500, 2)), axis=0)])
    work = lowest = 0.0
    held = np.zeros(2)
    for k in range(1, len(x)):
        work -= float(held @ (x[k] - x[k - 1]))
        lowest = min(lowest, work)
        v = (x[k] - x[k - 1]) / T
        release = k % 50 == 0
        subject.tick(T, tuple(x[k].tolist()), tuple(v.tolist()), release=release)
        np.testing.assert_array_equal(law.reported[-1], held)
        wanted = np.zeros(2) if release else -400.0 * x[k] - 2.0 * v
        length = float(np.linalg.norm(wanted))
        held = wanted * min(1.0, 3.0 / length) if length else wanted
        np.testing.assert_allclose(subject.force, held, rtol=1e-12, atol=1e-15)
        held = np.array(subject.force)
    ledger = subject.coupling.ledger
    assert ledger.work == pytest.approx(work, rel=1e-12)
    assert ledger.margin_min == pytest.approx(0.05 + lowest, rel=1e-12)
    assert law.releases == 10
    assert (ledger.sent, ledger.credited) == (0.0, 0.0)


def test_a_hand_that_presses_a_spring_puts_energy_in() -> None:
    """The sign: 10 mm into 100 N/m in steps of 0.1 mm, each with the force of the step before, and back out again.

    In goes K sum_k (k - 1) h h = K h^2 n (n - 1)/2 = 4.95 mJ; out comes K h^2 n (n + 1)/2 = 5.05 mJ, as it is held.
    """
    subject = servo(Spring(100.0, 0.0), period=1.0)
    for k in range(1, 101):
        subject.tick(T, (k * 1e-4,), (0.0,))
    assert subject.coupling.ledger.work == pytest.approx(4.95e-3)
    for k in range(99, -1, -1):
        subject.tick(T, (k * 1e-4,), (0.0,))
    assert subject.coupling.ledger.work == pytest.approx(-0.1e-3)


@pytest.mark.parametrize(("dt", "every"), [(T, 5), (T * (1 - 1e-7), 5), (2e-3, 3), (0.5e-3, 10), (7e-3, 1)])
def test_a_sample_is_due_once_a_period(dt: float, every: int) -> None:
    """At the first tick that is no sooner, clocks of whole nanoseconds allowed for."""
    subject = servo(Spring(1.0, 0.0))
    sent = [k for k in range(1, 31) if subject.tick(dt, (0.1,), (0.2,)) == Update(MotionSample((0.1,), (0.2,)))]
    assert sent == list(range(every, 31, every))


def test_a_released_servo_renders_nothing_and_still_speaks() -> None:
    law = Spring(100.0, 0.0)
    subject = servo(law, period=2 * T)
    subject.tick(T, (0.01,), (0.0,))
    assert subject.force == (-1.0,)
    assert subject.tick(T, (0.02,), (0.0,), release=True) == Update(MotionSample((0.02,), (0.0,)))
    assert subject.force == (0.0,)
    subject.tick(T, (0.03,), (0.0,))
    assert law.reported == [(0.0,), (-1.0,), (0.0,)]
    subject.stop()
    assert subject.force == (0.0,)


def test_the_limit_keeps_the_direction() -> None:
    law = Spring(100.0, 0.0, n=2)
    subject = servo(law, limit=2.0, n=2)
    subject.tick(T, (0.03, -0.04), (0.0, 0.0))
    assert subject.force == pytest.approx((-1.2, 1.6))
    subject.tick(T, (0.003, -0.004), (0.0, 0.0))
    assert subject.force == pytest.approx((-0.3, 0.4))


def test_a_coupling_passes_on_what_concerns_the_law() -> None:
    law = Spring(1.0, 0.0)
    coupling = LawState(law, 0.05)
    coupling.receive((0.3,), 12.0, 0.0)
    coupling.credit(1.0)
    assert coupling.on_peer_changed() == 0.0
    assert (coupling.set_position, coupling.target, law.renewals) == ((0.3,), (0.3,), 1)
    assert (coupling.ledger.margin, coupling.ledger.bound, coupling.potential((9.0,))) == (0.05, 0.05, 0.0)


class Order:
    """A law of the world that notes what it is asked."""

    set_position = (0.0,)

    def __init__(self) -> None:
        self.asked: list[str] = []

    def receive(self, sample: CouplingSample) -> None:
        self.asked.append(f"receive {sample}")

    def on_peer_changed(self) -> None: ...

    def begin(self) -> None:
        self.asked.append("begin")

    def impedance(self, dt: float) -> tuple[float, Vector]:
        return 0.0, (0.0,)

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None: ...

    def next_sample(self) -> CouplingSample:
        self.asked.append("sample")
        return WaveSample((1.0,), 0.5)


def test_a_step_begins_with_what_has_arrived_and_then_says_its_own() -> None:
    law = Order()
    steps = LawSteps(law, 0.0)
    steps.coupling.receive(PortSample((1.0,), 2.0), 0.0, 0.0)
    assert steps.update(0.01, (0.0,), 0.0) == Update(WaveSample((1.0,), 0.5))
    assert law.asked == [f"receive {PortSample((1.0,), 2.0)}", "begin", "sample"]


class Bank:
    """A coupling with a spring of 0.25 J and 1 J in its reservoir, of which the law discards 0.7 J."""

    def __init__(self) -> None:
        self.ledger = Ledger(0.0, 1.0)
        self.account = 1.0
        self.coupling = self

    def potential(self, x: Vector) -> float:
        return 0.25

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        self.account = 0.3
        return Update(None)


@pytest.mark.parametrize(
    ("kinetic", "dissipated", "least"), [(0.5, -0.2, -0.45), (0.25, 0.2, -0.4), (0.0, -0.1, -0.05)]
)
def test_a_step_is_checked_before_the_law_too(kinetic: float, dissipated: float, least: float) -> None:
    """1 J at the start and 0.1 J of work, less what is stored and 1 J in the reservoir: that is the least slack.

    A negative D is charged first. After the law 0.3 J are in the reservoir, and the slack is larger.
    """
    bank = Bank()
    counted(bank, T, (0.0,), kinetic, 0.1, dissipated)
    assert bank.ledger.slack_min == pytest.approx(least)
    assert bank.ledger.slack == pytest.approx(1.1 - kinetic - 0.25 - 0.3)
