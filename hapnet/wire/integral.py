"""The integral of all waves of a stream, which its messages have."""

from __future__ import annotations

from hapnet.records.equation import equation
from hapnet.records.record import OfAxes, Reals, Record


class Integral(Record):
    """total : the integral of all waves so far [sqrt(W) s]. elapsed_ns : the sum of their spans."""

    total: OfAxes
    elapsed_ns: int


@equation
def integrate(integral: Integral, n: int, wave: Reals, span_ns: int) -> None:
    """Add a wave [sqrt(W)], the mean over `span_ns`."""
    seconds = span_ns * 1e-9
    for i in range(n):
        integral.total[i] = integral.total[i] + wave[i] * seconds
    integral.elapsed_ns += span_ns
