"""A side's reports: notices to its user, samples to its recording, both to viewers, and the account of its half to
its peer.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hapnet.realtime.figures import SideFigures
from hapnet.realtime.link_driver import LinkDriver
from hapnet.realtime.notifier import Notifier
from hapnet.realtime.recorder import Recordings
from hapnet.realtime.telemetry_publisher import TelemetryPublisher
from hapnet.recording import link_events
from hapnet.recording.samples import Event as Note, Sample
from hapnet.side.device import Clock
from hapnet.side.notices import Notice
from hapnet.wire.events import Event
from hapnet.wire.messages import Role
from hapnet.wire.session import Session

_MOST_NOTES = 1000


class Reporter:
    """A side's notices, recordings and telemetry. `keep` is for any thread, all else for the event loop.

    role : this side's. on_silence : its action on a silence of the peer. clock : returns the time [ns].
    notify : called with each notice. telemetry : publishes telemetry; None: there is none.
    watch : called with each sample or note from control, on control's thread.

    Attributes
    ----------
    notifier : decides which notices are sent, and when. recordings : this side's.
    """

    def __init__(
        self,
        role: Role,
        on_silence: str,
        clock: Clock,
        notify: Callable[[Notice], None],
        telemetry: TelemetryPublisher | None,
        watch: Callable[[Sample], None] = lambda sample: None,
    ) -> None:
        self.notifier: Notifier = Notifier(role, on_silence, self.notify)
        self.recordings: Recordings = Recordings(lambda text: self.notifier.notify("recording", text, clock()))
        self._notify, self._telemetry, self._watch = notify, telemetry, watch
        self._notes: deque[Note] = deque(maxlen=_MOST_NOTES)

    def keep(self, sample: Sample) -> None:
        """Keep a sample or a note from control, from any thread; `report_notes` reports the notes."""
        if isinstance(sample, Note):
            self._notes.append(sample)
        elif self._telemetry is not None:
            self._telemetry.keep(sample)
        self.recordings.keep(sample)
        self._watch(sample)

    def notify(self, notice: Notice) -> None:
        """Send a notice, and record it if a replay needs it. `happened` records the session's events."""
        self._notify(notice)
        note = Note(notice.at_ns, notice.kind, notice.text, notice.level)
        if notice.kind in (link_events.KIND, "pause"):
            self.recordings.keep(note)
        if self._telemetry is not None and notice.kind != "progress":
            self._telemetry.keep(note)

    def happened(self, event: Event, now_ns: int) -> None:
        """Report an event of the session, and record the notice."""
        if (notice := self.notifier.happened(event, now_ns)) is not None:
            self.recordings.keep(Note(now_ns, notice.kind, notice.text, notice.level))

    def report_notes(self) -> None:
        """Report control's notes since the last call."""
        while self._notes:
            note = self._notes.popleft()
            self.notifier.notify(note.kind, note.text, note.time_ns, note.level)


EVERY_NS = 1_000_000_000
AT_THE_END_NS = 50_000_000


class AccountReporter:
    """Reports one side's account to its peer; on the event loop.

    figures, session, driver, clock : the side's parts.
    """

    def __init__(self, figures: SideFigures, session: Session, driver: LinkDriver, clock: Clock) -> None:
        self._figures, self._session, self._driver, self._clock = figures, session, driver, clock
        self._reported_ns: int | None = None

    def look(self) -> None:
        """Report the account if it is due, or if the peer has requested it; call this regularly."""
        with self._driver.lock:
            paired, owes = self._session.peer is not None, self._session.accounts.owes
        if paired and (owes or self._is_due(EVERY_NS)):
            self._report(final=False)

    def end(self) -> bool:
        """Report the account after control has stopped; True once the peer has answered. Call this until then."""
        if self._is_due(AT_THE_END_NS):
            self._report(final=True)
        with self._driver.lock:
            return self._session.accounts.known

    def _is_due(self, every_ns: int) -> bool:
        return self._reported_ns is None or self._clock() - self._reported_ns >= every_ns

    def _report(self, *, final: bool) -> None:
        values = self._figures.account(final=final)
        self._reported_ns = self._clock()
        with self._driver.lock:
            self._session.accounts.report(values, final=final)
        self._driver.arm()
