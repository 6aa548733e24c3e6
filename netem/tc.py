"""The texts of Linux's ``tc``: the options of a netem qdisc, from a whole command or from ``tc qdisc show``.

tc prints each qdisc with its place (``qdisc netem 1: dev eth0 root refcnt 2``) before its options and, with ``-s``,
with its counters after them. It does not print which distribution a delay or a slot has (iproute2, ``tc/q_netem.c``).
"""

from __future__ import annotations

from netem import units
from netem.errors import ProfileError

_PLACE = {"dev": 1, "parent": 1, "refcnt": 1, "root": 0, "offloaded": 0, "ingress": 0}
"""The words that tc prints between a qdisc's handle and its options, and the number of their values."""

_COUNTERS = "Sent"


def options(text: str) -> str:
    """The options in a text that begins with ``tc`` or ``qdisc``; any other text unchanged.

    Raises ProfileError: it describes no netem qdisc, or several qdiscs.
    """
    words = text.split()
    if not is_of_tc(text):
        return text
    printed = words[0] == "qdisc"
    if "netem" not in words or (printed and words.count("qdisc") > 1):
        raise ProfileError("profile", " ".join(words)[:60], "the text of one qdisc, and that of netem")
    after = words[words.index("netem") + 1 :]
    if printed and after and after[0].endswith(":"):
        del after[0]
        while after and after[0] in _PLACE:
            del after[: 1 + _PLACE[after[0]]]
        if _COUNTERS in after:
            del after[after.index(_COUNTERS) :]
    return " ".join(after)


def full_word(word: str) -> str:
    """The word of an option: tc reads the beginning of a word too, in this order, and has two names for some."""
    word = next((name for name in _OPTIONS if word and name.startswith(word)), word)
    return _SAME.get(word, word)


_OPTIONS = (
    "limit", "latency", "delay", "loss", "drop", "seed", "ecn", "reorder", "corrupt", "gap", "duplicate",
    "distribution", "rate", "slot",
)  # fmt: skip
_SAME = {"latency": "delay", "drop": "loss"}


def is_of_tc(text: str) -> bool:
    """Whether a text is a command of tc, or printed by it, and not just a qdisc's options."""
    words = text.split(maxsplit=2)
    return words[:1] == ["qdisc"] or "tc" in words[:1] or words[:2] == ["sudo", "tc"]


def left_out(text: str) -> list[str]:
    """A sentence for each setting that tc did not print and that netem therefore has to assume."""
    words, out = options(text).split(), []
    if text.split()[:1] == ["qdisc"] and "delay" in words and "distribution" not in _before(words, "slot"):
        after = words[words.index("delay") + 1 :]
        if len(after) > 1 and units.is_number(after[1]):
            out.append("tc does not print the distribution of a delay; it is uniform here: add 'distribution NAME'")
    if "slot" in words and words[words.index("slot") + 1 :][:1] == ["distribution"]:
        after = words[words.index("slot") + 2 :]
        if after and units.is_number(after[0]):
            out.append(
                "tc does not print the distribution of a slot; it is uniform here: write 'slot distribution NAME ...'"
            )
    return out


def _before(words: list[str], word: str) -> list[str]:
    return words[: words.index(word)] if word in words else words
