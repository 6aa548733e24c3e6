"""The statistics to expect of a link, computed from its profile alone, to compare with those achieved."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from netem import models
from netem.loss_chain import lost_again, share_and_run
from netem.profile import LinkProfile


@dataclass(frozen=True, slots=True)
class Expectation:
    """Long-run figures; the names are those that `LinkStats` uses for the achieved ones.

    `loss`, `recovered`, `corrupted` (and not lost) and `sent_ahead` are shares of the messages offered, `duplicated` is
    the share of copies;
    `resent` is the number of resends per message offered. `mean_loss_burst` is None without loss, or if it depends on
    the traffic's pace (``csv``) or on an impairment of `netem.impairments`. `sent_ahead` neglects that losses weaken a
    correlation beyond a gap. The delays are those of the words `delay`, `csv`, `resend` and `reorder`, and of
    impairments, including the cut at 0. The delay added by a rate, a trace, a slot or waiting for a resend depends on
    the traffic and is left out. With `csv`, a message and its resends are assumed to use the same line of the file.
    `delay_correlation` is that of successive messages; None if the delay is constant, or if the pace, `reorder` or
    `resend` affects it.
    """

    loss: float
    mean_loss_burst: float | None
    resent: float
    recovered: float
    corrupted: float
    duplicated: float
    sent_ahead: float
    delay_mean_ms: float
    delay_std_ms: float
    delay_correlation: float | None

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return dataclasses.asdict(self)


def expect(profile: LinkProfile) -> Expectation:
    """The figures that a long run through a link with this profile approaches."""
    resend, csv = profile.resend, profile.csv
    shares, lost = _fates(profile)
    number = np.arange(len(shares))
    resent, recovered = float(shares @ number) + lost * (len(shares) - 1), float(shares[1:].sum())
    added = [each.expected() for each in profile.others]
    for loses, _, _ in added:
        shares, lost = shares * (1.0 - loses), lost + float(shares.sum()) * loses
    copies = sum(each.copies for each in profile.others)
    arrived = float(shares.sum())
    ahead = _ahead(profile)
    delays = models.delay_quantiles(profile) * 1e-6
    mean, variance = float(delays.mean()), float(delays.var())
    if csv is not None:
        mean += csv.mean()[0] * 1e-6
        variance += csv.delay_variance() * 1e-12
    mean += sum(more for _, more, _ in added) * 1e-6
    variance += sum(spread**2 for _, _, spread in added) * 1e-12
    # a message's delay starts after its resends; of those without resends, the share sent ahead has no delay
    of_them = shares / arrived if arrived else np.eye(1, len(shares))[0]
    later = mean + number * (0.0 if resend is None else resend.after_ns * 1e-6)
    at_once = ahead * float(of_them[0])
    of_them[0] -= at_once
    total = float(of_them @ later)
    spread = float(of_them @ (variance + (later - total) ** 2)) + at_once * total**2
    steady = csv is None and not ahead and not added and resend is None and profile.jitter_ns > 0
    return Expectation(
        loss=lost,
        mean_loss_burst=_burst(profile),
        resent=resent,
        recovered=recovered,
        corrupted=arrived * profile.corrupt,
        duplicated=copies / (1.0 + copies),
        sent_ahead=float(shares[0]) * ahead,
        delay_mean_ms=total,
        delay_std_ms=math.sqrt(spread),
        delay_correlation=profile.delay_correlation if steady else None,
    )


def _ahead(profile: LinkProfile) -> float:
    """The share of messages sent ahead: one over their mean distance, gap - 1 plus the mean number of tries."""
    chance, correlation = profile.reorder, profile.reorder_correlation
    if chance in (0.0, 1.0) or correlation == 1.0:
        return chance / profile.gap
    # the first try is correlated with the last message sent ahead, later tries with a failed try
    first = chance + correlation**profile.gap * (1.0 - chance)
    later = chance * (1.0 - correlation)
    return 1.0 / (profile.gap + (1.0 - first) / later)


def _fates(profile: LinkProfile) -> tuple[NDArray[np.float64], float]:
    """The shares that arrive after 0, 1, 2, ... resends, and the share lost."""
    if profile.csv is None:
        shares, lost = _fates_at(profile, 0.0)
        return np.array(shares), lost
    lines = [_fates_at(profile, chance) for chance in profile.csv.losses]
    mean = profile.csv.mean_of
    return np.array([mean(column) for column in zip(*(shares for shares, _ in lines), strict=True)]), mean(
        [lost for _, lost in lines]
    )


def _fates_at(profile: LinkProfile, chance: float) -> tuple[list[float], float]:
    """The result of `_fates`, if a trace loses a message with the probability `chance`."""
    loss = 0.0 if profile.loss is None else share_and_run(profile.loss)[0]
    lost = loss + chance - loss * chance
    shares, before = [1.0 - lost], 1.0
    for again in lost_again(profile.loss, 0 if profile.resend is None else profile.resend.times):
        model = again / before if before else 0.0
        still = lost * (model + chance - model * chance)
        shares.append(lost - still)
        lost, before = still, again
    return shares, lost


def _burst(profile: LinkProfile) -> float | None:
    if profile.loss is None or profile.others or (profile.csv is not None and any(profile.csv.losses)):
        return None
    kept = 1.0 if profile.resend is None else lost_again(profile.loss, profile.resend.times)[-1]
    return share_and_run(profile.loss, kept)[1]
