"""A side's port, driven by nothing but `next_due_ns`, as any runtime drives it."""

from collections.abc import Sequence

import pytest

from hapnet.realtime.link_driver import LinkDriver
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.link_port import FRAME_OVERHEAD, LinkPort, Packet
from hapnet.wire.events import Event, Paired
from hapnet.wire.messages import Role
from hapnet.wire.session import Session
from netem import Link, LinkProfile, Timeline

MS = 1_000_000
PROFILES = ["", "delay 40ms", "delay 20ms 15ms loss 20%", "delay 5ms rate 256kbit reorder 20%", "slot 10ms packets 3"]


def port(role: Role, words: str = "", seed: int = 1) -> LinkPort:
    session = Session(role=role, dof=1, name=role, incarnation={"device": 5, "world": 6}[role])
    endpoint = DeviceEndpoint(session) if role == "device" else WorldEndpoint(session)
    return LinkPort(endpoint, Link(LinkProfile.parse(words), seed=seed))


class Pair:
    """Two ports: what comes out of one goes into the other at once, and is kept with its time."""

    def __init__(self, device: LinkPort, world: LinkPort) -> None:
        self.device, self.world = device, world
        self.now_ns = 0
        self.crossed: list[tuple[int, Packet]] = []
        self.events: list[Event] = []

    def pump(self, here: LinkPort) -> tuple[Sequence[Packet], tuple[Event, ...]]:
        pumped = here.pump(self.now_ns)
        return pumped.packets, pumped.events

    def send(self, here: LinkPort, frame: bytes) -> Sequence[Packet]:
        return here.send(self.now_ns, frame)

    def deliver(self, packets: Sequence[Packet], sender: LinkPort) -> None:
        receiver = self.world if sender is self.device else self.device
        for packet in packets:
            self.crossed.append((self.now_ns, packet))
            self.events += receiver.receive(self.now_ns, packet.data)

    def run(self, for_ns: int) -> None:
        end_ns = self.now_ns + for_ns
        while True:
            dues = [(due_ns, k) for k, p in enumerate(self.ports) if (due_ns := p.next_due_ns) is not None]
            if not dues or min(dues)[0] > end_ns:
                break
            due_ns, which = min(dues)
            self.now_ns = max(self.now_ns, due_ns)
            packets, events = self.pump(self.ports[which])
            self.events += events
            self.deliver(packets, self.ports[which])
        self.now_ns = end_ns

    def talk(self, turns: int) -> None:
        """Every 5 ms each side says where it is and shuffles energy."""
        for turn in range(turns):
            self.run(5 * MS)
            for here in self.ports:
                frame = here.wire.session.position(self.now_ns, [1e-3 * turn])
                self.deliver(self.send(here, frame), here)
                here.wire.session.shuffle(1e-6 * (turn + 1))

    @property
    def ports(self) -> tuple[LinkPort, LinkPort]:
        return self.device, self.world


@pytest.mark.parametrize("words", PROFILES)
def test_pumped_when_due_the_sides_pair_and_lose_no_energy(words: str) -> None:
    pair = Pair(port("device", words, 1), port("world", words, 2))
    pair.run(3_000 * MS)
    assert sum(isinstance(event, Paired) for event in pair.events) == 2
    pair.talk(100)
    pair.run(20_000 * MS)
    for here, there in (pair.ports, pair.ports[::-1]):
        session = here.wire.session
        assert session.sent_nJ == there.wire.session.credited_nJ
        assert abs(session.sent_nJ - 5_050_000) <= 1  # what makes no whole nanojoule is kept
        assert session.settled
        stats = here.link.stats
        assert stats.offered == stats.delivered + stats.lost
        assert here.next_due_ns is None
    assert len(pair.crossed) == sum(here.link.stats.delivered for here in pair.ports)


def test_nothing_comes_out_before_it_is_due() -> None:
    here = port("device", "delay 40ms")
    assert here.next_due_ns == 0  # its first hello
    assert here.pump(0) == ([], (), [])
    assert here.next_due_ns == 40 * MS
    assert here.pump(40 * MS - 1) == ([], (), [])
    [hello], events, changes = here.pump(40 * MS)
    assert (hello.kind, events, changes) == ("control", (), [])


