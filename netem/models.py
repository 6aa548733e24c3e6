"""The random effects of a link: endless streams of decisions, one per message, drawn in blocks.

Every stream is a generator of blocks (arrays of `BLOCK` decisions). `numpy.random.Generator`s are arguments. A stream
takes a fixed number of draws per message, whatever its parameters. So message n gets the same draws when another
effect, or this effect's parameters, change.

These streams correct an error of Linux's netem. Its correlated generator averages uniform draws, which concentrates
them in the middle: `loss 5% 25%` loses 0.2 % and `reorder 25% 50%` reorders 7 %, and the delays' correlation has no
effect. Here a correlation C is the lag-1 correlation of the decisions (or of the delays), and their distribution stays
as requested.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import repeat
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from netem.delay_table import DelayTable
from netem.effects import FourStateLoss, GilbertElliottLoss, Loss, RandomLoss, Slot
from netem.profile import LinkProfile

if TYPE_CHECKING:
    from netem.line import RateLine

BLOCK = 256  # a refill takes tens of microseconds, much less than a servo's period
_TABLE_SIZE = 4096
_TABLE_ONE = 8192  # the jitter J in the units of a table's entries
_SHORT_MAX = 32767


@lru_cache
def table(distribution: str) -> NDArray[np.int64]:
    """iproute2's table of a distribution: 4096 quantiles, ascending, in units of J/8192, clipped to 16 bits.

    ``normal`` goes from -4 to +3.52 J. ``pareto`` is clip((X - 1.5) 4/3, -4, 4) with X Pareto of shape 3: its minimum
    is -0.67 J, its mean -0.03 J because of the clip, its standard deviation 0.82 J (1.15 J unclipped). ``paretonormal``
    is a quarter of the normal quantile plus three quarters of the clipped pareto one: from -1.50 to 3.88 J, standard
    deviation 0.83 J.
    """
    steps = np.arange(_TABLE_SIZE)
    # a slice's entry is the last grid point that rounds to it; the grid is 5e-5 standard deviations wide
    upper = (4 * steps + 0.5) / (4 * _TABLE_SIZE)
    points = np.floor(np.array([NormalDist().inv_cdf(p) for p in upper.tolist()]) * 20_000)
    normal = np.rint(points * (_TABLE_ONE / 20_000)).astype(np.int64)
    shape_3 = (1.0 - steps / _TABLE_SIZE) ** (-1.0 / 3.0)
    pareto = np.rint(np.minimum((shape_3 - 1.5) * (4.0 / 3.0) * _TABLE_ONE, _SHORT_MAX)).astype(np.int64)
    mixed = normal + 3 * pareto
    paretonormal = np.sign(mixed) * (np.abs(mixed) // 4)  # C's division, towards zero
    tables: dict[str, NDArray[np.int64]] = {"normal": np.clip(normal, -_SHORT_MAX - 1, _SHORT_MAX)}
    tables |= {"pareto": pareto, "paretonormal": paretonormal}
    return tables[distribution]


def delays(rng: Generator, profile: LinkProfile) -> Iterator[NDArray[np.int64]]:
    """Delays in ns, never negative: the delay plus jitter.

    Without a distribution the jitter is uniform in [-J, J), with standard deviation J/sqrt(3). With one it is J times
    an entry of `table`, or of a file's (`netem.delay_table`). With a correlation C the delays' lag-1 correlation is C:
    the quantiles follow a Gaussian AR(1) process, whose coefficient comes from `latent_correlation`.
    """
    if profile.jitter_ns == 0:
        return repeat(np.full(BLOCK, profile.delay_ns))
    values = _Jittered(profile.delay_ns, profile.jitter_ns, profile.distribution)
    if profile.delay_correlation == 0.0:
        return (values(rng.random(BLOCK)) for _ in repeat(None))
    shape = profile.delay_ns, profile.jitter_ns, profile.distribution
    uniforms = _correlated_uniforms(rng, _delay_coefficient(*shape, profile.delay_correlation))
    return (values(u) for u in uniforms)


def delay_quantiles(profile: LinkProfile) -> NDArray[np.int64]:
    """The delays in ns at the centres of equal slices of probability, ascending: 4096, or all of a file's delays."""
    own = profile.distribution
    return _quantiles(profile.delay_ns, profile.jitter_ns, own, len(own.values) if isinstance(own, DelayTable) else 0)


