"""Energy in a session: whatever happens to pairs, no nanojoule is created, and each is accounted for."""

from typing import Any

import pytest

from hapnet.wire.events import PeerLeft, PositionReceived
from hapnet.wire.messages import Bye, Role, decode, encode
from hapnet.wire.session import Session, SessionSettings
from tests.conftest import mostly_slow
from tests.support.sessions import MS, Network, paired, session


@pytest.mark.parametrize("seed", mostly_slow(range(8), 1))
@pytest.mark.long
def test_hostile_channel_loses_and_creates_no_energy(seed: int) -> None:
    device, world = session("device", 1), session("world", 2)
    network = Network(device, world, seed=seed, loss=0.4, repeat=0.3, jitter=80 * MS)
    for _ in range(100):
        for s in (device, world):
            s.shuffle(network.rng.expovariate(1e3))
            network.put(s, s.position(network.now, [0.5]))
        network.run(network.rng.randrange(1, 30) * MS)
    network.loss = 0.0
    network.run(6000 * MS)
    assert device.settled
    assert world.settled
    for here, there in ((device, world), (world, device)):
        assert there.credited_nJ == here.acked_nJ == here.sent_nJ - here.abandoned_nJ > 0
        received = [e.sequence for e in network.happened(here) if isinstance(e, PositionReceived)]
        assert received == sorted(set(received))
        assert len(received) > 10
    assert device.next_due_ns is None
    assert set(device.dropped) <= {"stale", "unpaired"}


def test_the_reservoirs_of_the_peers_are_added_up_and_a_restarted_one_starts_with_none() -> None:
    def with_reservoir(role: Role, incarnation: int, value: Any) -> Session:
        return Session(role=role, dof=1, name=role, incarnation=incarnation, about={"reservoir_J": value})

    device, world = with_reservoir("device", 1, 0.03), with_reservoir("world", 2, 0.05)
    network = Network(device, world)
    network.run(300 * MS)
    assert (device.peers_J, world.peers_J) == (0.05, 0.03)
    network.kill(world)
    network.run(600 * MS)
    reborn = with_reservoir("world", 3, 0.05)
    network.sessions.append(reborn)
    network.run(600 * MS)
    assert (device.incarnations, device.peers_J, reborn.peers_J) == (2, 0.05, 0.03)
    for nonsense in (-1.0, "much", True, None):
        network = Network(one := session("device", 1), with_reservoir("world", 2, nonsense))
        network.run(300 * MS)
        assert (one.incarnations, one.peers_J) == (1, 0.0)


def test_bye_settles_the_account_exactly() -> None:
    network, device, world = paired()
    world.shuffle(3e-6)
    device.shuffle(5e-6)
    network.run(8 * MS)  # delivered; the acknowledgements are still owed
    assert (device.credited_nJ, world.acked_nJ) == (3000, 0)
    device.close(network.now, "the\nend")
    assert device.settled
    network.run(300 * MS)
    assert network.happened(world)[-1] == PeerLeft("the end")
    assert (world.acked_nJ, world.abandoned_nJ, world.peer) == (3000, 0, None)
    assert (device.next_due_ns, device.poll(network.now)) == (None, ([], ()))
    byes = [d for d in network.sent if isinstance(decode(d), Bye)]
    assert len(byes) == 3
    assert device.receive(network.now, b"x") == ()
    assert device.dropped["closed"] > 0


@pytest.mark.parametrize("addressee", [0, 77])
def test_a_bye_to_somebody_else_ends_the_pair_and_acknowledges_nothing(addressee: int) -> None:
    """The sender is gone whoever it says so to; but what it credited, it credited to the one that it speaks to."""
    network, device, _ = paired()
    device.shuffle(3e-6)
    device.poll(network.now)
    assert device.receive(network.now, encode(Bye(2, addressee, 2000, "gone"))) == (PeerLeft("gone"),)
    assert (device.peer, device.acked_nJ, device.abandoned_nJ) == (None, 0, 3000)
    network, device, _ = paired()
    device.shuffle(3e-6)
    device.poll(network.now)
    device.receive(network.now, encode(Bye(2, 1, 2000, "gone")))
    assert (device.peer, device.acked_nJ, device.abandoned_nJ) == (None, 2000, 1000)


def test_energy_given_after_the_end_is_abandoned() -> None:
    network, device, _ = paired()
    device.shuffle(1e-6)
    network.run(300 * MS)
    device.close(network.now, "the end")
    assert device.peer is not None
    device.shuffle(2e-6)
    assert (device.sent_nJ, device.acked_nJ, device.abandoned_nJ, device.in_flight_nJ) == (3000, 1000, 2000, 0)
    assert device.settled


def test_what_the_first_peer_began_with_counts_and_what_a_later_one_says_does_not() -> None:
    """Those after it begin with nothing, whatever they say: else a crash loop would raise the bound."""
    device = session("device", 1)
    network = Network(device)
    for incarnation, reservoir_J, counted_J in ((2, 0.05, 0.05), (3, 0.5, 0.05), (4, 7.0, 0.05)):
        about: dict[str, Any] = {"reservoir_J": reservoir_J}
        world = Session(role="world", dof=1, name="world", incarnation=incarnation, about=about)
        network.sessions.append(world)
        network.run(1200 * MS)
        assert device.peer == world.identity
        assert device.peers_J == counted_J
        network.kill(world)
        network.run(600 * MS)


def test_energy_without_a_peer_is_abandoned_and_counted() -> None:
    device = session("device", 1)
    for _ in range(2):
        device.shuffle(2.6e-9)
    assert (device.sent_nJ, device.abandoned_nJ, device.settled) == (5, 5, True)
    world = session("world", 2)
    device.shuffle(0.4e-9)
    Network(device, world).run(300 * MS)
    assert device.peer is not None
    device.shuffle(0.5e-9)  # the fraction came along
    assert device.sent_nJ == 6


def test_what_the_bucket_kept_waiting_comes_from_poll() -> None:
    device = session("device", 1, settings=SessionSettings(admission_W=1.0, admission_burst_J=0.001))
    world = session("world", 2)
    network = Network(device, world)
    network.run(300 * MS)
    world.shuffle(0.003)
    network.run(5 * MS)
    assert device.credited_nJ == 10**6
    network.run(100 * MS)
    assert (device.credited_nJ, world.settled) == (3 * 10**6, True)


def test_a_restart_earns_no_fresh_burst() -> None:
    device = session("device", 1, settings=SessionSettings(admission_W=1e-9, admission_burst_J=0.001))
    network = Network(device)
    for incarnation in range(2, 7):
        world = session("world", incarnation)
        network.sessions.append(world)
        network.run(400 * MS)
        assert device.peer == world.identity
        world.shuffle(1.0)
        network.run(50 * MS)
        network.kill(world)
        network.run(400 * MS)  # with the 50 before, so long that the next one is no rival
        assert 10**6 <= device.credited_nJ <= 10**6 + 5
    assert device.incarnations == 5
