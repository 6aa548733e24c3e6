"""One complete side of the coupling: control and wire together, without clock or I/O.

An endpoint has two halves, each with one owner. The servo (or the world's loop) owns control, which ticks and never
waits. The code that moves bytes owns wire, which processes received bytes and returns the messages to send. Only whole
values pass between them (`ControlInbox`): set-positions and credited energy to control, shuffled energy to wire. In
virtual time one loop owns both halves; in real time two threads or two processes do.
"""

from __future__ import annotations

from collections import deque
from functools import partial

from hapnet.checks import Vector
from hapnet.control.continuous_servo import ContinuousServo, Passage
from hapnet.control.coupling import (
    CouplingSample,
    CouplingState,
    DeviceCoupling,
    MotionSample,
    PortSample,
    PositionSample,
    ProxySample,
    Update,
    WaveSample,
    WorldCoupling,
    counted,
)
from hapnet.control.deadband import Deadband
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose_frame import Arms
from hapnet.side.content import NANO as NANO, energy_nJ, moment_ns, sample_of, span_ns, with_arms
from hapnet.side.inbox import ControlInbox
from hapnet.side.reindexing import Reindexing, rest
from hapnet.wire import messages
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.events import EnergyCredited, Event, Paired, PositionReceived, SampleReceived, SignalReceived
from hapnet.wire.fields import Signal
from hapnet.wire.identity import EARLIER, ROBOT
from hapnet.wire.path import InUse, age_of_content_s, age_s, transit_s
from hapnet.wire.session import PositionStream, Session
from hapnet.wire.signals import STOP
from hapnet.wire.stream import BACKLOG as BACKLOG

_MOST_SIGNALS = 256


def backlog(expects: type[messages.Stream]) -> int:
    """The number of a peer's stream messages that may wait for the next tick. Every wave counts, and a predictor uses
    every position, of ports too; of the other kinds only the newest message counts."""
    return BACKLOG if expects in (messages.Wave, messages.Position, messages.Port) else 1


