"""A link's random streams: each effect has its own, so that changing one effect does not change the others' draws."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain, islice, repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.typing import NDArray

from netem import models
from netem.impairment import Acting, Twice
from netem.profile import LinkProfile

_FIELDS = {
    "delay": ("delay_ns", "jitter_ns", "delay_correlation", "distribution"),
    "loss": ("loss",),
    "corrupt": ("corrupt", "corrupt_correlation"),
    "reorder": ("reorder", "reorder_correlation"),
    "slot": ("slot",),
}
# Appended to the seed's spawn key, so that no stream equals one that the caller spawns from the same seed. Append new
# streams at the end, so that the others do not change.
_STREAM_KEYS = {name: (0x6E6574656D, index) for index, name in enumerate((*_FIELDS, "bit", "csv", "resend"))}

_OTHERS = (0x6E6574656D, 0x6F74686572)
"""The start of the key of a further impairment's stream, before the letters of its word."""


class Fates(NamedTuple):
    """The draws of several messages, one element per message.

    lost : whether it is lost at its first offer. ahead : whether it may be sent ahead. delay_ns : its delay.
    luck : the draw in [0, 1) that decides how many of its resends are lost.
    """

    lost: NDArray[np.bool_]
    ahead: NDArray[np.bool_]
    delay_ns: NDArray[np.int64]
    luck: NDArray[np.float64]


class Draws:
    """The draws of one effect: `each` yields them one by one, `many` returns arrays.

    `before` : number of messages offered before the first draw.
    """

    def __init__(self, blocks: Iterator[NDArray[Any]], before: int) -> None:
        self._blocks, self._before = blocks, before
        self.each = chain.from_iterable(block.tolist() for block in blocks)

    def many(self, taken: int, count: int) -> NDArray[Any]:
        """The next `count` draws; `taken` messages already have their draws."""
        parts = []
        while count:
            left = (self._before - taken) % models.BLOCK  # draws left in the current block
            whole = not left and count >= models.BLOCK
            parts.append(next(self._blocks) if whole else np.array(list(islice(self.each, min(left or count, count)))))
            taken, count = taken + len(parts[-1]), count - len(parts[-1])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


class Streams:
    """A link's draws, one stream per effect. A seed in the profile replaces `seed`.

    Attributes
    ----------
    others : the further impairments' actions on a message. twice : their decisions which messages are offered twice.
    next : for the next message: whether it is lost, corrupted, and may be sent ahead, its delay [ns], its luck (see
        `Fates`). next_bit : which bit of a corrupted message is flipped, in [0, 1). next_chance : the draw in [0, 1)
        that is compared with the loss of a trace of conditions. next_slot : the time to the next slot [ns], if the
        profile has slots.
    """

    next: Callable[[], tuple[bool, bool, bool, int, float]]
    next_bit: Callable[[], float]
    next_chance: Callable[[], float]
    next_slot: Callable[[], int]

    def __init__(self, seed: SeedSequence) -> None:
        self._seed = seed
        self._profile: LinkProfile | None = None
        self._profile_seed: int | None = None
        self._generators: dict[str, Generator] = {}
        self.others: tuple[Acting, ...] = ()
        self.twice: tuple[Twice, ...] = ()
        self._draws: dict[str, Draws] = {}

    def configure(self, profile: LinkProfile, offered: int) -> set[str]:
        """Draw for `profile` from now on; `offered` messages already have their draws. Returns the changed effects.

        Effects with unchanged settings keep their streams; the others continue their streams with the new settings.
        """
        previous = self._profile
        if previous is None or profile.seed not in (None, self._profile_seed):
            previous = None
            self._profile_seed = profile.seed
            self._generators = generators(self._seed, profile.seed)
            self.next_bit = Draws(models.fractions(self._generators["bit"]), 0).each.__next__
            self.next_chance = Draws(models.fractions(self._generators["csv"]), 0).each.__next__
        self._profile = profile
        if previous is None or profile.others != previous.others:
            self.others = tuple([each.acting(self._of(each.word())) for each in profile.others])
            decisions = [each.twice(self._of(each.word())) for each in profile.others]
            self.twice = tuple([each for each in decisions if each is not None])
        new = {effect for effect in _FIELDS if _changed(effect, profile, previous)}
        if previous is None or (profile.resend is None) != (previous.resend is None):
            new.add("resend")
        for effect in new - {"slot"}:
            self._draws[effect] = Draws(_blocks(effect, self._generators[effect], profile), offered)
        if profile.slot is not None and "slot" in new:
            self.next_slot = Draws(models.slot_intervals(self._generators["slot"], profile.slot), 0).each.__next__
        each = [self._draws[effect].each for effect in ("loss", "corrupt", "reorder", "delay", "resend")]
        self.next = zip(*each, strict=False).__next__
        return new

    def _of(self, word: str) -> Generator:
        """The generator of a further impairment, which goes on when the impairment's parameters change."""
        if word not in self._generators:
            self._generators[word] = _generator(self._seed, self._profile_seed, (*_OTHERS, *word.encode()))
        return self._generators[word]

    def many(self, taken: int, count: int) -> Fates:
        """The draws of the next `count` messages; `taken` messages already have their draws."""
        return Fates(*(self._draws[effect].many(taken, count) for effect in ("loss", "reorder", "delay", "resend")))

    def put_back(self, fates: Fates) -> None:
        """Use these draws again for the next messages."""
        lost, ahead, delay_ns, luck = (values.tolist() for values in fates)
        back = zip(lost, repeat(False), ahead, delay_ns, luck, strict=False)
        self.next = chain(back, iter(self.next, None)).__next__


def _blocks(effect: str, rng: Generator, profile: LinkProfile) -> Iterator[NDArray[Any]]:
    match effect:
        case "delay":
            return models.delays(rng, profile)
        case "loss":
            return models.losses(rng, profile.loss)
        case "corrupt":
            return models.decisions(rng, profile.corrupt, profile.corrupt_correlation)
        case "reorder":
            return models.decisions(rng, profile.reorder, profile.reorder_correlation)
    return repeat(np.zeros(models.BLOCK)) if profile.resend is None else models.fractions(rng)


def _changed(effect: str, profile: LinkProfile, previous: LinkProfile | None) -> bool:
    """Whether this effect's settings change."""
    return previous is None or any(getattr(profile, name) != getattr(previous, name) for name in _FIELDS[effect])


def generators(seed: SeedSequence, profile_seed: int | None) -> dict[str, Generator]:
    """The generator of each stream; a seed in the profile replaces the entropy of `seed`."""
    return {name: _generator(seed, profile_seed, key) for name, key in _STREAM_KEYS.items()}


def _generator(seed: SeedSequence, profile_seed: int | None, key: tuple[int, ...]) -> Generator:
    entropy = seed.entropy if profile_seed is None else profile_seed
    return Generator(PCG64(SeedSequence(entropy, spawn_key=(*seed.spawn_key, *key))))
