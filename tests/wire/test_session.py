"""A session: who is paired with whom, what is refused and dropped, and what is said of it."""

import random
from typing import Any

import msgpack
import pytest

from hapnet.errors import InvalidParameter
from hapnet.wire.control_sender import MAX_REPLIES
from hapnet.wire.events import (
    Contradiction,
    EnergyCredited,
    Mismatch,
    Paired,
    PeerHeard,
    PeerLeft,
    PeerRefused,
    PeerSilent,
    PositionReceived,
)
from hapnet.wire.messages import Bye, Energy, Hello, Identity, Position, Refuse, Welcome, decode, encode
from hapnet.wire.peer_monitor import Outages
from hapnet.wire.session import Session, SessionSettings
from tests.support.sessions import MS, Network, paired, session


def test_pairs_once_and_falls_silent() -> None:
    network, device, world = paired()
    assert network.happened(device) == [Paired(world.identity, 1)]
    assert network.happened(world) == [Paired(device.identity, 1)]
    before = len(network.sent)
    network.run(1000 * MS)
    assert len(network.sent) == before <= 8
    assert (device.next_due_ns, world.next_due_ns) == (None, None)
    assert not device.dropped + world.dropped


def test_the_second_may_start_much_later() -> None:
    device, world = session("device", 1), session("world", 2)
    network = Network(device)
    network.run(1000 * MS)
    assert len(network.sent) == 10  # one hello a period
    network.sessions.append(world)
    network.run(230 * MS)
    assert device.peer is not None
    assert world.peer is not None


def test_positions_newest_wins_unless_stale_ones_are_wanted() -> None:
    for accept, expected in ((False, [1, 2]), (True, [1, 0, 2])):
        device = session("device", 1)
        world = session("world", 2, settings=SessionSettings(accept_stale=accept))
        Network(device, world).run(300 * MS)
        frames = [device.position(k, [0.25]) for k in range(3)]
        events = [e for k in (1, 0, 2, 2) for e in world.receive(400 * MS, frames[k])]
        assert [e[:3] for e in events] == [(k, k, (0.25,)) for k in expected]
        assert world.dropped["stale"] == 4 - len(expected)


def test_restart_makes_a_new_pair_and_abandons_what_was_in_flight() -> None:
    network, device, world = paired()
    device.shuffle(0.5e-6)
    network.run(300 * MS)
    network.kill(world)
    device.shuffle(1e-6)
    network.run(300 * MS)
    late = [item for item in network.path if item[1] is device]
    assert device.in_flight_nJ == 1000
    reborn = session("world", 3)
    network.sessions.append(reborn)
    network.run(300 * MS)
    for _ in range(20):  # positions of the survivor reach a stranger, and the other way round
        network.put(device, device.position(network.now, [0.0]))
        network.put(reborn, reborn.position(network.now, [0.0]))
        network.run(20 * MS)
    assert network.happened(device, Paired) == [Paired(world.identity, 1), Paired(reborn.identity, 2)]
    assert (device.sent_nJ, device.acked_nJ, device.abandoned_nJ, device.in_flight_nJ) == (1500, 500, 1000, 0)
    assert (reborn.credited_nJ, device.incarnations, reborn.incarnations) == (0, 2, 1)
    for _, _, data in late:
        assert reborn.receive(network.now, data) == ()
    device.shuffle(2e-6)
    network.run(300 * MS)
    assert (reborn.credited_nJ, device.settled) == (2000, True)


def test_frames_of_the_dead_change_nothing() -> None:
    network, device, world = paired()
    world.shuffle(1e-6)
    network.run(300 * MS)
    old = [data for data in network.sent if decode(data).incarnation == 2] + [world.position(0, [1.0])]
    network.kill(world)
    reborn = session("world", 3)
    network.sessions.append(reborn)
    network.put(reborn, reborn.position(network.now, [0.0]))
    network.run(500 * MS)
    assert device.peer == reborn.identity
    for data in old * 2:
        assert device.receive(network.now, data) == ()
    assert device.peer == reborn.identity
    assert device.credited_nJ == 1000
    assert device.dropped["retired"] >= 2 * (len(old) - 3)


