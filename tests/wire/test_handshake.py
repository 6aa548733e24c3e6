"""Who becomes the peer, at the edges of the rules: welcomes by number, couplings, and the last peer of a long life."""

import contextlib
import pickle
from collections.abc import Iterator

import pytest

from hapnet.errors import BadMessage, LocalProtocolError
from hapnet.wire.events import Event, Mismatch, Paired
from hapnet.wire.handshake import MAX_PEERS, Handshake
from hapnet.wire.identity import COUPLING, EARLIER
from hapnet.wire.messages import Bye, Hello, Identity, Refuse, Role, Scalar, Welcome
from hapnet.wire.pairing import TRANSITIONS, Action, Input, PairingState, transition

MS = 1_000_000
PERIOD_NS = 100 * MS
ME = Identity(1, "device", 2, "pen", {COUPLING: "pspm"})


def side(**about: Scalar) -> Handshake:
    """A side whose peer, if it has one, is never heard."""
    me = Identity(1, "device", 2, "pen", {**ME.about, **about})
    return Handshake(me, lambda now_ns: False, PERIOD_NS)


def welcome(number: int, incarnation: int = 2, role: Role = "world", dof: int = 2, **about: Scalar) -> Welcome:
    return Welcome(incarnation, 1, number, role, dof, "wall", {COUPLING: "pspm", **about})


def taken(handshake: Handshake, message: Welcome, now_ns: int) -> bool:
    try:
        return any(isinstance(event, Paired) for event in handshake.receive(message, now_ns))
    except BadMessage as error:
        if error.kind != "stale":
            raise
        return False


def after_hellos(count: int) -> Handshake:
    handshake = side()
    for k in range(count):
        ((said, _),) = handshake.poll(k * PERIOD_NS)
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
        handshake.receive(Bye(2, 1, 0, "the end"), 700 * MS)
    else:
        with pytest.raises(BadMessage):
            handshake.on_data(9, 700 * MS)
    ((said, _),) = handshake.poll(800 * MS)
    assert isinstance(said, Hello)
    assert said.number == 4
    assert taken(handshake, welcome(number, incarnation=3), 900 * MS) is pairs
    assert handshake.pairs == 1 + pairs


def test_a_hello_said_before_the_pair_ended_is_too_old_after_it() -> None:
    handshake = after_hellos(3)
    assert taken(handshake, welcome(3), 600 * MS)
    with pytest.raises(BadMessage):
        handshake.on_data(9, 700 * MS)  # a stranger speaks, so the fourth is said
    assert [said.number for said, _ in handshake.poll(700 * MS) if isinstance(said, Hello)] == [4]
    handshake.receive(Bye(2, 1, 0, "the end"), 800 * MS)
    assert not taken(handshake, welcome(4, incarnation=3), 900 * MS)
    assert [said.number for said, _ in handshake.poll(1000 * MS) if isinstance(said, Hello)] == [5]
    assert taken(handshake, welcome(5, incarnation=3), 1100 * MS)


def refused(handshake: Handshake, events: tuple[Event, ...], now_ns: int) -> Iterator[str]:
    """What it sends to whom it refuses; it says the same of itself."""
    (event,) = events
    assert isinstance(event, Mismatch)
    for said, _ in handshake.poll(now_ns):
        if isinstance(said, Refuse):
            assert said.reason == event.reason
            yield said.reason


def test_another_coupling_is_refused_whoever_asks() -> None:
    handshake = after_hellos(1)
    hello = Hello(2, 1, "world", 2, "wall", {COUPLING: "zoh"})
    why = ["wall runs the coupling zoh, pen runs pspm"]
    assert list(refused(handshake, handshake.receive(hello, 300 * MS), 300 * MS)) == why
    answer = welcome(1, incarnation=3, coupling="zoh")
    assert list(refused(handshake, handshake.receive(answer, 400 * MS), 500 * MS)) == why
    assert handshake.peer is None


@pytest.mark.parametrize("theirs", [{COUPLING: "pspm"}, {COUPLING: None}, {}])
def test_the_same_coupling_fits_and_so_does_none(theirs: dict[str, Scalar]) -> None:
    handshake = after_hellos(1)
    assert handshake.receive(Hello(2, 1, "world", 2, "wall", theirs), 300 * MS) == ()
    assert any(isinstance(said, Welcome) for said, _ in handshake.poll(300 * MS))


def test_after_so_many_peers_a_side_pairs_no_more() -> None:
    """The list of the retired is what keeps energy from being credited twice: it is never shortened, and ends."""
    handshake = side()
    now_ns, number, limit = 0, 0, MAX_PEERS
    for incarnation in range(2, limit + 2):
        now_ns += PERIOD_NS
        number += sum(isinstance(said, Hello) for said, _ in handshake.poll(now_ns))
        assert taken(handshake, welcome(number, incarnation), now_ns), incarnation
        handshake.receive(Bye(incarnation, 1, 0, "the end"), now_ns)
    assert handshake.pairs == limit == 4096
    now_ns += PERIOD_NS
    number += sum(isinstance(said, Hello) for said, _ in handshake.poll(now_ns))
    late = handshake.receive(welcome(number, limit + 2), now_ns)
    assert list(refused(handshake, late, now_ns + PERIOD_NS)) == ["this side has seen 4096 peers; restart it"]
    assert handshake.peer is None
    with pytest.raises(BadMessage, match="was the peer once"):
        handshake.receive(Hello(2, 1, "world", 2, "wall", {}), now_ns)  # the first of them is not forgotten


