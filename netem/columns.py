"""Files of numbers in columns, as people keep what they measured; blank lines and comments (``#``) are skipped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation

from netem import units
from netem.errors import ProfileError

_BETWEEN = re.compile(r"\s*[,;]\s*|\s+")


def rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Each line with data as its number, from 1, and its texts, which commas, semicolons or spaces separate."""
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        if text:
            yield number, _BETWEEN.split(text)


def numbers(word: str, path: str, row: tuple[int, list[str]], low: int, high: int, allowed: str) -> list[Decimal]:
    """The numbers of a row, each in [low, high]. Raises ProfileError, which names the line, with `allowed`."""
    try:
        values = [Decimal(text) for text in row[1]]
    except InvalidOperation:
        values = []
    if not values or not all(value.is_finite() and low <= value <= high for value in values):
        raise refused(word, path, row, allowed)
    return values


def refused(word: str, path: str, row: tuple[int, list[str]], allowed: str) -> ProfileError:
    """The error that names the line of a row."""
    return ProfileError(f"{word} {units.format_path(path)}, line {row[0]}", " ".join(row[1])[:40], allowed)


def is_number(text: str) -> bool:
    """Whether a text is a finite number."""
    try:
        return Decimal(text).is_finite()
    except InvalidOperation:
        return False
