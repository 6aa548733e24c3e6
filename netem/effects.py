"""The parts of a profile with several values: loss models and slots, in tc-netem's syntax, and resends."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from netem import units
from netem.delay_table import DelayTable
from netem.errors import ProfileError

DISTRIBUTIONS = ("uniform", "normal", "pareto", "paretonormal")
MOST_RESENDS = 100


@dataclass(frozen=True, slots=True)
class RandomLoss:
    """``loss [random] P [C]``: each message is lost with `probability`; `correlation` is that of successive losses."""

    probability: float
    correlation: float = 0.0

    def __post_init__(self) -> None:
        check_fractions("loss random", self)

    def __str__(self) -> str:
        return "loss " + fractions(self.probability, self.correlation or None)


@dataclass(frozen=True, slots=True)
class FourStateLoss:
    """``loss state P13 [P31 [P32 [P23 [P14]]]]``: Salsano's four-state Markov chain, one transition per message.

    States: 1 received in a gap, 2 received in a burst, 3 lost in a burst, 4 lost alone (always followed by 1). `pXY` is
    the probability of a transition from X to Y; tc's defaults are P31 = 1 - P13, P32 = 0, P23 = 1, P14 = 0.
    """

    p13: float
    p31: float
    p32: float = 0.0
    p23: float = 1.0
    p14: float = 0.0

    def __post_init__(self) -> None:
        check_fractions("loss state", self)
        for first, second in (("p13", "p14"), ("p31", "p32")):
            total = getattr(self, first) + getattr(self, second)
            if total > 1.0 + 1e-12:
                raise ProfileError(f"loss state {first} + {second}", total, "a sum of at most 100%")

    def __str__(self) -> str:
        return "loss state " + fractions(self.p13, self.p31, self.p32, self.p23, self.p14)


@dataclass(frozen=True, slots=True)
class GilbertElliottLoss:
    """``loss gemodel P [R [1-H [1-K]]]``: two states, good and bad; each message is lost with its state's probability.

    Per message, `p` is the probability of the transition from good to bad and `r` from bad to good. `bad_loss` (1-H)
    and `good_loss` (1-K) are the loss probabilities in each state. tc's defaults are R = 1 - P, 1-H = 100 %, 1-K = 0.
    """

    p: float
    r: float
    bad_loss: float = 1.0
    good_loss: float = 0.0

    def __post_init__(self) -> None:
        check_fractions("loss gemodel", self)

    def __str__(self) -> str:
        return "loss gemodel " + fractions(self.p, self.r, self.bad_loss, self.good_loss)


Loss = RandomLoss | FourStateLoss | GilbertElliottLoss


@dataclass(frozen=True, slots=True)
class Resend:
    """``resend N TIME [unordered]``: a lost message is offered again after `after_ns`, up to `times` times.

    Ordered, as link layers deliver: later messages wait until the lost one has come through or is given up, which is
    `times` resends after its loss, and none arrives before an earlier one, whatever the jitter. Unordered: none waits.
    """

    times: int
    after_ns: int
    ordered: bool = True

    def __post_init__(self) -> None:
        check_int("resend", self.times, 1, MOST_RESENDS)
        check_int("resend after", self.after_ns, 0, units.MAX_TIME_NS // MOST_RESENDS)

    def __str__(self) -> str:
        return f"resend {self.times} {units.format_time(self.after_ns)}" + ("" if self.ordered else " unordered")


@dataclass(frozen=True, slots=True)
class Slot:
    """``slot MIN [MAX]`` or ``slot distribution NAME|FILE DELAY JITTER``, then ``[packets N] [bytes N]``.

    The time between slots is uniform in [min_ns, max_ns]. With a `distribution`, min_ns is its DELAY and max_ns its
    JITTER. A slot lets at most `packets` packets and `bytes` bytes through (0: no limit).
    """

    min_ns: int
    max_ns: int
    distribution: str | DelayTable = ""
    packets: int = 0
    bytes: int = 0

    def __post_init__(self) -> None:
        for name in ("min_ns", "max_ns"):
            check_int(f"slot {name}", getattr(self, name), 0, units.MAX_TIME_NS)
        for name in ("packets", "bytes"):
            check_int(f"slot {name}", getattr(self, name), 0, 2**31 - 1)
        if self.distribution:
            check_distribution("slot distribution", self.distribution)
        elif self.max_ns < self.min_ns:
            raise ProfileError("slot", units.format_time(self.max_ns), "a maximum that is not below the minimum")

    def __str__(self) -> str:
        first, second = units.format_time(self.min_ns), units.format_time(self.max_ns)
        text = (
            f"slot distribution {self.distribution} {first} {second}" if self.distribution else f"slot {first} {second}"
        )
        text += f" packets {self.packets}" if self.packets else ""
        return text + (f" bytes {self.bytes}" if self.bytes else "")


def fractions(*values: float | None) -> str:
    """Percentages separated by spaces; None is left out."""
    return " ".join(units.format_fraction(v) for v in values if v is not None)


def check_fractions(word: str, model: Loss) -> None:
    """Raise ProfileError unless all fields of a loss model are in [0, 1]."""
    for field in dataclasses.fields(model):
        check_fraction(f"{word} {field.name}", getattr(model, field.name))


def check_fraction(word: str, value: float) -> None:
    """Raise ProfileError unless `value` is in [0, 1]."""
    if not 0.0 <= value <= 1.0:
        raise ProfileError(word, value, "a probability in [0, 1]")


def check_int(word: str, value: int, low: int, high: int) -> None:
    """Raise ProfileError unless `value` is a whole number in [low, high]."""
    if not isinstance(value, int) or not low <= value <= high:
        raise ProfileError(word, value, f"a whole number from {low} to {high}")


def check_distribution(word: str, value: str | DelayTable) -> None:
    """Raise ProfileError unless `value` is a table or the name of a distribution."""
    if isinstance(value, str) and value not in DISTRIBUTIONS:
        raise ProfileError(word, value, f"{', '.join(DISTRIBUTIONS)}, or a file that exists", DISTRIBUTIONS)
