"""The figures asked for: closed forms, and what links come to."""

import numpy as np
import pytest
from scipy import stats

from netem import PRESETS, ConditionTrace, Link, LinkProfile, expect
from tests.conftest import mostly_slow
from tests.netem.support import drive

MS = 1_000_000
# what the cut at 4 J takes from a mean of 0: 4/3 E[X - 4.5, if positive] for X Pareto of shape 3
CUT = 4 / 3 * 0.5 / 4.5**2


def test_an_ideal_link() -> None:
    found = expect(LinkProfile())
    assert found.as_dict() == {
        "loss": 0.0,
        "mean_loss_burst": None,
        "resent": 0.0,
        "recovered": 0.0,
        "corrupted": 0.0,
        "sent_ahead": 0.0,
        "duplicated": 0.0,
        "delay_mean_ms": 0.0,
        "delay_std_ms": 0.0,
        "delay_correlation": None,
    }


@pytest.mark.parametrize(
    ("words", "loss", "burst"),
    [
        ("loss 10%", 0.1, 1 / 0.9),
        ("loss 10% 50%", 0.1, 1 / (0.9 * 0.5)),
        ("loss 0%", 0.0, None),
        ("loss 100%", 1.0, None),
        ("loss gemodel 1% 20%", 1 / 21, 5.0),
        ("loss gemodel 0% 20%", 0.0, None),
        ("loss gemodel 100% 100%", 0.5, 1.0),
        ("loss gemodel 5% 0%", 1.0, None),
        ("loss state 5% 25%", 1 / 6, 4.0),
        ("loss state 0.0001% 20%", 1e-6 / (1e-6 + 0.2), 5.0),
    ],
)
def test_loss_in_closed_form(words: str, loss: float, burst: float | None) -> None:
    found = expect(LinkProfile.parse(words))
    assert found.loss == pytest.approx(loss, rel=1e-9, abs=1e-12)
    assert found.mean_loss_burst == (None if burst is None else pytest.approx(burst, rel=1e-9))


def test_a_decision_that_stays_is_as_rare_as_any() -> None:
    assert expect(LinkProfile.parse("loss 10% 100%")).loss == pytest.approx(0.1)


def test_four_state_loss_is_the_chains_stationary_law() -> None:
    p13, p31, p32, p23, p14 = 0.03, 0.25, 0.15, 0.30, 0.02
    rows = np.array([[1 - p13 - p14, 0, p13, p14], [0, 1 - p23, p23, 0], [p31, p32, 1 - p31 - p32, 0], [1, 0, 0, 0]])
    values, vectors = np.linalg.eig(rows.T)
    shares = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    shares /= shares.sum()
    into_4, into_3 = shares[0] * p14, shares[0] * p13 + shares[1] * p23
    found = expect(LinkProfile.parse("loss state 3% 25% 15% 30% 2%"))
    assert found.loss == pytest.approx(shares[2] + shares[3], rel=1e-9)
    assert found.mean_loss_burst == pytest.approx((into_4 + into_3 / (p31 + p32)) / (into_4 + into_3), rel=1e-9)


@pytest.mark.parametrize(
    ("words", "mean", "deviation", "tolerance"),
    [
        ("delay 40ms", 40.0, 0.0, 1e-9),
        ("delay 40ms 10ms", 40.0, 10 / 3**0.5, 1e-3),
        ("delay 40ms 10ms distribution normal", 40.0, 10.0, 0.01),
        ("delay 40ms 10ms distribution pareto", 40 - 10 * CUT, 8.2, 0.01),
        ("delay 40ms 10ms distribution paretonormal", 40 - 7.5 * CUT, 8.34, 0.01),
        # uniform in [-10, 10), cut at 0: half nothing, half uniform in [0, 10)
        ("delay 0ms 10ms", 2.5, (100 / 6 - 2.5**2) ** 0.5, 0.01),
        # a quarter has no delay, three quarters have 40 ms
        ("delay 40ms reorder 25%", 30.0, 40 * (0.25 * 0.75) ** 0.5, 1e-6),
    ],
)
def test_delays_in_closed_form(words: str, mean: float, deviation: float, tolerance: float) -> None:
    found = expect(LinkProfile.parse(words))
    assert found.delay_mean_ms == pytest.approx(mean, abs=tolerance)
    assert found.delay_std_ms == pytest.approx(deviation, abs=tolerance)


