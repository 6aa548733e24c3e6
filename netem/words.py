"""The words of a profile, taken one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

    def put_back(self) -> None:
        """Let the word that was taken last be taken again."""
        self._next -= 1

    def numbers(self, word: str, read: Callable[[str, str], Any], low: int, high: int) -> list[Any]:
        """Read at least `low` values with `read`, and up to `high` while numbers follow."""
        out: list[Any] = []
        while len(out) < low or (len(out) < high and self.number_follows()):
            out.append(read(word, self.take(word)))
        return out

    def labelled(self, word: str, read: Callable[[str, str], Any], labels: Sequence[str]) -> list[Any]:
        """Read up to one value for each label, at least one; each may stand after its label, as tc prints it."""
        out: list[Any] = []
        for label in labels:
            named = self.take_if(label)
            if out and not named and not self.number_follows():
                break
            out.append(read(f"{word} {label}" if named else word, self.take(word)))
        return out

    def number_follows(self) -> bool:
        """Whether the next word is a number, perhaps with a unit."""
        return not self.at_end() and units.is_number(self._words[self._next])
