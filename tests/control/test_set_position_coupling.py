"""The set-position's way through one side: what arrives is used once, in order, and the ledger misses nothing."""

import math

import numpy as np
import pytest

from hapnet.control.limits import OnSilence, Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.smoothing import Pipeline, SmoothingFilter
from hapnet.control.zoh import ZeroOrderHold
from hapnet.mechanics.spring import Spring
from tests.conftest import random_spd


def coupling(
    *, ceiling: float = 0.05, smoothing: float = 0.0, policy: OnSilence = "hold", maximum: float = math.inf
) -> SetPositionCoupling:
    """K = 100 N/m, from rest at 0."""
    return SetPositionCoupling(
        SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=ceiling),
        stages=Pipeline([SmoothingFilter(smoothing)] if smoothing else []),
        silence=Silence(policy, 0.02),
        max_step=maximum,
    )


def test_at_the_start_it_is_at_rest() -> None:
    c = coupling()
    assert (c.set_position, c.target, c.account, c.has_sample) == ((0.0,), (0.0,), 0.05, False)
    assert c.potential((0.02,)) == pytest.approx(0.02)  # 1/2 100 0.02^2
    assert c.ledger.bound == 0.05


def test_a_set_position_is_taken_and_kept() -> None:
    """y = 20 mm costs 20 mJ of 50; it stays asked for when nothing new arrives."""
    c = coupling()
    c.receive((0.02,), 1.0, 0.0)
    waiting = [c.has_sample]
    result = c.update(0.005, (0.0,), 0.0)
    waiting.append(c.has_sample)
    assert waiting == [True, False]
    assert result.set_position == (0.02,)
    assert result.energy == pytest.approx(0.03)
    c.update(0.005, (0.01,), 0.0)
    assert c.target == (0.02,)


def test_only_the_newest_set_position_counts() -> None:
    c = coupling()
    c.receive((0.01,), 1.0, 0.0)
    c.receive((0.02,), 1.1, 0.0)
    assert c.update(0.005, (0.0,), 0.0).set_position == (0.02,)


def test_energy_is_credited_once() -> None:
    """10 + 5 mJ arrive between two updates; the third update finds nothing more."""
    c = coupling(ceiling=0.1)
    c.receive((0.04,), 1.0, 0.0)
    c.update(0.005, (0.0,), 0.0)  # 80 mJ of 100
    c.credit(0.010)
    c.credit(0.005)
    assert c.has_sample
    assert c.ledger.credited == 0.0  # counted when it is used
    assert c.update(0.005, (0.0,), 0.0).energy == pytest.approx(0.035)
    assert c.update(0.005, (0.0,), 0.0).energy == pytest.approx(0.035)
    assert c.ledger.credited == pytest.approx(0.015)


def test_what_is_sent_and_discarded_is_counted() -> None:
    """A full reservoir, 3 mJ harvested and 4 mJ received: 3 go on, 4 are dropped."""
    c = coupling()
    c.credit(0.004)
    result = c.update(0.005, (0.0,), 0.003)
    assert result.sent == pytest.approx(0.003)
    assert result.discarded == pytest.approx(0.004)
    assert c.ledger.sent == result.sent
    assert c.discarded == result.discarded


def test_minimum_and_deficit_are_remembered() -> None:
    c = coupling(ceiling=0.02)
    c.receive((0.02,), 1.0, 0.0)
    c.update(0.005, (0.0,), 0.0)  # exactly all of it: 1/2 100 0.02^2
    c.update(0.005, (0.02,), -0.007)
    assert c.energy_min == 0.0
    assert c.deficit_max == pytest.approx(0.007)
    assert c.account == pytest.approx(-0.007)
    c.update(0.005, (0.02,), 0.01)
    assert c.account == pytest.approx(0.003)
    assert c.deficit_max == pytest.approx(0.007)


def test_the_step_of_the_spring_is_limited() -> None:
    """5 mm an update, so 0.5 N; `target` is what was asked for."""
    c = coupling(maximum=0.005)
    c.receive((0.02,), 1.0, 0.0)
    steps = [c.update(0.005, (0.0,), 0.0).set_position[0] for _ in range(5)]
    assert steps == pytest.approx([0.005, 0.010, 0.015, 0.02, 0.02])
    assert c.target == (0.02,)


@pytest.mark.parametrize("maximum", [math.inf, 0.001])
def test_silence_lets_go(maximum: float) -> None:
    """After 20 ms without data y = x, under the step limit; the first sample after that takes hold again."""
    c = coupling(policy="release", maximum=maximum)
    c.receive((0.001,), 1.0, 0.0)
    positions = [c.update(0.005, (0.01,), 0.0).set_position[0] for _ in range(5)]
    assert positions == [0.001] * 5
    assert c.update(0.005, (0.01,), 0.0).set_position[0] == pytest.approx(0.01 if maximum == math.inf else 0.002)
    c.receive((0.001,), 2.0, 0.0)
    assert c.update(0.005, (0.01,), 0.0).set_position[0] == 0.001