class ControlHalf:
    """The control half, owned by the servo or the world's loop. Whole values pass through deques.

    positions : makes the position messages.
    backlog : how many messages of the peer's stream may wait.
    """

    def __init__(self, positions: PositionStream, backlog: int = 1) -> None:
        self.paired: bool = False
        """Whether a peer was paired: control may start."""
        self.restarted: bool = False
        """Whether the peer was paired before, with another side in this side's place. Then this side starts with an
        empty reservoir: each start with a full reservoir would create energy, and a crash loop would pump it."""
        self.leads_robot: bool = False
        """Whether this side's device leads a robot at the other side."""
        self.reindexing: Reindexing | None = None
        """Re-indexes this side's robot when its leader returns; None: the robot is not re-indexed."""
        self.deadband: Deadband | None = None
        """Decides which samples are worth sending; None: all are."""
        self.arms: Arms | None = None
        """Converts control's poses to the arms of the link's poses; None: the arms are the same."""
        self._positions = positions
        self._pairs = 0
        self._pair = 1  # the pair in use; another peer has another clock and another position
        self._coupling: CouplingState | None = None
        self._still = False
        self._echo = 0, 0  # stamp and arrival of the peer's last message
        self.in_use: InUse = InUse()
        # samples for the next tick, each with its times of sending and arrival, its duration, and its pair
        self.waiting: deque[tuple[CouplingSample, int, int, int, int]] = deque(maxlen=backlog)
        self.credits: deque[int] = deque()
        self._shuffled: deque[float] = deque()
        self._signals: deque[tuple[str, Signal]] = deque(maxlen=_MOST_SIGNALS)
        self._outgoing_signals: deque[tuple[str, Signal]] = deque(maxlen=_MOST_SIGNALS)

    @property
    def coupling(self) -> CouplingState:
        """The coupling; it exists once control has started."""
        assert self._coupling is not None, "control has not started"
        return self._coupling

    @property
    def started(self) -> bool:
        """Whether control has started."""
        return self._coupling is not None

    # -- called by the wire half: the methods of `ControlInbox` ------------------------------------------------------

    def pair(self, restarted: bool, leads_robot: bool = False) -> None:
        if not self.paired:
            self.restarted = restarted
        self.leads_robot = leads_robot
        self._pairs += 1
        self.paired = True
        self._echo = 0, 0

    def echo(self, sent_ns: int, came_ns: int) -> None:
        self._echo = sent_ns, came_ns

    def on_sample(self, sample: CouplingSample, sent_ns: int, came_ns: int, took_ns: int) -> None:
        if self.arms is not None:
            sample = with_arms(self.arms.back, sample)
        self.waiting.append((sample, sent_ns, came_ns, took_ns, self._pairs))

    def credit(self, credited_nJ: int) -> None:
        self.credits.append(credited_nJ)

    def on_signal(self, name: str, value: Signal) -> None:
        self._signals.append((name, value))

    def reported(self) -> tuple[str, Signal] | None:
        return self._outgoing_signals.popleft() if self._outgoing_signals else None

    @property
    def has_reported(self) -> bool:
        return bool(self._outgoing_signals)

    def shuffled(self) -> float:
        return self._shuffled.popleft() if self._shuffled else 0.0

    @property
    def has_shuffled(self) -> bool:
        return bool(self._shuffled)

    # -- called by control ------------------------------------------------------------------------------------------

    @property
    def arrived(self) -> CouplingSample | None:
        """The newest sample that control has not taken yet."""
        return self.waiting[-1][0] if self.waiting else None

    def report(self, name: str, value: Signal) -> None:
        """Send the peer this value beside the stream."""
        self._outgoing_signals.append((name, value))

    def signals(self) -> list[tuple[str, Signal]]:
        """Take the received signals."""
        return [self._signals.popleft() for _ in range(len(self._signals))] if self._signals else []

    def take(self, now_ns: int) -> CouplingState:
        """Pass the arrived samples and credits to the coupling, and a share of the reservoir to a new peer.

        Samples of an earlier peer are dropped.
        """
        coupling = self._coupling
        assert coupling is not None, "control has not started"
        if self._pair < self._pairs:
            self._change_peer(coupling, self._pairs)
        while self.waiting:
            sample, sent_ns, came_ns, took_ns, pair = self.waiting.popleft()
            if pair > self._pair:  # paired since this tick began
                self._change_peer(coupling, pair)
            if pair == self._pair and not self._still and (self.reindexing is None or self.reindexing.leads):
                if self.reindexing is not None:
                    sample = self.reindexing.led(coupling, sample, came_ns)
                used = self.in_use
                used.sent_ns, used.came_ns, used.took_ns = sent_ns, came_ns, took_ns
                aimed_s = sample.aimed_s if type(sample) is ProxySample else 0.0
                coupling.receive(sample, sent_ns * NANO, age_of_content_s(used, now_ns, aimed_s))
        while self.credits:
            coupling.credit(self.credits.popleft() * NANO)
        return coupling

    def stand_still(self) -> None:
        """Hold the set-position from now on; ignore further samples."""
        self._still = True
        if self._coupling is not None:
            rest(self._coupling)

    def lead(self, leads: bool) -> None:
        """Set whether the leader of this side's robot leads. If the robot re-indexes, the leader's position when it
        leads again corresponds to the robot's."""
        if self.reindexing is not None:
            self.reindexing.leads = leads
            if leads:
                self.reindexing.due = True
            elif self._coupling is not None:
                rest(self._coupling)

    def used(self, now_ns: int) -> tuple[float, float]:
        """Age and transit of the newest sample that the coupling uses, as in a `DeviceSample` [s]."""
        return age_s(self.in_use, now_ns), transit_s(self.in_use)

    def _change_peer(self, coupling: CouplingState, pair: int) -> None:
        self._pair, self.in_use.took_ns = pair, -1
        if self.deadband is not None:
            self.deadband.on_peer_changed()
        self.lead(True)
        if (energy := coupling.on_peer_changed()) > 0.0:
            self._shuffled.append(energy)

    def _send(self, now_ns: int, update: Update) -> bytes | None:
        """Queue the energy that an update shuffles; returns the message with the update's sample.

        None: there is no sample, or the deadband holds it back. Energy is never held back.
        """
        sample, shuffled = update
        if shuffled > 0.0:
            self._shuffled.append(shuffled)
        if sample is None:
            return None
        if self.deadband is not None:
            sample = self.deadband.offer(now_ns * NANO, sample, self.coupling.set_position)
            if sample is None:
                return None
        if self.reindexing is not None:
            sample = self.reindexing.outward(sample)
        if self.arms is not None:
            sample = with_arms(self.arms, sample)
        positions = self._positions
        positions.echo(*self._echo)
        match sample:
            case MotionSample(position, velocity):
                return positions.motion(now_ns, position, velocity)
            case PortSample(value, energy):
                return positions.port(now_ns, value, energy_nJ(energy))
            case ProxySample(position, aimed_s, force, planes, reach_m, level):
                return positions.proxy(now_ns, position, moment_ns(aimed_s), force, planes, reach_m, level)
            case PositionSample(position, level):
                return positions.position(now_ns, position, level)
            case WaveSample(value, span, _, _):
                return positions.wave(now_ns, value, span_ns(span))
            case _:
                return positions.position(now_ns, sample)


