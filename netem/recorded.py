"""Finds out which kind of recorded link a file is, so that a file's name alone can stand in a profile."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable

from netem import columns, units
from netem.delay_table import HEADINGS
from netem.errors import ProfileError
from netem.files import read_once
from netem.rate_trace import HEADING

_KINDS = (
    "a file of one kind: mahimahi's trace (whole ms, never less than above), 'seconds Mbit/s', a heading "
    "time_s,delay_ms[,loss_percent], one delay in ms per line, or iproute2's .dist"
)


def is_file(text: str) -> bool:
    """Whether a word of a profile is the name of a file that is there."""
    return os.path.isfile(text)


def table(name: str) -> str | None:
    """The file of a distribution: `name` itself, or the ``.dist`` that tc on this machine has under this name."""
    if is_file(name) or "/" in name:
        return name if is_file(name) else None
    places = ["/usr/lib/tc", "/usr/lib64/tc", "/usr/share/tc", *glob.glob("/usr/lib/*-linux-gnu/tc")]
    return next((file for place in places if is_file(file := f"{place}/{name}.dist")), None)


@read_once
def kind_of(path: str) -> tuple[str, str]:
    """The word of a profile that reads this file, and a sentence that says what it is read as.

    Raises ProfileError: it cannot be read, or its first line is of no kind.
    """
    name = units.format_path(path)
    if path.endswith(".dist"):
        return "distribution", f"{name} is a table of iproute2 ('distribution {name}'), for a delay with jitter"
    with units.open_file("profile", path) as lines:
        rows = list(columns.rows(lines))
    row = rows[0] if rows else (1, [""])
    first = row[1]
    if first[0] == "time_s" and first != HEADING:
        return "csv", f"{name} has delays and losses over time ('csv {name}')"
    if first == HEADING or (len(first) == 2 and all(map(columns.is_number, first))):
        return "trace", f"{name} has seconds and Mbit/s ('trace {name}'): each rate holds until the next time"
    named = first[0] in HEADINGS
    if len(first) == 1 and not named and _are_opportunities(texts for _, texts in rows):
        return "trace", (
            f"{name} has the times in ms at which 1500 bytes can pass, as mahimahi's traces ('trace {name}'); if these "
            f"are delays, write 'csv {name}' or 'distribution {name}'"
        )
    if len(first) == 1 and (named or columns.is_number(first[0])):
        return "csv", (
            f"{name} has one delay per line, in their order, one every 10 ms ('csv {name} every 10ms'); 'distribution "
            f"{name}' draws them at random"
        )
    raise ProfileError(f"{name}, line {row[0]}", " ".join(first)[:40], _KINDS)


def _are_opportunities(rows: Iterable[list[str]]) -> bool:
    """Whether the lines that are numbers are whole and never less than the one above; the last is above 0."""
    last = 0
    for texts in rows:
        if columns.is_number(texts[0]):
            if not (texts[0].isascii() and texts[0].isdigit()) or len(texts[0]) > 12 or int(texts[0]) < last:
                return False
            last = int(texts[0])
    return last > 0
