"""The base of a link's further impairments: the words, the parameters, and what happens to a message."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from netem.words import Words

if TYPE_CHECKING:  # a profile needs no numpy
    from numpy.random import Generator

Acting = Callable[[int, int], int | None]
"""Asked once for each message that reaches it, with the time [ns] and the message's size in bytes (0: not known).

The delay that it adds [ns], 0 or above; None: the message is lost.
"""


Twice = Callable[[], bool]
"""Asked once for each message, before all else: is it offered twice?"""


class Impairment(ABC):
    """An impairment with its parameters, as a profile has it: a frozen dataclass, so that profiles compare."""

    @classmethod
    def word(cls) -> str:
        """The word in a profile: the name of its file."""
        return cls.__module__.rpartition(".")[2]

    @classmethod
    @abstractmethod
    def read(cls, words: Words) -> Self:
        """From what stands behind its word. Raises ProfileError."""

    @abstractmethod
    def __str__(self) -> str:
        """Its word and what stands behind: what `read` reads."""

    @abstractmethod
    def acting(self, rng: Generator) -> Acting:
        """Return its action on messages, with draws of its own."""

    def twice(self, rng: Generator) -> Twice | None:
        """Which messages it offers twice, with the same draws as `acting`; None: it never does."""
        return None

    @property
    def copies(self) -> float:
        """In the long run: the share of messages that it offers twice."""
        return 0.0

    @abstractmethod
    def expected(self) -> tuple[float, float, float]:
        """In the long run: the share that it loses, and mean and standard deviation of the delay that it adds [ns]."""
