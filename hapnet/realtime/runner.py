"""Real time: one side in this process, over Zenoh, through the emulated link.

Three kinds of thread share a side. The control thread (servo, or the world's stepper) owns the control half and puts a
position that the link does not delay on the wire itself. Zenoh's receiving thread decodes what arrives into the control
half's slots. The event loop does what is left: delayed release, retransmission, recording, telemetry. What they share,
wire half and link, is behind one lock (link_driver.py).
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hapnet import checks
from hapnet.assembly.build import LIVE, Setup, link_profile
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.realtime.controller_choice import control_of
from hapnet.realtime.controllers import ControlCallbacks
from hapnet.realtime.link_driver import LinkDriver
from hapnet.realtime.notifier import Notifier
from hapnet.realtime.peerless import Alone
from hapnet.realtime.recorder import Recordings, described
from hapnet.realtime.servo import tuned_interpreter
from hapnet.realtime.shutdown import LINGER_S, GracefulShutdown
from hapnet.realtime.telemetry_publisher import LinkMeter, Telemeter
from hapnet.recording import hand, link_events
from hapnet.recording.samples import Event as Note
from hapnet.recording.samples import Sample
from hapnet.recording.telemetry import Status
from hapnet.side.endpoint import NANO
from hapnet.side.link_port import LinkPort
from hapnet.side.notices import Notice, notice_of
from hapnet.summary import path as paths
from hapnet.summary.run import Summary, combine, versions
from hapnet.transport.config import ZenohSettings
from hapnet.transport.diagnosis import UNANSWERED_NS, ConnectionDiagnosis
from hapnet.transport.zenoh import TELEMETRY, ZenohTransport
from hapnet.wire.events import EnergyCredited, Event, Mismatch, PeerRefused, PositionReceived, SampleReceived
from hapnet.wire.messages import Role
from netem import Link, LinkProfile

REFUSE_S = 0.4
"""How long a device goes on refusing a world that does not fit before it ends: some refusals get lost [s].

