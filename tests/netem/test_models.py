"""The random effects against theory, and against what the kernel did where the kernel is right.

All draws are seeded; the tests' levels (1e-3 and five standard errors) say how far from theory a correct model may be.
"""

from itertools import chain, islice
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from netem import LinkProfile, models
from netem.effects import FourStateLoss, GilbertElliottLoss, RandomLoss, Slot
from netem.survey import lag_1_correlation
from tests.conftest import mostly_slow
from tests.netem.support import burst_lengths, recorded

J = 10_000_000
TABLES = ("/usr/lib/x86_64-linux-gnu/tc", "/usr/lib/aarch64-linux-gnu/tc", "/usr/lib64/tc", "/usr/lib/tc")


def take_delays(words: str, count: int, seed: int = 1) -> NDArray[np.float64]:
    blocks = models.delays(np.random.default_rng(seed), LinkProfile.parse(words))
    return np.fromiter(islice(chain.from_iterable(blocks), count), dtype=np.float64, count=count)


def take_losses(words: str, count: int, seed: int = 1) -> NDArray[np.bool_]:
    blocks = models.losses(np.random.default_rng(seed), LinkProfile.parse(words).loss)
    return np.fromiter(islice(chain.from_iterable(blocks), count), dtype=np.bool_, count=count)


