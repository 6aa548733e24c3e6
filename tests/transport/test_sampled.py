"""A transport that drops what was overtaken: what is lost is known, and round trips are of all messages."""

import asyncio
from statistics import median

import pytest
import zenoh

from hapnet.transport.config import ZenohSettings, free_address, zenoh_config
from hapnet.transport.sampled import SPACING_S, channels_of, sample_every
from hapnet.wire.messages import Position, decode, encode
from hapnet.wire.path import PathFigures
from hapnet.wire.session import Session
from hapnet.wire.stream_frames import sequence_of
from netem import Link, LinkProfile
from tests.conftest import mostly_slow
from tests.support.lossy import lossy_relay, talking
from tests.support.transports import Side, opened, paired

MS = 1_000_000
PERIOD_NS = 5 * MS
CHANNELS = 8
EVERY = sample_every([(zenoh.Priority.DATA, zenoh.Reliability.RELIABLE)] * CHANNELS, 1e9 / PERIOD_NS)


class Dropping:
    """Links with jitter and loss, and at their end Zenoh's rule: what was overtaken on its channel is dropped.

    lost, dropped : messages. delays_ns : of all that were not lost.
    """

    def __init__(self, words: str, seed: int) -> None:
        self._link = Link[tuple[int, bytes]](LinkProfile.parse(words), seed=seed)
        self._newest: dict[int, int] = {}
        self.dropped = 0
        self.delays_ns: list[int] = []

    @property
    def share_lost(self) -> float:
        stats = self._link.stats
        return stats.lost / stats.offered

    def send(self, now_ns: int, data: bytes) -> None:
        self._link.send(now_ns, (now_ns, data), 100)

    def poll(self, now_ns: int) -> list[bytes]:
        out = []
        for due_ns, (sent_ns, data) in self._link.poll(now_ns):
            self.delays_ns.append(due_ns - sent_ns)
            frame = decode(data)
            assert isinstance(frame, Position)
            number = frame.sequence
            channel = -1 if number % EVERY else number // EVERY % CHANNELS
            if number < self._newest.get(channel, -1):
                self.dropped += 1
                continue
            self._newest[channel] = number
            out.append(data)
        return out


def talk(words: str, seconds: int, *, reported: bool) -> tuple[list[Session], list[Dropping]]:
    """Both sides over such links, each with its own clock; `told`: their greetings say which messages are sampled."""
    sides = [Session(role=role, dof=1, name=role, incarnation=k) for k, role in enumerate(("device", "world"), 1)]
    for side in sides if reported else ():
        side.sample(EVERY)
    ahead, links = (5_000_000_000, 987_654_321_000_000), [Dropping(words, 1), Dropping(words, 2)]
    for now_ns in range(0, 20 * MS, MS):
        for k, side in enumerate(sides):
            for _, data in side.poll(now_ns + ahead[k])[0]:
                sides[1 - k].receive(now_ns + ahead[1 - k], data)
    for now_ns in range(20 * MS, seconds * 1000 * MS, MS):
        for k, side in enumerate(sides):
            if now_ns % PERIOD_NS == 0:
                if side.path.arrival is not None:
                    side.positions.echo(*side.path.arrival)
                links[k].send(now_ns, side.position(now_ns + ahead[k], [0.0]))
            for data in links[k].poll(now_ns):
                sides[1 - k].receive(now_ns + ahead[1 - k], data)
    return sides, links


def shares(known: PathFigures) -> tuple[float, float]:
    assert known.sent == known.arrived + known.lost + (known.overtaken - late(known))
    return known.lost / known.sent, known.overtaken / known.sent


def late(known: PathFigures) -> int:
    """What arrived although it was overtaken."""
    return known.arrived + known.overtaken + known.lost - known.sent


