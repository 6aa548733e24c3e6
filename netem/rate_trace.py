"""``trace FILE`` with a rate over time: seconds and Mbit/s, as in recordings of mobile networks for video."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import accumulate, pairwise

from netem import columns, units
from netem.errors import ProfileError
from netem.files import read_once

HEADING = ["time_s", "mbit_s"]
_MBIT = 10**6


@dataclass(frozen=True, slots=True)
class RateTrace:
    """The rate of a link over time, in steps.

    Each line of the file has a time in seconds and a rate in Mbit/s, separated by spaces, a tab or a comma; line 1 may
    be ``time_s,mbit_s``. Times increase and count from the first one. A rate holds until the next line's time, the last
    one as long as the one before it; then the trace starts over. A trace of one line never changes.

    `path` is the file's name, for `str`; a trace made in memory may have any name.
    """

    path: str
    times_ns: tuple[int, ...] = field(repr=False)
    rates_bit_s: tuple[int, ...] = field(repr=False)

    def __post_init__(self) -> None:
        units.check_path("trace", self.path)
        if not len(self.times_ns) == len(self.rates_bit_s) > 0:
            raise ProfileError("trace", self.path, "one rate for each time, and at least one time")
        if self.times_ns[0] != 0 or any(later <= earlier for earlier, later in pairwise(self.times_ns)):
            raise ProfileError("trace", self.path, "increasing times that begin with 0")
        if not all(0 <= rate <= units.MAX_RATE_BIT_S for rate in self.rates_bit_s) or not any(self.rates_bit_s):
            raise ProfileError("trace", self.path, "rates from 0, and one above 0")

    def __str__(self) -> str:
        return f"trace {units.format_path(self.path)}"

    @property
    def period_ns(self) -> int:
        """Length of one repetition [ns]."""
        return 2 * self.times_ns[-1] - self.times_ns[-2] if len(self.times_ns) > 1 else 10**9

    @property
    def mean_rate_bit_s(self) -> float:
        """Mean rate over one repetition [bit/s]."""
        return sum(self.carried()) / self.period_ns

    def carried(self) -> list[int]:
        """The capacity of each step, in bit/s times ns (1e-9 bit)."""
        ends = (*self.times_ns[1:], self.period_ns)
        return [rate * (end - begin) for begin, end, rate in zip(self.times_ns, ends, self.rates_bit_s, strict=True)]

    def line(self, start_ns: int, free_ns: int) -> RateTraceLine:
        """The line that plays this trace from `start_ns` on; until `free_ns` it carries earlier messages."""
        return RateTraceLine(self, start_ns, free_ns)

    @classmethod
    def load(cls, path: str) -> RateTrace:
        """Read a file. Raises ProfileError: it cannot be read, or a line is malformed; it names the line."""
        return _rates(path)


class RateTraceLine:
    """The line of a `RateTrace`: messages cross in order, each as fast as the rate of the time allows.

    trace, start_ns, free_ns : as in `RateTrace.line`; the trace also repeats backwards from its start.
    """

    def __init__(self, trace: RateTrace, start_ns: int, free_ns: int) -> None:
        self._trace, self._start_ns, self._free_ns = trace, start_ns, free_ns
        self._ends = list(accumulate(trace.carried()))

    def release_ns(self, ready_ns: int, size: int) -> int:
        """The time at which a message of `size` bytes, ready at `ready_ns`, has crossed the line after all others."""
        trace, ends, begin_ns = self._trace, self._ends, max(ready_ns, self._free_ns)
        if size > 0:
            whole = ends[-1]
            cycle, within = divmod(begin_ns - self._start_ns, trace.period_ns)
            at = bisect_right(trace.times_ns, within) - 1
            before = ends[at - 1] if at else 0
            target = cycle * whole + before + trace.rates_bit_s[at] * (within - trace.times_ns[at]) + size * 8 * 10**9
            cycle, rest = divmod(target - 1, whole)  # an end of a step belongs to that step
            at = bisect_left(ends, rest + 1)
            crossed = rest + 1 - (ends[at - 1] if at else 0)
            within = trace.times_ns[at] - -crossed // trace.rates_bit_s[at]
            begin_ns = self._start_ns + cycle * trace.period_ns + within
        self._free_ns = begin_ns
        return begin_ns


@read_once
def _rates(path: str) -> RateTrace:
    units.check_path("trace", path)
    with units.open_file("trace", path) as lines:
        times, rates = _steps(path, lines)
    return RateTrace(path, tuple(time - times[0] for time in times), tuple(rates))


def _steps(path: str, lines: Iterable[str]) -> tuple[list[int], list[int]]:
    most_s = units.MAX_TIME_NS // 10**9
    allowed = f"a time of at most {most_s} s, greater than on the line above, and a rate from 0 in Mbit/s: '0.5 2.25'"
    times, rates = list[int](), list[int]()
    for row in columns.rows(lines):
        if row == (1, HEADING):
            continue
        values = columns.numbers("trace", path, row, -most_s, units.MAX_RATE_BIT_S // _MBIT, allowed)
        time_ns = int(values[0] * 10**9)
        if len(values) != 2 or values[1] < 0 or abs(values[0]) > most_s or (times and time_ns <= times[-1]):
            raise columns.refused("trace", path, row, allowed)
        times.append(time_ns)
        rates.append(int(values[1] * _MBIT))
    if not any(rates):
        raise ProfileError(f"trace {units.format_path(path)}", "", "at least one line with a rate above 0")
    return times, rates
