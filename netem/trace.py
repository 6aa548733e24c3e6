"""Recorded links: mahimahi's delivery opportunities, and delay and loss over time. Both repeat at their end.

`load_trace` reads the opportunities, or a rate over time (`netem.rate_trace`).
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from typing import TypeVar

from netem import columns, delay_table, units
from netem.errors import ProfileError
from netem.files import read_once
from netem.rate_trace import HEADING, RateTrace

OPPORTUNITY_BYTES = 1500
EVERY_NS = 10_000_000
"""The time for which a delay holds in a file with one per line, as in LeoCC's recordings of Starlink [ns]."""

_MS = 1_000_000
_MAX_MS = units.MAX_TIME_NS // _MS

_Trace = TypeVar("_Trace")


@dataclass(frozen=True, slots=True)
class CapacityTrace:
    """``trace FILE``: the times at which a link could deliver 1500 bytes, in mahimahi's format.

    Each line of the file is one delivery opportunity: its time in milliseconds, never less than on the line above.
    After the last line's time the trace repeats (Netravali et al., USENIX ATC 2015; Winstein et al., NSDI 2013).

    `path` is the file's name, for `str`; a trace made in memory may have any name.
    """

    path: str
    times_ns: tuple[int, ...] = field(repr=False)

    def __post_init__(self) -> None:
        units.check_path("trace", self.path)
        if not self.times_ns or self.times_ns[-1] <= 0:
            raise ProfileError("trace", self.path, "at least one opportunity after time 0")
        if self.times_ns[0] < 0 or any(later < earlier for earlier, later in pairwise(self.times_ns)):
            raise ProfileError("trace", self.path, "times from 0 on, none less than the one before it")

    def __str__(self) -> str:
        return f"trace {units.format_path(self.path)}"

    @property
    def period_ns(self) -> int:
        """Length of one repetition [ns]: the time of its last opportunity."""
        return self.times_ns[-1]

    @property
    def mean_rate_bit_s(self) -> float:
        """Mean capacity over one repetition [bit/s]."""
        return 8 * OPPORTUNITY_BYTES * len(self.times_ns) * 1e9 / self.period_ns

    def time_ns(self, number: int) -> int:
        """Time of opportunity `number` since the start [ns]; opportunities count from 0 through all repetitions."""
        cycle, index = divmod(number, len(self.times_ns))
        return cycle * self.period_ns + self.times_ns[index]

    def first_after(self, elapsed_ns: int) -> int:
        """Number of the first opportunity later than `elapsed_ns` after the start."""
        cycle, within = divmod(elapsed_ns, self.period_ns)
        return cycle * len(self.times_ns) + bisect_right(self.times_ns, within)

    def line(self, start_ns: int, free_ns: int) -> TraceLine:
        """The line that plays this trace from `start_ns` on; until `free_ns` it carries earlier messages."""
        return TraceLine(self, start_ns, free_ns)

    @classmethod
    def load(cls, path: str) -> CapacityTrace:
        """Read a file in mahimahi's format.

        Raises ProfileError: the file cannot be read, or a line is not a time in milliseconds; it names the line.
        """
        return _capacity(path)