def test_what_a_dead_process_left_cannot_displace_the_living() -> None:
    """A world that never paired dies; its hello, and a welcome to an early hello, arrive after its successor's."""
    device = session("device", 1)
    dead = session("world", 9)
    hello = dead.poll(0)[0][0].data
    early = device.poll(0)[0][0].data
    dead.receive(0, early)
    welcome = dead.poll(0)[0][0].data
    assert isinstance(decode(welcome), Welcome)
    world = session("world", 2)
    network = Network(device, world)
    network.now = 200 * MS
    network.run(600 * MS)
    assert device.peer == world.identity
    for data in (hello, welcome, hello):
        assert device.receive(network.now, data) == ()
        network.run(300 * MS)
        assert device.peer == world.identity
    assert network.happened(device) == [Paired(world.identity, 1)]
    assert device.dropped == {"stale": 1}


@pytest.mark.long
def test_a_rival_waits_until_the_peer_is_silent() -> None:
    """Two worlds under one name: the second gets nothing, not even an answer, as long as the first is heard."""
    network, device, world = paired()
    rival = session("world", 3)
    network.sessions.append(rival)
    for _ in range(100):
        network.put(world, world.position(network.now, [0.0]))
        network.put(rival, rival.position(network.now, [1.0]))
        network.run(20 * MS)
    assert (device.peer, rival.peer) == (world.identity, None)
    positions = [e.position for e in network.happened(device, PositionReceived) if isinstance(e, PositionReceived)]
    assert positions
    assert set(positions) == {(0.0,)}
    assert device.dropped.keys() == {"rival"}
    assert not [data for data in network.sent if decode(data).incarnation == 1 and isinstance(decode(data), Refuse)]
    replay = [data for data in network.sent if decode(data).incarnation == 2]
    network.kill(world)
    for _ in range(45):  # what the dead one said is no sign of life
        for data in replay:
            device.receive(network.now, data)
        network.run(20 * MS)
    assert device.peer == rival.identity


@pytest.mark.long
def test_of_two_that_wait_one_is_welcomed() -> None:
    """Else both would believe themselves the peer, and both would start with a full reservoir."""
    for seed in range(20):
        world, *devices = session("world", 1), session("device", 2), session("device", 3)
        network = Network(*devices, seed=seed, jitter=100 * MS)
        network.run(300 * MS)
        network.sessions.append(world)
        for _ in range(100):
            for device in devices:
                network.put(device, device.position(network.now, [0.0]))
            network.run(20 * MS)
        assert [device.peer is None for device in devices].count(True) == 1
        assert world.peer in [device.identity for device in devices if device.peer is not None]


def test_a_position_that_has_leapt_deafens_nobody() -> None:
    """A forger's one position in the peer's name, with the highest number there is, must not be the last one heard."""
    network, device, world = paired()
    world.receive(network.now, device.position(network.now, [0.0]))
    assert world.receive(network.now, encode(Position(1, 2**64 - 1, network.now, (0.5,)))) == ()
    network.run(5000 * MS)
    assert len(world.receive(network.now, device.position(network.now, [0.0]))) == 2  # heard again
    assert world.dropped == {"leap": 1}


def test_a_strangers_refusal_ends_nothing_and_is_told_only_when_the_peer_is_silent() -> None:
    """Anybody who hears a hello can send one; it must not be printed as the peer's."""
    network, device, world = paired()
    refusal = encode(Refuse(77, 1, "not you"))
    assert device.receive(network.now, refusal) == ()
    assert device.dropped == {"rival": 1}
    network.run(600 * MS)  # the peer says nothing
    assert device.receive(network.now, refusal) == (PeerRefused("not you", by_peer=False),)
    assert device.peer == world.identity


def test_while_somebody_is_about_to_be_the_peer_others_refuse_in_vain() -> None:
    device, world = session("device", 1), session("world", 2)
    device.receive(0, world.poll(0)[0][0].data)  # its hello
    assert device.receive(MS, encode(Refuse(77, 1, "not you"))) == ()
    assert device.dropped == {"rival": 1}
    assert device.receive(2 * MS, encode(Refuse(2, 1, "changed my mind"))) == (PeerRefused("changed my mind"),)