def pareto_cdf(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """clip((X - 1.5) 4/3, -4, 4), X Pareto of shape 3."""
    inside = 1.0 - np.maximum(0.75 * np.asarray(x) + 1.5, 1.0) ** -3.0
    return np.where(np.asarray(x) >= 4.0, 1.0, inside)


def paretonormal_cdf(x: NDArray[np.float64]) -> NDArray[np.float64]:
    p = (np.arange(200_000) + 0.5) / 200_000
    quantiles = 0.25 * stats.norm.ppf(p) + 0.75 * np.minimum((4 / 3) * ((1 - p) ** (-1 / 3) - 1.5), 4.0)
    return np.interp(x, quantiles, p, left=0.0, right=1.0)


CDFS = {
    "uniform": stats.uniform(-1, 2).cdf,
    "normal": stats.norm.cdf,
    "pareto": pareto_cdf,
    "paretonormal": paretonormal_cdf,
}


@pytest.mark.parametrize("name", CDFS)
def test_delays_follow_their_distribution(name: str) -> None:
    jitter = (take_delays(f"delay 200ms 10ms distribution {name}", 20_000) - 200e6) / J
    # the tables have 4096 steps, so a test of a continuous law is offset by at most one of them
    distance = stats.kstest(jitter, CDFS[name]).statistic - 1 / 4096
    assert stats.kstwo.sf(distance, len(jitter)) > 1e-3


def test_tables_have_the_shape_of_iproute2s() -> None:
    """Extremes and deviations as counted in the files of Debian 12's iproute2 6.1."""
    shapes = {
        "normal": (-32768, 28858, 1.0001),
        "pareto": (-5461, 32767, 0.8197),
        "paretonormal": (-12305, 31789, 0.8339),
    }
    for name, (lowest, most, deviation) in shapes.items():
        table = models.table(name)
        assert (len(table), table[0], table[-1]) == (4096, lowest, most)
        assert np.all(np.diff(table) >= 0)
        assert table.std() / 8192 == pytest.approx(deviation, abs=1e-4)


@pytest.mark.parametrize("name", ["normal", "pareto", "paretonormal"])
def test_tables_are_iproute2s(name: str) -> None:
    """Entry by entry, those of the files that tc itself reads here."""
    found = [path for folder in TABLES if (path := Path(folder) / f"{name}.dist").exists()]
    if not found:
        pytest.skip("iproute2 is not installed, so there are no tables to compare with")
    lines = [line for line in found[0].read_text().splitlines() if not line.startswith("#")]
    assert models.table(name).tolist() == sorted(int(entry) for line in lines for entry in line.split())


def test_uniform_jitter_is_half_open_with_deviation_j_over_root_3() -> None:
    jitter = take_delays("delay 5us 4ns", 100_000) - 5000
    assert set(jitter) == set(range(-4, 4))
    wide = take_delays("delay 200ms 10ms", 100_000)
    assert wide.std() == pytest.approx(J / np.sqrt(3), rel=0.01)


def test_delays_are_never_negative() -> None:
    assert take_delays("delay 1ms 10ms distribution normal", 10_000).min() == 0.0


@pytest.mark.parametrize("name", mostly_slow([(one,) for one in CDFS], 1))
@pytest.mark.parametrize("correlation", [0.25, 0.5, 0.9])
@pytest.mark.long
def test_delay_correlation_is_the_one_asked_for_and_leaves_the_distribution(name: str, correlation: float) -> None:
    words = f"delay 200ms 10ms {100 * correlation:g}% distribution {name}"
    jitter = (take_delays(words, 200_000) - 200e6) / J
    # Bartlett: the variance of the lag-1 estimate is below (1 + r^2) / (1 - r^2) / n for such a process
    error = np.sqrt((1 + correlation**2) / (1 - correlation**2) / len(jitter))
    assert lag_1_correlation(jitter) == pytest.approx(correlation, abs=5 * error)
    thinned = jitter[::100]
    assert stats.kstwo.sf(stats.kstest(thinned, CDFS[name]).statistic - 1 / 4096, len(thinned)) > 1e-3


@pytest.mark.long
def test_clipped_delays_keep_the_correlation_asked_for() -> None:
    assert lag_1_correlation(take_delays("delay 4ms 10ms 50%", 200_000)) == pytest.approx(0.5, abs=0.015)


def test_full_correlation_repeats_the_first_delay() -> None:
    assert len(set(take_delays("delay 40ms 10ms 100% distribution normal", 1000))) == 1


def test_the_latent_coefficient_of_a_uniform_is_known_in_closed_form() -> None:
    """corr = 6/pi asin(rho/2) for uniforms joined by a Gaussian copula (Kruskal 1958)."""
    grid = np.arange(4096)
    for correlation in (0.1, 0.5, 0.9):
        expected = 2 * np.sin(np.pi * correlation / 6)
        assert models.latent_correlation(grid, correlation) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("percent", [0.1, 2, 40])
def test_random_loss_is_exactly_binomial(percent: float) -> None:
    lost = take_losses(f"loss {percent}%", 100_000)
    assert stats.binomtest(int(lost.sum()), len(lost), percent / 100).pvalue > 1e-3
    lengths = burst_lengths(lost)
    assert stats.binomtest(len(lengths), int(lost.sum()), 1 - percent / 100).pvalue > 1e-3


@pytest.mark.parametrize(("percent", "correlation"), [(5, 0.25), (20, 0.8), (50, 0.5)])
def test_correlated_loss_keeps_its_rate_and_has_its_correlation(percent: float, correlation: float) -> None:
    lost = take_losses(f"loss {percent}% {100 * correlation:g}%", 200_000)
    p = percent / 100
    # a sum over a chain of lag-1 correlation C has (1 + C)/(1 - C) times the binomial variance
    error = np.sqrt(p * (1 - p) * (1 + correlation) / (1 - correlation) / len(lost))
    assert lost.mean() == pytest.approx(p, abs=5 * error)
    assert lag_1_correlation(lost.astype(np.float64)) == pytest.approx(correlation, abs=0.03)


@pytest.mark.parametrize("words", ["1% 20%", "1% 20% 70% 0.1%", "30% 90% 80% 10%"])
def test_gilbert_elliott_rate_and_correlation(words: str) -> None:
    lost = take_losses(f"loss gemodel {words}", 200_000)
    model = LinkProfile.parse(f"loss gemodel {words}").loss
    assert isinstance(model, GilbertElliottLoss)
    p, r, h, k = model.p, model.r, model.bad_loss, model.good_loss
    bad = p / (p + r)
    rate = bad * h + (1 - bad) * k
    decay = 1 - p - r
    state_variance = bad * (1 - bad) * (h - k) ** 2
    variance = rate * (1 - rate) + 2 * state_variance * decay / (1 - decay)
    assert lost.mean() == pytest.approx(rate, abs=5 * np.sqrt(variance / len(lost)))
    assert lag_1_correlation(lost.astype(float)) == pytest.approx(
        state_variance * decay / (rate * (1 - rate)), abs=0.03
    )


def test_gilbert_bursts_are_geometric() -> None:
    """With 1-H = 100 % and 1-K = 0 a burst is a stay in the bad state: geometric with mean 1/R; the gaps 1/P."""
    lost = take_losses("loss gemodel 5% 20%", 200_000)
    for lengths, chance in ((burst_lengths(lost), 0.20), (burst_lengths(~lost)[1:-1], 0.05)):
        edges = np.unique(stats.geom(chance).ppf(np.linspace(0, 1, 9)[1:-1]))
        observed = np.histogram(lengths, bins=[0, *(edges + 0.5), np.inf])[0]
        expected = np.diff([0, *stats.geom(chance).cdf(edges), 1]) * len(lengths)
        assert stats.chisquare(observed, expected).pvalue > 1e-3


def test_gilbert_elliott_loses_by_the_state_it_finds() -> None:
    """It starts good and moves after the loss was decided: P = 100 % and R = 0 loses all but the first message."""
    assert take_losses("loss gemodel 100% 0%", 5).tolist() == [False, True, True, True, True]


def test_four_state_chain_has_its_stationary_law_and_bursts() -> None:
    model = FourStateLoss(p13=0.03, p31=0.25, p32=0.15, p23=0.30, p14=0.02)
    lost = take_losses(str(model), 300_000)
    rows = np.array(
        [
            [1 - model.p13 - model.p14, 0, model.p13, model.p14],
            [0, 1 - model.p23, model.p23, 0],
            [model.p31, model.p32, 1 - model.p31 - model.p32, 0],
            [1, 0, 0, 0],
        ]
    )
    stationary = np.linalg.matrix_power(rows, 10_000)[0]
    loses = np.array([0.0, 0.0, 1.0, 1.0])
    rate = stationary @ loses
    # the variance of the sum, from the chain's fundamental matrix (Kemeny and Snell)
    fundamental = np.linalg.inv(np.eye(4) - rows + stationary)
    centred = loses - rate
    variance = 2 * (stationary * centred) @ fundamental @ centred - (stationary * centred) @ centred
    assert lost.mean() == pytest.approx(rate, abs=5 * np.sqrt(variance / len(lost)))
    # a burst starts alone (state 4, length 1) or in state 3 (geometric, left with p31 + p32)
    into_4, into_3 = stationary[0] * model.p14, stationary[0] * model.p13 + stationary[1] * model.p23
    mean = (into_4 + into_3 / (model.p31 + model.p32)) / (into_4 + into_3)
    lengths = burst_lengths(lost)
    assert lengths.mean() == pytest.approx(mean, abs=5 * lengths.std() / np.sqrt(len(lengths)))
    leave = model.p31 + model.p32
    expected = into_3 / (into_3 + into_4) * stats.geom(leave).pmf(np.arange(1, 9))
    expected[0] += into_4 / (into_3 + into_4)
    observed = np.bincount(np.minimum(lengths, 9), minlength=10)[1:]
    assert stats.chisquare(observed, len(lengths) * np.append(expected, 1 - expected.sum())).pvalue > 1e-3


def test_two_state_loss_is_the_four_state_models_special_case() -> None:
    lengths = burst_lengths(take_losses("loss state 5% 25%", 200_000))
    assert lengths.mean() == pytest.approx(4.0, abs=5 * np.sqrt(0.75) / 0.25 / np.sqrt(len(lengths)))


def test_streams_of_an_effect_do_not_depend_on_its_parameters() -> None:
    """The same draws behind another jitter, another distribution and another rate of loss."""
    narrow, wide = take_delays("delay 1s 1ms", 1000) - 1e9, take_delays("delay 2s 10ms", 1000) - 2e9
    np.testing.assert_allclose(wide, 10 * narrow, atol=10)
    normal = take_delays("delay 1s 1ms distribution normal", 1000)
    assert stats.spearmanr(narrow, normal).statistic > 0.9999
    few, many = take_losses("loss 5%", 10_000), take_losses("loss 10%", 10_000)
    assert few.sum() > 0
    assert not np.any(few & ~many)


def test_slot_intervals() -> None:
    rng = np.random.default_rng(2)
    uniform = list(islice(chain.from_iterable(models.slot_intervals(rng, Slot(1_000_000, 3_000_000))), 20_000))
    assert stats.kstest(uniform, stats.uniform(1e6, 2e6).cdf).pvalue > 1e-3
    normal = np.array(
        list(islice(chain.from_iterable(models.slot_intervals(rng, Slot(10**8, 10**7, "normal"))), 20_000))
    )
    assert stats.kstest((normal - 1e8) / 1e7, stats.norm.cdf).pvalue > 1e-3


def test_one_bit_is_flipped_anywhere() -> None:
    data = bytes(range(5))
    seen = set()
    for position in np.linspace(0, 1, 400, endpoint=False).tolist():
        changed = int.from_bytes(data, "big") ^ int.from_bytes(models.flip_bit(data, position), "big")
        assert changed.bit_count() == 1
        seen.add(changed)
    assert len(seen) == 40
    assert models.flip_bit(b"", 0.5) == b""


@pytest.mark.parametrize(
    ("words", "size", "expected_ns"),
    [
        ("rate 1mbit", 125, 1_000_000),
        ("rate 1mbit 42", 972, 8_112_000),
        ("rate 8bit -14", 10, 0),
        ("rate 155mbit 8 48 5", 100, 3 * 53 * 8_000_000_000 // 155_000_000),
    ],
)
def test_transmission_time(words: str, size: int, expected_ns: int) -> None:
    assert models.transmission_ns(size, LinkProfile.parse(words)) == expected_ns


@pytest.mark.parametrize(
    ("name", "words"), [("d20j5", "delay 20ms 5ms"), ("d20j5n", "delay 20ms 5ms distribution normal")]
)
def test_delays_are_the_kernels(name: str, words: str) -> None:
    kernel = recorded(name)[:, 2]
    own = np.median(recorded("d20")[:, 2]) - 20e6  # what the measuring machine adds
    assert stats.ks_2samp(kernel - own, take_delays(words, 100_000)).pvalue > 1e-3


def test_random_loss_is_the_kernels() -> None:
    kernel = recorded("loss5")[:, 1] < 0
    assert stats.binomtest(int(kernel.sum()), len(kernel), 0.05).pvalue > 1e-3
    ours = take_losses(str(RandomLoss(0.05)), 100_000)
    table = [[kernel.sum(), (~kernel).sum()], [ours.sum(), (~ours).sum()]]
    assert stats.chi2_contingency(table).pvalue > 1e-3


def test_gilbert_elliott_loss_is_the_kernels() -> None:
    """Rate and burst lengths of ten recordings' worth of ours and the kernel's one."""
    kernel = recorded("ge")[:, 1] < 0
    ours = take_losses("loss gemodel 1% 20% 70% 0.1%", 10 * len(kernel))
    rates = ours.reshape(-1, 2000).mean(axis=1)
    error = rates.std() * np.sqrt(2000 / len(kernel))
    assert kernel.mean() == pytest.approx(ours.mean(), abs=4 * error)
    highest = 8
    counts = [
        np.bincount(np.minimum(burst_lengths(lost), highest), minlength=highest + 1)[1:] for lost in (kernel, ours)
    ]
    assert stats.chi2_contingency(counts).pvalue > 1e-3
