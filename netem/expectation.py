"""What a link's statistics should come to, from its profile alone: the figures asked for, beside those achieved."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from netem import models
from netem.effects import FourStateLoss, GilbertElliottLoss, RandomLoss
from netem.profile import LinkProfile

_Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Expectation:
    """Long-run figures with the names that `LinkStats` gives to those achieved.

    `loss` and `sent_ahead` are shares of what is offered; `mean_loss_burst` is None without loss, or where it depends
    on the traffic's pace (``csv``). `sent_ahead` neglects that losses weaken a correlation beyond a gap. The delays are
    those that the words `delay`, `csv` and `reorder` make, cuts at 0 included: what a rate, a trace or a slot adds to
    them depends on the traffic. `delay_correlation` is that of successive messages, None where the delay is constant or
    the pace and `reorder` have a part in it.
    """

    loss: float
    mean_loss_burst: float | None
    sent_ahead: float
    delay_mean_ms: float
    delay_std_ms: float
    delay_correlation: float | None

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return dataclasses.asdict(self)


def expect(profile: LinkProfile) -> Expectation:
    """The figures that a long run through a link of this profile comes to."""
    loss, burst = _loss(profile)
    ahead = _ahead(profile)
    delays = models.delay_quantiles(profile) * 1e-6
    mean, variance = float(delays.mean()), float(delays.var())
    if profile.csv is not None:
        more_ns, more_loss = profile.csv.mean()
        mean += more_ns * 1e-6
        variance += profile.csv.delay_variance() * 1e-12
        if more_loss:
            loss, burst = 1.0 - (1.0 - loss) * (1.0 - more_loss), None
    # a share of the messages has no delay at all
    variance = (1.0 - ahead) * (variance + ahead * mean**2)
    steady = profile.csv is None and not ahead and profile.jitter_ns > 0
    return Expectation(
        loss=loss,
        mean_loss_burst=burst,
        sent_ahead=(1.0 - loss) * ahead,
        delay_mean_ms=(1.0 - ahead) * mean,
        delay_std_ms=math.sqrt(variance),
        delay_correlation=profile.delay_correlation if steady else None,
    )


def _ahead(profile: LinkProfile) -> float:
    """The share of messages sent ahead: one over their mean distance, gap - 1 that cannot and then the tries."""
    chance, correlation = profile.reorder, profile.reorder_correlation
    if chance in (0.0, 1.0) or correlation == 1.0:
        return chance / profile.gap
    # the first try knows of the last one sent ahead, the later ones of a try that failed
    first = chance + correlation**profile.gap * (1.0 - chance)
    later = chance * (1.0 - correlation)
    return 1.0 / (profile.gap + (1.0 - first) / later)


def _loss(profile: LinkProfile) -> tuple[float, float | None]:
    """The share lost, and the mean run of losses: the share lost over that of losses which follow no loss."""
    if profile.loss is None:
        return 0.0, None
    moves, loses = _chain(profile.loss)
    stay = _long_run(moves)
    lost = float(stay @ loses)
    begins = float((stay * (1.0 - loses)) @ moves @ loses)
    return lost, lost / begins if begins else None


def _chain(loss: RandomLoss | FourStateLoss | GilbertElliottLoss) -> tuple[_Matrix, _Matrix]:
    """A loss model as a Markov chain that starts in state 0: its transitions, and each state's chance to lose."""
    if isinstance(loss, RandomLoss):
        after_loss = loss.probability + loss.correlation * (1.0 - loss.probability)
        after_none = loss.probability * (1.0 - loss.correlation)
        if loss.correlation == 1.0:  # the first decision is repeated for ever, so the long run is that of many links
            after_loss = after_none = loss.probability
        return np.array([[1.0 - after_none, after_none], [1.0 - after_loss, after_loss]]), np.array([0.0, 1.0])
    if isinstance(loss, GilbertElliottLoss):
        moves = np.array([[1.0 - loss.p, loss.p], [loss.r, 1.0 - loss.r]])
        return moves, np.array([loss.good_loss, loss.bad_loss])
    moves = np.array(
        [
            [max(0.0, 1.0 - loss.p13 - loss.p14), 0.0, loss.p13, loss.p14],
            [0.0, 1.0 - loss.p23, loss.p23, 0.0],
            [loss.p31, loss.p32, max(0.0, 1.0 - loss.p31 - loss.p32), 0.0],
            [1.0, 0.0, 0.0, 0.0],
        ]
    )
    return moves, np.array([0.0, 0.0, 1.0, 1.0])


def _long_run(moves: _Matrix) -> _Matrix:
    """The share of time in each state of a chain that starts in state 0."""
    # half of the time nothing moves: the same shares, without a period
    power = 0.5 * (moves + np.eye(len(moves)))
    for _ in range(100):
        power = power @ power
        power /= power.sum(axis=1, keepdims=True)
    shares: _Matrix = power[0]
    return shares
