"""The errors that netem raises: one root; every message names the wrong word and what is allowed."""

from __future__ import annotations


class NetemError(ValueError):
    """Root of all errors that netem raises on purpose."""


class ProfileError(NetemError):
    """A value in a link profile is not allowed.

    Parameters
    ----------
    word : the word of the profile, as its user knows it (``"delay"``, ``"loss gemodel"``).
    value : the value given.
    allowed : a text that says what is allowed.
    """

    def __init__(self, word: str, value: object, allowed: str) -> None:
        self.word, self.value, self.allowed = word, value, allowed
        super().__init__(f"{word}: {value!r} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[ProfileError], tuple[str, object, str]]:
        return type(self), (self.word, self.value, self.allowed)
