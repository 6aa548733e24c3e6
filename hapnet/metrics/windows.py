"""The windows of a long run: its first seconds beside its last minute, and its tenths."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array

Mask: TypeAlias = NDArray[np.bool_]
"""(N,) which samples count."""

FIRST_S, LAST_S, LONG_S = 10.0, 60.0, 120.0
"""How long the first window and the last one are, and how long a run must last to have them [s]."""

TENTHS = 10


class Span(NamedTuple):
    """From `since_s` to before `until_s` [s]."""

    since_s: float
    until_s: float

    def holds(self, times: Array) -> Mask:
        """Which of `times` (N,) [s] lie in it."""
        return np.asarray((times >= self.since_s) & (times < self.until_s))


def first_and_last(lasts_s: float, still_s: float = 0.0) -> tuple[Span, Span] | None:
    """The first 10 s and the last minute; None: the run is too short.

    Parameters
    ----------
    lasts_s : the whole run [s], 120 or more. still_s : so long the hand holds still at the end [s]; the last minute is
        the one before.
    """
    if lasts_s < LONG_S:
        return None
    end_s = lasts_s - still_s
    return Span(0.0, FIRST_S), Span(end_s - LAST_S, end_s)


def tenths(times: Array, lasts_s: float) -> list[Mask]:
    """Which of `times` (N,) [s] lie in each tenth of a run of `lasts_s` [s]; what is beyond counts with the last."""
    which = np.minimum((times * (TENTHS / lasts_s)).astype(int), TENTHS - 1)
    return [which == tenth for tenth in range(TENTHS)]
