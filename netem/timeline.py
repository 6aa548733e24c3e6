"""Change a link while it runs: ``at 5s: delay 200ms; at 8s: down; at 9s: up``.

For TCP connections there are also ``at 5s: reset`` and ``at 5s: end``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from netem import units
from netem.errors import ProfileError
from netem.link import Link
from netem.profile import LinkProfile

_ENTRY = re.compile(r'(?:"[^"\n]*"|[^";\n]|")+')
_COMMENT = re.compile(r'("[^"\n]*")|#[^\n]*')
_HEAD = re.compile(r"\s*at\s+([^\s:]+)\s*:(.*)", re.DOTALL)
_NO_CUT = "reset and end only for TCP connections: netem tcp, TcpRelay"
_LIKE_ENTRIES = re.compile(r"\s*(at\s|#)")
_FORM = "'at TIME: PROFILE', 'at TIME: down', 'at TIME: up' or, last, 'at TIME: repeat'"


Cut = Literal["reset", "end"]
"""The ways to cut TCP connections: both programs receive a reset, or an orderly end of the stream."""

Action = LinkProfile | Literal["down", "up"] | Cut


@dataclass(frozen=True, slots=True)
class Entry:
    """A change at a time since the timeline's start: another profile, a link that goes down or up, or a cut."""

    at_ns: int
    action: Action

    def __str__(self) -> str:
        return f"at {units.format_time(self.at_ns)}: {str(self.action) or 'ideal'}"


@dataclass(frozen=True, slots=True)
class Timeline:
    """Changes of a link in the order of their times. All are repeated after `repeat_ns`, unless that is 0.

    `parse` and `load` read it and `str` writes it; ``parse(str(t)) == t``.

    Raises ProfileError: the entries' times decrease, or the repetition is at 0 or before the last entry.
    """

    entries: tuple[Entry, ...]
    repeat_ns: int = 0

    def __post_init__(self) -> None:
        for earlier, later in pairwise(self.entries):
            if later.at_ns < earlier.at_ns:
                raise ProfileError("timeline", str(later), f"a time of {units.format_time(earlier.at_ns)} or later")
        for entry in self.entries:
            if not 0 <= entry.at_ns <= units.MAX_TIME_NS:
                raise ProfileError("timeline", entry.at_ns, "times from 0 to 100000s")
        last_ns = self.entries[-1].at_ns if self.entries else 0
        if self.repeat_ns and not max(last_ns, 1) <= self.repeat_ns <= units.MAX_TIME_NS:
            raise ProfileError("timeline", self.repeat_ns, "a repetition after 0 and not before the last entry")

    def __str__(self) -> str:
        out = [str(entry) for entry in self.entries]
        return "; ".join([*out, f"at {units.format_time(self.repeat_ns)}: repeat"] if self.repeat_ns else out)

    @classmethod
    def parse(cls, text: str, *, connections: bool = False) -> Timeline:
        """Read entries ``at TIME: WHAT``, one per line or separated by semicolons; ``#`` starts a comment.

        WHAT is a whole profile in its words (words left out mean the default, not the previous value), a named profile,
        ``down``, ``up``, or, in the last entry, ``repeat``. With `connections`, which only TCP has, also ``reset`` and
        ``end``.

        Raises ProfileError: an entry is malformed; it names the entry and the word.
        """
        entries: list[Entry] = []
        repeat_ns = 0
        for number, given in enumerate(_split(text), start=1):
            word = f"timeline entry {number} ({given!r})"
            if repeat_ns:
                raise ProfileError(word, given, "nothing after 'repeat'")
            at_ns, what = _read_head(word, given)
            if entries and at_ns < entries[-1].at_ns:
                raise ProfileError(word, units.format_time(at_ns), "a time that is not before the previous entry's")
            if what == "repeat":
                if not entries or at_ns == 0:
                    raise ProfileError(word, "repeat", "a time above 0, after at least one entry")
                repeat_ns = at_ns
            else:
                entries.append(Entry(at_ns, _action(word, what, connections)))
        if not entries:
            raise ProfileError("timeline", text[:40], _FORM)
        return cls(tuple(entries), repeat_ns)

    @classmethod
    def load(cls, path: str, *, connections: bool = False) -> Timeline:
        """Read a file of entries.

        Raises ProfileError: the file cannot be read, or an entry is malformed.
        """
        with units.open_file("timeline", path, f"{_FORM}, or ") as file:
            return cls.parse(file.read(), connections=connections)

    @classmethod
    def read(cls, text_or_path: str, *, connections: bool = False) -> Timeline:
        """Read a command's option: entries if it starts like an entry, else the name of a file."""
        read = cls.parse if _LIKE_ENTRIES.match(text_or_path) else cls.load
        return read(text_or_path, connections=connections)


