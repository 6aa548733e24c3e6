import random
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from math import inf, nan, nextafter

import pytest
from hypothesis import given, settings, strategies as st

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.wire.energy_channel import EnergyChannel
from hapnet.wire.rto import CEILING_NS, FLOOR_NS, INITIAL_NS
from hapnet.wire.token_bucket import TokenBucket

MS = 1_000_000


def channel(power_W: float = 1e6, burst_J: float = 1e6) -> EnergyChannel:
    return EnergyChannel(TokenBucket(power_W, burst_J), spacing_ns=10 * MS)


def smoothed(c: EnergyChannel) -> int | None:
    return c.rto.srtt_ns


class Pair:
    """Two channels and what is on its way between them; `path[i]` holds the messages that side i sent."""

    def __init__(self, a: EnergyChannel, b: EnergyChannel) -> None:
        self.sides = (a, b)
        self.path: tuple[list[tuple[int, int]], list[tuple[int, int]]] = ([], [])
        self.now = 0
        self.messages = 0

    def poll(self) -> None:
        for side, path in zip(self.sides, self.path, strict=True):
            side.admit(self.now)
            if (message := side.poll(self.now)) is not None:
                self.messages += 1
                path.append(message)
        self.check()

    def deliver(self, sender: int, index: int, *, keep: bool = False) -> None:
        path = self.path[sender]
        if path:
            index %= len(path)
            self.sides[1 - sender].receive(*(path[index] if keep else path.pop(index)), self.now)
        self.check()

    def check(self) -> None:
        for here, there in (self.sides, self.sides[::-1]):
            assert here.acked_nJ <= there.credited_nJ <= here.sent_nJ
            assert here.in_flight_nJ == here.sent_nJ - here.acked_nJ >= 0
            assert here.residue_J >= 0.0

    def heal(self, delay_ns: int = 5 * MS) -> int:
        """A link without faults from here on, until nothing is due; returns the number of messages that took."""
        before = self.messages
        for _ in range(10_000):
            due = [t for side in self.sides if (t := side.next_due_ns) is not None]
            if not due and not any(self.path):
                return self.messages - before
            self.now = max(self.now, min(due, default=self.now))
            self.poll()
            self.now += delay_ns
            for sender in (0, 1):
                while self.path[sender]:
                    self.deliver(sender, 0)
        pytest.fail("never quiet")


OPERATIONS = st.lists(
    st.one_of(
        st.tuples(st.just("send"), st.integers(0, 1), st.floats(0, 0.01)),
        st.tuples(st.just("deliver"), st.integers(0, 1), st.integers(0, 99)),
        st.tuples(st.just("repeat"), st.integers(0, 1), st.integers(0, 99)),
        st.tuples(st.just("lose"), st.integers(0, 1), st.integers(0, 99)),
        st.tuples(st.just("wait"), st.integers(0, 1), st.integers(0, 300)),
    ),
    max_size=60,
)


@settings(max_examples=150, deadline=None)
@given(OPERATIONS, st.booleans())
@pytest.mark.long
def test_exactly_once_whatever_the_network_does(operations: list[tuple[str, int, float]], slow: bool) -> None:
    pair = Pair(channel(0.05, 0.001) if slow else channel(), channel())
    for name, side, value in operations:
        path = pair.path[side]
        if name == "send":
            pair.sides[side].send(value)
        elif name == "lose" and path:
            path.pop(int(value) % len(path))
        elif name == "wait":
            pair.now += int(value) * MS
            pair.poll()
        else:
            pair.deliver(side, int(value), keep=name == "repeat")
    # Each retransmission costs a message and its answer; the slow bucket answers once a step of 10 ms
    limit = 20 + (int(max(s.in_flight_nJ for s in pair.sides) / 0.05e7) + 1) * 4 if slow else 20
    assert pair.heal() <= limit
    a, b = pair.sides
    assert (a.credited_nJ, b.credited_nJ) == (b.sent_nJ, a.sent_nJ)
    assert (a.in_flight_nJ, b.in_flight_nJ) == (0, 0)
    assert (a.next_due_ns, b.next_due_ns) == (None, None)
    assert a.poll(pair.now + 10**12) is None


@pytest.mark.parametrize("seed", range(5))
def test_long_run_over_a_bad_link(seed: int) -> None:
    rng = random.Random(seed)
    pair = Pair(channel(), channel())
    for _ in range(3000):
        pair.now += rng.randrange(20) * MS
        pair.sides[rng.randrange(2)].send(rng.expovariate(1e3))
        pair.poll()
        for sender in (0, 1):
            for _ in range(len(pair.path[sender])):
                lot = rng.random()
                if lot < 0.3:
                    pair.path[sender].pop(0)
                elif lot < 0.9:
                    pair.deliver(sender, rng.randrange(1000), keep=lot < 0.5)
    pair.heal()
    a, b = pair.sides
    assert (a.credited_nJ, b.credited_nJ) == (b.sent_nJ, a.sent_nJ)


