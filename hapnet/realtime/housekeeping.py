"""The periodic work of one side while it runs: twenty times a second, on the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Literal

from hapnet.errors import HapnetError
from hapnet.realtime.controllers import Control
from hapnet.realtime.figures import SideFigures
from hapnet.realtime.link_driver import LinkDriver
from hapnet.realtime.reporter import AccountReporter, Reporter
from hapnet.realtime.shutdown import PeerAbsence
from hapnet.side.device import Clock
from hapnet.side.endpoint import NANO
from hapnet.side.notices import notice_of
from hapnet.summary.path import PathReporter
from hapnet.transport.diagnosis import UNANSWERED_NS, ConnectionDiagnosis
from hapnet.transport.zenoh import ZenohTransport
from hapnet.wire.events import Event, Mismatch, PeerRefused
from hapnet.wire.messages import Role
from netem import Timeline

REFUSE_S = 0.4
"""For this time a device keeps refusing a world that does not fit, and then ends [s]: some refusals get lost.

A world keeps waiting for a device that fits: otherwise any stranger could end it.
"""

_PERIOD_S = 0.05
_COLLECT_EVERY = 20  # rounds


class Housekeeping:
    """Reports what a side waits for, monitors its peer, and ends the side when it is time.

    role : this side's. control, driver, transport, figures, reporter, clock : its parts.
    accounts : reports its account. alone : acts while it has no peer. diagnosis : finds out why there is no answer.
    timeline : that of its link, from pairing on.
    refused : called with the time [ns]; returns a text with the refusals since the last call.
    fail : ends the side with an error.
    """

    def __init__(
        self,
        role: Role,
        control: Control,
        driver: LinkDriver,
        transport: ZenohTransport,
        figures: SideFigures,
        reporter: Reporter,
        clock: Clock,
        *,
        accounts: AccountReporter,
        alone: PeerAbsence,
        diagnosis: ConnectionDiagnosis,
        timeline: Timeline | None,
        refused: Callable[[int], list[str]],
        fail: Callable[[BaseException], None],
    ) -> None:
        self._role, self._clock = role, clock
        self._control, self._driver, self._transport = control, driver, transport
        self._figures, self._reporter, self._accounts = figures, reporter, accounts
        self._alone, self._diagnosis, self._timeline = alone, diagnosis, timeline
        self._refused, self._fail = refused, fail
        self._path = PathReporter(role, control.wire.session.path)
        self._started_ns = clock()
        self._duration_s = 0.0

    async def run(self, stop: asyncio.Event, duration_s: float, collect: Callable[[], int]) -> None:
        """Run until `stop` is set or `duration_s` seconds have passed since pairing (0: no end).

        collect : collects Python's garbage.
        """
        self._duration_s = duration_s
        stopped = asyncio.ensure_future(stop.wait())  # one for all rounds: one each would cost more than the rest
        try:
            await self._rounds(stop, stopped, duration_s, collect)
        finally:
            stopped.cancel()

    async def _rounds(
        self, stop: asyncio.Event, stopped: asyncio.Future[Literal[True]], duration_s: float, collect: Callable[[], int]
    ) -> None:
        rounds = 0
        while not stop.is_set():
            self._control.beat()
            origin_ns = self._control.origin_ns
            if origin_ns is None:
                self._wait(self._clock())
            elif duration_s > 0.0 and self._clock() - origin_ns >= duration_s / NANO:
                break
            elif self._timeline is not None:
                self._driver.play(self._timeline, origin_ns)
                self._timeline = None
            self.watch()
            self.drain()
            self._accounts.look()
            rounds += 1
            if rounds % _COLLECT_EVERY == 0:
                collect()
                self._check_each_second(origin_ns)
            await asyncio.wait((stopped,), timeout=_PERIOD_S)

    def on_connection(self) -> None:
        """Report that Zenoh has gained or lost a connection."""
        over = self._figures.stopped_ns is not None
        if self._control.origin_ns is not None and not over and self._control.wire.session.peer is not None:
            self._reporter.notifier.link(self._clock(), up=self._transport.peers > 0)

    def watch(self) -> None:
        """Report a silence of the other side, dropped messages, refused strangers and silent keys."""
        session, now_ns, notifier = self._control.wire.session, self._clock(), self._reporter.notifier
        with self._driver.lock:
            events, counts, why = session.watch(now_ns), self._figures.dropped(), session.dropped_for.copy()
        self.on_events(events, now_ns)
        self._alone.watch(now_ns, self._transport.partners)
        notifier.dropped(now_ns, counts, why)
        for text in self._refused(now_ns):
            notifier.notify("access", text, now_ns)
        notifier.keys(now_ns, self._transport.silent if session.peer is not None else [])

    def on_events(self, events: Iterable[Event], now_ns: int) -> None:
        """Act on the session's events."""
        origin_ns, duration_s = self._control.origin_ns, self._duration_s
        left_s = duration_s - (now_ns - (origin_ns or now_ns)) * NANO if duration_s else None
        for event in events:
            if self._is_final(event):
                notice = notice_of(event, now_ns, "world", "")
                assert notice is not None
                loop = asyncio.get_running_loop()
                loop.call_later(REFUSE_S, self._end_unpaired, HapnetError(notice.text))
            else:
                self._reporter.happened(event, now_ns)
            self._alone.happened(event, now_ns, left_s)

    def drain(self) -> None:
        """Report control's notes, and write its samples, since the last call."""
        self._reporter.report_notes()
        if self._control.origin_ns is not None:
            self._reporter.recordings.drain(self._clock(), self._figures.meta)

    def _check_each_second(self, origin_ns: int | None) -> None:
        """Run the checks of each second."""
        self.on_connection()  # when Zenoh reports a lost link, it may still count that link
        if origin_ns is not None:
            now_ns = self._clock()
            self._reporter.notifier.progress(now_ns, (now_ns - origin_ns) * NANO)
            if (notice := self._path.look(now_ns)) is not None:
                self._reporter.notify(notice)

    def _wait(self, now_ns: int) -> None:
        """Report what this side waits for and, if no node is connected, the possible cause."""
        transport = self._transport
        status, others = transport.status, transport.partners or transport.doubled
        if not transport.peers and (why := self._diagnosis.answer(now_ns)):
            status += f" ({why})"
        elif transport.peers and not others and now_ns - self._started_ns > UNANSWERED_NS:
            status += f" ({self._why_alone()})"
        self._reporter.notifier.waiting(now_ns, status, transport.partners)

    def _why_alone(self) -> str:
        """The possible causes if nodes are connected, and none is the other side."""
        other = "device" if self._role == "world" else "world"
        match self._transport.through_router:
            case "peer":
                meet = "that node is a router, through which only clients meet: start both sides with -m client"
                seat = "; if it is a world with --seats or --graph, it has no seat of this --session and --name"
                return meet + (seat if other == "world" else "")
            case "client":
                names = f"a {other} with -m client and the same --session and --name"
                return f"{names} is not connected to that router, or its access control does not let this side in"
        return f"the {other} is not started yet, its --session or --name differs, or access control keeps this side out"

    def _is_final(self, event: Event) -> bool:
        """Whether this event ends a device: the world does not fit, or has another device and never accepts this
        one.
        """
        if self._role != "device" or not isinstance(event, Mismatch | PeerRefused):
            return False
        return self._control.origin_ns is None or (isinstance(event, PeerRefused) and event.by_peer)

    def _end_unpaired(self, error: HapnetError) -> None:
        """End the side, unless a world has paired with it after all: any node may send a refusal."""
        if self._control.wire.session.peer is None:
            self._fail(error)
