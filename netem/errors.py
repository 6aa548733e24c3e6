"""The errors that netem raises: one root; every message names the wrong word and what is allowed."""

from __future__ import annotations

from collections.abc import Iterable


class NetemError(ValueError):
    """Root of all errors that netem raises on purpose."""


def unknown(what: str, value: object, known: Iterable[str]) -> str:
    """``unknown profile '4gg'; did you mean 4g?``; empty if no name in `known` is nearly `value`.

    what : the kind of name, after its place and a colon if there is one: ``"spec.toml: parameter"``.
    """
    from difflib import get_close_matches  # only an error needs it

    names = {name.lower(): name for name in known}
    typed = str(value).lower()
    ends = [name for name in names if name.rpartition(".")[2] == typed][:3]  # stiffness: device.stiffness
    *before, last = [names[name] for name in ends or get_close_matches(typed, names, n=3, cutoff=0.7)] or ("",)
    where, colon, what = what.rpartition(": ")
    meant = f"{', '.join(before)} or {last}" if before else last
    return f"{where}{colon}unknown {what} {value!r}; did you mean {meant}?" if last else ""


class ProfileError(NetemError):
    """A value in a link profile is not allowed.

    word : the word of the profile, as its user writes it (``"delay"``, ``"loss gemodel"``).
    value : the value given.
    allowed : a text that describes the allowed values.
    known : the allowed names, if the value is a name: the message has the most similar of them.
    why : the reason, in place of what is allowed.
    """

    def __init__(self, word: str, value: object, allowed: str, known: Iterable[str] = (), why: str = "") -> None:
        self.word, self.value, self.allowed, self.known, self.why = word, value, allowed, tuple(known), why
        given = word if value == word else f"{word} {value}"
        says = f"{given}: {why}" if why else f"{word}: {value!r} is not allowed; allowed: {allowed}"
        super().__init__(unknown(word, value, self.known) or says)

    def __reduce__(self) -> tuple[type[ProfileError], tuple[str, object, str, tuple[str, ...], str]]:
        return type(self), (self.word, self.value, self.allowed, self.known, self.why)
