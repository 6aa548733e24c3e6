"""Decide which notices are sent, and when: each event once, and events that strangers cause at a bounded rate."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from hapnet.recording.samples import Level
from hapnet.side.endpoint import NANO
from hapnet.side.notices import Notice, notice_of
from hapnet.wire.events import Event, PeerRefused

REPORT_EVERY_NS = 10_000_000_000
"""Events that strangers cause are reported once in this time [ns]; a new kind of dropped message at once."""

MOST_REPORTED = 20
"""At most this many events of the session are reported in `REPORT_EVERY_NS`."""

ROUTINE = frozenset({"stale", "closed", "unpaired", "retired", "addressee"})
"""Kinds of dropped messages that delays, starts, ends and restarts cause: they are in the summary only."""

PATIENCE_NS = 1_500_000_000
"""A connected side that has not answered for longer than this may have another peer [ns]."""


class Notifier:
    """Sends one side's notices; on the event loop.

    role : this side's. on_silence : its action on a silence of the peer. notify : called with each notice.
    """

    def __init__(self, role: str, on_silence: str, notify: Callable[[Notice], None]) -> None:
        self._role, self._on_silence, self._notify = role, on_silence, notify
        self._other = "world" if role == "device" else "device"
        self._drops = Drops()
        self._waiting = ""
        self._reported_ns: deque[int] = deque(maxlen=MOST_REPORTED)
        self._not_shown = 0
        self._met_ns: int | None = None
        self._refusal = ""
        self._refused_ns: int | None = None
        self._link_lost_ns: int | None = None
        self._silent: dict[str, int] = {}

    def notify(self, kind: str, text: str, now_ns: int, level: Level = "warning") -> None:
        """Send a notice."""
        self._notify(Notice(kind, text, now_ns, level))

    def waiting(self, now_ns: int, status: str, partners: int) -> None:
        """Report that this side has no peer. status : the transport's. partners : the number of possible peers."""
        text = f"waiting for the {self._other}: {status}"
        if not partners:
            self._met_ns, self._refusal = None, ""
        elif self._refusal and partners == 1:  # without the reason, which a stranger may vary
            text = f"waiting for the {self._other}: {self._refusal}"
        elif self._met_ns is None:
            self._met_ns = now_ns
        elif now_ns - self._met_ns > PATIENCE_NS:
            text += f", which does not answer: it may be ending, or paired with another {self._role}"
        if text != self._waiting:
            self._waiting = text
            self._notify(Notice("waiting", text, now_ns))

    def progress(self, now_ns: int, elapsed_s: float) -> None:
        """Report how long control has run [s]."""
        self._notify(Notice("progress", f"{elapsed_s:.1f}", now_ns))

    def happened(self, event: Event, now_ns: int) -> Notice | None:
        """Report an event of the session; returns the notice that was sent, if any."""
        notice = notice_of(event, now_ns, self._other, self._on_silence)
        if notice is None:
            return None
        if notice.kind == "paired":
            self._refusal = ""
        if notice.kind in ("refused", "unproven"):
            if notice.kind == "unproven":
                refuses = "does not prove its key"
            else:
                refuses = "refuses this side" if isinstance(event, PeerRefused) else "was refused"
            self._refusal = f"the connected {self._other} {refuses}"
            if self._refused_ns is not None and now_ns - self._refused_ns < REPORT_EVERY_NS:
                return None
            self._refused_ns = now_ns
        if len(self._reported_ns) == MOST_REPORTED and now_ns - self._reported_ns[0] < REPORT_EVERY_NS:
            self._not_shown += 1
            return None
        self._reported_ns.append(now_ns)
        if self._not_shown:
            notice = replace(notice, text=f"{notice.text} ({self._not_shown} events before this one were not shown)")
            self._not_shown = 0
        self._notify(notice)
        return notice

    def dropped(self, now_ns: int, counts: Mapping[str, int], why: Mapping[str, str]) -> None:
        """Report the dropped messages. counts : how many so far, by kind. why : the last reason of each kind."""
        if (notice := self._drops.look(now_ns, counts, why)) is not None:
            self._notify(notice)

    def link(self, now_ns: int, *, up: bool) -> None:
        """Report a change of whether Zenoh is connected to any node."""
        if not up and self._link_lost_ns is None:
            self._link_lost_ns = now_ns
            self._notify(Notice("link", f"the connection to the {self._other} is lost", now_ns, "warning"))
        elif up and self._link_lost_ns is not None:
            silent_s = (now_ns - self._link_lost_ns) * NANO
            self._link_lost_ns = None
            self._notify(
                Notice("link", f"the connection is back after {silent_s:.2f} s", now_ns, values={"gone_s": silent_s})
            )

    def keys(self, now_ns: int, silent: Sequence[str]) -> None:
        """Report the kinds of message that do not arrive although other kinds do, at a bounded rate."""
        for kind in silent:
            if now_ns - self._silent.get(kind, -REPORT_EVERY_NS) >= REPORT_EVERY_NS:
                self._silent[kind] = now_ns
                text = f"no {kind} messages arrive from the {self._other}, although others do; subscribing again"
                self._notify(Notice("link", text, now_ns, "warning"))


class Drops:
    """Reports dropped messages at a bounded rate, so that their sender cannot fill a log."""

    def __init__(self) -> None:
        self._reported: Counter[str] = Counter()
        self._reported_ns: int | None = None

    def look(self, now_ns: int, dropped: Mapping[str, int], why: Mapping[str, str]) -> Notice | None:
        """Return a notice of the messages dropped since the last notice. why : the last reason of each kind."""
        new = {kind: count - self._reported[kind] for kind, count in dropped.items() if kind not in ROUTINE}
        new = {kind: count for kind, count in new.items() if count > 0}
        known = all(self._reported[kind] for kind in new)
        if not new or (known and self._reported_ns is not None and now_ns - self._reported_ns < REPORT_EVERY_NS):
            return None
        total = sum(new.values())
        text = f"dropped {total} message{'s' * (total > 1)}"
        if self._reported_ns is not None:
            text += f" in the last {(now_ns - self._reported_ns) * NANO:.0f} s"
        text += ": " + ", ".join(
            f"{count} {kind}{f' ({why[kind]})' if kind in why else ''}" for kind, count in sorted(new.items())
        )
        self._reported.update(new)
        self._reported_ns = now_ns
        return Notice("dropped", text, now_ns, "warning", dict(new))
