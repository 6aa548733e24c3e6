"""``distribution FILE``: a distribution of one's own, from measured delays or from a table of iproute2."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from decimal import Decimal

from netem import columns, units
from netem.errors import ProfileError
from netem.files import read_once

TABLE_ONE = 8192
"""The jitter in the units of iproute2's tables (NETEM_DIST_SCALE)."""

_NS = {"delay_s": 10**9, "delay_ms": 10**6, "delay_us": 10**3}
_MOST = {unit: units.MAX_TIME_NS // scale for unit, scale in _NS.items()}
HEADINGS = tuple(_NS)
"""The heading of a file with one delay per line, by its unit."""


@dataclass(frozen=True, slots=True)
class DelayTable:
    """A distribution as equally likely values in units of the jitter, ascending; 0 is the delay.

    A file whose name ends in ``.dist`` is a table as tc reads it: whole numbers from -32768 to 32767, several per line,
    8192 for the jitter. Any other file has one measured delay per line, in ms, or in the unit that line 1 names
    (``delay_s``, ``delay_ms``, ``delay_us``). Then the values have mean 0 and standard deviation 1, and `mean_ns` and
    `std_ns` are those of the delays; in a table of iproute2 both are 0.
    """

    path: str
    values: tuple[float, ...] = field(repr=False)
    mean_ns: int = 0
    std_ns: int = 0

    def __post_init__(self) -> None:
        units.check_path("distribution", self.path)
        if not self.values:
            raise ProfileError("distribution", self.path, "a file with at least one value")

    def __str__(self) -> str:
        return units.format_path(self.path)

    @classmethod
    def load(cls, path: str) -> DelayTable:
        """Read a file. Raises ProfileError: it cannot be read, or a line is malformed; it names the line."""
        return _table(path)


@read_once
def _table(path: str) -> DelayTable:
    units.check_path("distribution", path)
    with units.open_file("distribution", path, "uniform, normal, pareto, paretonormal, or ") as lines:
        return DelayTable(path, _scaled(path, lines)) if path.endswith(".dist") else _measured(path, lines)


def _scaled(path: str, lines: Iterable[str]) -> tuple[float, ...]:
    allowed = "whole numbers from -32768 to 32767, as in iproute2's .dist"
    entries: list[float] = []
    for row in columns.rows(lines):
        for value in columns.numbers("distribution", path, row, -(2**15), 2**15 - 1, allowed):
            if value != int(value):
                raise columns.refused("distribution", path, row, allowed)
            entries.append(int(value) / TABLE_ONE)
    return tuple(sorted(entries))


def _measured(path: str, lines: Iterable[str]) -> DelayTable:
    delays_ns = sorted(delays(path, "distribution", lines))
    if not delays_ns:
        raise ProfileError(f"distribution {units.format_path(path)}", "", "at least one line with a delay")
    mean = math.fsum(delays_ns) / len(delays_ns)
    std = math.sqrt(math.fsum((delay - mean) ** 2 for delay in delays_ns) / len(delays_ns))
    # in units of the jitter's whole ns, so that the same jitter gives the same delays
    jitter_ns = round(std)
    values = tuple((delay - mean) / (jitter_ns or 1) for delay in delays_ns)
    return DelayTable(path, values, round(mean), jitter_ns)


def delays(path: str, word: str, lines: Iterable[str]) -> list[int]:
    """The delays [ns] of a file with one per line; `word` is the word of the profile, for errors."""
    unit, out = "delay_ms", list[int]()
    for row in columns.rows(lines):
        texts = row[1]
        if not out and len(texts) == 1 and texts[0] in _NS:
            unit = texts[0]
            continue
        allowed = (
            f"one delay per line, {unit} from 0 to {_MOST[unit]} (line 1 may name another unit: {', '.join(HEADINGS)})"
        )
        if len(texts) > 1:
            raise columns.refused(word, path, row, allowed)
        value: Decimal = columns.numbers(word, path, row, 0, _MOST[unit], allowed)[0]
        out.append(int(value * _NS[unit]))
    return out
