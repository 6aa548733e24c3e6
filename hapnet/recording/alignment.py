"""The difference of two hosts' clocks during a run, from the recorded transits of each other's messages.

A message's transit (`DeviceSample.transit_s`) is its delay plus the receiver's clock less the sender's. So in one
direction the difference of the clocks is added, in the other it is subtracted:

    to the world:  delay + difference        to the device:  delay - difference

Low transits show low delays. As in NTP (RFC 5905, section 8) both directions are assumed to have the same low delay,
since how a round trip splits cannot be known; so the error is at most half of the round trip. Clocks also run at
different rates, so low transits lie along lines, one for each direction, of opposite slopes. Moon, Skelly and Towsley,
"Estimation and Removal of Clock Skew from Network Delay Measurements" (INFOCOM 1999), take the line below all points of
one direction. Here it is the line below nine tenths of them, by quantile regression (Koenker and Bassett, Econometrica
46(1), 1978), in both directions together: the minimum of a few hundred jittery delays is a jittery number itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array

WINDOW_S = 60.0
"""Clocks are assumed to run at constant rates for this long. With temperature, a quartz changes its rate by some 1e-7
in that time, which makes some 6 us."""

MOST_DRIFT = 5e-4
"""No clock runs faster or slower than another by more: the limit of NTP's corrections (RFC 5905, section 11.3)."""

LOW = 0.1
"""This share of the transits is below the lines."""

_MINIMUM = 4  # messages in each direction
_SPANNED = 0.5  # of a window: a slope over less of it is too uncertain at its ends
_HALVINGS = 48
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class ClockDifference:
    """The world's clock less the device's, at some instants of the device's clock; linear between them and beyond.

    device_ns, difference_ns : the instants, at least two, and the difference there [ns].
    error_s : half of a low round trip [s]. The error of a constant difference is at most this, however the round trip
        splits; as the drift is fitted, this is only an estimate for a changing difference.
    """

    device_ns: tuple[int, ...]
    difference_ns: tuple[int, ...]
    error_s: float

    @classmethod
    def of(cls, reported: Mapping[str, Any]) -> ClockDifference:
        """Make a difference from its `vars`, read back from JSON."""
        return cls(tuple(reported["device_ns"]), tuple(reported["difference_ns"]), float(reported["error_s"]))

    @property
    def drift(self) -> float:
        """The mean excess rate of the world's clock, in seconds a second."""
        first, last = (at[-1] - at[0] for at in (self.difference_ns, self.device_ns))
        return first / last

    def on_device(self, world_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert times of the world's clock to the device's clock [ns]."""
        knots = np.array(self.device_ns, dtype=np.int64) + np.array(self.difference_ns, dtype=np.int64)
        since = (world_ns - knots[0]).astype(float)  # small numbers: a double has no nanoseconds of a year
        at, y = (knots - knots[0]).astype(float), np.array(self.difference_ns, dtype=np.int64) - self.difference_ns[0]
        part = np.clip(np.searchsorted(at, since, side="right") - 1, 0, len(at) - 2)
        slope = (np.diff(y) / np.diff(at))[part]
        more = np.rint(y[part] + slope * (since - at[part])).astype(np.int64)
        return np.asarray(world_ns - self.difference_ns[0] - more)


def words(meta: Mapping[str, Any]) -> str | None:
    """Text on how a joined recording's two sides were put on one clock; None if `meta` is not of a joined recording."""
    if "sides" not in meta:
        return None
    if not meta.get("aligned"):
        return "the two hosts' clocks cannot be compared: each side begins at its own start"
    if "clock_difference" not in meta:
        return "both sides have the same clock"
    try:
        found = ClockDifference.of(meta["clock_difference"])
        ahead_s, drift, error_ms = found.difference_ns[0] * 1e-9, found.drift * 1e6, found.error_s * 1e3
    except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError):
        return None
    where, rate = "ahead" if ahead_s > 0.0 else "behind", "fast" if drift > 0.0 else "slow"
    return (
        f"the world's host's clock is {abs(ahead_s):.6f} s {where} and {abs(drift):.0f} ppm {rate}, as the messages "
        f"show: to within {error_ms:.2g} ms, half a round trip"
    )