class WireHalf:
    """The wire half, owned by the code that moves bytes.

    session : this side's protocol state.
    control : receives samples, credits and signals.
    """

    def __init__(self, session: Session, control: ControlInbox) -> None:
        self.session = session
        self.planes: tuple[Plane, ...] | None = None
        """The planes in the peer's newest message; None: the message has no planes."""
        self._control = control
        self._echoed: tuple[int, int] | None = None

    def receive(self, now_ns: int, data: bytes) -> tuple[Event, ...]:
        """Process bytes from the network; never raises, whatever the bytes are."""
        events = self.session.receive(now_ns, data)
        self._hand_over(events, now_ns)
        if (arrival := self.session.path.arrival) is not None and arrival != self._echoed:
            self._echoed = arrival
            self._control.echo(*arrival)
        return events

    def poll(self, now_ns: int) -> tuple[list[Outgoing], tuple[Event, ...]]:
        """The messages to send now, and the events that the passing of time has caused."""
        self.collect()
        outgoing, events = self.session.poll(now_ns)
        self._hand_over(events, now_ns)
        return outgoing, events

    def stop_force(self, why: str) -> None:
        """Stop the device's force for good, from either side."""
        self._control.on_signal(STOP, why)
        self.session.report(STOP, why)

    @property
    def uncollected(self) -> bool:
        """Whether there is anything to `collect`."""
        return self._control.has_shuffled or self._control.has_reported

    def collect(self) -> None:
        """Pass control's surplus energy and signals to the session, which sends them when due; `poll` does this too.

        After a tick this saves a poll: energy is sent at most 100 times a second, but there are 1000 ticks a second.
        """
        while surplus := self._control.shuffled():
            self.session.shuffle(surplus)
        while (signal := self._control.reported()) is not None:
            self.session.report(*signal)

    @property
    def next_due_ns(self) -> int | None:
        """The time of the next `poll` if nothing else happens; energy that waits to be sent is due at once."""
        return 0 if self.uncollected else self.session.next_due_ns

    def _hand_over(self, events: tuple[Event, ...], now_ns: int) -> None:
        for event in events:
            if isinstance(event, PositionReceived):
                sample: CouplingSample
                sample = event.position if event.level is None else PositionSample(event.position, event.level)
                self._control.on_sample(sample, event.sent_ns, now_ns, event.took_ns)
            elif isinstance(event, SampleReceived):
                content = sample_of(event.message)
                if isinstance(content, ProxySample):
                    self.planes = content.planes
                self._control.on_sample(content, event.message.sent_ns, now_ns, event.took_ns)
            elif isinstance(event, EnergyCredited):
                self._control.credit(event.credited_nJ)
            elif isinstance(event, SignalReceived):
                self._control.on_signal(event.name, event.value)
            elif isinstance(event, Paired):
                self.planes = self._echoed = None
                about = event.peer.about
                self._control.pair(bool(about.get(EARLIER)), about.get(ROBOT) is True)