@given(st.lists(st.floats(0, 1e3), max_size=200))
def test_residue_keeps_what_makes_no_whole_nanojoule(energies: list[float]) -> None:
    c = channel()
    for energy in energies:
        c.send(energy)
        assert 0.0 <= c.residue_J <= 1.000001e-9
    assert c.sent_nJ / 1e9 + c.residue_J == pytest.approx(sum(energies), rel=1e-12, abs=1e-15)


def test_small_energies_add_up() -> None:
    c = channel()
    for _ in range(1000):
        c.send(0.3e-9)
    assert c.sent_nJ in (299, 300)  # 0.3e-9 is a shade off 3/10
    assert c.sent_nJ * 1e-9 + c.residue_J == pytest.approx(300e-9, rel=1e-12)


@pytest.mark.parametrize("energy", [-1e-18, nan, inf, -inf, 1e10])
def test_bad_energy_is_refused(energy: float) -> None:
    c = channel()
    with pytest.raises(InvalidParameter, match="energy"):
        c.send(energy)
    assert c.sent_nJ == 0


def test_the_total_stays_below_63_bits() -> None:
    c = channel()
    c.send(9e9)
    with pytest.raises(InvalidParameter, match="2\\^63"):
        c.send(9e9)
    assert c.sent_nJ == 9 * 10**18


def test_new_energy_leaves_at_once_and_then_coalesces() -> None:
    c = channel()
    assert (c.next_due_ns, c.poll(100 * MS)) == (None, None)
    c.send(1e-6)
    assert c.poll(100 * MS) == (1000, 0)
    for k in range(1, 10):
        c.send(1e-6)
        assert c.poll((100 + k) * MS) is None
    assert c.next_due_ns == 110 * MS
    assert c.poll(110 * MS) == (10_000, 0)


def test_retransmission_backs_off_until_acknowledged() -> None:
    c = channel()
    c.send(1e-6)
    now, times = 0, []
    for _ in range(6):
        assert c.poll(now) == (1000, 0)
        times.append(now)
        assert c.poll(now) is None
        due = c.next_due_ns
        assert due is not None
        now = due
    assert [b - a for a, b in pairwise(times)] == [
        INITIAL_NS,
        2 * INITIAL_NS,
        4 * INITIAL_NS,
        CEILING_NS,
        CEILING_NS,
    ]
    c.receive(0, 1000, now)
    assert (c.next_due_ns, c.in_flight_nJ) == (None, 0)


def test_karn_no_sample_from_a_repeated_message() -> None:
    c = channel()
    c.send(1e-6)
    c.poll(0)
    c.poll(INITIAL_NS)
    c.receive(0, 1000, INITIAL_NS + MS)
    assert smoothed(c) is None
    assert c.rto.rto_ns == 2 * INITIAL_NS  # and the back-off stays until there is one
    c.send(1e-6)
    c.poll(1000 * MS)
    c.receive(0, 2000, 1003 * MS)
    assert smoothed(c) == 3 * MS
    assert c.rto.rto_ns == FLOOR_NS


def test_round_trip_is_that_of_the_message_acknowledged() -> None:
    c = channel()
    for k in range(5):
        c.send(1e-6)
        c.poll(10 * k * MS)
    c.receive(0, 3000, 60 * MS)  # the third, sent at 20 ms
    assert c.rto.srtt_ns == 40 * MS
    c.receive(0, 2000, 61 * MS)  # stale
    assert (c.acked_nJ, c.rto.srtt_ns) == (3000, 40 * MS)


def test_partial_credit_is_no_sample() -> None:
    c = channel()
    c.send(1e-6)
    c.poll(0)
    c.receive(0, 400, 5 * MS)
    c.receive(0, 1000, 5000 * MS)
    assert c.rto.srtt_ns is None
    assert c.in_flight_nJ == 0


def test_acknowledgement_rides_or_goes_alone() -> None:
    c = channel()
    assert c.receive(500, 0, 0) == 500
    assert c.next_due_ns == 10 * MS
    assert c.poll(9 * MS) is None
    assert c.poll(10 * MS) == (0, 500)
    assert c.receive(500, 0, 20 * MS) == 0  # a repetition: the acknowledgement was lost, so another
    c.send(1e-9)
    assert c.poll(21 * MS) == (1, 500)
    c.receive(0, 1, 22 * MS)  # an acknowledgement alone is not answered
    assert c.next_due_ns is None


def test_stale_totals_credit_nothing() -> None:
    c = channel()
    assert [c.receive(t, 0, 0) for t in (10, 30, 20, 30, 31)] == [10, 20, 0, 0, 1]


