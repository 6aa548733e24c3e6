"""Real time: one side in this process, over Zenoh, through the emulated link.

Three kinds of thread share a side. The control thread (the servo, or the world's stepper) owns the control half, and
puts positions on the wire itself unless the link delays them. Zenoh's receiving thread decodes arriving messages into
the control half's slots. The event loop does the rest: delayed release, retransmission, housekeeping (housekeeping.py)
and reports (reporter.py, figures.py). One lock guards the shared data: the wire half and the link (link_driver.py).
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from hapnet import checks
from hapnet.assembly.build import Setup
from hapnet.assembly.links import link_profile
from hapnet.assembly.operators import LIVE
from hapnet.assembly.own_parts import named_failure
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.params import is_simulated
from hapnet.realtime.controllers import Control, ControlCallbacks, MakeServo
from hapnet.realtime.figures import SideFigures
from hapnet.realtime.housekeeping import Housekeeping
from hapnet.realtime.link_driver import LinkDriver
from hapnet.realtime.off_loop import off_loop
from hapnet.realtime.recorder import measured_utc_less_clock_ns, require_writable
from hapnet.realtime.reporter import AccountReporter, Reporter
from hapnet.realtime.servo import MakeStepLoop, Servo, Stepper, require_fine_clock, tuned_interpreter
from hapnet.realtime.servo_process import control_of
from hapnet.realtime.shutdown import FAILED_LINGER_S, LINGER_S, GracefulShutdown, PeerAbsence
from hapnet.realtime.telemetry_publisher import TelemetryPublisher
from hapnet.recording import hand, link_events
from hapnet.recording.samples import Event as Note, Sample
from hapnet.recording.telemetry import Status
from hapnet.side.endpoint import NANO, WireHalf
from hapnet.side.link_port import LinkPort
from hapnet.side.notices import OVER, Notice, signal_text
from hapnet.summary.run import Summary, has_account
from hapnet.transport.config import ZenohSettings, proof_of
from hapnet.transport.diagnosis import ConnectionDiagnosis
from hapnet.transport.entities import TELEMETRY
from hapnet.transport.zenoh import ZenohTransport
from hapnet.units import POSE
from hapnet.wire.encryption import Cipher
from hapnet.wire.events import EnergyCredited, Event, PositionReceived, SampleReceived
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Role
from hapnet.wire.secret import Secret
from netem import Link, LinkProfile

_ORDINARY = (PositionReceived, SampleReceived, EnergyCredited)
"""Events of ordinary traffic, which are not reported."""


class RealtimeSide:
    """One side, running.

    setup : checked parameters. role : "device" or "world".
    zenoh : how to reach the other side. session, name : parts of the key expressions.
    seed : the seed of this side's link and the world's steps; None: a random one.
    record : path of the recording; None: none.
    realtime : run the device's servo in a process of its own, with SCHED_FIFO and locked memory where that is allowed.
    once : end with the first peer; do not wait for another one.
    notify : called with each notice, on the event loop.
    watch : called with each sample or note, on control's thread; it must return at once.
    refused : called with the time [ns]; returns a text with the refusals since the last call.
    page : called with each telemetry message of both sides, on any thread; it must return at once. None: no page.
    make_steps : makes the loop of a world's steps, which several hands of one world share. make_servo : makes the servo
    of a device, which its several pairs share.
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
        watch: Callable[[Sample], None] = lambda sample: None,
        refused: Callable[[int], list[str]] = lambda now_ns: [],
        page: Callable[[bytes], None] | None = None,
        make_steps: MakeStepLoop = Stepper,
        make_servo: MakeServo = Servo,
    ) -> None:
        require_fine_clock()
        self.setup: Setup = setup
        self.role = role
        self._clock = clock = time.monotonic_ns
        seed = secrets.randbits(32) if seed is None else seed
        entropy = np.random.SeedSequence(seed).spawn(4)
        early: list[Sample] = []  # control's notes while it is made
        self._write: Callable[[Sample], None] = early.append
        callbacks = ControlCallbacks(self._send, self._keep, self._fail, lambda: self._link_driver.arm())
        incarnation = secrets.randbits(63) + 1
        security = zenoh.security
        secret = Secret(
            secrets.token_bytes(32), security.secret_word(), encrypts=security.encrypt, proof=proof_of(zenoh)
        )
        if record is not None:
            require_writable(record)
        mean_step_s = 0.5 * (setup.params.world.step_min_s + setup.params.world.step_max_s)
        self._transport = ZenohTransport(
            zenoh,
            partial(self._on_message, page),
            session=session,
            device=name,
            role=role,
            rate_hz=max(setup.params.device.servo_hz, 1.0 / setup.params.world.step_min_s),
            stream_hz=1.0 / (setup.params.device.pspm_period_s if role == "device" else mean_step_s),
            on_change=lambda: self._housekeeping.on_connection(),
            warn=self._warn,
            also=() if page is None else (TELEMETRY,),
        )
        # last, after all checks: it opens the device
        self.control: Control = control_of(
            setup, role, incarnation, secret, callbacks, clock, entropy[2], realtime=realtime, make_steps=make_steps,
            make_servo=make_servo,
        )  # fmt: skip
        control = self.control
        self.wire: WireHalf = control.wire
        self.wire.session.sample(self._transport.sampled)
        own, direction = (setup.params.device, 0) if role == "device" else (setup.params.world, 1)
        profile, timeline = (setup.up, setup.up_timeline) if role == "device" else (setup.down, setup.down_timeline)
        port = LinkPort(control.wire, Link(profile, seed=entropy[direction]))
        period_ns = round(1e9 / setup.params.device.servo_hz) if role == "device" else None
        self._link_driver = LinkDriver(port, self._transport.put, clock, period_ns=period_ns)
        rate_hz = setup.params.telemetry_hz
        planes = (lambda: self.wire.planes) if role == "device" else None
        self._telemetry = (
            TelemetryPublisher(
                rate_hz, partial(self._put, page, secret.for_watchers(incarnation)), self._status, planes
            )
            if rate_hz
            else None
        )
        self._reporter = Reporter(role, own.on_silence, clock, notify, self._telemetry, watch)
        self._figures = SideFigures(
            setup, role, seed, (session, name), control, self._link_driver, self._transport, clock,
            measured_utc_less_clock_ns(clock, time.time_ns),
        )  # fmt: skip
        for sample in early:
            self._keep_and_measure(sample)
        self._write = self._keep_and_measure
        self._accounts = AccountReporter(self._figures, control.wire.session, self._link_driver, clock)
        self._diagnosis = ConnectionDiagnosis(zenoh, clock())
        self._housekeeping = Housekeeping(
            role, control, self._link_driver, self._transport, self._figures, self._reporter, clock,
            accounts=self._accounts,
            alone=PeerAbsence(role, once, self._reporter.notify, lambda: self._stop.set()),
            diagnosis=self._diagnosis,
            timeline=timeline, refused=refused, fail=self._fail,
        )  # fmt: skip
        self._failure: BaseException | None = None
        self._paused = self._hurried = False
        self._lingers = True
        if record is not None:
            self._reporter.recordings.begin(record)

    @property
    def profile(self) -> LinkProfile:
        """The present profile of this side's link."""
        return self._link_driver.port.link.profile

    # -- on other threads ---------------------------------------------------------------------------------------------

    def _keep(self, sample: Sample) -> None:
        self._write(sample)

    def _keep_and_measure(self, sample: Sample) -> None:
        self._figures.live.see(sample)
        self._reporter.keep(sample)

    def _send(self, data: bytes) -> None:
        """Send control's message, on control's thread."""
        self._link_driver.send(data)

    def _put(self, page: Callable[[bytes], None] | None, for_watchers: Cipher | None, data: bytes) -> None:
        if page is not None:
            page(data)
        if self.wire.session.encrypts:
            if for_watchers is None:
                return  # the pair's data are secret
            data = for_watchers.encrypt(data)
        self._transport.put(TELEMETRY, data)

    def _on_message(self, page: Callable[[bytes], None] | None, kind: str, data: bytes, now_ns: int) -> None:
        """Process a message, on Zenoh's thread."""
        if kind != TELEMETRY:
            self._report(self._link_driver.receive(now_ns, data))
        elif page is not None:
            page(data)

    def _report(self, events: tuple[Event, ...]) -> None:
        notable = [event for event in events if not isinstance(event, _ORDINARY)]
        if notable:
            self._loop.call_soon_threadsafe(self._housekeeping.on_events, notable, self._clock())

    def _warn(self, text: str) -> None:
        """Let the loop report a warning; from any thread."""
        self._reporter.keep(Note(self._clock(), "transport", text, "warning"))

    def _fail(self, error: BaseException) -> None:
        self._failure = self._failure or named_failure(self.setup.params, error)
        self._figures.failed = str(self._failure) or type(self._failure).__name__
        self._loop.call_soon_threadsafe(self._stop.set)

    # -- the event loop ----------------------------------------------------------------------------------------------

    async def run(self, stop: asyncio.Event, duration_s: float, opened: Callable[[], object] = lambda: None) -> Summary:
        """Run until `duration_s` seconds after pairing (0: no end) or until `stop` is set; returns the side's summary.

        opened : called when control runs and the other side can connect.

        At its end, even by an error, there is no force any more, and no thread, task, socket or file is left. If it is
        cancelled, it ends as soon as that is so, without a bye to the peer; to end in order, set `stop`.

        Raises HapnetError: the peer does not fit, the transport cannot be opened, or the control thread failed.
        """
        self._loop, self._stop = asyncio.get_running_loop(), stop
        self._link_driver.open(self._loop, self._pump)
        telemetry = None if self._telemetry is None else self._loop.create_task(self._telemetry.run())
        try:
            with tuned_interpreter() as collect:
                refused = await off_loop(self.control.start)
                await self._open(stop)  # only now: control must be ready before a peer is answered
                if refused:
                    self._reporter.notifier.notify("realtime", refused, self._clock())
                self._link_driver.arm()
                opened()
                await self._housekeeping.run(stop, duration_s, collect)
                self.wire.session.monitor.leave(self._clock())
                await off_loop(self.control.stop)
                self._figures.stopped_ns = self._clock()
            if self._failure is not None:
                with suppress(Exception):  # the bye may need the part that has failed
                    await self._part("it failed", linger=False)
                raise self._failure
            await self._part(OVER, linger=True)
            if self._telemetry is not None:
                self._telemetry.report_status()  # the final account, for viewers
        finally:
            if telemetry is not None:
                telemetry.cancel()
            try:
                await off_loop(self._close)
            finally:
                self._link_driver.close()
                summary = self.summary()
                self._housekeeping.drain()
                self._housekeeping.watch()
                self._reporter.recordings.end(self._reported(summary), self.control.unrecorded)
        return summary

    async def _open(self, stop: asyncio.Event) -> None:
        """Open the transport, unless `stop` is set before: a client waits for its router."""
        opening, stopped = asyncio.ensure_future(self._transport.open()), asyncio.ensure_future(stop.wait())
        try:
            await asyncio.wait((opening, stopped), return_when=asyncio.FIRST_COMPLETED)
            if opening.done():
                opening.result()
        finally:
            opening.cancel()
            stopped.cancel()
            if opening.done() and not opening.cancelled():
                opening.exception()  # so that asyncio does not log it

    def _close(self) -> None:
        """Stop control and close the transport, on a thread that may wait."""
        try:
            self.control.stop()
        finally:
            self._transport.shut()
            self._diagnosis.close()

    def summary(self) -> Summary:
        """The summary so far; the other side's part is the one it reported, or None."""
        return self._figures.summary()

    def interrupt(self, why: str) -> None:
        """Store why this side is to end before its time; the caller also sets `stop`."""
        self._figures.failed = why

    def skip_settling(self) -> None:
        """Leave without waiting for the energy in flight: it is lost, which is safe. The peer is notified."""
        self._lingers = False

    def leave_at_once(self) -> None:
        """Leave at once; the peer may not be notified."""
        self._hurried = True

    @property
    def unrecorded(self) -> str | None:
        """Describe what is missing in the recordings; None: nothing."""
        return "; ".join(self._reporter.recordings.missing) or None

    # -- while it runs, on the event loop ----------------------------------------------------------------------------

    def change_link(self, text: str) -> None:
        """Send through another link from now on: tc-netem's syntax, or a profile's name.

        Raises NetemError, InvalidParameter: there is no such link.
        """
        profile = link_profile(f"link.{self._figures.direction}", text)
        self._link_driver.change(profile)
        self._reporter.notify(Notice(link_events.KIND, link_events.text_of(profile), self._clock()))

    def pause(self, paused: bool) -> None:
        """Halt the simulated device or world, or let it continue. Servo, protocol and link keep running."""
        self._paused = paused
        self.control.pause(paused)
        self._reporter.notify(Notice("pause", hand.PAUSED if paused else "goes on", self._clock()))

    def lead(self, position: Vector) -> None:
        """Lead the hand of the operator ``mouse`` to `position` [m], shape (n,); of a tool that turns (3,).

        Raises InvalidParameter: this side has no such hand, or `position` is not valid.
        """
        self._require_live_hand()
        axes = 3 if self.setup.units == POSE else self.setup.dof
        self.control.lead(checks.vector("position", position, axes))

    def let_go(self, why: str) -> None:
        """Stop the device leading, for the reason `why`: a robot that it leads stops, and the device has no force. If
        `why` is empty, it leads again, from where it then is; the robot stays where it is. For a device's side only.

        Raises InvalidParameter: this side has no device.
        """
        if self.role != "device":
            raise InvalidParameter("let_go", why, "a device's side: a world leads nothing")
        self.control.let_go(why)

    def place(self, position: Vector) -> None:
        """Begin at `position` [m], shape (n,), not where the scene and the hand begin; before `run`.

        Raises InvalidParameter: this device has no live hand, or `position` is not valid.
        """
        if self.role == "device":
            self._require_live_hand()
        self.control.place(checks.vector("position", position, self.setup.dof))

    def _require_live_hand(self) -> None:
        params = self.setup.params
        if self.role != "device" or params.operator != LIVE or not is_simulated(params.hardware):
            raise InvalidParameter("operator", params.operator, f"{LIVE}, on a device's side with a simulated device")

    def report(self, name: str, value: Signal) -> None:
        """Send the other side a small value beside the stream: its scene, device or program gets it as a signal.

        Raises InvalidParameter: it is no number, text, boolean, None or tuple of numbers, or there are too many.
        """
        with self._link_driver.lock:
            self.wire.session.signals.report(name, value)
        self._link_driver.arm()
        self._reporter.notify(Notice("signal", signal_text(name, value), self._clock()))

    tell = report
    """The former name of `report`, kept for one more release."""

    def stop_force(self, why: str) -> None:
        """End the device's force for good; either side may call it. why : the reason, for people."""
        with self._link_driver.lock:
            self.wire.stop_force(why)
        self._link_driver.arm()
        if self.role == "world":
            self._reporter.notify(Notice("stop", f"the device's force is ended: {why}", self._clock()))

    def record(self, path: Path | None) -> None:
        """End the running recording, if there is one, and begin another at `path`; None: only end it.

        Raises RecordingError: it cannot be written.
        """
        self._housekeeping.drain()
        recordings = self._reporter.recordings
        recordings.end(self._reported(self.summary()), self.control.unrecorded)
        if path is not None:
            recordings.begin(path)
            if not self._link_driver.port.link.is_up:
                recordings.keep(Note(self._clock(), link_events.KIND, link_events.text_of("down")))

    def _reported(self, summary: Summary) -> Summary | None:
        """Return the summary for a recording's end. None: the part of a servo's process is missing, which reports it
        only at its end, and not if it was killed; the samples then count.
        """
        return summary if has_account(summary[self.role]) else None

    async def _part(self, reason: str, *, linger: bool) -> None:
        """After control has stopped, wait until the energy in flight is acknowledged, then send the bye."""
        session, driver = self.wire.session, self._link_driver
        leaving = GracefulShutdown(
            session, driver, self._clock, self._pump, self._accounts.end,
            lambda: self._lingers, lambda: self._hurried,
        )  # fmt: skip
        await leaving.run(reason, LINGER_S if linger else FAILED_LINGER_S, self.profile.delay_ns * NANO)

    def _pump(self) -> None:
        """Send due messages, and report events."""
        _, events, changes = self._link_driver.pump()
        self._report(events)
        for at_ns, entry in changes:
            self._reporter.notify(Notice(link_events.KIND, link_events.text_of(entry), at_ns))

    def _status(self) -> Status:
        return self._figures.status(paused=self._paused, recording=str(self._reporter.recordings.path or ""))
