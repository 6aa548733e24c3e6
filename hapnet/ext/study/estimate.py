"""How long a study takes, by a few of its parts."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

Part = TypeVar("Part")
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def spread(parts: Sequence[Part], most: int = 8) -> list[Part]:
    """Up to `most` of these, from the whole list.

    By the golden ratio, not at equal distances: in a list of all combinations those may all have the same coupling.
    """
    places: list[int] = []
    part = itertools.count(1)
    while len(places) < min(most, len(parts)):
        place = int(len(parts) * (next(part) * _GOLDEN % 1.0))
        if place not in places:
            places.append(place)
    return [parts[place] for place in places]


def mean_seconds(
    run: Callable[[Part], object],
    parts: Sequence[Part],
    limit_s: float = 5.0,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, int]:
    """The mean time that `run` takes with one of the parts, in this process [s], and of how many parts it is the mean.

    At most 8 of them are run, and at most half; after `limit_s` no further one is begun. The first is run once before,
    as it also loads what all need, and counts only if no other is run.
    """

    def timed(part: Part) -> float:
        began = clock()
        run(part)
        return clock() - began

    some = spread(parts, min(8, max(1, len(parts) // 2)))
    first_s = timed(some[0])
    took_s: list[float] = []
    while len(took_s) < len(some) and first_s + sum(took_s) <= limit_s:
        took_s.append(timed(some[len(took_s)]))
    took_s = took_s or [first_s]
    return sum(took_s) / len(took_s), len(took_s)
