"""Who becomes the peer, at the edges of the rules: welcomes by number, couplings, and the last peer of a long life."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hapnet.errors import BadMessage
from hapnet.wire.events import Event, Mismatch, Paired
from hapnet.wire.handshake import COUPLING, HELLO_PERIOD_NS, MAX_PEERS, Handshake
from hapnet.wire.messages import Bye, Hello, Identity, Refuse, Role, Scalar, Welcome

MS = 1_000_000
ME = Identity(1, "device", 2, "pen", {COUPLING: "pspm"})


def side(**about: Scalar) -> Handshake:
    """A side whose peer, if it has one, is never heard."""
    me = Identity(1, "device", 2, "pen", {**ME.about, **about})
    return Handshake(me, lambda now_ns: False, HELLO_PERIOD_NS)


def welcome(number: int, incarnation: int = 2, role: Role = "world", dof: int = 2, **about: Scalar) -> Welcome:
    return Welcome(incarnation, 1, number, role, dof, "wall", {COUPLING: "pspm", **about})


def taken(handshake: Handshake, message: Welcome, now_ns: int) -> bool:
    try:
        return any(isinstance(event, Paired) for event in handshake.welcome(message, now_ns))
    except BadMessage as error:
        if error.kind != "stale":
            raise
        return False


def after_hellos(count: int) -> Handshake:
    handshake = side()
    for k in range(count):
        (said,) = handshake.poll(k * HELLO_PERIOD_NS)
        assert isinstance(said, Hello)
        assert said.number == k + 1
    return handshake


@pytest.mark.parametrize(("number", "pairs"), [(0, False), (1, True), (3, True), (4, False), (2**64 - 1, False)])
def test_a_welcome_must_be_to_a_hello_that_was_said(number: int, pairs: bool) -> None:
    """Three were: to the first and the last of them, not to none and not to one that is still to come."""
    handshake = after_hellos(3)
    assert taken(handshake, welcome(number), 1000 * MS) is pairs
    assert (handshake.peer is not None) is pairs


@pytest.mark.parametrize("ended", [False, True])
@pytest.mark.parametrize(("number", "pairs"), [(3, False), (4, True), (5, False)])
def test_after_a_pairing_or_its_end_only_later_hellos_count(number: int, pairs: bool, ended: bool) -> None:
    """Three hellos were said when the pair was made, or when it ended, and one after that, as a stranger spoke."""
    handshake = after_hellos(3)
    assert taken(handshake, welcome(3), 600 * MS)
    if ended:
        handshake.bye(Bye(2, 1, 0, "the end"), 700 * MS)
    else:
        with pytest.raises(BadMessage):
            handshake.check_peer(9, 700 * MS)
    (said,) = handshake.poll(800 * MS)
    assert isinstance(said, Hello)
    assert said.number == 4
    assert taken(handshake, welcome(number, incarnation=3), 900 * MS) is pairs
    assert handshake.pairs == 1 + pairs


def test_a_hello_said_before_the_pair_ended_is_too_old_after_it() -> None:
    handshake = after_hellos(3)
    assert taken(handshake, welcome(3), 600 * MS)
    with pytest.raises(BadMessage):
        handshake.check_peer(9, 700 * MS)  # a stranger speaks, so the fourth is said
    assert [said.number for said in handshake.poll(700 * MS) if isinstance(said, Hello)] == [4]
    handshake.bye(Bye(2, 1, 0, "the end"), 800 * MS)
    assert not taken(handshake, welcome(4, incarnation=3), 900 * MS)
    assert [said.number for said in handshake.poll(1000 * MS) if isinstance(said, Hello)] == [5]
    assert taken(handshake, welcome(5, incarnation=3), 1100 * MS)


def refused(handshake: Handshake, events: tuple[Event, ...], now_ns: int) -> Iterator[str]:
    """What it says to whom it refuses; it tells the same of itself."""
    (event,) = events
    assert isinstance(event, Mismatch)
    for said in handshake.poll(now_ns):
        if isinstance(said, Refuse):
            assert said.reason == event.reason
            yield said.reason


def test_another_coupling_is_refused_whoever_asks() -> None:
    handshake = after_hellos(1)
    hello = Hello(2, 1, "world", 2, "wall", {COUPLING: "zoh"})
    why = ["wall runs the coupling zoh, pen runs pspm"]
    assert list(refused(handshake, handshake.hello(hello, 300 * MS), 300 * MS)) == why
    answer = welcome(1, incarnation=3, coupling="zoh")
    assert list(refused(handshake, handshake.welcome(answer, 400 * MS), 500 * MS)) == why
    assert handshake.peer is None


@pytest.mark.parametrize("theirs", [{COUPLING: "pspm"}, {COUPLING: None}, {}])
def test_the_same_coupling_fits_and_so_does_none(theirs: dict[str, Scalar]) -> None:
    handshake = after_hellos(1)
    assert handshake.hello(Hello(2, 1, "world", 2, "wall", theirs), 300 * MS) == ()
    assert any(isinstance(said, Welcome) for said in handshake.poll(300 * MS))


def test_after_so_many_peers_a_side_pairs_no_more() -> None:
    """The list of the retired is what keeps energy from being credited twice: it is never shortened, and ends."""
    handshake = side()
    now_ns, number, limit = 0, 0, MAX_PEERS
    for incarnation in range(2, limit + 2):
        now_ns += HELLO_PERIOD_NS
        number += sum(isinstance(said, Hello) for said in handshake.poll(now_ns))
        assert taken(handshake, welcome(number, incarnation), now_ns), incarnation
        handshake.bye(Bye(incarnation, 1, 0, "the end"), now_ns)
    assert handshake.pairs == limit == 4096
    now_ns += HELLO_PERIOD_NS
    number += sum(isinstance(said, Hello) for said in handshake.poll(now_ns))
    late = handshake.welcome(welcome(number, limit + 2), now_ns)
    assert list(refused(handshake, late, now_ns + HELLO_PERIOD_NS)) == ["this side has seen 4096 peers; restart it"]
    assert handshake.peer is None
    with pytest.raises(BadMessage, match="was the peer once"):
        handshake.hello(Hello(2, 1, "world", 2, "wall", {}), now_ns)  # the first of them is not forgotten
