"""The events of a connected side, for programs: its notices, in a few kinds."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hapnet.recording.samples import Level
from hapnet.side.notices import Notice

EventKind = Literal[
    "paired",
    "peer changed",
    "peer left",
    "silence",
    "recovered",
    "passivity lost",
    "missed",
    "notice",
    "ended",
]


@dataclass(frozen=True)
class SideEvent:
    """Something that happened to a connected side.

    * ``paired``: with its first peer. ``peer changed``: paired with another process than before.
    * ``peer left``: the peer sent its bye. ``silence``: its messages stop; ``recovered``: they come again.
    * ``passivity lost``: by its own account this side gave out more energy than it may. It is reported once.
    * ``missed``: this program was too slow, and one of its streams skipped items, as in `text`.
    * ``ended``: the last event; `level` is "error" if the side failed.
    * ``notice``: any other notice for people.

    kind : one of these. notice : when it happened, its text for people, how serious it is, and values.
    """

    kind: EventKind
    notice: Notice

    @property
    def text(self) -> str:
        """The event's text for people."""
        return self.notice.text

    @property
    def at_ns(self) -> int:
        """The event's time on this machine's monotonic clock [ns]."""
        return self.notice.at_ns

    @property
    def level(self) -> Level:
        """The event's level: info, warning or error."""
        return self.notice.level

    @property
    def values(self) -> Mapping[str, str | int | float]:
        """The event's numbers by name, such as ``silence_s`` of a silence."""
        return self.notice.values


_KINDS: Mapping[str, EventKind] = {"left": "peer left", "silent": "silence", "heard": "recovered"}


def event_of(notice: Notice) -> SideEvent:
    """The event of a side's notice."""
    if notice.kind == "paired":
        return SideEvent("paired" if notice.values.get("pair") == 1 else "peer changed", notice)
    return SideEvent(_KINDS.get(notice.kind, "notice"), notice)


def own_event(
    kind: EventKind, text: str, level: Level = "info", values: Mapping[str, str | int | float] | None = None
) -> SideEvent:
    """An event of the present time without a notice of a side."""
    return SideEvent(kind, Notice(kind, text, time.monotonic_ns(), level, values or {}))
