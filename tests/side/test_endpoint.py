"""The two halves of a side, without a plant: what goes between them, and what becomes of it on the wire."""

from typing import ClassVar

import pytest

from hapnet.control.coupling import CouplingSample, LawServo, MotionSample, PortSample, WaveSample
from hapnet.control.deadband import Deadband
from hapnet.control.ledger import Ledger
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.control.smoothing import Pipeline
from hapnet.side.endpoint import BACKLOG, ControlHalf, DeviceEndpoint, WorldControl
from hapnet.wire import messages
from hapnet.wire.messages import Stream, decode
from hapnet.wire.session import Session, SessionSettings
from hapnet.wire.stream import PositionStream

MS = 1_000_000


class Reported:
    """A law that says what it is told to say, and keeps what it hears."""

    set_position = (0.0,)

    def __init__(self) -> None:
        self.say: CouplingSample = (0.0,)
        self.heard: list[CouplingSample | str] = []

    def receive(self, sample: CouplingSample) -> None:
        self.heard.append(sample)

    def on_peer_changed(self) -> None:
        self.heard.append("another")

    def force(self, dt: float, x: object, v: object, held: object) -> tuple[float, ...]:
        return (0.0,)

    def next_sample(self, x: object, v: object) -> CouplingSample:
        return self.say

    def release(self, dt: float, x: object, held: object) -> None: ...


class Side:
    """A device's endpoint with such a law, and a peer to feed it."""

    def __init__(self, expects: type[Stream] = messages.Position) -> None:
        settings = SessionSettings(expects=expects)
        self.endpoint = DeviceEndpoint(Session(role="device", dof=1, name="pen", incarnation=7, settings=settings))
        self.law = Reported()
        self.now_ns = 0

    def meet(self, incarnation: int) -> Session:
        """Another peer, once the one before is silent."""
        peer = Session(role="world", dof=1, name="wall", incarnation=incarnation)
        self.now_ns += 2_000 * MS
        for _ in range(100):
            self.now_ns += 10 * MS
            for _, data in peer.poll(self.now_ns)[0]:
                self.endpoint.receive(self.now_ns, data)
            for _, data in self.endpoint.poll(self.now_ns)[0]:
                peer.receive(self.now_ns, data)
        assert self.endpoint.session.peer == peer.identity
        return peer

    def start(self) -> None:
        self.endpoint.start(LawServo(self.law, period=1e-3, position=(0.0,), initial_energy=0.0, force_limit=1.0))

    def tick(self) -> Stream | None:
        self.now_ns += MS
        self.endpoint.take(self.now_ns)
        data = self.endpoint.tick_sampled(self.now_ns, 1e-3, (0.0,), (0.0,))
        if data is None:
            return None
        message = decode(data)
        assert isinstance(message, messages.Position | messages.Motion | messages.Port | messages.Wave)
        return message


@pytest.mark.parametrize(
    ("sample", "expected"),
    [
        ((0.5,), messages.Position(7, 0, MS, (0.5,))),
        (MotionSample((0.5,), (-1.0,)), messages.Motion(7, 0, MS, (0.5,), (-1.0,))),
        (MotionSample((1,), (0,)), messages.Motion(7, 0, MS, (1.0,), (0.0,))),  # a law may say 0 for 0.0
        (PortSample((2.0,), 1.5e-3), messages.Port(7, 0, MS, (2.0,), 1_500_000)),
        (PortSample((2.0,), 1.9999e-9), messages.Port(7, 0, MS, (2.0,), 1)),  # never more than went in
        (PortSample((2.0,), -1e-18), messages.Port(7, 0, MS, (2.0,), 0)),  # rounding; a peer takes no negative total
        (WaveSample((0.25,), 5e-3), messages.Wave(7, 0, MS, (0.25,), 5 * MS, more={"integral": ((1.25e-3,), 5 * MS)})),
        (
            WaveSample((0.25,), 1e-12),
            messages.Wave(7, 0, MS, (0.25,), 1, more={"integral": ((2.5e-10,), 1)}),
        ),  # a span of nothing is none
    ],
)
def test_a_sample_becomes_its_message(sample: CouplingSample, expected: Stream) -> None:
    side = Side()
    side.start()
    side.law.say = sample
    message = side.tick()
    assert message == expected
    assert type(message) is type(expected)


def test_a_message_becomes_its_sample() -> None:
    for kind, expected in (
        (messages.Motion, MotionSample((0.5,), (2.0,))),
        (messages.Port, PortSample((0.5,), 3e-9)),
        (messages.Wave, WaveSample((0.5,), 4e-9, (2e-9,), 4e-9)),
    ):
        side = Side(kind)
        peer = side.meet(3)
        side.start()
        frames = {
            messages.Motion: peer.positions.motion(1, (0.5,), (2.0,)),
            messages.Port: peer.positions.port(1, (0.5,), 3),
            messages.Wave: peer.positions.wave(1, (0.5,), 4),
        }
        for data in frames.values():
            side.endpoint.receive(side.now_ns, data)
        side.tick()
        (heard,) = side.law.heard
        assert type(heard) is type(expected)
        assert tuple(heard) == tuple(map(pytest.approx, expected))
        assert side.endpoint.session.dropped == {"stream": 2}