def said_to(handshake: Handshake, incarnation: int, now_ns: int) -> list[Welcome | Refuse]:
    replies = [said for said, _ in handshake.poll(now_ns) if isinstance(said, Welcome | Refuse)]
    return [reply for reply in replies if reply.addressee == incarnation]


def hello(incarnation: int, dof: int = 2) -> Hello:
    return Hello(incarnation, 1, "world", dof, "wall", {})


def after_a_pair(*, ended: bool) -> Handshake:
    """It was paired with 2 at 300 ms, which is silent, or which has left."""
    handshake = after_hellos(3)
    assert taken(handshake, welcome(3), 300 * MS)
    if ended:
        handshake.receive(Bye(2, 1, 0, "the end"), 300 * MS)
    return handshake


def test_a_retired_incarnation_is_told_to_start_anew() -> None:
    handshake = after_a_pair(ended=True)
    with pytest.raises(BadMessage, match="was the peer once"):
        handshake.receive(hello(2), 310 * MS)
    assert said_to(handshake, 2, 320 * MS) == [Refuse(1, 2, "this incarnation was retired; restart it")]


def test_a_replaced_incarnation_is_told_so_each_time_it_speaks() -> None:
    """The first time it may not hear it."""
    handshake = after_a_pair(ended=False)
    handshake.receive(hello(3), 400 * MS)  # 2 is silent: this is the candidate
    number = sum(isinstance(said, Hello) for k in range(3) for said, _ in handshake.poll((400 + 100 * k) * MS))
    assert taken(handshake, welcome(3 + number, 3), 700 * MS)
    assert said_to(handshake, 2, 710 * MS) == [Refuse(1, 2, "replaced by wall")]
    with pytest.raises(BadMessage, match="was the peer once"):
        handshake.receive(hello(2), 720 * MS)
    assert said_to(handshake, 2, 730 * MS) == [Refuse(1, 2, "replaced by wall")]


def test_a_forged_hello_in_the_peers_name_is_not_answered() -> None:
    """A refusal would end the pair."""
    handshake = after_a_pair(ended=False)
    assert handshake.receive(hello(2, dof=3), 310 * MS) == ()
    assert said_to(handshake, 2, 320 * MS) == []


def test_a_pair_leaves_no_candidate_and_no_hello_behind() -> None:
    handshake = after_hellos(3)
    handshake.receive(hello(2), 280 * MS)
    assert taken(handshake, welcome(3), 300 * MS)
    handshake.poll(300 * MS)
    assert handshake.next_due_ns is None
    handshake.receive(Bye(2, 1, 0, "the end"), 310 * MS)
    handshake.receive(hello(3), 320 * MS)  # at once: 2 is no candidate any more
    assert isinstance(said_to(handshake, 3, 330 * MS)[0], Welcome)


@pytest.mark.parametrize("message", [hello(3), welcome(4, 3, dof=3)], ids=["hello", "unfit"])
def test_who_says_hello_or_welcome_first_is_the_candidate(message: Hello | Welcome) -> None:
    """Another one waits until that was not heard for 500 ms."""
    handshake = after_a_pair(ended=True)
    handshake.poll(330 * MS)  # the fourth hello
    handshake.receive(message, 340 * MS)
    for now_ms in (341, 840):
        with pytest.raises(BadMessage, match="another one is about to be the peer"):
            handshake.receive(hello(5), now_ms * MS)
    handshake.receive(hello(5), 841 * MS)
    assert isinstance(said_to(handshake, 5, 900 * MS)[0], Welcome)


def test_a_candidate_that_never_becomes_the_peer_makes_room() -> None:
    """3 says hello for ever and welcomes nobody; after 2 s it is the turn of 5 for 500 ms, if 5 says hello then."""
    handshake = side()
    welcomed = []
    for now_ms in range(0, 6000, 100):
        for who in (3, 5):
            if who == 3 or now_ms > 1000:
                with contextlib.suppress(BadMessage):
                    handshake.receive(hello(who), now_ms * MS)
        welcomed += [(now_ms, said.addressee) for said, _ in handshake.poll(now_ms * MS) if isinstance(said, Welcome)]
    assert {who for now_ms, who in welcomed if now_ms <= 2000} == {3}
    assert {who for now_ms, who in welcomed if 2000 < now_ms <= 4000} == {5}


def test_a_stale_welcome_is_answered_with_a_hello() -> None:
    handshake = after_a_pair(ended=False)
    assert handshake.next_due_ns is None
    assert not taken(handshake, welcome(3, 3), 400 * MS)
    assert [said.number for said, _ in handshake.poll(400 * MS) if isinstance(said, Hello)] == [4]