def test_a_silence_is_told_once_and_counted() -> None:
    network, device, world = paired()
    for _ in range(3):
        world.receive(network.now, device.position(network.now, [0.0]))
        network.run(400 * MS)
        assert world.watch(network.now) == ()
    last = network.now - 400 * MS
    device.position(network.now, [0.0])  # lost
    network.run(200 * MS)
    assert world.watch(network.now) == (PeerSilent(last),)
    assert world.watch(network.now) == ()
    assert world.outages(network.now).max_ns == 600 * MS
    energy = encode(Energy(1, 2, 0, 0))
    world.receive(last + 700 * MS, energy)
    events = world.receive(last + 730 * MS, device.position(last + 730 * MS, [0.0]))
    assert events[1] == PeerHeard(silence_ns=730 * MS, recovery_ns=30 * MS, missing=1)
    assert world.watch(last + 740 * MS) == ()
    assert world.outages(last + 740 * MS) == Outages(1, 730 * MS, 730 * MS, 30 * MS, received=4, missing=1)


def test_a_displaced_peer_is_told_and_never_comes_back() -> None:
    network, device, world = paired()
    rival = session("world", 3)
    network.sessions.append(rival)
    network.run(900 * MS)  # the first says nothing, so it is taken for dead
    assert device.peer == rival.identity
    assert network.happened(world)[1] == PeerRefused("replaced by world-3", by_peer=True)
    world.shuffle(1.0)
    network.run(2000 * MS)
    assert device.peer == rival.identity
    assert world.peer is None
    assert device.credited_nJ == 0
    assert world.abandoned_nJ == 10**9


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (session("world", 2, dof=3), "degrees of freedom"),
        (session("device", 2), "both sides are a device"),
    ],
)
def test_misfits_are_refused_in_words_once(other: Session, reason: str) -> None:
    device = session("device", 1)
    network = Network(device, other)
    network.one_key = True
    network.run(1500 * MS)
    for s in (device, other):
        assert s.peer is None
        events = network.happened(s)
        assert {type(e) for e in events} == {Mismatch, PeerRefused}
        assert len(events) == 2
        assert all(reason in e.reason for e in events if isinstance(e, Mismatch | PeerRefused))


def test_another_version_is_refused_in_words() -> None:
    device = session("device", 1)
    hello = msgpack.packb([3, Hello.KIND, 77, "new fields"])
    assert device.receive(0, hello) == (Mismatch("peer speaks protocol 3, this side speaks 2"),)
    assert device.receive(0, hello) == ()
    replies = [decode(o.data) for o in device.poll(0)[0]]
    assert Refuse(1, 77, "peer speaks protocol 3, this side speaks 2") in replies
    assert device.receive(0, msgpack.packb([3, 5, 77, 1, "speak 3"])) == (PeerRefused("speak 3"),)
    assert device.dropped == {"version": 2}


# what version 1 said: a hello, a refusal, a position (the golden frames of that version)
HELLO_1 = "980103cf112233445566778801a664657669636503a370656e80"
POSITION_1 = "960101cf112233445566778807ce3b9aca0091cb3f847ae147ae147b"


def test_version_1_is_refused_in_words_that_it_understands() -> None:
    world = session("world", 2, dof=3)
    sender = 0x1122334455667788
    assert world.receive(0, bytes.fromhex(HELLO_1)) == (Mismatch("peer speaks protocol 1, this side speaks 2"),)
    refusal = next(data for _, data in world.poll(0)[0] if data[2] == Refuse.KIND)
    # by version 1: an array of five, whatever the version, with kind 5, incarnations and a text
    assert msgpack.unpackb(refusal) == [2, 5, 2, sender, "peer speaks protocol 1, this side speaks 2"]
    assert world.receive(0, bytes.fromhex(POSITION_1)) == ()
    assert world.dropped == {"version": 2}
    answer = msgpack.packb([1, 5, sender, 2, "peer speaks protocol 2, this side speaks 1"])  # to a hello of version 2
    assert world.receive(0, answer) == (PeerRefused("peer speaks protocol 2, this side speaks 1"),)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("own", Position(1, 5, 0, (0.0,))),
        ("stranger", Position(8, 5, 0, (0.0,))),
        ("dimension", Position(2, 5, 0, (0.0, 0.0))),
        ("addressee", Energy(2, 9, 10, 0)),
        ("stranger", Energy(9, 1, 10, 0)),
        ("addressee", Welcome(8, 7, 1, "world", 1, "w", {})),
        ("stale", Welcome(8, 1, 10**6, "world", 1, "w", {})),
        ("stranger", Bye(8, 1, 0, "")),
    ],
)
def test_bad_messages_are_counted_and_change_nothing(kind: str, message: Any) -> None:
    _, device, world = paired()
    assert device.receive(10**9, encode(message)) == ()  # long after the last position: a stranger is no rival
    assert device.dropped == {kind: 1}
    assert (device.peer, device.credited_nJ) == (world.identity, 0)


