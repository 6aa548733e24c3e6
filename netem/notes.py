"""The assumptions that netem makes in reading the text of a link, as sentences for its user."""

from __future__ import annotations

from netem import recorded, tc, units
from netem.impairments import IMPAIRMENTS
from netem.presets import ALIASES, PRESETS
from netem.profile import WORDS


def notes(text: str) -> list[str]:
    """A sentence for each thing that netem assumes in reading the text of a profile. The text was read before."""
    if text in PRESETS or text in ALIASES:
        return []
    words = units.split_words(tc.options(text))
    files = [
        word
        for before, word in zip(("", *words), words, strict=False)
        if word not in WORDS and word not in IMPAIRMENTS and before not in _NAMING and recorded.is_file(word)
    ]
    return [*tc.left_out(text), *(recorded.kind_of(path)[1] for path in files)]


_NAMING = ("trace", "csv", "distribution")
"""The words that a file's name may follow."""
