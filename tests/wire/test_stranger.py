"""A peer written from `hapnet/wire/README.md` alone: msgpack, and none of hapnet's wire code.

It says hello, answers, pairs, sends positions and energy, acknowledges, echoes stamps and says goodbye, over an
ideal link and a bad one, on either side of hapnet's own; in the end both accounts agree to the nanojoule.
"""

from collections.abc import Iterator

import msgpack
import pytest

from hapnet.assembly.build import device_session, prepare
from hapnet.wire.events import PositionReceived
from hapnet.wire.session import Session, SessionSettings
from netem import Link, LinkProfile

MS = 1_000_000
VERSION, POSITION, ENERGY, HELLO, WELCOME, REFUSE, BYE, PROXY = 2, 1, 2, 3, 4, 5, 6, 10
KEY = {
    POSITION: "position",
    PROXY: "position",
    ENERGY: "energy",
    HELLO: "control",
    WELCOME: "control",
    REFUSE: "control",
    BYE: "control",
}


class Stranger:
    """One side. What it has to say is fetched from `said`: (last part of the key, frame)."""

    def __init__(self, role: str, dof: int, incarnation: int) -> None:
        self.role, self.dof, self.me = role, dof, incarnation
        self.peer = 0
        self.retired: set[int] = set()
        self.refused = ""
        self.hellos = self.paired_at_hello = 0
        self.hello_ns = 0
        self.numbers = -1
        self.newest: tuple[int, int] | None = None  # number and stamp of the peer's newest position
        self.position: list[float] | None = None
        self.echo = (0, 0)
        self.trips: list[int] = []
        self.sent = self.acked = self.claimed = self.credited = self.reported = 0
        self.repeat_ns: int | None = None
        self.ack_ns: int | None = None
        self.spaced_ns = 0
        self.said: list[tuple[str, bytes]] = []
        self.knows_a_place = False

    def _say(self, kind: int, *elements: object) -> None:
        self.said.append((KEY[kind], msgpack.packb([VERSION, kind, self.me, *elements])))

    def hear(self, now_ns: int, data: bytes) -> None:
        """What a receiver checks, in the page's order; then what the kind asks for."""
        try:
            frame = msgpack.unpackb(data) if len(data) <= 4096 else None
        except (ValueError, msgpack.UnpackException):
            return
        if not isinstance(frame, list) or len(frame) < 3:
            return
        version, kind, sender, *rest = frame
        if kind == REFUSE:
            if (rest[0] == self.me and sender in (self.peer, 0)) or not self.peer:
                self.refused = rest[1]
            return
        if version != VERSION:
            if kind == HELLO:
                self._say(REFUSE, sender, f"peer speaks protocol {version}, this side speaks {VERSION}")
            return
        if sender == self.me or sender in self.retired:
            return
        if kind == HELLO:
            self._on_hello(sender, *rest[:5])
        elif kind == WELCOME and rest[0] == self.me and self.paired_at_hello < rest[1] <= self.hellos:
            if sender != self.peer and not self._misfit(*rest[2:4]):
                self._begin(sender)
        elif sender == self.peer and kind == POSITION:
            self._on_position(now_ns, *rest[:5])
        elif sender == self.peer and kind == ENERGY and rest[0] == self.me and rest[2] <= self.reported:
            self._on_energy(now_ns, rest[1], rest[2])
        elif sender == self.peer and kind == BYE:
            if rest[0] == self.me:
                self.acked = max(self.acked, rest[1])
            self.retired.add(sender)
            self.peer = 0

    def _misfit(self, role: str, dof: int) -> str:
        if role == self.role:
            return "both the same"
        return "" if dof == self.dof else f"{dof} degrees of freedom, here {self.dof}"

    def _on_hello(self, sender: int, number: int, role: str, dof: int, name: str, about: object) -> None:
        if why := self._misfit(role, dof):
            self._say(REFUSE, sender, why)
        else:
            self._say(WELCOME, sender, number, self.role, self.dof, "stranger", {})

    def _begin(self, peer: int) -> None:
        self.peer, self.paired_at_hello, self.newest, self.echo = peer, self.hellos, None, (0, 0)
        self.sent = self.acked = self.claimed = self.credited = self.reported = 0

    def _on_position(
        self, now_ns: int, sequence: int, sent_ns: int, position: list[float], echo_ns: int, came_ns: int
    ) -> None:
        if self.newest is not None and (sequence <= self.newest[0] or sent_ns < self.newest[1]):
            return
        self.newest, self.position, self.echo = (sequence, sent_ns), position, (sent_ns, now_ns)
        if echo_ns:
            self.trips.append(now_ns - echo_ns - (sent_ns - came_ns))

    def _on_energy(self, now_ns: int, total: int, acked: int) -> None:
        if acked > self.acked:
            self.acked = acked
            self.repeat_ns = now_ns + 250 * MS if self.reported > acked else None
        self.claimed = max(self.claimed, total)
        self.credited = self.claimed  # no bucket: this peer is trusted
        if total > 0 and self.ack_ns is None:
            self.ack_ns = now_ns + 10 * MS

    def move(self, now_ns: int, position: list[float]) -> None:
        """Send a position."""
        if self.peer:
            self.numbers += 1
            if self.knows_a_place:
                self._say(PROXY, self.numbers, now_ns, position, 0, [0.0] * len(position), None, *self.echo)
            else:
                self._say(POSITION, self.numbers, now_ns, position, *self.echo)

    def poll(self, now_ns: int) -> Iterator[tuple[str, bytes]]:
        """All that is to be said now."""
        if not self.peer and now_ns >= self.hello_ns:
            self.hellos += 1
            self.hello_ns = now_ns + 100 * MS
            self._say(HELLO, self.hellos, self.role, self.dof, "stranger", {})
        if self.peer and (
            (self.sent > self.reported and now_ns >= self.spaced_ns) or (self.repeat_ns and now_ns >= self.repeat_ns)
        ):
            self.reported, self.ack_ns = self.sent, None
            self.spaced_ns, self.repeat_ns = now_ns + 10 * MS, now_ns + 250 * MS
            self._say(ENERGY, self.peer, self.reported, self.credited)
        elif self.peer and self.ack_ns is not None and now_ns >= self.ack_ns:
            self.ack_ns = None
            self._say(ENERGY, self.peer, 0, self.credited)
        said, self.said = self.said, []
        yield from said

    def leave(self) -> None:
        """Say goodbye."""
        for _ in range(3):
            self._say(BYE, self.peer, self.credited, "that was all")


