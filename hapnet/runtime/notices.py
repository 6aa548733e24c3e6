"""What a side has to say to the people who run it: who came, who went, what was lost, when and since when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from hapnet.endpoint import NANO
from hapnet.wire.events import Event, Mismatch, Paired, PeerHeard, PeerLeft, PeerRefused, PeerSilent

Level = Literal["info", "warning", "error"]

DROPS_EVERY_NS = 10_000_000_000
"""Dropped messages are told of at once when their kind is new, else at most this often [ns]."""

ROUTINE = frozenset({"stale", "closed", "unpaired", "retired", "addressee"})
"""Kinds of dropped messages that come of themselves, of delays, beginnings, ends and restarts: in the summary only."""


@dataclass(frozen=True)
class Notice:
    """Something that happened at `at_ns` on this machine's monotonic clock.

    kind, values : for programs. text : for people. level : how much it matters.
    """

    kind: str
    text: str
    at_ns: int
    level: Level = "info"
    values: Mapping[str, str | int | float] = field(default_factory=dict)


def notice_of(event: Event, now_ns: int, other: str, on_silence: str) -> Notice | None:
    """What to say of an event of the session; None: nothing, as it is the ordinary course.

    other : the other side's role. on_silence : what this side does when nothing arrives.
    """
    match event:
        case Paired(_, number):
            again = "" if number == 1 else f" (it restarted; pair {number})"
            return Notice("paired", f"paired with the {other}{again}", now_ns, values={"pair": number})
        case PeerLeft(reason):
            return Notice("left", f"the {other} left: {reason}", now_ns, values={"reason": reason})
        case Mismatch(reason):
            return Notice("refused", f"the {other} does not fit: {reason}", now_ns, "error", {"reason": reason})
        case PeerRefused(reason):
            return Notice("refused", f"the {other} refuses this side: {reason}", now_ns, "error", {"reason": reason})
        case PeerSilent(since_ns):
            silence_s = (now_ns - since_ns) * NANO
            does = "the set-position is held" if on_silence == "hold" else "the spring is let go"
            text = f"nothing from the {other} for {silence_s:.2f} s: {does}"
            return Notice("silent", text, now_ns, "warning", {"since_ns": since_ns, "silence_s": silence_s})
        case PeerHeard(silence_ns, recovery_ns, missing):
            text = f"the {other} is heard again after {silence_ns * NANO:.2f} s"
            if recovery_ns:
                text += f", {recovery_ns * 1e-6:.0f} ms after its first word"
            if missing:
                text += f"; {missing} positions are missing"
            values = {"silence_s": silence_ns * NANO, "recovery_s": recovery_ns * NANO, "missing": missing}
            return Notice("heard", text, now_ns, values=values)
    return None


class Drops:
    """Tells of messages that were dropped, at a bounded rate; whoever sends them cannot fill a log."""

    def __init__(self) -> None:
        self._told: Counter[str] = Counter()
        self._told_ns: int | None = None

    def look(self, now_ns: int, dropped: Mapping[str, int], why: Mapping[str, str]) -> Notice | None:
        """What to say of the counts by kind since the last time. `why` : of the last one of each kind, in words."""
        new = {kind: count - self._told[kind] for kind, count in dropped.items() if kind not in ROUTINE}
        new = {kind: count for kind, count in new.items() if count > 0}
        known = all(self._told[kind] for kind in new)
        if not new or (known and self._told_ns is not None and now_ns - self._told_ns < DROPS_EVERY_NS):
            return None
        total = sum(new.values())
        text = f"dropped {total} message{'s' * (total > 1)}"
        if self._told_ns is not None:
            text += f" in the last {(now_ns - self._told_ns) * NANO:.0f} s"
        text += ": " + ", ".join(
            f"{count} {kind}{f' ({why[kind]})' if kind in why else ''}" for kind, count in sorted(new.items())
        )
        self._told.update(new)
        self._told_ns = now_ns
        return Notice("dropped", text, now_ns, "warning", dict(new))
