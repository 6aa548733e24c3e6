"""Decides what is told, and when: each thing once, and whatever a stranger does, at a bounded rate."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from hapnet.side.endpoint import NANO
from hapnet.side.notices import Notice, notice_of
from hapnet.wire.events import Event

TOLD_EVERY_NS = 10_000_000_000
"""What strangers can bring about is told of at most so often [ns]; dropped messages of a new kind at once."""

MOST_TOLD = 20
"""At most so many events of the session are told in `TOLD_EVERY_NS`."""

ROUTINE = frozenset({"stale", "closed", "unpaired", "retired", "addressee"})
"""Kinds of dropped messages that come of themselves, of delays, beginnings, ends and restarts: in the summary only."""

PATIENCE_NS = 1_500_000_000
"""A peer that is there and has not answered for longer may have another one."""


class Notifier:
    """What one side tells; on the event loop.

    role : this side's. on_silence : what it does when nothing arrives. notify : called with each notice.
    """

    def __init__(self, role: str, on_silence: str, notify: Callable[[Notice], None]) -> None:
        self._role, self._on_silence, self._notify = role, on_silence, notify
        self._other = "world" if role == "device" else "device"
        self._drops = Drops()
        self._waiting = ""
        self._told_ns: deque[int] = deque(maxlen=MOST_TOLD)
        self._untold = 0
        self._met_ns: int | None = None
        self._refused_ns: int | None = None
        self._link_lost_ns: int | None = None
        self._silent: dict[str, int] = {}

    def tell(self, kind: str, text: str, now_ns: int) -> None:
        """A warning in plain words."""
        self._notify(Notice(kind, text, now_ns, "warning"))

    def waiting(self, now_ns: int, status: str, partners: int) -> None:
        """This side has no peer; `status` says what the transport does, `partners` how many could be one."""
        text = f"waiting for the {self._other}: {status}"
        if not partners:
            self._met_ns = None
        elif self._met_ns is None:
            self._met_ns = now_ns
        elif now_ns - self._met_ns > PATIENCE_NS:
            text += f", which does not answer: perhaps it has another {self._role}"
        if text != self._waiting:
            self._waiting = text
            self._notify(Notice("waiting", text, now_ns))

    def progress(self, now_ns: int, elapsed_s: float) -> None:
        """How long control has run [s]."""
        self._notify(Notice("progress", f"{elapsed_s:.1f}", now_ns))

    def happened(self, event: Event, now_ns: int) -> Notice | None:
        """An event of the session; what was said of it."""
        notice = notice_of(event, now_ns, self._other, self._on_silence)
        if notice is None:
            return None
        if notice.kind == "refused":
            if self._refused_ns is not None and now_ns - self._refused_ns < TOLD_EVERY_NS:
                return None
            self._refused_ns = now_ns
        if len(self._told_ns) == MOST_TOLD and now_ns - self._told_ns[0] < TOLD_EVERY_NS:
            self._untold += 1
            return None
        self._told_ns.append(now_ns)
        if self._untold:
            notice = replace(notice, text=f"{notice.text} ({self._untold} events before this were too many to tell)")
            self._untold = 0
        self._notify(notice)
        return notice

    def dropped(self, now_ns: int, counts: Mapping[str, int], why: Mapping[str, str]) -> None:
        """How many messages were dropped so far, by kind, and why the last of each."""
        if (notice := self._drops.look(now_ns, counts, why)) is not None:
            self._notify(notice)

    def link(self, now_ns: int, *, up: bool) -> None:
        """Whether Zenoh is connected to anybody."""
        if not up and self._link_lost_ns is None:
            self._link_lost_ns = now_ns
            self._notify(Notice("link", f"the connection to the {self._other} is lost", now_ns, "warning"))
        elif up and self._link_lost_ns is not None:
            gone_s = (now_ns - self._link_lost_ns) * NANO
            self._link_lost_ns = None
            self._notify(
                Notice("link", f"the connection is back after {gone_s:.2f} s", now_ns, values={"gone_s": gone_s})
            )

    def keys(self, now_ns: int, silent: Sequence[str]) -> None:
        """Which kinds of message do not arrive, though the link is up and others do: told at a bounded rate."""
        for kind in silent:
            if now_ns - self._silent.get(kind, -TOLD_EVERY_NS) >= TOLD_EVERY_NS:
                self._silent[kind] = now_ns
                text = f"no {kind} messages of the {self._other} arrive, though others do; subscribing again"
                self._notify(Notice("link", text, now_ns, "warning"))


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
        if not new or (known and self._told_ns is not None and now_ns - self._told_ns < TOLD_EVERY_NS):
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