AHEAD = 10**15
"""The stranger's clock is ahead of hapnet's by that [ns]."""


def ours(role: str, dof: int = 2) -> Session:
    plenty = SessionSettings(admission_W=1e6, admission_burst_J=1e6)
    return Session(role="device" if role == "device" else "world", dof=dof, name="ours", incarnation=7, settings=plenty)


class Talk:
    """hapnet's session and a stranger over a link in each direction."""

    def __init__(self, session: Session, stranger: Stranger, words: str) -> None:
        self.session, self.stranger = session, stranger
        self.to_us: Link[bytes] = Link(LinkProfile.parse(words), seed=1)
        self.to_them: Link[bytes] = Link(LinkProfile.parse(words), seed=2)
        self.now = 0

    def run(self, duration_ns: int, *, moving: bool = False, energy: bool = False) -> None:
        session, stranger = self.session, self.stranger
        for now in range(self.now, self.now + duration_ns, MS):
            if moving and now % (5 * MS) == 0 and session.peer is not None:
                self.to_them.send(now, session.position(now, (1e-6 * now, -0.5)[: stranger.dof]))
                stranger.move(now + AHEAD, [0.25, 1e-6 * now][: stranger.dof])
            if energy and now % (7 * MS) == 0:
                session.shuffle(1.7e-6)
                stranger.sent += 1234
            for frame in session.poll(now)[0]:
                self.to_them.send(now, frame.data)
            for _, data in stranger.poll(now + AHEAD):
                self.to_us.send(now, data)
            for _, data in self.to_us.poll(now):
                for event in session.receive(now, data):
                    if isinstance(event, PositionReceived):  # as this side's control half does when it uses it
                        session.positions.echo(event.sent_ns, now)
            for _, data in self.to_them.poll(now):
                stranger.hear(now + AHEAD, data)
        self.now += duration_ns


@pytest.mark.parametrize("words", ["", "delay 30ms 20ms loss 20%"])
@pytest.mark.parametrize("role", ["device", "world"])
def test_a_peer_that_was_written_from_the_page_works(role: str, words: str) -> None:
    stranger = Stranger("world" if role == "device" else "device", 2, 2**63 + 9)
    session = ours(role)
    talk = Talk(session, stranger, words)
    talk.run(2000 * MS)
    assert session.peer.incarnation == stranger.me
    assert stranger.peer == session.identity.incarnation
    talk.run(3000 * MS, moving=True, energy=True)
    assert stranger.position[1] == -0.5
    assert session.outages(talk.now).received > 200
    talk.run(4000 * MS)
    assert stranger.acked == session.credited_nJ == stranger.sent > 400_000
    assert session.acked_nJ == stranger.credited == session.sent_nJ > 600_000
    if not words:
        assert session.dropped.keys() <= {"unpaired"}
    stranger.leave()
    talk.run(300 * MS)
    assert session.peer is None
    assert session.abandoned_nJ == 0


def test_both_measure_the_same_round_trip() -> None:
    stranger = Stranger("world", 2, 99)
    session = ours("device")
    talk = Talk(session, stranger, "delay 30ms")
    talk.run(300 * MS)
    talk.run(1000 * MS, moving=True)
    figures = session.path.figures()
    assert figures.round_trip_p50_ns == pytest.approx(60 * MS, rel=1 / 32)
    assert len(stranger.trips) > 180
    assert max(stranger.trips) - 60 * MS <= MS >= 60 * MS - min(stranger.trips)


def test_it_is_refused_where_it_does_not_fit_and_understands_why() -> None:
    stranger = Stranger("world", 3, 99)
    Talk(ours("device"), stranger, "").run(500 * MS)
    assert stranger.peer == 0
    assert stranger.refused == "stranger has 3 degrees of freedom, ours has 2"


@pytest.mark.parametrize("rendering", ["hapnet", "paper"])
@pytest.mark.parametrize("sends_proxies", [True, False])
def test_where_a_world_must_send_proxies(rendering: str, sends_proxies: bool) -> None:
    """The page says by which entry of the device's hello a world knows it; and what else comes is silence."""
    session = device_session(prepare({"rendering": rendering}), 7)
    stranger = Stranger("world", 1, 99)
    stranger.knows_a_place = sends_proxies
    talk = Talk(session, stranger, "")
    talk.run(300 * MS)
    talk.run(1000 * MS, moving=True)
    assert session.identity.about["shared.contact_model"] is (rendering == "hapnet")
    if sends_proxies is session.identity.about["shared.contact_model"]:
        assert session.outages(talk.now).received >= 200
        assert "stream" not in session.dropped
    else:
        assert session.outages(talk.now).received == 0
        assert session.dropped["stream"] >= 200
