"""``duplicate P [C]``: a message is offered twice, as in tc-netem."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING

from netem import units
from netem.effects import check_fraction, fractions
from netem.impairment import Acting, Impairment, Twice
from netem.words import Words

if TYPE_CHECKING:  # a profile needs no numpy
    from numpy.random import Generator


@dataclass(frozen=True, slots=True)
class Duplicate(Impairment):
    """Each message is offered twice with `probability`; `correlation` is that of successive decisions."""

    probability: float
    correlation: float = 0.0

    def __post_init__(self) -> None:
        check_fraction("duplicate", self.probability)
        check_fraction("duplicate correlation", self.correlation)

    @classmethod
    def read(cls, words: Words) -> Duplicate:
        return cls(*words.numbers("duplicate", units.parse_fraction, 1, 2))

    def __str__(self) -> str:
        return f"duplicate {fractions(self.probability, self.correlation or None)}"

    def acting(self, rng: Generator) -> Acting:
        return lambda now_ns, size: 0

    def twice(self, rng: Generator) -> Twice:
        from netem.models import decisions

        blocks = decisions(rng, self.probability, self.correlation)
        return chain.from_iterable(block.tolist() for block in blocks).__next__

    def expected(self) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0

    @property
    def copies(self) -> float:
        return self.probability