def test_acknowledging_what_was_never_announced_changes_nothing() -> None:
    c = channel()
    c.send(1e-6)
    with pytest.raises(BadMessage) as caught:
        c.receive(77, 1, 0)  # sent, but not yet in any message
    assert caught.value.kind == "acknowledgement"
    assert (c.credited_nJ, c.acked_nJ) == (0, 0)
    assert c.poll(0) == (1000, 0)


def test_admission_lets_a_leap_in_slowly() -> None:
    c = channel(power_W=1.0, burst_J=0.001)
    leap = 2**63 - 1
    assert c.receive(leap, 0, 0) == 10**6
    now, credited = 0, 10**6
    for _ in range(100):
        due = c.next_due_ns
        assert due > now or c.poll(due) is not None
        now = max(now, due)
        credited += c.admit(now)
        c.poll(now)
        assert credited <= 10**6 + now
    assert credited == c.credited_nJ > 10**6


def test_one_message_that_leaps_is_soon_forgotten() -> None:
    """A total of 9e9 J, said once: the burst, and what the bucket pays in 2 s, and no more in an hour."""
    c = channel(power_W=5.0, burst_J=0.5)
    c.receive(10**6, 0, 0)
    credited = c.receive(2**63 - 1, 0, 10 * MS)
    for now in range(20 * MS, 3600 * 1000 * MS, 1000 * MS):
        credited += c.admit(now)
        c.receive(10**6, 0, now)  # what was really sent
    assert credited + 10**6 == c.credited_nJ <= 10**6 + round((0.5 + 2.0 * 5.0) * 1e9)


def test_a_long_backlog_comes_at_the_rate_of_the_bucket() -> None:
    """100 J after a long silence, 5 W and a burst of 0.5 J: (100 - 0.5) / 5 = 19.9 s, and the round trips."""
    a, b = channel(), channel(power_W=5.0, burst_J=0.5)
    pair = Pair(a, b)
    a.send(100.0)
    pair.heal()
    assert b.credited_nJ == a.acked_nJ == 100 * 10**9
    assert 19.9e9 <= pair.now <= 19.9e9 * 1.02


def test_what_waits_is_credited_without_further_messages() -> None:
    c = channel(power_W=1.0, burst_J=0.001)
    credited = c.receive(5 * 10**6, 0, 0)

    def dues() -> Iterator[int]:
        while (due := c.next_due_ns) is not None:
            yield due

    last = 0
    for last in dues():
        credited += c.admit(last)
        c.poll(last)
    assert credited == 5 * 10**6
    assert 4 * MS <= last <= 30 * MS


def test_abandon_is_for_good() -> None:
    c = channel()
    c.send(3e-9)
    c.poll(0)
    c.receive(0, 1, 0)
    assert c.abandon() == 2
    assert (c.sent_nJ, c.acked_nJ, c.abandoned_nJ, c.in_flight_nJ) == (3, 1, 2, 0)
    assert (c.poll(10**12), c.next_due_ns) == (None, None)
    assert c.receive(50, 3, 10**12) == 0
    assert (c.acked_nJ, c.credited_nJ) == (1, 0)
    c.send(4e-9)
    assert c.abandon() == 4


def test_a_repeated_acknowledgement_does_not_postpone_the_retransmission() -> None:
    """Only one that advances starts the timer anew: else a copy every 200 ms would keep the repair away for ever."""
    c = channel()
    c.send(1e-6)
    c.poll(0)
    c.send(1e-6)
    c.poll(10 * MS)
    c.receive(0, 1000, 20 * MS)  # of the first; the second is lost
    due = c.next_due_ns
    assert due is not None
    for k in range(1, 4):
        c.receive(0, 1000, 20 * MS + k * MS)
        assert c.next_due_ns == due
    assert c.poll(due) == (2000, 0)


def test_a_product_that_is_rounded_up_makes_no_nanojoule() -> None:
    """Energies whose product with 1e9 rounds up to the next integer: what is sent is never more than was given."""
    rng = random.Random(1)
    found = 0
    for _ in range(20_000):
        whole = rng.randrange(1, 10**15)
        energy = nextafter(whole / 1e9, 0.0)
        if energy * 1e9 >= whole > Fraction(energy) * 10**9:
            found += 1
            c = channel()
            c.send(energy)
            assert c.sent_nJ == whole - 1
            assert c.residue_J >= 0.0
    assert found > 500


def test_messages_that_ask_again_do_not_postpone_the_acknowledgement() -> None:
    """It is due 10 ms after it was first owed, however often the peer repeats itself meanwhile."""
    c = channel()
    for now in range(0, 10, 2):
        c.receive(500, 0, now * MS)
        assert c.next_due_ns == 10 * MS
        assert c.poll(now * MS) is None
    assert c.poll(10 * MS) == (0, 500)
    assert c.next_due_ns is None