def test_the_filter_stands_before_the_modulator() -> None:
    """Backward Euler from rest at 0: y_f = dt/(tau + dt) y = 0.02/3 with tau = 2 dt."""
    c = coupling(smoothing=0.010)
    c.receive((0.02,), 1.0, 0.0)
    assert c.update(0.005, (0.0,), 0.0).set_position[0] == pytest.approx(0.02 / 3.0)
    assert c.target[0] == pytest.approx(0.02 / 3.0)


def test_a_release_forgets_what_came_before_it() -> None:
    """A filter on its way to 20 mm: after a release at 5 mm it stays there until something new arrives."""
    c = coupling(smoothing=0.05, ceiling=1.0)
    c.receive((0.02,), 1.0, 0.0)
    for _ in range(5):
        c.update(0.005, (0.0,), 0.0)
    assert 0.0 < c.set_position[0] < 0.02
    c.release((0.005,), 0.0)
    for _ in range(5):
        assert c.update(0.005, (0.005,), 0.0).set_position == (0.005,)
    c.receive((0.02,), 2.0, 0.0)
    assert 0.005 < c.update(0.005, (0.005,), 0.0).set_position[0] < 0.02


def test_switched_off_it_follows_at_any_price() -> None:
    c = SetPositionCoupling(
        ZeroOrderHold(Spring(100.0, 1), (0.0,), 0.05), stages=Pipeline(), silence=Silence("hold", 1.0)
    )
    c.receive((1.0,), 1.0, 0.0)
    c.credit(0.3)
    result = c.update(0.005, (0.0,), 0.2)
    assert result.set_position == (1.0,)
    assert result.jump == pytest.approx(50.0)
    assert (result.sent, result.discarded, c.account) == (0.0, 0.0, 0.05)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.long
def test_the_ledger_balances_whatever_happens(seed: int) -> None:
    """A massless handle moved at will, its work at the port chosen as exactly what the spring and damper took:
    the slack is then what was discarded, and never below zero."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    K = random_spd(rng, n, 20.0, 500.0)
    shuffle = ("harvested", "all")[seed % 2]
    modulator = SetPositionModulator(
        stiffness=K,
        position=np.zeros(n),
        ceiling=float(rng.uniform(0.0, 0.05)),
        shuffle=shuffle,  # type: ignore[arg-type]
    )
    c = SetPositionCoupling(
        modulator, stages=Pipeline(), silence=Silence("release", 0.02), max_step=float(rng.choice([0.01, math.inf]))
    )
    x = np.zeros(n)

    def phi(at: np.ndarray) -> float:
        e = at - np.array(c.set_position)
        return float(0.5 * e @ K @ e)

    for _ in range(200):
        before = phi(x)
        x = x + rng.normal(size=n) * 0.005
        dissipated = float(rng.exponential(1e-4))
        c.ledger.put_in(phi(x) - before + dissipated)
        if rng.random() < 0.4:
            c.receive(tuple((rng.normal(size=n) * 0.05).tolist()), 0.0, 0.0)
        if rng.random() < 0.3:
            c.credit(float(rng.exponential(0.01)))
        c.update(0.005, tuple(x.tolist()), dissipated)
        c.ledger.observe(phi(x), c.account)
        assert c.ledger.slack == pytest.approx(c.discarded, abs=1e-12)
        assert c.energy_min >= 0.0


def test_what_is_shared_with_a_peer_that_begins_with_nothing_is_sent_and_leaves_the_slack_as_it_was() -> None:
    c = coupling(ceiling=0.05)
    c.receive((0.02,), 1.0, 0.0)
    c.update(0.005, (0.0,), 0.0)  # 20 mJ of the 50 are in the spring
    before = c.modulator.energy
    c.ledger.observe(c.potential((0.0,)), c.account)
    slack = c.ledger.slack
    margin = c.ledger.margin
    given = c.on_peer_changed()
    c.ledger.observe(c.potential((0.0,)), c.account)
    assert given == c.ledger.sent == before / 2.0 == c.modulator.energy == c.account
    assert given == pytest.approx(0.015)
    assert c.ledger.slack == pytest.approx(slack, abs=1e-17)
    assert c.ledger.margin == pytest.approx(margin - given, abs=1e-17)


def test_without_pspm_nothing_is_shared() -> None:
    zoh = ZeroOrderHold(Spring(100.0, 1), (0.0,), 0.05)
    c = SetPositionCoupling(zoh, stages=Pipeline([]), silence=Silence("hold", 0.1))
    assert (c.on_peer_changed(), c.ledger.sent, c.account) == (0.0, 0.0, 0.05)


def test_of_the_last_energy_each_new_peer_gets_a_little() -> None:
    """A hundredth of 0.1 mJ is 1 uJ; after a hundred peers 37 % are left (0.99^100), a nanojoule is far away."""
    c = SetPositionCoupling(
        SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=0.05, reserve=1e-4),
        stages=Pipeline(), silence=Silence("hold", 1.0), kept_for_peers=1e-4,
    )  # fmt: skip
    c.receive((1.0,), 1.0, 0.0)
    c.update(0.005, (0.0,), 0.0)  # the spring takes all that may be spent
    assert c.reservoir == pytest.approx(1e-4)
    given = [c.on_peer_changed() for _ in range(100)]
    assert given[0] == pytest.approx(1e-6)
    assert min(given) > 0.3e-6
    assert c.reservoir == pytest.approx(1e-4 * 0.99**100)
