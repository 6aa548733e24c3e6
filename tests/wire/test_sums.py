"""The sums in energy messages: one sender's always fit together, two senders' never do for long."""

from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import assume, given, strategies as st

from hapnet.errors import BadMessage
from hapnet.wire.fields import SUMS
from hapnet.wire.messages import Energy, decode, encode
from hapnet.wire.sums import Sums

A, B = 5, 9


@dataclass
class Side:
    """One side of an account kept by hand: what it sent, credited, and said."""

    me: int
    other: int
    sent: int = 0
    credited: int = 0
    sums: Sums = field(default_factory=Sums)
    said: list[Energy] = field(default_factory=list)

    def speak(self, more_nJ: int, whole: bool) -> None:
        self.sent += more_nJ
        reported = self.sums.next(self.sent, self.credited)
        self.said.append(Energy(self.me, self.other, self.sent if whole else 0, self.credited, {SUMS: reported}))

    def hear(self, message: Energy, announced_nJ: int) -> None:
        self.sums.take(message, announced_nJ)
        self.credited = max(self.credited, message.total_nJ)


move = st.tuples(st.booleans(), st.sampled_from(["speak", "hear"]), st.integers(0, 10**12), st.integers(0, 60))


@given(st.lists(move, max_size=80))
@pytest.mark.long
def test_loss_repetition_and_any_order_contradict_nothing(moves: list[tuple[bool, str, int, int]]) -> None:
    sides = Side(A, B), Side(B, A)
    for first, what, energy_nJ, which in moves:
        one, other = sides if first else sides[::-1]
        if what == "speak":
            one.speak(energy_nJ * (which % 3 > 0), which % 2 == 0)
        elif other.said:
            one.hear(other.said[which % len(other.said)], one.sent)
    assert not sides[0].sums.contradictions
    assert not sides[1].sums.contradictions


@given(st.integers(-40, 2000), st.integers(1, 10**10), st.integers(2, 30), st.booleans())
@pytest.mark.long
def test_a_second_teller_is_found_once_he_is_overtaken(ahead: int, early_nJ: int, after: int, bare: bool) -> None:
    """He sends what the device sends later, under any number; then the device does send it."""
    assume(ahead != 1)  # that is her next message to the letter: only what was credited before shows it then
    device, world = Side(A, B), Side(B, A)
    for _ in range(50):
        device.speak(10, True)
        world.hear(device.said[-1], 0)
    number, sent_nJ, seen = (device.said[-1].more or {})[SUMS]
    more = None if bare else {SUMS: (number + ahead, sent_nJ + early_nJ, seen)}
    world.hear(Energy(A, B, sent_nJ + early_nJ, 0, more), 0)
    for _ in range(after):
        device.speak(early_nJ, True)
        world.hear(device.said[-1], 0)
    for _ in range(max(0, ahead)):  # up to his number, if it is far ahead
        device.speak(0, True)
        world.hear(device.said[-1], 0)
    assert world.sums.contradictions["senders"] > 0


def test_what_was_told_less_than_credited_needs_no_clock() -> None:
    """The forged total is credited, and reported in message 1; the device has seen that, and reports less."""
    device, world = Side(A, B), Side(B, A)
    device.speak(10, True)
    world.hear(device.said[-1], 0)
    world.credited = 500  # by a frame that is not among hers
    world.speak(0, False)
    device.hear(world.said[-1], device.sent)
    assert device.sums.contradictions == {"acknowledged": 1}
    device.speak(100, False)
    world.hear(device.said[-1], 0)
    assert world.sums.contradictions == {"credited": 1}
    assert world.sums.take(device.said[-1], 0) == ()  # reported once


def test_another_peer_counts_anew() -> None:
    one, other = Sums(), Sums()
    for k in range(3):
        one.take(Energy(B, A, 9, 0, {SUMS: other.next(9, 0)}), k)
    one.change_pair()
    one.take(Energy(7, A, 1, 0, {SUMS: (1, 1, 0)}), 0)
    assert not one.contradictions


@pytest.mark.parametrize(
    "sums",
    [
        None,
        (1, 2),
        (0, 1, 1),
        (1, -1, 1),
        (1, 2**63, 1),
        (1, 1, -1),
        (1.0, 1, 1),
        (True, 1, 1),
        "sums",
        (1, 1, 2**64 - 1),
    ],
)
def test_sums_that_are_none_are_a_bad_message(sums: Any) -> None:
    with pytest.raises(BadMessage):
        decode(encode(Energy(A, B, 1, 1, {SUMS: sums})))
