"""What netem raises: one root, and every message names the offending word and what is allowed."""

from __future__ import annotations


class NetemError(ValueError):
    """Root of all errors that netem raises on purpose."""


class ProfileError(NetemError):
    """A link profile says something that cannot be.

    Parameters
    ----------
    word : the word of the profile, as its user knows it (``"delay"``, ``"loss gemodel"``).
    value : what was given.
    allowed : what would have been accepted, in words.
    """

    def __init__(self, word: str, value: object, allowed: str) -> None:
        self.word, self.value, self.allowed = word, value, allowed
        super().__init__(f"{word}: {value!r} is not allowed; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[ProfileError], tuple[str, object, str]]:
        return type(self), (self.word, self.value, self.allowed)
