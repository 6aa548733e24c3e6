"""How a board's states arrive: at which rate, in bursts or one by one, and whether its clock is right."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from itertools import pairwise

from hapnet.ext.devices.serial_frames import WRAP

_LEAST = 8
"""States that are enough to judge."""

_LATE_PERIODS = 2.5
"""States that come further apart than this, in most cases, come in bursts."""

_CLOCK = 0.1
"""The board's clock may differ from ours by so much: some states may have waited."""

MICRO = 1e-6


class Untimely(Exception):
    """The states do not arrive as they should; the text says how. bursts : do they come in bursts?"""

    def __init__(self, text: str, bursts: bool = False) -> None:
        super().__init__(text)
        self.bursts: bool = bursts


def period_us(arrivals: Sequence[tuple[float, Sequence[int]]]) -> float:
    """The time between states as the board makes them [us]: a quarter come as soon or sooner, as some may be lost.

    arrivals : by our clock [s], and the times of the states that came then, by the board's clock [us].

    Raises Untimely: too few states, the board's clock is wrong, or the states come in bursts.
    """
    times_us = [time_us for _, together in arrivals for time_us in together]
    if len(times_us) < _LEAST:
        raise Untimely(f"only {len(times_us)} states came")
    took_s = arrivals[-1][0] - arrivals[0][0]
    clock = (arrivals[-1][1][-1] - arrivals[0][1][-1]) % WRAP * MICRO / took_s if took_s > 0.0 else 0.0
    if abs(clock - 1.0) > _CLOCK:
        raise Untimely(f"the board's clock goes {clock:.2g} times as fast as it should: does a PWM use its timer?")
    made_us = statistics.quantiles([(b - a) % WRAP for a, b in pairwise(times_us)])[0]
    apart_us = statistics.median(b - a for (a, _), (b, _) in pairwise(arrivals)) / MICRO
    if apart_us > _LATE_PERIODS * made_us:
        together = f"one each {made_us * 1e-3:.2g} ms, but arrive {apart_us * 1e-3:.2g} ms apart, several together"
        raise Untimely(f"the board makes {together}", bursts=True)
    return made_us
