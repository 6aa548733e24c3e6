"""The streams of couplings in a session: each kind is taken as its law needs it."""

import random
from typing import Any

import pytest
from msgspec import structs

from hapnet.wire.events import Mismatch, PositionReceived, SampleReceived
from hapnet.wire.messages import Motion, Port, Position, Proxy, Stream, Wave, encode
from hapnet.wire.session import Session, SessionSettings
from tests.support.sessions import MS, Network, session


def expecting(kind: type[Stream], **more: Any) -> tuple[Session, Session]:
    """A device that takes this kind, and its peer."""
    device = session("device", 1, settings=SessionSettings(expects=kind, **more))
    world = session("world", 2)
    Network(device, world).run(300 * MS)
    assert device.peer == world.identity
    return device, world


def of_kind(kind: type[Stream], number: int, *, dof: int = 1) -> Stream:
    value = (0.1 * number,) * dof
    last: dict[type[Stream], Any] = {Motion: (value,), Port: (number,), Wave: (1 + number,)}
    last[Proxy] = (number, value, None)
    return kind(2, number, 1, value, *last.get(kind, ()))


KINDS: tuple[type[Stream], ...] = (Position, Motion, Port, Wave, Proxy)


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_stream_that_the_coupling_takes_is_handed_out(kind: type[Stream]) -> None:
    device, _ = expecting(kind)
    for number, other in enumerate(KINDS):
        message = of_kind(other, number)
        events = device.receive(300 * MS, encode(message))
        if other is not kind:
            assert events == ()
        elif isinstance(message, Position):
            assert events == (PositionReceived(message.sequence, message.sent_ns, message.position, 0),)
        else:
            assert events == (SampleReceived(message),)
    assert device.dropped == {"stream": len(KINDS) - 1}
    assert device.dropped_for["stream"].endswith(f"allowed with this coupling: a {kind.__name__.lower()}")


@pytest.mark.parametrize("kind", KINDS)
def test_of_other_dimensions_or_from_others_it_is_dropped(kind: type[Stream]) -> None:
    device, _ = expecting(kind)
    assert device.receive(300 * MS, encode(of_kind(kind, 1, dof=2))) == ()
    assert device.receive(300 * MS, encode(structs.replace(of_kind(kind, 1), incarnation=9))) == ()
    assert device.dropped == {"dimension": 1, "rival": 1}


@pytest.mark.parametrize("kind", KINDS)
def test_what_comes_late_is_taken_by_its_kind(kind: type[Stream]) -> None:
    """0, 3, 1, 3, 2, 1: of waves all once; of positions none that is older, unless asked for; of the rest none.
    No copy is taken."""
    for stale, taken in ((False, [0, 3]), (True, [0, 3, 1, 2] if kind is Position else [0, 3])):
        device, _ = expecting(kind, accept_stale=stale)
        if kind is Wave:
            taken = [0, 3, 1, 2]
        order = (0, 3, 1, 3, 2, 1)
        assert [n for n in order if device.receive(300 * MS, encode(of_kind(kind, n)))] == taken
        assert device.dropped["stale"] == len(order) - len(taken)


def test_each_wave_of_a_bad_link_is_used_once() -> None:
    """Lost, repeated, and each up to 200 places late: those that came at all are handed out once each."""
    device, world = expecting(Wave)
    rng = random.Random(3)
    frames = [(number, world.positions.wave(number, (0.0,), 1)) for number in range(2000)]
    arrive = sorted(
        (number + rng.uniform(0.0, 200.0), number, data)
        for number, data in frames
        for _ in range(rng.choice((0, 1, 1, 2)))
    )
    taken = []
    for place, _, data in arrive:
        for event in device.receive(300 * MS + round(place * 5 * MS), data):
            assert isinstance(event, SampleReceived)
            taken.append(event.message.sequence)
    assert sorted(taken) == sorted({number for _, number, _ in arrive})
    assert device.dropped["stale"] == len(arrive) - len(taken) > 0


def test_a_wave_far_behind_counts_as_used() -> None:
    device, _ = expecting(Wave)
    for number in (0, 1500):
        assert device.receive(300 * MS, encode(of_kind(Wave, number)))
    assert device.receive(300 * MS, encode(of_kind(Wave, 476))) == ()
    assert device.receive(300 * MS, encode(of_kind(Wave, 477)))


def test_a_forged_wave_far_ahead_silences_nobody() -> None:
    device, world = expecting(Wave)
    for k in range(10):
        assert device.receive(300 * MS + 5 * k * MS, world.positions.wave(5 * k * MS, (0.0,), 1))
    assert device.receive(350 * MS, encode(Wave(2, 1900, 50 * MS, (0.5,), 1)))
    taken = [
        len(device.receive(350 * MS + 5 * k * MS, world.positions.wave(50 * MS + 5 * k * MS, (0.0,), 1)))
        for k in range(1, 10)
    ]
    assert taken == [0, *[1] * 8]


def test_another_peers_waves_are_counted_anew() -> None:
    device, world = expecting(Wave)
    assert device.receive(300 * MS, encode(of_kind(Wave, 5)))
    other = session("world", 3)
    network = Network(device, other)
    network.now = 2000 * MS
    network.run(300 * MS)
    assert device.peer == other.identity
    assert device.receive(network.now, encode(structs.replace(of_kind(Wave, 5), incarnation=3)))
    assert device.receive(network.now, encode(of_kind(Wave, 6))) == ()
    assert world.identity.incarnation == 2


def test_a_streams_energy_is_as_the_newest_says_it() -> None:
    """One that leapt by a flipped bit is repaired by the next."""
    device, _ = expecting(Port)
    for number, energy_nJ in enumerate((5, 2**62, 6)):
        message = Port(2, number, 1, (0.0,), energy_nJ)
        assert device.receive(300 * MS, encode(message)) == (SampleReceived(message),)


@pytest.mark.parametrize(
    ("mine", "theirs", "fits"),
    [
        ({"shared.b": 2.5}, {"shared.b": 2.5}, True),
        ({"shared.b": 2.5}, {"shared.b": 2.6}, False),
        ({"shared.b": 2.5}, {"shared.b": "2.5"}, False),
        ({"shared.b": 2.5}, {}, True),
        ({}, {"shared.b": 2.5}, True),
        ({"b": 2.5}, {"b": 2.6}, True),
    ],
)
def test_what_is_shared_must_be_the_same(mine: dict[str, Any], theirs: dict[str, Any], fits: bool) -> None:
    device = Session(role="device", dof=1, name="pen", incarnation=1, about=mine)
    world = Session(role="world", dof=1, name="wall", incarnation=2, about=theirs)
    network = Network(device, world)
    network.run(300 * MS)
    assert (device.peer == world.identity) is fits
    if not fits:
        (mismatch,) = network.happened(device, Mismatch)
        assert mismatch == Mismatch(f"wall has b {theirs['shared.b']}, pen has 2.5: both must have the same")