@pytest.mark.parametrize("words", ["", "loss 0%", "loss 1% limit 5", "delay 3ms"])
def test_a_message_that_nothing_delays_comes_out_of_send(words: str) -> None:
    here = port("device", words, seed=3)
    frame = here.wire.session.position(0, [0.0])
    released = here.send(7, frame)
    assert list(released) == ([] if "delay" in words else [Packet("position", frame)])
    if "delay" in words:
        assert here.release_due_ns == 3 * MS + 7
    assert (here.link.stats.offered, here.link.stats.in_flight) == (1, int("delay" in words))


def test_a_frames_headers_count_on_a_link_with_a_rate() -> None:
    here = port("device", "rate 8mbit")  # a byte a microsecond
    frame = here.wire.session.position(0, [0.0])
    assert not here.send(0, frame)
    assert here.release_due_ns == (len(frame) + FRAME_OVERHEAD) * 1000


def test_a_change_comes_before_all_else_that_is_due_then() -> None:
    here = port("device", "delay 1ms")
    here.pump(0)
    assert here.next_due_ns == MS  # its first hello leaves the link; the next is due at a whole number of periods
    here.pump(MS)
    due_ns = here.next_due_ns
    here.play(Timeline.parse("at 0s: delay 5ms; at 1ms: up"), due_ns)
    packets, _, [(at_ns, _)] = here.pump(due_ns)
    assert (packets, at_ns) == ([], due_ns)
    assert here.next_due_ns == due_ns + MS  # the next change, before what is on the link
    here.pump(due_ns + MS)
    assert here.release_due_ns == due_ns + 5 * MS


class DrivenPair(Pair):
    """Two ports behind the drivers of real time, whose clock shows the pair's time."""

    def __init__(self, device: LinkPort, world: LinkPort) -> None:
        super().__init__(device, world)
        self.put: list[Packet] = []
        self.drivers = {
            id(port): LinkDriver(port, lambda kind, data: self.put.append(Packet(kind, data)), lambda: self.now_ns)
            for port in self.ports
        }

    def pump(self, here: LinkPort) -> tuple[Sequence[Packet], tuple[Event, ...]]:
        events = self.drivers[id(here)].pump().events
        return self.taken(), events

    def send(self, here: LinkPort, frame: bytes) -> Sequence[Packet]:
        self.drivers[id(here)].send(frame)
        return self.taken()

    def taken(self) -> Sequence[Packet]:
        packets, self.put = self.put, []
        return packets


@pytest.mark.parametrize("words", PROFILES)
def test_the_driver_of_real_time_puts_what_the_port_gives_when_the_port_gives_it(words: str) -> None:
    """With a clock that is set by hand, to the nanosecond and to the bit."""
    plain = Pair(port("device", words, 1), port("world", words, 2))
    driven = DrivenPair(port("device", words, 1), port("world", words, 2))
    for pair in (plain, driven):
        pair.run(1_000 * MS)
        pair.talk(50)
        pair.run(5_000 * MS)
    assert driven.crossed == plain.crossed
    assert driven.events == plain.events
    assert len(plain.crossed) > 50


def test_what_a_tick_takes_before_its_message_is_sent_is_no_part_of_the_round_trip() -> None:
    """Messages wait 3 and 4 ms between being made and sent, on links of 20 and 30 ms: a round trip takes 50 ms."""
    pair = DrivenPair(port("device", "delay 20ms"), port("world", "delay 30ms"))
    pair.run(1_000 * MS)
    for _ in range(100):
        for here, waits_ns in ((pair.device, 3 * MS), (pair.world, 4 * MS)):
            if (arrival := here.wire.session.path.arrival) is not None:
                here.wire.session.positions.echo(*arrival)
            frame = here.wire.session.position(pair.now_ns, [0.0])
            pair.run(waits_ns)
            pair.deliver(pair.send(here, frame), here)
    for here in pair.ports:
        figures = here.wire.session.path.figures()
        assert (figures.round_trip_min_ns, figures.round_trip_p99_ns) == (50 * MS, 50 * MS)
