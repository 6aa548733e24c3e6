"""Times, rates and percentages as tc writes them, and file names: exact conversion of text to values and back."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from typing import TextIO

from netem.errors import ProfileError

MAX_TIME_NS = 10**14  # 100,000 s; keeps jitter times table entry within 64 bits
MAX_RATE_BIT_S = 10**15
LARGEST_FILE = 64 << 20  # of a recorded link [bytes]

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)([a-z%]*)", re.IGNORECASE)
_WORD = re.compile(r'(?:"[^"]*"|[^\s"]|")+')
_TIME_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_TIME_ALIASES = {"sec": "s", "secs": "s", "msec": "ms", "msecs": "ms", "usec": "us", "usecs": "us"}
_TIME_ALIASES |= {"nsec": "ns", "nsecs": "ns"}
_RATE_BIT_S = {"": 1, "bit": 1, "bps": 8}
for _power, _letter in enumerate("kmgt", start=1):
    _RATE_BIT_S |= {f"{_letter}bit": 1000**_power, f"{_letter}ibit": 1024**_power}
    _RATE_BIT_S |= {f"{_letter}bps": 8 * 1000**_power, f"{_letter}ibps": 8 * 1024**_power}


def is_number(text: str) -> bool:
    """Whether tc would read `text` as the next optional number (and not as the next word)."""
    return text.lstrip("+-.")[:1].isdigit()


def parse_time(word: str, text: str, bare: str = "") -> int:
    """Time in whole ns, truncated as tc does, 0 to 100,000 s. bare : the unit of a number without one.

    Without `bare`, a unit is required (except for 0): tc's manual page reads a bare number as microseconds, its code as
    nanoseconds.
    """
    allowed = "a time with its unit (s, ms, us, ns), 0 to 100000s, such as 40ms"
    number, unit = _split(word, text, allowed)
    unit = _TIME_ALIASES.get(unit, unit) or bare
    if unit == "" and number == 0:
        return 0
    if unit not in _TIME_NS or not 0 <= (ns := number * _TIME_NS[unit]) <= MAX_TIME_NS:
        raise ProfileError(word, text, allowed)
    return int(ns)


def format_time(ns: int) -> str:
    """The shortest exact text of a time; ``parse_time`` returns the same ns."""
    unit = next((u for u, scale in _TIME_NS.items() if ns >= scale), "ms")
    return _plain(Decimal(ns) / _TIME_NS[unit]) + unit


def parse_fraction(word: str, text: str) -> float:
    """A percentage (with or without its sign, as in tc) as a fraction in [0, 1]."""
    allowed = "a percentage, 0% to 100%"
    number, unit = _split(word, text, allowed)
    if unit not in ("", "%") or not 0 <= number <= 100:
        raise ProfileError(word, text, allowed)
    return float(number.scaleb(-2))


def format_fraction(fraction: float) -> str:
    """The shortest percentage that ``parse_fraction`` reads as exactly this float."""
    return _plain(Decimal(repr(float(fraction))).scaleb(2)) + "%"


def parse_rate(word: str, text: str) -> int:
    """Rate in bit/s, with tc's suffixes: ``bit`` and a bare number mean bits, ``bps`` bytes."""
    allowed = "a rate such as 1mbit, 500kbit (bits per second) or 60kbps (bytes per second); a bare 0 for no limit"
    number, unit = _split(word, text, allowed)
    if unit not in _RATE_BIT_S or not 0 <= (rate := number * _RATE_BIT_S[unit]) <= MAX_RATE_BIT_S:
        raise ProfileError(word, text, allowed)
    if 0 < rate < 1 or (unit and not rate):  # a rate of 0 would let nothing pass, and not everything
        raise ProfileError(word, text, allowed)
    return int(rate)


def format_rate(bit_s: int) -> str:
    """The shortest exact text of a rate in bit/s; 0 is no limit."""
    if not bit_s:
        return "0"
    unit = next((u for u in ("tbit", "gbit", "mbit", "kbit") if bit_s >= _RATE_BIT_S[u]), "bit")
    return _plain(Decimal(bit_s) / _RATE_BIT_S[unit]) + unit


def parse_int(word: str, text: str, low: int, high: int = 2**63 - 1) -> int:
    """A whole number in [low, high]."""
    if not re.fullmatch(r"[+-]?\d{1,20}", text, re.ASCII) or not low <= int(text) <= high:
        raise ProfileError(word, text, f"a whole number from {low} to {high}")
    return int(text)


def parse_size(word: str, text: str, low: int = 1, high: int = 2**53) -> int:
    """A size in whole bytes, in [low, high], with tc's suffixes: ``b`` or none; ``k``, ``kb``, ``m`` ... by 1024."""
    allowed = f"a size in bytes from {low} to {high}, such as 15000, 64kb or 1mb (1024 kb)"
    number, unit = _split(word, text, allowed)
    scale = {"": 0, "k": 1, "m": 2, "g": 3}.get(unit.removesuffix("b"))
    if scale is None or not low <= (size := number * 1024**scale) <= high:
        raise ProfileError(word, text, allowed)
    return int(size)


def split_words(text: str) -> list[str]:
    """The words of a text. A word in double quotes may contain spaces; it is returned without the quotes.

    Raises ProfileError: a quote has no partner, or is inside a word.
    """
    words = _WORD.findall(text)
    for word in words:
        if '"' in word and not (len(word) > 1 and word[0] == word[-1] == '"' and word.count('"') == 2):
            raise ProfileError("profile", word, "words, and file names in double quotes")
    return [word.strip('"') for word in words]


def format_path(path: str) -> str:
    """A file's name as one word: in double quotes if needed."""
    return f'"{path}"' if any(c.isspace() or c in ";#" for c in path) else path


def check_path(word: str, path: str) -> None:
    """Raise ProfileError unless `path` can be written as one word."""
    if not path or '"' in path or not path.isprintable():
        raise ProfileError(word, path, "a file's name without double quotes or line breaks")


@contextmanager
def open_file(word: str, path: str, allowed: str = "") -> Iterator[TextIO]:
    """Open a text file for reading. A pipe or a device is refused, because reading it may never end.

    Raises ProfileError: it cannot be read, or is not text. allowed : what else is allowed in its place.
    """
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            raise ProfileError(word, path, f"{allowed}a plain file, not a pipe, device or directory")
        if status.st_size > LARGEST_FILE:
            raise ProfileError(word, path, f"{allowed}a file of {LARGEST_FILE >> 20} MB at most")
        with open(path, encoding="utf-8-sig", newline="") as file:
            yield file
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text"
        raise ProfileError(word, path, f"{allowed}a readable text file ({reason})") from error


def _split(word: str, text: str, allowed: str) -> tuple[Decimal, str]:
    match = _NUMBER.fullmatch(text) if text.isascii() else None
    if match is None:
        raise ProfileError(word, text, allowed)
    return Decimal(match[1]), match[2].lower()


def _plain(number: Decimal) -> str:
    text = f"{number:f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