def _quantiles(delay_ns: int, jitter_ns: int, distribution: str | DelayTable, slices: int = 0) -> NDArray[np.int64]:
    slices = slices or _TABLE_SIZE
    return _Jittered(delay_ns, jitter_ns, distribution)((np.arange(slices) + 0.5) / slices)


@lru_cache
def _delay_coefficient(delay_ns: int, jitter_ns: int, distribution: str | DelayTable, correlation: float) -> float:
    """`latent_correlation` of a profile's delays, cached: it takes milliseconds, and many links share a profile."""
    return latent_correlation(_quantiles(delay_ns, jitter_ns, distribution), correlation)


class _Jittered:
    """An increasing map of uniform draws in [0, 1) to delays in ns; its table is made once."""

    def __init__(self, delay_ns: int, jitter_ns: int, distribution: str | DelayTable) -> None:
        self._low, self._width = delay_ns - jitter_ns, 2 * jitter_ns
        self._table: NDArray[np.int64] | None = None
        if isinstance(distribution, DelayTable):
            around = np.rint(np.array(distribution.values) * jitter_ns)
            self._table = np.maximum(delay_ns + around.astype(np.int64), 0)
        elif distribution != "uniform":
            scaled = table(distribution) * jitter_ns
            rounded = np.sign(scaled) * ((np.abs(scaled) + _TABLE_ONE // 2) // _TABLE_ONE)
            self._table = np.maximum(delay_ns + rounded, 0)

    def __call__(self, uniforms: NDArray[np.float64]) -> NDArray[np.int64]:
        if self._table is not None:
            return self._table[(uniforms * len(self._table)).astype(np.intp)]
        return np.maximum(self._low + (uniforms * self._width).astype(np.int64), 0)


def latent_correlation(quantiles: NDArray[np.int64], correlation: float) -> float:
    """The AR(1) coefficient rho of standard normal z for which g(z) has this lag-1 correlation.

    g maps the i-th of n equal slices of probability to ``quantiles[i]`` (ascending). Expanded in normalised Hermite
    polynomials, g(z) = sum a_k h_k(z), its correlation is sum a_k^2 rho^k / sum a_k^2 (the Nataf transform, Liu and Der
    Kiureghian 1986), which increases with rho.
    """
    n = len(quantiles)
    g = (quantiles - quantiles.mean()) / max(float(quantiles.std()), 1e-300)
    z = np.array([NormalDist().inv_cdf(i / n) for i in range(1, n)])
    steps = np.diff(g)
    # a_k = sum over the slices' edges of (rise of g) * h_{k-1}(z) phi(z) / sqrt(k); psi_k = h_k(z) phi(z)
    before, psi = np.zeros_like(z), np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    squares = []
    for k in range(1, 200):
        squares.append(float(steps @ psi) ** 2 / k)
        before, psi = psi, (z * psi - math.sqrt(k - 1) * before) / math.sqrt(k)
    rest = max(0.0, 1.0 - sum(squares))  # in orders so high that they count only at rho = 1
    low, high = 0.0, 1.0
    for _ in range(50):
        rho = 0.5 * (low + high)
        reached = sum(a * rho**k for k, a in enumerate(squares, start=1)) + rest * rho ** (len(squares) + 1)
        low, high = (rho, high) if reached < correlation else (low, rho)
    return high


def _correlated_uniforms(rng: Generator, rho: float) -> Iterator[NDArray[np.float64]]:
    z = float(rng.standard_normal())
    fresh = math.sqrt(max(0.0, 1.0 - rho * rho))
    below_one, root_half = math.nextafter(1.0, 0.0), math.sqrt(0.5)
    while True:
        doubled = []
        for new in rng.standard_normal(BLOCK).tolist():
            z = rho * z + fresh * new
            doubled.append(math.erfc(-z * root_half))
        yield np.minimum(0.5 * np.array(doubled), below_one)


def decisions(rng: Generator, probability: float, correlation: float) -> Iterator[NDArray[np.bool_]]:
    """Decisions that are true with `probability` and have lag-1 correlation `correlation`: a two-state Markov chain.

    P(true | true) = P + C (1 - P) and P(true | false) = P (1 - C) give exactly this mean and this correlation.
    """
    if probability == 0.0:
        return repeat(np.zeros(BLOCK, dtype=np.bool_))
    if correlation == 0.0:
        return (rng.random(BLOCK) < probability for _ in repeat(None))
    return _correlated_decisions(rng, probability, correlation)


def _correlated_decisions(rng: Generator, probability: float, correlation: float) -> Iterator[NDArray[np.bool_]]:
    after_true = probability + correlation * (1.0 - probability)
    after_false = probability * (1.0 - correlation)
    state = bool(rng.random() < probability)
    while True:
        block = []
        for u in rng.random(BLOCK).tolist():
            state = u < (after_true if state else after_false)
            block.append(state)
        yield np.array(block)


def losses(rng: Generator, loss: Loss | None) -> Iterator[NDArray[np.bool_]]:
    """Whether each message is lost."""
    if loss is None:
        return repeat(np.zeros(BLOCK, dtype=np.bool_))
    if isinstance(loss, RandomLoss):
        return decisions(rng, loss.probability, loss.correlation)
    return _gilbert_elliott(rng, loss) if isinstance(loss, GilbertElliottLoss) else _four_state(rng, loss)


def _gilbert_elliott(rng: Generator, loss: GilbertElliottLoss) -> Iterator[NDArray[np.bool_]]:
    """Start in the good state. For each message, decide its loss by the present state, then change the state."""
    bad = False
    p, r, bad_loss, good_loss = loss.p, loss.r, loss.bad_loss, loss.good_loss
    while True:
        block = []
        moves, chances = rng.random((2, BLOCK)).tolist()
        for move, chance in zip(moves, chances, strict=True):
            if bad:
                block.append(chance < bad_loss)
                bad = move >= r
            else:
                block.append(chance < good_loss)
                bad = move < p
        yield np.array(block)


def _four_state(rng: Generator, loss: FourStateLoss) -> Iterator[NDArray[np.bool_]]:
    """Start in state 1. For each message, change the state, then decide its loss by the new state (3 and 4 lose)."""
    state = 1
    while True:
        block = []
        for u in rng.random(BLOCK).tolist():
            if state == 1:
                state = 4 if u < loss.p14 else 3 if u < loss.p14 + loss.p13 else 1
            elif state == 2:
                state = 3 if u < loss.p23 else 2
            elif state == 3:
                state = 2 if u < loss.p32 else 1 if u < loss.p32 + loss.p31 else 3
            else:
                state = 1
            block.append(state >= 3)
        yield np.array(block)


def fractions(rng: Generator) -> Iterator[NDArray[np.float64]]:
    """Uniform draws in [0, 1): for the bit to flip, for a trace's loss, and for the number of lost resends."""
    while True:
        yield rng.random(BLOCK)


def flip_bit(data: bytes, position: float) -> bytes:
    """`data` with one bit flipped: the one at the fraction `position` in [0, 1) of its length."""
    bit = int(position * 8 * len(data))
    flipped = bytearray(data)
    if flipped:
        flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


def slot_intervals(rng: Generator, slot: Slot) -> Iterator[NDArray[np.int64]]:
    """Times between slots in ns, never negative."""
    if slot.distribution:
        values = _Jittered(slot.min_ns, slot.max_ns, slot.distribution)
        return (values(rng.random(BLOCK)) for _ in repeat(None))
    span = slot.max_ns - slot.min_ns
    return (slot.min_ns + (rng.random(BLOCK) * span).astype(np.int64) for _ in repeat(None))


def transmission_ns(size: int, profile: LinkProfile | RateLine) -> int:
    """Time in ns to send `size` bytes plus overhead over the line, in whole cells if the profile has cells."""
    length = max(0, size + profile.overhead)
    if profile.cell_size:
        length = -(-length // profile.cell_size) * (profile.cell_size + profile.cell_overhead)
    return length * 8_000_000_000 // profile.rate_bit_s