def test_an_acknowledgement_of_what_was_never_announced_is_told_and_the_rest_counts() -> None:
    """So that a forged total, which makes the other side acknowledge too much, does not end the stream back."""
    _, device, _ = paired()
    reported, credited = device.receive(10**9, encode(Energy(2, 1, 10, 1)))
    assert isinstance(reported, Contradiction)
    assert reported.kind == "acknowledged"
    assert credited == EnergyCredited(10)
    assert device.receive(10**9, encode(Energy(2, 1, 15, 7))) == (EnergyCredited(5),)  # reported once
    assert (device.acked_nJ, device.dropped.total()) == (0, 0)
    assert isinstance(device.receive(10**9, encode(Bye(2, 1, 10, "")))[-1], PeerLeft)
    assert device.sums.contradictions == {"acknowledged": 3}


@pytest.mark.long
def test_a_flood_of_strangers_costs_bounded_memory_and_replies() -> None:
    network, device, world = paired()
    replies = 0
    for k in range(20_000):
        now = 10**9 + k * 10_000  # 0.2 s
        device.receive(now, encode(Hello(1000 + k, 1, "world", 1, "w", {})))
        replies += len(device.poll(now)[0])
    assert replies <= 21 * MAX_REPLIES + 11
    assert device.peer == world.identity
    assert not network.happened(device)[1:]


@pytest.mark.long
def test_noise_never_raises_and_the_account_holds() -> None:
    network, device, world = paired()
    device.shuffle(1e-3)
    network.run(300 * MS)
    frames = [*network.sent, world.position(0, [0.0])]
    rng = random.Random(3)
    for k in range(20_000):
        data = bytearray(rng.choice(frames))
        for _ in range(rng.randrange(3)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        device.receive(10**9 + k, bytes(data[: rng.randrange(1, 200)]))
        device.poll(10**9 + k)
        assert device.sent_nJ == device.acked_nJ + device.in_flight_nJ + device.abandoned_nJ
    assert len(device.dropped) <= 16


@pytest.mark.parametrize(
    "change",
    [
        {"incarnation": 0},
        {"incarnation": 2**64},
        {"dof": 0},
        {"dof": 65},
        {"name": ""},
        {"name": "two\nlines"},
        {"role": "human"},
        {"about": {"a": float("nan")}},
        {"about": {f"{k:0250}": "x" * 250 for k in range(20)}},
        {"about": {"a": object()}},
    ],
)
def test_an_identity_no_peer_would_accept_is_refused_at_once(change: dict[str, Any]) -> None:
    given: dict[str, Any] = {"role": "device", "dof": 1, "name": "pen", "incarnation": 5} | change
    with pytest.raises(InvalidParameter, match="identity"):
        Session(**given)


def test_bad_settings() -> None:
    with pytest.raises(InvalidParameter, match="hello_period_ns"):
        SessionSettings(hello_period_ns=0)
    with pytest.raises(InvalidParameter, match="silence_ns"):
        SessionSettings(silence_ns=0)
    assert SessionSettings(hello_period_ns=MS, spacing_ns=10_000 * MS, silence_ns=1).silence_ns == 1
    with pytest.raises(InvalidParameter, match="admission"):
        session("device", 1, settings=SessionSettings(admission_W=-1.0))


def test_identity_is_what_the_peer_sees() -> None:
    device = Session(role="device", dof=2, name="pen", incarnation=5, about={"program": "x", "sampled": True})
    world = session("world", 2, dof=2)
    Network(device, world).run(300 * MS)
    assert world.peer == Identity(5, "device", 2, "pen", {"program": "x", "sampled": True})