def test_delays_of_conditions_weigh_by_time() -> None:
    trace = ConditionTrace("memory", (0, 1, 4), (10 * MS, 20 * MS, 30 * MS), (0.0, 0.1, 0.2))
    found = expect(LinkProfile(delay_ns=40 * MS, jitter_ns=MS, csv=trace))
    base = np.repeat([10.0, 20.0, 30.0], [1, 3, 3])
    assert found.delay_mean_ms == pytest.approx(40 + base.mean(), abs=1e-3)
    assert found.delay_std_ms == pytest.approx((base.var() + 1 / 3) ** 0.5, abs=1e-3)
    assert found.loss == pytest.approx(0.9 / 7)
    assert found.delay_correlation is None
    both = expect(LinkProfile.parse("loss 50%").replace(csv=trace))
    assert both.loss == pytest.approx(1 - 0.5 * (1 - 0.9 / 7))
    assert both.mean_loss_burst is None


@pytest.mark.parametrize(
    "words",
    mostly_slow(
        [
            "delay 40ms 10ms 25% loss 5% 25%",
            "delay 40ms 10ms distribution normal loss gemodel 1% 20% 70% 0.1%",
            "delay 15ms 10ms distribution paretonormal loss state 3% 25% 15% 30% 2%",
            "delay 20ms 5ms reorder 25% 50% loss 10%",
            "delay 20ms 5ms reorder 25% gap 3 loss 10%",
        ],
        1,
    ),
)
@pytest.mark.long
def test_links_achieve_what_is_expected(words: str) -> None:
    count = 100_000
    link: Link[int] = Link(LinkProfile.parse(words), 4)
    drive(link, count, MS)
    found, expected = link.stats, expect(link.profile)
    assert found.loss is not None
    assert found.mean_loss_burst is not None
    # bursts are independent: a sum of them has the variance of a compound, below burst (2 burst - 1) a loss
    error = (expected.loss * (2 * expected.mean_loss_burst) / count) ** 0.5
    assert found.loss == pytest.approx(expected.loss, abs=5 * error)
    assert found.mean_loss_burst == pytest.approx(expected.mean_loss_burst, rel=5 / found.loss_bursts**0.5)
    assert found.sent_ahead / count == pytest.approx(expected.sent_ahead, abs=5 * (0.25 * 3 / count) ** 0.5)
    assert found.delay_mean_ms == pytest.approx(
        expected.delay_mean_ms, abs=5 * expected.delay_std_ms * (3 / count) ** 0.5
    )
    assert found.delay_std_ms == pytest.approx(expected.delay_std_ms, rel=0.02)


@pytest.mark.long
def test_correlated_reordering_with_a_gap() -> None:
    count = 100_000
    link: Link[int] = Link(LinkProfile.parse("delay 20ms reorder 25% 50% gap 3"), 4)
    drive(link, count, MS)
    # distances are independent; a geometric tail bounds their deviation by 1/later = 8
    error = 8 * expect(link.profile).sent_ahead ** 1.5 / count**0.5
    assert link.stats.sent_ahead / count == pytest.approx(expect(link.profile).sent_ahead, abs=5 * error)
    assert expect(link.profile).sent_ahead == pytest.approx(1 / 8.25)  # 3 + (1 - 0.34375) / 0.125


def test_statistics_need_no_offer() -> None:
    link: Link[int] = Link(LinkProfile())
    assert (link.stats.loss, link.stats.mean_loss_burst, link.stats.delay_std_ms) == (None, None, None)


SOURCED = {  # medians and other quantiles that the comments beside the profiles name, in ms
    "wifi": {0.5: 3.0},
    "lossy-wifi": {0.5: 3.0, 0.9: 20.0},
    "4g": {0.5: 35.0},
    "leo": {0.5: 25.0},
    "worst": {0.5: 3500.0},
}


@pytest.mark.parametrize("name", SOURCED)
@pytest.mark.long
def test_named_profiles_have_the_quantiles_of_their_sources(name: str) -> None:
    """Of messages so far apart, as in the sources, that none waits for another."""
    link: Link[int] = Link(LinkProfile.preset(name).replace(rate_bit_s=0), 1)
    delays = [(due - 1000 * number * MS) / MS for due, number in drive(link, 20_000, 1000 * MS)]
    for fraction, expected in SOURCED[name].items():
        assert np.quantile(delays, fraction) == pytest.approx(expected, rel=0.05)


def test_every_named_profile_has_its_expectation() -> None:
    for name in PRESETS:
        found = expect(LinkProfile.preset(name))
        assert 0 <= found.loss <= 0.25 + 1e-12
        assert found.delay_mean_ms >= 0


def test_sent_ahead_counts_the_gap_and_what_survives() -> None:
    """With a gap of 4, three messages that cannot and then a geometric number of tries."""
    tries = stats.geom(0.25).mean()
    assert expect(LinkProfile.parse("delay 1ms reorder 25% gap 4 loss 50%")).sent_ahead == pytest.approx(
        0.5 / (3 + tries)
    )
