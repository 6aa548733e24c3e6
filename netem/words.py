"""The words of a profile, taken one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from netem import units
from netem.errors import ProfileError


class Words:
    """A cursor over the words of a profile."""

    def __init__(self, text: str) -> None:
        self._words = units.split_words(text)
        self._next = 0

    def at_end(self) -> bool:
        return self._next == len(self._words)

    def take(self, after: str) -> str:
        if self.at_end():
            raise ProfileError(after, "", f"a value after {after}")
        self._next += 1
        return self._words[self._next - 1]

    def take_if(self, *words: str) -> str:
        """The next word if it is one of `words`, else the empty string."""
        return self.take("") if not self.at_end() and self._words[self._next] in words else ""

    def numbers(self, word: str, read: Callable[[str, str], Any], low: int, high: int) -> list[Any]:
        """Read at least `low` values with `read`, and up to `high` while numbers follow."""
        out: list[Any] = []
        while len(out) < low or (len(out) < high and not self.at_end() and units.is_number(self._words[self._next])):
            out.append(read(word, self.take(word)))
        return out