class TimelinePlayer:
    """Applies a timeline to a link, without a clock: call `advance` before using the link at that time.

    A change is applied with its due time, even if the caller is late. Messages in flight stay in flight.

    link : the link to change.
    timeline : its changes.
    start_ns : the timeline's time 0 on the link's clock.
    cut : called to cut the connections.

    Raises ProfileError: the timeline cuts connections, and there is no `cut`.
    """

    def __init__(
        self, link: Link[Any], timeline: Timeline, start_ns: int, cut: Callable[[Cut], None] | None = None
    ) -> None:
        for entry in () if cut else timeline.entries:
            if entry.action == "reset" or entry.action == "end":
                raise ProfileError("timeline", str(entry), _NO_CUT)
        self._link, self._timeline, self._start_ns, self._cut = link, timeline, start_ns, cut
        self._next = 0

    @property
    def next_due_ns(self) -> int | None:
        """The time of the next change [ns]; None if none is left."""
        entries = self._timeline.entries
        if self._next < len(entries):
            return self._start_ns + entries[self._next].at_ns
        if not self._timeline.repeat_ns or not entries:
            return None
        return self._start_ns + self._timeline.repeat_ns + entries[0].at_ns

    def advance(self, now_ns: int) -> list[tuple[int, Entry]]:
        """Apply the changes due by `now_ns`. Returns them with their times.

        If the caller is late by several repetitions, only the last whole one is applied, which gives the same state.
        """
        period_ns = self._timeline.repeat_ns
        if period_ns and (behind := (now_ns - self._start_ns) // period_ns - 2) > 0:
            self._start_ns += behind * period_ns
        applied = []
        while (due_ns := self.next_due_ns) is not None and due_ns <= now_ns:
            if self._next == len(self._timeline.entries):
                self._start_ns, self._next = self._start_ns + period_ns, 0
            entry = self._timeline.entries[self._next]
            self._next += 1
            if entry.action == "down":
                self._link.down()
            elif entry.action == "up":
                self._link.up()
            elif entry.action == "reset" or entry.action == "end":
                if self._cut is not None:
                    self._cut(entry.action)
            else:
                self._link.change(entry.action, due_ns)
            applied.append((due_ns, entry))
        return applied


def _split(text: str) -> list[str]:
    plain = _COMMENT.sub(lambda match: match[1] or "", text)
    return [entry.strip() for entry in _ENTRY.findall(plain) if entry.strip()]


def _read_head(word: str, entry: str) -> tuple[int, str]:
    head = _HEAD.match(entry)
    if head is None:
        raise ProfileError(word, entry, _FORM)
    return units.parse_time(f"{word}: at", head[1]), head[2].strip()


def _action(word: str, what: str, connections: bool) -> Action:
    if what == "down":
        return "down"
    if what == "up":
        return "up"
    if what in ("reset", "end"):
        if not connections:
            raise ProfileError(word, what, _NO_CUT)
        return "reset" if what == "reset" else "end"
    if not what:
        raise ProfileError(word, what, _FORM)
    try:
        return LinkProfile.named(what)
    except ProfileError as error:
        raise ProfileError(f"{word}: {error.word}", error.value, error.allowed, error.known, error.why) from error
