"""The text of a solid: its kind, its file, and properties such as ``radius=20mm``, each given once."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)([a-z]*)", re.IGNORECASE | re.ASCII)


class Properties:
    """The properties of one solid; each is read once."""

    def __init__(self, spec: str, text: str) -> None:
        self.words = spec
        self.notes: list[str] = []
        """Notes on the solid for the user."""
        self._left: dict[str, str] = {}
        for entry in filter(None, text.split("&")):
            key, equals, value = entry.partition("=")
            if not equals or key in self._left:
                raise self.error(entry, "KEY=VALUE, each once")
            self._left[key.strip()] = value.strip()

    def error(self, value: object, allowed: str) -> InvalidParameter:
        return InvalidParameter(f"scene {self.words}", value, allowed)

    def text(self, key: str) -> str | None:
        return self._left.pop(key, None)

    def give_back(self, key: str, text: str) -> None:
        self._left[key] = text

    def numbers(self, key: str, default: Sequence[float], units: Mapping[str, float] | None = None) -> Vector:
        """The numbers of a property, as many as in `default`; in [m] with units."""
        if (text := self.text(key)) is None:
            return tuple(default)
        parts = text.split(",")
        values = [value_of(part.strip(), units) for part in parts]
        if len(parts) != len(default) or None in values:
            what = "a length with its unit, such as 20mm" if units else "a number"
            many = "" if len(default) == 1 else f"{len(default)} with commas, each "
            raise self.error(f"{key}={text}", f"{key}: {many}{what}")
        return tuple([value for value in values if value is not None])

    def lengths(self, key: str, default: Sequence[float]) -> Vector:
        return self.numbers(key, default, UNITS)

    def length(self, key: str, default: float) -> float:
        return self.lengths(key, (default,))[0]

    def number(self, key: str, default: float) -> float:
        return self.numbers(key, (default,))[0]

    def finish(self, words: str) -> None:
        """Raise InvalidParameter if an unread property is left; words : the help on the solid's properties."""
        if self._left:
            name, known = next(iter(self._left)), re.findall(r"(\w+)=", words)
            raise InvalidParameter(f"scene {self.words}: property", name, f"one of this solid: {words}", known)


def value_of(text: str, units: Mapping[str, float] | None) -> float | None:
    """The number in a text, in [m] with units; None: it is not a number."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    if not units or not float(match[1]):  # no unit is needed for 0
        return None if match[2] and match[2].lower() not in (units or ()) else float(match[1])
    scale = units.get(match[2].lower())
    return None if scale is None else float(match[1]) * scale


def kind_of(spec: str) -> tuple[str, str, str]:
    """Kind, file and properties."""
    head, _, text = spec.partition("?")
    name, _, file = head.strip().partition(":")
    return name, file, text