@pytest.mark.parametrize(("ended", "who"), [(False, 3), (True, 3), (False, 2)])
def test_a_welcome_says_how_many_others_there_were(ended: bool, who: int) -> None:
    """The peer that is to be displaced is one of them; the addressee itself is not."""
    handshake = after_a_pair(ended=ended)
    handshake.receive(hello(who), 400 * MS)
    (answer,) = said_to(handshake, who, 420 * MS)
    assert isinstance(answer, Welcome)
    assert answer.about.get(EARLIER) == (None if who == 2 else 1)


def test_misfits_are_reported_every_100_ms_at_most() -> None:
    handshake = after_hellos(1)
    reported = [ms for ms in range(0, 250, 10) if handshake.receive(hello(2 + ms, dof=3), (50 + ms) * MS)]
    assert reported == [0, 100, 200]


# -- the table ---------------------------------------------------------------------------------------------------------

FROM_PEER = {state for state in Input if state.name.endswith("_OF_PEER")} | {Input.FORGED_HELLO}
TIME = {Input.PEER_HEARD, Input.PEER_SILENT}
STRANGERS = set(Input) - FROM_PEER - TIME
"""What may happen whether there is a peer or not."""


def test_every_state_answers_all_that_can_come_in_it() -> None:
    assert set(TRANSITIONS[PairingState.SEARCHING]) == STRANGERS
    assert set(TRANSITIONS[PairingState.PAIRED]) == set(TRANSITIONS[PairingState.SILENT]) == set(Input)
    assert TRANSITIONS[PairingState.LEFT] == {}


def test_what_the_rows_must_keep() -> None:
    """The laws of the module's docstring, for every row."""
    for state, rows in TRANSITIONS.items():
        for happened, row in rows.items():
            where = state, happened
            assert (Action.PAIR in row.actions) == (happened is Input.WELCOME and state is not PairingState.PAIRED), (
                where
            )
            assert (Action.END_PAIR in row.actions) == (row.state is PairingState.SEARCHING is not state), where
            assert row.drop is None or row.state is state, where  # a dropped message changes no state
            if happened in (Input.OWN, Input.RETIRED, Input.MISADDRESSED, Input.OTHER_CANDIDATE):
                assert row.drop is not None, where
            if state is PairingState.PAIRED and happened in STRANGERS - {
                Input.RETIRED,
                Input.UNFIT_HELLO,
                Input.UNPROVEN_UNFIT_HELLO,
            }:
                assert row.actions == (), where  # nobody disturbs a peer that is heard


def test_what_this_program_does_wrong_is_no_fault_of_a_peer() -> None:
    with pytest.raises(LocalProtocolError, match=r"BYE_OF_PEER in state SEARCHING; allowed: CLOSE, OWN, "):
        transition(PairingState.SEARCHING, Input.BYE_OF_PEER)
    handshake = after_hellos(1)
    handshake.close(300 * MS, 0, "the end")
    for late in (lambda: handshake.close(400 * MS, 0, "again"), lambda: handshake.receive(welcome(1), 400 * MS)):
        with pytest.raises(LocalProtocolError, match="in state LEFT; allowed: nothing any more") as caught:
            late()
        assert not isinstance(caught.value, BadMessage)
    assert not issubclass(BadMessage, LocalProtocolError)


MESSAGES = (
    *(Hello(who, 1, role, 2, "wall", {}) for who in (1, 2, 3, 4, 5) for role in ("device", "world")),
    *(welcome(number, who, dof=dof) for number in (1, 2) for who in (1, 2, 3, 4, 5) for dof in (1, 2)),
    *(Refuse(who, to, "no") for who in (1, 2, 3, 4, 5) for to in (1, 9)),
    *(Bye(who, 1, 0, "the end") for who in (1, 2, 3, 4, 5)),
)


@pytest.mark.parametrize("state", [PairingState.SEARCHING, PairingState.PAIRED, PairingState.SILENT])
def test_to_look_at_a_message_changes_nothing(state: PairingState) -> None:
    """2 is the peer, 3 the candidate, 4 was the peer once, 5 a stranger, 1 this side itself; private, so as to look."""
    heard = state is PairingState.PAIRED
    handshake = Handshake(ME, lambda now_ns: heard, PERIOD_NS)
    for k, who in enumerate((4, 2) if state is not PairingState.SEARCHING else (4,)):
        handshake.poll(k * PERIOD_NS)
        handshake.receive(welcome(k + 1, who), k * PERIOD_NS)
        if who == 4:
            handshake.receive(Bye(4, 1, 0, "the end"), k * PERIOD_NS)
    handshake._candidate, handshake._candidate_ns = 3, 200 * MS
    before = pickle.dumps((vars(handshake.control), handshake.peer, handshake._retired, handshake._candidate))
    happened = {handshake._classify(message, 300 * MS)[0] for message in MESSAGES}
    assert pickle.dumps((vars(handshake.control), handshake.peer, handshake._retired, handshake._candidate)) == before
    assert happened >= {Input.OWN, Input.RETIRED, Input.OTHER_CANDIDATE, Input.MISADDRESSED, Input.BYE}
