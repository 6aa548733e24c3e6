"""Values of a metric that a case can miss, and quantiles that count each miss as infinite instead of leaving it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, inf, isfinite

from hapnet.ext.metrics.measured import DEFINED


def value_of(measures: Mapping[str, float | None], metric: str) -> float | None:
    """The value of a case; infinite if it missed (a contact that was not felt); None if there is none to have."""
    value = measures.get(metric)
    known = DEFINED.get(metric)
    if value is None and known is not None and known.missed and measures.get(known.missed):
        return inf
    return value


def quantile(values: Sequence[float], share: float) -> float:
    """The quantile at `share` (0 to 1), linear between values; infinite where one of the two is."""
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = floor(place)
    part = place - low
    below, above = ordered[low], ordered[min(low + 1, len(ordered) - 1)]
    if not part or below == above:
        return below
    return below + part * (above - below) if isfinite(above) else above
