"""What hands its state out and takes it back: whoever goes on from it does as if it had never stopped."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.control.ledger import Ledger
from hapnet.control.two_port import TwoPort
from hapnet.ext.compiled.memory import load, new, store
from hapnet.records.record import Record
from hapnet.wire.energy_channel import EnergyChannel
from hapnet.wire.token_bucket import TokenBucket
from netem.stats import BINS, DelayHistogram, Delays, bin_of

MS = 1_000_000
FEW = settings(max_examples=60, deadline=None)
ENERGIES = st.floats(-1e-3, 1e-3)


def hand_over(first: Record, second: Record) -> None:
    """By way of compiled code's memory."""
    structure = new(type(first))
    store(structure, first)
    load(second, structure)


def channel() -> EnergyChannel:
    return EnergyChannel(TokenBucket(0.05, 0.001), spacing_ns=10 * MS)


CHANNEL = st.lists(st.tuples(st.integers(0, 150), st.floats(0, 0.002), st.floats(0, 1), st.floats(0, 1)), max_size=15)


@FEW
@given(CHANNEL, CHANNEL)
@pytest.mark.long
def test_a_channel(before: list[tuple[float, ...]], after: list[tuple[float, ...]]) -> None:
    def run(c: EnergyChannel, moments: list[tuple[float, ...]], now_ns: int) -> list[Any]:
        seen: list[Any] = []
        for wait_ms, energy, received, acked in moments:
            now_ns += int(wait_ms) * MS
            c.send(energy)
            seen += [c.receive(int(received * 1e7), int(acked * c.announced_nJ), now_ns), c.poll(now_ns), c.next_due_ns]
            seen += [c.sent_nJ, c.acked_nJ, c.residue_J, c.rto.rto_ns, c.unanswered_ns(now_ns), now_ns]
        return seen

    first, second = channel(), channel()
    now_ns = run(first, before, 0)[-1] if before else 0
    store(second, first)
    assert run(second, after, now_ns) == run(first, after, now_ns)


@FEW
@given(*[st.lists(st.tuples(*[ENERGIES] * 5), max_size=10)] * 2)
@pytest.mark.long
def test_a_ledger(before: list[tuple[float, ...]], after: list[tuple[float, ...]]) -> None:
    def run(ledger: Ledger, terms: list[tuple[float, ...]]) -> list[float]:
        for work, credited, sent, stored, reservoir in terms:
            ledger.put_in(work)
            ledger.credit(credited)
            ledger.send(sent)
            ledger.observe(stored, reservoir)
        return list(vars(ledger).values())

    first, second = Ledger(0.1, 0.2), Ledger(0.0, 0.0)
    run(first, before)
    hand_over(first, second)
    assert run(second, after) == run(first, after)


@FEW
@given(*[st.lists(st.tuples(st.sampled_from(["device", "world", "begin"]), ENERGIES), max_size=12)] * 2)
@pytest.mark.long
def test_both_ports(before: list[tuple[str, float]], after: list[tuple[str, float]]) -> None:
    def run(ports: TwoPort, events: list[tuple[str, float]]) -> list[float | None]:
        seen = []
        for name, work in events:
            if name == "begin":
                ports.begin()
            else:
                getattr(ports, name)(work)
            seen += [ports.lowest, ports.later, ports.now]
        return seen

    first, second = TwoPort(), TwoPort()
    run(first, before)
    hand_over(first, second)
    assert run(second, after) == run(first, after)


@given(*[st.lists(st.integers(0, 10**12), min_size=1, max_size=40)] * 2)
@pytest.mark.long
def test_delays_that_others_counted(here: list[int], there: list[int]) -> None:
    alone, helped = DelayHistogram(), DelayHistogram()
    alone.pending += here + there
    helped.pending += here
    counts = np.zeros(BINS, dtype=np.int64)
    for delay in there:
        counts[bin_of([delay])] += 1
    helped.add(Delays(sum(there), sum(delay * delay for delay in there), min(there), max(there), counts))
    for seen in (alone, helped):
        assert seen.mean_ms() == pytest.approx(sum(here + there) / len(here + there) * 1e-6)
    assert alone.std_ms() == helped.std_ms()
    assert alone.bins_ms() == helped.bins_ms()
    assert [alone.quantile_ms(q) for q in (0, 0.5, 1)] == [helped.quantile_ms(q) for q in (0, 0.5, 1)]
