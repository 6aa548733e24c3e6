"""Changes of a side's emulated link during a run, as events of its recording, and the timeline made from them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

from netem import LinkProfile, Timeline
from netem.timeline import Action, Entry

KIND = "netem"
"""The kind of these events."""

_PREFIX = "emulated link, "

Change: TypeAlias = Action


def text_of(change: Change | Entry) -> str:
    """The text of the event: a change by the user, or an entry of the side's timeline."""
    return f"{_PREFIX}{str(change) or 'ideal'}"


def read(text: str) -> Change:
    """The change in a text from `text_of`. ValueError if there is none, or if a file that it names cannot be read."""
    words = text.removeprefix(_PREFIX)
    if words == text:
        raise ValueError(f"{text!r:.60} is not a change of the link")
    [entry] = Timeline.parse(words if words.startswith("at ") else f"at 0s: {words}").entries
    return entry.action


def played(spec: str, changes: Iterable[tuple[int, str]]) -> tuple[str, tuple[Entry, ...], list[str]]:
    """A recorded link, for a run that begins at the time 0 of the changes.

    spec : the link when the recording began.
    changes : time [ns] and text of each, in order. Changes up to time 0 are in force when the run starts.

    Returns
    -------
    The link at the run's start, the entries of a timeline, and a line with the reason for each change that is left out.
    """
    start, down = spec, False
    later: list[Entry] = []
    unread: list[str] = []
    for at_ns, text in changes:
        try:
            change = read(text)
        except ValueError as error:
            unread.append(f"a change of the link is left out: {error}")
            continue
        if at_ns > 0:
            later.append(Entry(at_ns, change))
        elif isinstance(change, LinkProfile):
            start = str(change)
        else:
            down = change == "down"
    if down:
        later.insert(0, Entry(0, "down"))
    return start, tuple(later), unread
