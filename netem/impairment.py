"""The base of a link's further impairments: the words, the parameters, and the action on a message."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Self

from netem.words import Words

if TYPE_CHECKING:  # a profile needs no numpy
    from numpy.random import Generator

Acting = Callable[[int, int], int | None]
"""Called once for each message that reaches it, with the time [ns] and the message's size in bytes (0: not known).

It returns the delay that it adds [ns], 0 or above; None: the message is lost.
"""


Twice = Callable[[], bool]
"""Called once for each message, before all effects; it returns whether the message is offered twice."""


class Impairment(ABC):
    """An impairment in a profile, with its parameters: a frozen dataclass, so that profiles can be compared."""

    @classmethod
    def word(cls) -> str:
        """The word in a profile: the name of its file."""
        return cls.__module__.rpartition(".")[2]

    @classmethod
    @abstractmethod
    def read(cls, words: Words) -> Self:
        """Read the values after its word. Raises ProfileError."""

    @abstractmethod
    def __str__(self) -> str:
        """Its word, and the values that `read` reads."""

    @abstractmethod
    def acting(self, rng: Generator) -> Acting:
        """Return its action on messages, with draws of its own."""

    def twice(self, rng: Generator) -> Twice | None:
        """Return its decision which messages are offered twice, with the same draws as `acting`; None: none are."""
        return None

    @property
    def copies(self) -> float:
        """The long-run share of messages that it offers twice."""
        return 0.0

    @abstractmethod
    def expected(self) -> tuple[float, float, float]:
        """The long-run share of messages that it loses, and mean and standard deviation of the delay it adds [ns]."""