class TraceLine:
    """The line of a `CapacityTrace`: messages cross in order and share opportunities.

    As in mahimahi's link shell, a message takes its bytes from successive opportunities and has crossed with its last
    byte. The rest of an opportunity goes to the message that waits behind it. If none waits, the rest, or the whole
    opportunity, is lost. A message that becomes ready at the instant of an opportunity waits for the next one.
    (mahimahi counts 1504 bytes, four of them for its tunnel's header per packet; here only the message's bytes count.)

    trace : the opportunities.
    start_ns : when the trace starts; it also repeats backwards from there.
    free_ns : when the line is free; until then it carries earlier messages.
    """

    def __init__(self, trace: CapacityTrace, start_ns: int, free_ns: int) -> None:
        self._trace, self._start_ns = trace, start_ns
        self._last_ns = free_ns
        self._number = trace.first_after(free_ns - start_ns) - 1
        self._left = 0

    def release_ns(self, ready_ns: int, size: int) -> int:
        """The time at which a message of `size` bytes, ready at `ready_ns`, has crossed the line after all others."""
        if ready_ns >= self._last_ns:
            self._number = self._trace.first_after(ready_ns - self._start_ns)
            self._left = OPPORTUNITY_BYTES
        if size > self._left or self._left == 0:
            more = max(1, -(-(size - self._left) // OPPORTUNITY_BYTES))
            self._number += more
            self._left += more * OPPORTUNITY_BYTES
        self._left -= size
        self._last_ns = self._start_ns + self._trace.time_ns(self._number)
        return self._last_ns


@dataclass(frozen=True, slots=True)
class ConditionTrace:
    """``csv FILE [every TIME]``: delay and loss over time, in steps.

    Line 1 names the columns ``time_s,delay_ms,loss_percent``. Or the file has one delay per line, in ms or in the unit
    that line 1 names (``delay_us``), and each holds for `every_ns`, 10 ms unless TIME is given.

    Times increase and count from the first one. Each line holds until the time of the next. The last line holds as long
    as the line before it; then the trace starts over. A trace of one line never changes. ``loss_percent`` may be left
    out.

    `losses` are probabilities. `path` is the file's name, for `str`; a trace made in memory may have any name.
    """

    path: str
    times_ns: tuple[int, ...] = field(repr=False)
    delays_ns: tuple[int, ...] = field(repr=False)
    losses: tuple[float, ...] = field(repr=False)
    every_ns: int = 0

    def __post_init__(self) -> None:
        units.check_path("csv", self.path)
        if not len(self.times_ns) == len(self.delays_ns) == len(self.losses) > 0:
            raise ProfileError("csv", self.path, "one delay and one loss for each time, and at least one time")
        if self.times_ns[0] != 0 or any(later <= earlier for earlier, later in pairwise(self.times_ns)):
            raise ProfileError("csv", self.path, "increasing times that begin with 0")
        if not all(0 <= delay <= units.MAX_TIME_NS for delay in self.delays_ns):
            raise ProfileError("csv", self.path, "delays from 0 to 100000s")
        if not all(0.0 <= loss <= 1.0 for loss in self.losses):
            raise ProfileError("csv", self.path, "losses from 0% to 100%")

    def __str__(self) -> str:
        return f"csv {units.format_path(self.path)}" + (
            f" every {units.format_time(self.every_ns)}" * bool(self.every_ns)
        )

    @property
    def period_ns(self) -> int:
        """Length of one repetition [ns]."""
        return 2 * self.times_ns[-1] - self.times_ns[-2] if len(self.times_ns) > 1 else 1

    def at(self, elapsed_ns: int) -> tuple[int, float]:
        """The delay in ns and the probability of loss at a time since the start."""
        index = bisect_right(self.times_ns, elapsed_ns % self.period_ns) - 1
        return self.delays_ns[index], self.losses[index]

    def mean(self) -> tuple[float, float]:
        """The means of delay in ns and of loss over one repetition."""
        return self.mean_of(self.delays_ns), self.mean_of(self.losses)

    def delay_variance(self) -> float:
        """The variance of the delay over one repetition, in ns^2."""
        mean = self.mean_of(self.delays_ns)
        return self.mean_of([(delay - mean) ** 2 for delay in self.delays_ns])

    def mean_of(self, values: Sequence[float]) -> float:
        """The mean over one repetition of a quantity with these values, one per line."""
        ends = (*self.times_ns[1:], self.period_ns)
        spans = zip(self.times_ns, ends, values, strict=True)
        return math.fsum((end - begin) * value for begin, end, value in spans) / self.period_ns

    @classmethod
    def load(cls, path: str, every_ns: int = 0) -> ConditionTrace:
        """Read a file of delay and loss over time; `every_ns` is that of a file with one delay per line.

        Raises ProfileError: the file cannot be read, or the heading or a line is malformed; it names the line.
        """
        return _condition(path, every_ns)


@read_once
def _capacity(path: str) -> CapacityTrace:
    return _load("trace", path, lambda lines: CapacityTrace(path, tuple(_opportunities(path, lines))))


@read_once
def _condition(path: str, every_ns: int) -> ConditionTrace:
    if _first(path, "csv", 1):
        return _load("csv", path, lambda lines: _delays(path, every_ns or EVERY_NS, lines))
    if every_ns:
        raise ProfileError(
            "csv every", units.format_time(every_ns), "", why="the file has times of its own; leave every out"
        )
    return _load("csv", path, lambda lines: ConditionTrace(path, *_conditions(path, lines)))


def load_trace(path: str) -> CapacityTrace | RateTrace:
    """Read a file of delivery opportunities, or of a rate over time, which has two columns.

    Raises ProfileError: as `CapacityTrace.load` and `RateTrace.load`.
    """
    return RateTrace.load(path) if _first(path, "trace", 2) else CapacityTrace.load(path)


def _first(path: str, word: str, count: int) -> bool:
    """Whether the first line with data has this number of columns, of numbers or with the heading of such a file."""
    units.check_path(word, path)
    with units.open_file(word, path) as lines:
        texts = next((texts for _, texts in columns.rows(lines)), [])
    named = texts == HEADING or (len(texts) == 1 and texts[0] in delay_table.HEADINGS)
    return len(texts) == count and (named or all(map(columns.is_number, texts)))


def _delays(path: str, every_ns: int, lines: Iterable[str]) -> ConditionTrace:
    delays_ns = delay_table.delays(path, "csv", lines)
    times_ns = tuple(number * every_ns for number in range(len(delays_ns)))
    return ConditionTrace(path, times_ns, tuple(delays_ns), (0.0,) * len(delays_ns), every_ns)


def _load(word: str, path: str, read: Callable[[Iterable[str]], _Trace]) -> _Trace:
    units.check_path(word, path)
    try:
        with units.open_file(word, path) as lines:
            return read(lines)
    except csv.Error as error:
        raise ProfileError(word, path, "a text file") from error


def _opportunities(path: str, lines: Iterable[str]) -> Iterable[int]:
    last = 0
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not (text.isascii() and text.isdigit()) or len(text) > 12 or not last <= int(text) <= _MAX_MS:
            allowed = f"whole milliseconds from 0 to {_MAX_MS}, one per line, none less than the one above it"
            raise ProfileError(f"trace {units.format_path(path)}, line {number}", text[:40], allowed)
        last = int(text)
        yield last * _MS


def _conditions(path: str, lines: Iterable[str]) -> tuple[tuple[int, ...], tuple[int, ...], tuple[float, ...]]:
    rows = csv.reader(lines)
    heading = [name.strip() for name in next(rows, [])]
    if heading not in (["time_s", "delay_ms"], ["time_s", "delay_ms", "loss_percent"]):
        raise ProfileError(
            f"csv {units.format_path(path)}, line 1", ",".join(heading)[:80], "time_s,delay_ms,loss_percent"
        )
    times: list[int] = []
    delays: list[int] = []
    losses: list[float] = []
    for row in rows:
        word = f"csv {units.format_path(path)}, line {rows.line_num}"
        if not row:
            continue
        try:
            values = [Decimal(text.strip()) for text in row]
            time, delay, loss = values if len(heading) == 3 else (*values, Decimal(0))
        except (InvalidOperation, ValueError):
            raise ProfileError(word, ",".join(row)[:80], "a number in each column that line 1 names") from None
        if not all(value.is_finite() for value in values) or not abs(time) <= units.MAX_TIME_NS:
            raise ProfileError(word, ",".join(row)[:80], "finite numbers")
        if not 0 <= delay <= _MAX_MS or not 0 <= loss <= 100:
            raise ProfileError(word, ",".join(row)[:80], f"a delay from 0 to {_MAX_MS} ms, a loss from 0 to 100 %")
        times.append(int(time * 10**9))
        if len(times) > 1 and times[-1] <= times[-2]:
            raise ProfileError(word, ",".join(row)[:80], "a time greater than on the line above")
        delays.append(int(delay * _MS))
        losses.append(float(loss.scaleb(-2)))
    if not times:
        raise ProfileError(f"csv {units.format_path(path)}", "", "at least one line below line 1")
    return tuple(time - times[0] for time in times), tuple(delays), tuple(losses)