A world goes on waiting for a device that fits: else any stranger could end it.
"""

_HOUSEKEEPING_S = 0.05
_MOST_NOTES = 1000
_COLLECT_EVERY = 20  # housekeepings
_UNTOLD = (PositionReceived, SampleReceived, EnergyCredited)
"""Events that come with the traffic, and that nobody is told."""


class RealtimeSide:
    """One side, running.

    Parameters
    ----------
    setup : checked parameters. role : "device" or "world".
    zenoh : how to reach the other side. session, name : of the key expressions.
    seed : of this side's link and the world's steps; None: drawn.
    record : path of the recording; None: none.
    realtime : the device's servo in a process of its own, under SCHED_FIFO and with locked memory if that is allowed.
    once : end with the first peer, not waiting for another one.
    notify : told what happens; called on the event loop.
    refused : asked, at a time [ns], who was refused since the last time, in words.
    """

    def __init__(
        self,
        setup: Setup,
        role: Role,
        zenoh: ZenohSettings,
        *,
        session: str = "default",
        name: str = "device",
        seed: int | None = None,
        record: Path | None = None,
        realtime: bool = False,
        once: bool = False,
        notify: Callable[[Notice], None] = lambda notice: None,
        refused: Callable[[int], list[str]] = lambda now_ns: [],
    ) -> None:
        self.setup, self.role = setup, role
        self.seed = secrets.randbits(32) if seed is None else seed
        self.profile = setup.up if role == "device" else setup.down
        self._timeline = setup.up_timeline if role == "device" else setup.down_timeline
        self._playing = self._down = self._paused = self._hurried = False
        self._way = "up" if role == "device" else "down"
        self._clock = time.monotonic_ns
        self._told, self._refused = notify, refused
        self._names = (session, name)
        self._versions = versions()  # a hundred files are read for it: not once the servo runs
        self._about = described(setup, role, self.seed, self.profile)
        rate_hz = setup.params.telemetry_hz
        self._telemeter = Telemeter(rate_hz, self._put, self._status) if rate_hz else None
        self._notes: deque[Note] = deque(maxlen=_MOST_NOTES)
        on_silence = (setup.params.device if role == "device" else setup.params.world).on_silence
        self._teller = Notifier(role, on_silence, self._notify)
        self._alone = Alone(role, once, self._notify, lambda: self._stop.set())
        self._recordings = Recordings(lambda text: self._teller.tell("recording", text, self._clock()))
        self._failure: BaseException | None = None
        self._started_ns = self._clock()
        self._diagnosis = ConnectionDiagnosis(zenoh, self._started_ns)
        self._stopped_ns: int | None = None
        entropy = np.random.SeedSequence(self.seed).spawn(4)
        incarnation = secrets.randbits(63) + 1
        callbacks = ControlCallbacks(self._send, self._keep_sample, self._fail, lambda: self._link_driver.arm())
        self.control = control_of(setup, role, incarnation, callbacks, self._clock, entropy[2], realtime=realtime)
        self.wire = self.control.wire
        self._path_told = paths.PathTeller(role, self.wire.session.path)
        self._path_shown = paths.PathMeter(role, self.wire.session.path)
        self._meter = LinkMeter()
        self._transport = ZenohTransport(
            zenoh, self._on_message, session=session, device=name, role=role, on_change=self._on_link
        )
        period_ns = round(1e9 / setup.params.device.servo_hz) if role == "device" else None
        port = LinkPort(self.wire, Link(self.profile, seed=entropy[0 if role == "device" else 1]))
        self._link_driver = LinkDriver(port, self._transport.put, self._clock, period_ns=period_ns)
        if record is not None:
            self._recordings.begin(record)

    # -- threads of their own ----------------------------------------------------------------------------------------

    def _keep_sample(self, sample: Sample) -> None:
        """For the recording and who watches; from any thread. A note is told as well, by the loop."""
        if isinstance(sample, Note):
            self._notes.append(sample)
        elif self._telemeter is not None:
            self._telemeter.keep(sample)
        self._recordings.keep(sample)

    def _send(self, data: bytes) -> None:
        """On control's thread."""
        self._link_driver.send(data)

    def _put(self, data: bytes) -> None:
        self._transport.put(TELEMETRY, data)

    def _on_message(self, kind: str, data: bytes) -> None:
        """On Zenoh's thread."""
        self._report(self._link_driver.receive(data))

    def _report(self, events: tuple[Event, ...]) -> None:
        told = [event for event in events if not isinstance(event, _UNTOLD)]
        if told:
            self._loop.call_soon_threadsafe(self._tell, told, self._clock())

    def _fail(self, error: BaseException) -> None:
        self._failure = self._failure or error
        self._loop.call_soon_threadsafe(self._stop.set)

    # -- the event loop ----------------------------------------------------------------------------------------------

    async def run(self, stop: asyncio.Event, duration_s: float) -> Summary:
        """Run until `duration_s` seconds after pairing (0: no end) or until `stop` is set; the side's summary.

        Raises
        ------
        HapnetError : the peer does not fit, the transport cannot be opened, or the control thread failed.
        """
        self._loop = asyncio.get_running_loop()
        self._stop, self._duration_s = stop, duration_s
        self._link_driver.open(self._loop, self._pump)
        telemetry = None if self._telemeter is None else self._loop.create_task(self._telemeter.run())
        try:
            with tuned_interpreter() as collect:
                refused = await asyncio.to_thread(self.control.start)
                await self._transport.open()  # only now: a peer that is answered is one that control is ready for
                if refused:
                    self._teller.tell("realtime", refused, self._clock())
                self._link_driver.arm()
                await self._keep(stop, duration_s, collect)
                await asyncio.to_thread(self.control.stop)
                self._stopped_ns = self._clock()
            if self._failure is not None:
                with suppress(Exception):  # what has failed may be what says so
                    await self._part("it failed", linger=False)
                raise self._failure
            await self._part("the run is over", linger=True)
        finally:
            self.control.stop()
            if telemetry is not None:
                telemetry.cancel()
            await self._transport.close()
            self._link_driver.close()
            summary = self.summary()
            self._drain()
            self._watch()
            self._recordings.end(summary, self.control.unrecorded)
        return summary

    def hurry(self) -> None:
        """Part without waiting for what is in flight: that energy is lost, which is safe."""
        self._hurried = True

    @property
    def unrecorded(self) -> str | None:
        """What is missing in the recording; None: nothing."""
        return "; ".join(self._recordings.missing) or None

    # -- while it runs, on the event loop ----------------------------------------------------------------------------

    def change_link(self, words: str) -> None:
        """From now on what this side sends goes through this link, in tc-netem's words or a profile's name.

        Raises
        ------
        NetemError, InvalidParameter : there is no such link.
        """
        profile = link_profile(f"link.{self._way}", words)
        self._link_driver.change(profile)
        self._link_changed(profile, link_events.told(profile), self._clock())

    def pause(self, paused: bool) -> None:
        """Let what is simulated stand still, or go on; servo, protocol and link go on all the time."""
        self._paused = paused
        self.control.pause(paused)
        self._notify(Notice("pause", hand.PAUSED if paused else "goes on", self._clock()))

    def lead(self, position: Vector) -> None:
        """Where the hand of the operator ``mouse`` is to go [m], shape (n,).

        Raises
        ------
        InvalidParameter : this side has no such hand, or that is no position.
        """
        params = self.setup.params
        if self.role != "device" or params.operator != LIVE or params.hardware != "simulated":
            raise InvalidParameter("operator", params.operator, f"{LIVE}, at the device, a simulated one")
        self.control.lead(checks.vector("position", position, self.setup.dof))

    def record(self, path: Path | None) -> None:
        """Begin a recording and end the one that is being made, if there is one; None: only end it.

        Raises
        ------
        RecordingError : it cannot be written.
        """
        self._drain()
        summary = self.summary()
        known = (part := summary[self.role]) is not None and part["ledger"]["margin_J"] is not None
        self._recordings.end(summary if known else None, self.control.unrecorded)
        if path is not None:
            self._recordings.begin(path)
            if self._down:
                self._recordings.keep(Note(self._clock(), link_events.KIND, link_events.told("down")))

    async def _keep(self, stop: asyncio.Event, duration_s: float, collect: Callable[[], int]) -> None:
        """Housekeeping until it is time to stop."""
        rounds = 0
        stopped = self._loop.create_task(stop.wait())  # one for all rounds: a new one each costs more than the rest
        while not stop.is_set():
            origin_ns = self.control.origin_ns
            if origin_ns is None:
                self._wait(self._clock())
            elif duration_s > 0.0 and self._clock() - origin_ns >= duration_s / NANO:
                break
            if origin_ns is not None and self._timeline is not None and not self._playing:
                self._playing = True
                self._link_driver.play(self._timeline, origin_ns)
            self._watch()
            self._drain()
            rounds += 1
            if rounds % _COLLECT_EVERY == 0:
                collect()
                self._on_link()  # Zenoh's event of a loss may come while it still counts the link
                if origin_ns is not None:
                    now_ns = self._clock()
                    self._teller.progress(now_ns, (now_ns - origin_ns) * NANO)
                    if (notice := self._path_told.look(now_ns)) is not None:
                        self._notify(notice)
            await asyncio.wait((stopped,), timeout=_HOUSEKEEPING_S)
        stopped.cancel()

    async def _part(self, reason: str, *, linger: bool) -> None:
        """Control has stopped: let energy in flight be acknowledged, then say goodbye."""
        leaving = GracefulShutdown(self.wire.session, self._link_driver, self._clock, self._pump, lambda: self._hurried)
        await leaving.run(reason, LINGER_S * linger, self.profile.delay_ns * NANO)

    def _pump(self) -> None:
        """Send what is due, and tell what has happened."""
        _, events, changes = self._link_driver.pump()
        self._report(events)
        for at_ns, entry in changes:
            self._link_changed(entry.action, link_events.told(entry), at_ns)

    def _link_changed(self, change: link_events.Change, text: str, at_ns: int) -> None:
        if isinstance(change, LinkProfile):
            self.profile = change
            self._about = self._about | {"links": {self._way: str(change)}}
        else:
            self._down = change == "down"
        self._notify(Notice(link_events.KIND, text, at_ns))

    def _notify(self, notice: Notice) -> None:
        self._told(notice)
        note = Note(notice.at_ns, notice.kind, notice.text)
        if notice.kind in (link_events.KIND, "pause"):  # a replay needs them; the session's are kept where told
            self._recordings.keep(note)
        if self._telemeter is not None and notice.kind != "progress":
            self._telemeter.keep(note)

    def _wait(self, now_ns: int) -> None:
        """There is no peer yet: tell what this side does, and if nobody is there at all, why that may be."""
        transport = self._transport
        status, others = transport.status, transport.partners or transport.doubled
        if not transport.peers and (why := self._diagnosis.answer(now_ns)):
            status += f" ({why})"
        elif transport.peers and not others and now_ns - self._started_ns > UNANSWERED_NS:
            status += " (--session or --name differs, or access control does not let this side in)"
        self._teller.waiting(now_ns, status, transport.partners)

    def _on_link(self) -> None:
        """Zenoh has gained or lost a connection."""
        if self.control.origin_ns is not None and self._stopped_ns is None and self.wire.session.peer is not None:
            self._teller.link(self._clock(), up=self._transport.peers > 0)

    def _watch(self) -> None:
        """Has the other side fallen silent, and what was dropped?"""
        session, now_ns = self.wire.session, self._clock()
        with self._link_driver.lock:
            events, counts, why = session.watch(now_ns), self._dropped(), session.dropped_for.copy()
        self._tell(events, now_ns)
        self._alone.watch(now_ns, self._transport.partners)
        self._teller.dropped(now_ns, counts, why)
        for text in self._refused(now_ns):
            self._teller.tell("access", text, now_ns)
        self._teller.keys(now_ns, self._transport.silent if session.peer is not None else [])

    def _is_final(self, event: Event) -> bool:
        """Does this end a device: a world that does not fit, or that has another one and will never take this again?"""
        if self.role != "device" or not isinstance(event, Mismatch | PeerRefused):
            return False
        return self.control.origin_ns is None or (isinstance(event, PeerRefused) and event.by_peer)

    def _end_unpaired(self, error: HapnetError) -> None:
        """Unless a world has taken this side after all: anybody may send a refusal."""
        if self.wire.session.peer is None:
            self._fail(error)

    def _dropped(self) -> dict[str, int]:
        """How many messages were dropped, by kind; the lock is held."""
        flood = self._transport.gate.refused
        return dict(self.wire.session.dropped) | ({"flood": flood} if flood else {})

    def _tell(self, events: Iterable[Event], now_ns: int) -> None:
        origin_ns = self.control.origin_ns
        left_s = self._duration_s - (now_ns - (origin_ns or now_ns)) * NANO if self._duration_s else None
        for event in events:
            if self._is_final(event):
                notice = notice_of(event, now_ns, "world", "")
                assert notice is not None
                self._loop.call_later(REFUSE_S, self._end_unpaired, HapnetError(notice.text))
            elif (notice := self._teller.happened(event, now_ns)) is not None:
                self._recordings.keep(Note(now_ns, notice.kind, notice.text))
            self._alone.happened(event, now_ns, left_s)

    # -- recording and summary ---------------------------------------------------------------------------------------

    def summary(self) -> Summary:
        """This side's summary so far; the other side's part is None."""
        own: dict[str, Any] = {"device": None, "world": None}
        links: dict[str, Any] = {"up": None, "down": None}
        end_ns = self._stopped_ns or self._clock()
        with self._link_driver.lock:
            own[self.role] = self.control.summary(end_ns) | {
                "dropped": self._dropped(), "declared_again": self._transport.declared_again,
            }  # fmt: skip
            links[self._way] = self._link_driver.port.link.stats.as_dict()
        origin_ns = self.control.origin_ns
        elapsed = None if origin_ns is None else (end_ns - origin_ns) * NANO
        summary = combine(
            own["device"], own["world"], links,
            seed=self.seed, duration_s=elapsed, coupling=self.setup.params.coupling, tuning=self.setup.tuned,
            path=paths.of_side(self.role, self.wire.session.path.figures()),
        )  # fmt: skip
        summary["wall_clock"] = {"elapsed_s": (self._clock() - self._started_ns) * NANO}
        return summary

    def _drain(self) -> None:
        """Say what control has noted, and write what was recorded, since the last call."""
        while self._notes:
            note = self._notes.popleft()
            self._teller.tell(note.kind, note.text, note.time_ns)
        if self.control.origin_ns is not None:
            self._recordings.drain(self._clock(), self._meta)

    def _meta(self) -> dict[str, Any]:
        session, name = self._names
        own = {"origin_ns": self.control.origin_ns, "session": session, "name": name, "versions": self._versions}
        return self._about | own

    # -- telemetry ---------------------------------------------------------------------------------------------------

    def _status(self) -> Status:
        session = self.wire.session
        with self._link_driver.lock:
            stats, paired = self._link_driver.port.link.stats, session.peer is not None
        return Status(
            role=self.role,
            time_ns=self._clock(),
            incarnation=session.identity.incarnation,
            paired=paired,
            paused=self._paused,
            recording=str(self._recordings.path or ""),
            about=self._meta(),
            link=self._meter.read(stats),
            path=dict(self._path_shown.read()),
        )