@pytest.mark.parametrize(
    "words", mostly_slow(["delay 100ms 30ms distribution normal loss 5%", "delay 40ms 10ms loss 15%"], 1)
)
def test_loss_and_round_trip_are_the_networks_though_most_is_dropped(words: str) -> None:
    """24,000 messages, 6,000 in the sample: the loss has a standard error of 0.3 and 0.5 points."""
    sides, links = talk(words, 120, reported=True)
    trip_ns = sum(median(link.delays_ns) for link in links)
    for side, link in zip(sides, reversed(links), strict=True):
        known = side.path.figures()
        assert known.round_trip_p50_ns == pytest.approx(trip_ns, rel=0.05)
        assert shares(known)[0] == pytest.approx(link.share_lost, abs=0.01)
        assert known.overtaken == pytest.approx(link.dropped + late(known), abs=0.011 * known.sent)
        assert link.dropped > 0.1 * known.sent


def test_without_a_word_from_the_sender_what_is_dropped_counts_as_lost() -> None:
    sides, links = talk("delay 40ms 10ms loss 5%", 20, reported=False)
    for side, link in zip(sides, reversed(links), strict=True):
        known = side.path.figures()
        assert known.lost == known.sent - known.arrived > link.dropped


@pytest.mark.parametrize("said", [0, -3, 1001, 2.0, True, "4"])
def test_a_share_that_makes_no_sense_is_ignored(said: object) -> None:
    sides = [
        Session(role="device", dof=1, name="d", incarnation=1, about={"sampled": said}),  # type: ignore[dict-item]
        Session(role="world", dof=1, name="w", incarnation=2),
    ]
    for now_ns in range(0, 20 * MS, MS):
        for k, side in enumerate(sides):
            for _, data in side.poll(now_ns)[0]:
                sides[1 - k].receive(now_ns, data)
    assert sides[1].peer is not None
    assert sides[1].path.every == 1


@pytest.mark.parametrize(
    ("endpoint", "count"),
    [
        ("tcp/127.0.0.1:1", 0), ("quic/127.0.0.1:1", 0), ("udp/127.0.0.1:1?rel=1", 0), ("udp/127.0.0.1:1", 8),
        ("quic/127.0.0.1:1?mixed_rel=1", 2), ("quic/127.0.0.1:1?rel=0", 2),
    ],
)  # fmt: skip
def test_messages_have_channels_of_their_own_where_they_overtake_each_other(endpoint: str, count: int) -> None:
    channels = channels_of(zenoh_config(ZenohSettings(connect=(endpoint,))))
    assert len({str(channel) for channel in channels}) == len(channels) == count
    every = sample_every(channels, 200.0)
    assert every == 1 if not count else every * count >= 200.0 * SPACING_S > (every - 1) * count


def test_the_number_of_a_frame_is_read_where_the_page_has_it() -> None:
    assert sequence_of(encode(Position(2**64 - 1, 2**40 + 7, 2**60, (0.1, 0.2), 3, 4))) == 2**40 + 7
    assert sequence_of(b"") is None
    assert sequence_of(b"\x98\x02\x01") is None


async def test_all_messages_arrive_on_the_same_key_whatever_their_channel() -> None:
    address = free_address("udp")
    world = Side("world", ZenohSettings(listen=(address,)))
    device = Side("device", ZenohSettings(connect=(address,)))
    assert device.transport.sampled == 4
    stream = Session(role="device", dof=1, name="d", incarnation=1).positions
    async with opened(world, device):
        await paired(world, device)
        for k in range(40):
            data = stream.position(k, [0.0])
            assert device.transport.put("position", data)
            assert await asyncio.wait_for(world.received.get(), 30.0) == ("position", data)


@pytest.mark.parametrize("count", mostly_slow([1000, 3000], 0, 1))
async def test_over_udp_the_relay_and_the_path_lose_the_same(count: int) -> None:
    """A hundred messages a second; the sample is 50 of them, so that 30 s have a standard error of 0.7 points."""
    async with talking("udp", lossy_relay("delay 60ms 20ms distribution normal loss 5%", 3)) as two:
        await two.until(lambda: all(side.session.path.figures().sent >= count for side in two.sides), 120.0)
        for side in two.sides:
            known = side.session.path.figures()
            assert known.lost / known.sent == pytest.approx(0.05, abs=0.021 * (3000 / count) ** 0.5)
            assert known.overtaken > 0.2 * known.sent
            assert known.round_trip_p50_ns == pytest.approx(120 * MS, rel=0.1)