def clock_difference(
    device: Mapping[str, NDArray[Any]], world: Mapping[str, NDArray[Any]], window_s: float = WINDOW_S
) -> ClockDifference | None:
    """The difference of the clocks, from both sides' columns of a `Recording`; the sides must be of one pair.

    None if it is not known: no ages were recorded, messages came in one direction only, or the sides are not a pair.
    """
    down_ns, down = _transits(device)
    up_ns, up = _transits(world)
    if min(len(down), len(up)) < _MINIMUM:
        return None
    origin_ns, base = int(down_ns[0]), float(up[0])
    up, down = up - base, down + base  # the difference is now small
    sent = (up_ns - round(base * 1e9) - origin_ns).astype(float) * 1e-9  # near the device's clock
    came = (down_ns - origin_ns).astype(float) * 1e-9
    begin, end = max(sent[0], came[0]), min(sent[-1], came[-1])
    if end <= begin:
        return None
    ends = np.linspace(begin, end, max(1, round((end - begin) / window_s)) + 1).tolist()
    knots: dict[float, list[float]] = {}
    trips: list[float] = []
    for first, last in pairwise(ends):
        if (line := _line(sent, up, came, down, first, last)) is not None:  # else: a silence, from knot to knot
            knots.setdefault(first, []).append(line[0])
            knots.setdefault(last, []).append(line[0] + line[1] * (last - first))
            trips.append(line[2])
    if not trips or min(trips) < -1e-6:
        return None
    return ClockDifference(
        tuple(origin_ns + round(at * 1e9) for at in knots),
        tuple(round(base * 1e9) + round(sum(values) / len(values) * 1e9) for values in knots.values()),
        max(0.0, *trips) / 2.0,
    )


def _transits(columns: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.int64], Array]:
    """The time of the first sample with each message [ns], and the message's transit [s]."""
    transit = columns.get("transit_s", np.array([]))
    known = np.flatnonzero(np.isfinite(transit))
    transit = transit[known]
    first = np.append(True, np.diff(transit) != 0.0)[: len(transit)]
    return columns["time_ns"][known][first], transit[first]


def _line(
    sent: Array, up: Array, came: Array, down: Array, begin: float, end: float
) -> tuple[float, float, float] | None:
    """Difference at `begin` [s], its slope, and a low round trip [s]; None: too few messages, or for too short a time.

    sent, up : of messages to the world. came, down : of messages to the device. Messages from `begin` to `end` count.
    """
    directions = []
    for at, transit in ((sent, up), (came, down)):
        inside = (at >= begin) & (at <= end)
        if np.count_nonzero(inside) < _MINIMUM or np.ptp(at[inside]) < _SPANNED * (end - begin):
            return None
        directions.append((at[inside] - begin, transit[inside]))
    (x_up, y_up), (x_down, y_down) = directions

    def left(slope: float) -> float:
        """Return the weighted residual of lines with this slope, as in quantile regression."""
        return _pinball(y_up - slope * x_up) + _pinball(y_down + slope * x_down)

    slope = _minimum(left, -MOST_DRIFT, MOST_DRIFT)
    low_up, low_down = (float(np.quantile(y, LOW)) for y in (y_up - slope * x_up, y_down + slope * x_down))
    return (low_up - low_down) / 2.0, slope, low_up + low_down


def _pinball(values: Array) -> float:
    """The mean pinball loss of the values at their quantile `LOW`, which minimises it."""
    apart = values - np.quantile(values, LOW)
    return float(np.maximum(LOW * apart, (LOW - 1.0) * apart).mean())


def _minimum(function: Any, low: float, high: float) -> float:
    """The place of a convex function's minimum, by golden section."""
    a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_a, at_b = function(a), function(b)
    for _ in range(_HALVINGS):
        if at_a <= at_b:
            high, b, at_b = b, a, at_a
            a = high - _GOLDEN * (high - low)
            at_a = function(a)
        else:
            low, a, at_a = a, b, at_b
            b = low + _GOLDEN * (high - low)
            at_b = function(b)
    return (low + high) / 2.0