class DeviceControl(ControlHalf):
    """The device's control half: its servo."""

    def start(self, servo: DeviceCoupling) -> None:
        """Start a servo that holds forces; `servo` is at rest at the device's position (ybar = x)."""
        self._held = servo
        self._coupling = servo.coupling

    def start_continuous(self, servo: ContinuousServo) -> None:
        """Start a servo that renders within the tick; `servo` is at rest at the device's position (ybar = x)."""
        self._continuous = servo
        self._coupling = servo.coupling

    def tick_sampled(self, now_ns: int, dt: float, x: Vector, v: Vector, *, release: bool = False) -> bytes | None:
        """Tick a servo that holds its torque: the servo's `force` is then the force to apply.

        Call `take` before, if anything has arrived. `release`: release the spring, with no force in this tick. Returns
        the position message to send, if there is one.
        """
        if self.reindexing is not None:
            self.reindexing.watch(self.coupling, now_ns)
        update = self._held.tick(dt, x, v, release=release)
        return None if update is None else self._send(now_ns, update)

    @property
    def has_news(self) -> bool:
        """Whether something has arrived that the next tick must take."""
        return bool(self.waiting or self.credits or self._signals)

    def tick_continuous(
        self,
        now_ns: int,
        dt: float,
        x: Vector,
        passage: Passage,
        work: float,
        kinetic: float,
        *,
        release: bool = False,
    ) -> bytes | None:
        """Tick a device that renders the coupling itself: `coupling.set_position` is then its spring's anchor.

        Call `take` before, if anything has arrived. The other arguments are those of `ContinuousServo.tick`. Returns
        the position message to send, if there is one.
        """
        update = self._continuous.tick(dt, x, passage, work, kinetic, release=release)
        return None if update is None else self._send(now_ns, update)


class WorldControl(ControlHalf):
    """The virtual world's control half: its law runs at the onset of every integration step."""

    def start(self, coupling: WorldCoupling) -> None:
        """Start to step; the coupling is at rest at the virtual mass's position."""
        self._counted = coupling.counted if isinstance(coupling, SetPositionSteps) else partial(counted, coupling)
        self._coupling = coupling.coupling

    def step(self, now_ns: int, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> bytes | None:
        """Run the law at the onset of step k with the newest set-position; `coupling.set_position` is then ybar_k.

        dt : T_{k-1}, the length of the step that has ended [s].
        x, kinetic : position x_k [m] and kinetic energy kappa_k [J] of the virtual mass.
        work : f_{k-1} . vhat_{k-1} T_{k-1} [J], put in by the environment in the step that has ended.
        dissipated : D_{k-1} = |vhat|_B'^2 T of the step that has ended [J]. An engine's step measures it, and it may be
            negative.

        Returns the position message to send, unless it is held back.
        """
        self.take(now_ns)
        return self.answer(now_ns, dt, x, kinetic, work, dissipated)

    def answer(self, now_ns: int, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> bytes | None:
        """Run the law as `step` does, but without `take`, which was called before."""
        if self.reindexing is not None:
            self.reindexing.watch(self.coupling, now_ns)
        return self._send(now_ns, self._counted(dt, x, kinetic, work, dissipated))


class DeviceEndpoint(WireHalf, DeviceControl):
    """The device's side: both halves in one process."""

    def __init__(self, session: Session) -> None:
        DeviceControl.__init__(self, session.positions, backlog(session.settings.expects))
        WireHalf.__init__(self, session, self)


class WorldEndpoint(WireHalf, WorldControl):
    """The virtual world's side: both halves in one process."""

    def __init__(self, session: Session) -> None:
        WorldControl.__init__(self, session.positions, backlog(session.settings.expects))
        WireHalf.__init__(self, session, self)


Endpoint = DeviceEndpoint | WorldEndpoint
