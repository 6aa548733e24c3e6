"""A link's random streams: each effect has its own, so that changing one leaves the others' draws as they were."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.typing import NDArray

from netem import models
from netem.profile import LinkProfile

_FIELDS = {
    "delay": ("delay_ns", "jitter_ns", "delay_correlation", "distribution"),
    "loss": ("loss",),
    "corrupt": ("corrupt", "corrupt_correlation"),
    "reorder": ("reorder", "reorder_correlation"),
    "slot": ("slot",),
}
# appended to the seed's spawn key, so that no stream is also one of the caller's own children of the same seed; a new
# one goes to the end, for the others to stay what they are
_STREAM_KEYS = {name: (0x6E6574656D, index) for index, name in enumerate((*_FIELDS, "bit", "csv", "resend"))}


class Fates(NamedTuple):
    """What becomes of messages, an element each.

    Is it lost when it is first offered, may it go ahead of the others, its delay [ns], and the draw in [0, 1) that says
    how many of its resends are lost.
    """

    lost: NDArray[np.bool_]
    ahead: NDArray[np.bool_]
    delay_ns: NDArray[np.int64]
    luck: NDArray[np.float64]


class Draws:
    """One effect's draws: `each` gives them one by one, `many` in arrays.

    `before` : how many messages were offered before the first.
    """

    def __init__(self, blocks: Iterator[NDArray[Any]], before: int) -> None:
        self._blocks, self._before = blocks, before
        self.each = chain.from_iterable(block.tolist() for block in blocks)

    def many(self, taken: int, count: int) -> NDArray[Any]:
        """The next `count`, when `taken` messages have had theirs."""
        parts = []
        while count:
            left = (self._before - taken) % models.BLOCK  # of a block that was begun
            whole = not left and count >= models.BLOCK
            parts.append(next(self._blocks) if whole else np.array(list(islice(self.each, min(left or count, count)))))
            taken, count = taken + len(parts[-1]), count - len(parts[-1])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def changed(effect: str, profile: LinkProfile, previous: LinkProfile | None) -> bool:
    """Does this effect get other settings?"""
    return previous is None or any(getattr(profile, name) != getattr(previous, name) for name in _FIELDS[effect])


def generators(seed: SeedSequence, profile_seed: int | None) -> dict[str, Generator]:
    """The generator of each stream; a seed in the profile takes the place of the other's."""
    entropy = seed.entropy if profile_seed is None else profile_seed
    return {
        name: Generator(PCG64(SeedSequence(entropy, spawn_key=(*seed.spawn_key, *key))))
        for name, key in _STREAM_KEYS.items()
    }
