"""The accounts that two sides exchange: when one is sent, and when all is known."""

import pytest

from hapnet.wire.account import REPEAT_NS, Account, AccountExchange
from hapnet.wire.messages import BadMessage

VALUES = {"sent_nJ": 5}


def of_peer(number: int, heard: int, *, final: bool = False, asks: bool = False) -> Account:
    return Account(7, 9, number, heard, asks, final, {})


def test_a_final_account_is_repeated_until_the_peer_has_answered_it() -> None:
    mine = AccountExchange()
    assert mine.known  # a peer that never reports will not answer
    assert not mine.whole
    assert mine.poll(0) is None
    mine.receive(of_peer(1, 0, asks=True), 0)
    assert (mine.owes, mine.known) == (True, False)
    mine.report(VALUES, final=False)
    assert (mine.owes, mine.known, mine.next_due_ns) == (False, False, 0)
    assert mine.poll(0) == (1, 1, False, False, VALUES)
    assert mine.next_due_ns is None
    mine.receive(of_peer(2, 1), 10)
    assert not mine.known  # it has answered, but this one was not final
    mine.report(VALUES, final=True)
    assert mine.poll(10) == (2, 2, True, True, VALUES)
    assert mine.next_due_ns == 10 + REPEAT_NS
    assert mine.poll(9 + REPEAT_NS) is None
    assert mine.poll(10 + REPEAT_NS) == (2, 2, True, True, VALUES)
    assert not mine.whole
    mine.receive(of_peer(2, 2), 20 + REPEAT_NS)  # the same once more, and it answers
    assert (mine.known, mine.whole) == (True, True)
    assert mine.poll(10 + 2 * REPEAT_NS) is None
    assert mine.next_due_ns is None
    mine.report(VALUES, final=True)  # nothing new: it keeps its number
    assert mine.poll(30 + 2 * REPEAT_NS) == (2, 2, False, True, VALUES)
    mine.report({"sent_nJ": 6}, final=True)
    assert mine.poll(30 + 2 * REPEAT_NS) == (3, 2, True, True, {"sent_nJ": 6})
    assert (mine.known, mine.whole) == (False, True)  # of what it covers, all was final before


def test_a_final_account_of_the_peer_covers_all() -> None:
    mine = AccountExchange()
    mine.receive(of_peer(1, 0, final=True), 0)
    assert mine.whole


def test_what_cannot_be_is_refused() -> None:
    mine = AccountExchange()
    mine.report(VALUES, final=False)
    mine.receive(of_peer(3, 1), 0)
    for wrong, kind in ((of_peer(4, 2), "range"), (of_peer(2, 0), "stale")):
        with pytest.raises(BadMessage) as caught:
            mine.receive(wrong, 1)
        assert caught.value.kind == kind
    with pytest.raises(BadMessage):
        AccountExchange().receive(of_peer(0, 0), 1)


def test_another_peer_has_heard_nothing() -> None:
    mine = AccountExchange()
    mine.report(VALUES, final=True)
    mine.receive(of_peer(5, 1, asks=True), 0)
    mine.change_pair(paired=False)
    assert (mine.heard is None, mine.owes, mine.next_due_ns) == (False, False, None)
    mine.change_pair(paired=True)
    assert mine.heard is None
    mine.receive(of_peer(1, 0), 0)
    assert not mine.known