def test_waves_and_ports_wait_and_of_the_rest_the_newest() -> None:
    for kind, left in ((messages.Wave, BACKLOG), (messages.Port, BACKLOG), (messages.Motion, 1)):
        side = Side(kind)
        peer = side.meet(3)
        side.start()
        stream = peer.positions
        for number in range(1, BACKLOG + 101):
            frames = {
                messages.Wave: stream.wave(1, (0.0,), number),
                messages.Port: stream.port(1, (0.0,), number),
                messages.Motion: stream.motion(1, (0.0,), (number * 1e-9,)),
            }
            side.endpoint.receive(side.now_ns, frames[kind])
        side.tick()
        assert len(side.law.heard) == left
        last = side.law.heard[-1]
        assert isinstance(last, WaveSample | PortSample | MotionSample)
        newest = (BACKLOG + 100) * 1e-9
        assert last[1] == pytest.approx((newest,) if isinstance(last, MotionSample) else newest)


def test_what_an_earlier_peer_said_is_not_for_a_law_that_has_begun_anew() -> None:
    side = Side(messages.Wave)
    first = side.meet(3)
    side.start()
    side.endpoint.receive(side.now_ns, first.positions.wave(1, (0.1,), 1))
    side.tick()
    side.endpoint.receive(side.now_ns, first.positions.wave(1, (0.2,), 1))  # which no tick takes in time
    second = side.meet(5)
    side.endpoint.receive(side.now_ns, second.positions.wave(1, (0.3,), 1))
    side.tick()
    first_heard, another, second_heard = side.law.heard
    assert (first_heard[:2], another, second_heard[:2]) == (((0.1,), 1e-9), "another", ((0.3,), 1e-9))


def test_a_deadband_decides_what_is_sent_and_tells_another_peer_at_once() -> None:
    side = Side()
    side.endpoint.deadband = Deadband(0.1)
    side.meet(3)
    side.start()
    side.law.say = (0.01,)  # the law's spring ends at 0
    assert [side.tick() is None for _ in range(5)] == [False, True, True, True, True]
    side.law.say = (0.0105,)
    assert side.tick() is None
    side.law.say = (0.0115,)
    message = side.tick()
    assert isinstance(message, messages.Position)
    assert message.sequence == 1, "numbers count what is sent"
    assert side.tick() is None
    second = side.meet(5)
    side.endpoint.receive(side.now_ns, second.position(1, (0.0,)))
    side.now_ns -= 4_000 * MS  # so that it is not the longest time that sends it
    assert side.tick() is not None


def test_a_side_that_took_somebodys_place_stays_one_that_did() -> None:
    """What the first peer says of this side counts: a peer after it that knows nobody else gives no reservoir back."""
    for words in ((True, False), (False, True)):
        side = ControlHalf(PositionStream(1))
        for restarted in words:
            side.pair(restarted)
        assert side.restarted is words[0]


class Watching(Ledger):
    """A ledger that keeps what it was shown."""

    seen: ClassVar[list[float]] = []

    def __setattr__(self, name: str, value: float) -> None:
        super().__setattr__(name, value)
        if name == "stored":
            self.seen.append(value)


def test_a_world_is_seen_before_pspm_and_after() -> None:
    """Theorem 1 pairs the work of the steps before with both springs, the one that ends and the one that begins.

    A spring of 500 N/m, the mass 10 mm away: 25 mJ before PSPM lets it go to where the mass is, nothing after.
    """
    modulator = SetPositionModulator(stiffness=500.0, position=(0.0,), ceiling=0.1)
    coupling = SetPositionCoupling(modulator, stages=Pipeline([]), silence=Silence("hold", 1e9))
    ledger = coupling.ledger = Watching(0.0, 0.0)
    ledger.seen.clear()
    world = WorldControl(PositionStream(1))
    world.start(SetPositionSteps(coupling))
    world.pair(restarted=False)
    world.on_sample((0.01,), 0, 0, 0)
    world.step(5 * MS, 5e-3, (0.01,), 0.001, 0.03, 0.0)
    assert coupling.set_position == (0.01,)
    assert ledger.seen == pytest.approx([0.001 + 0.025, 0.001])
    assert ledger.work == 0.03


def test_what_pspm_throws_away_hides_no_energy_from_nothing() -> None:
    """25 mJ are in the spring that nobody put in; PSPM throws 30 mJ of credit away: after it, nothing is seen."""
    modulator = SetPositionModulator(stiffness=500.0, position=(0.0,), ceiling=0.1)
    coupling = SetPositionCoupling(modulator, stages=Pipeline([]), silence=Silence("hold", 1e9))
    world = WorldControl(PositionStream(1))
    world.start(SetPositionSteps(coupling))
    world.pair(restarted=False)
    world.on_sample((0.01,), 0, 0, 0)
    world.credit(30_000_000)
    world.step(5 * MS, 5e-3, (0.01,), 0.0, 0.0, 0.0)
    assert coupling.discarded == pytest.approx(0.03)
    assert coupling.ledger.slack == pytest.approx(0.03 - 0.025)
    assert coupling.ledger.slack_min == pytest.approx(-0.025)
