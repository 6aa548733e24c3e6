"""What the tests of netem share: random profiles, recorded kernel output, and a link driven in virtual time."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray

from netem.effects import DISTRIBUTIONS, FourStateLoss, GilbertElliottLoss, RandomLoss, Resend, Slot
from netem.link import Link
from netem.profile import LinkProfile
from netem.trace import CapacityTrace, ConditionTrace

MS = 1_000_000
RECORDED = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "tc-netem"

fractions = st.one_of(st.floats(0, 1), st.integers(0, 100).map(lambda n: n / 100))
times = st.one_of(st.integers(0, 10**14), st.integers(0, 500).map(lambda n: n * 10**6))
loss_models = st.one_of(
    st.none(),
    st.builds(RandomLoss, fractions, fractions),
    st.builds(GilbertElliottLoss, fractions, fractions, fractions, fractions),
    st.tuples(fractions, fractions, fractions).map(lambda p: FourStateLoss(p[0], p[1], 1 - p[1], p[2], (1 - p[0]) / 2)),
)


resends = st.one_of(
    st.none(), st.builds(Resend, st.integers(1, 8), st.one_of(st.just(0), st.integers(0, 9 * 10**6)), st.booleans())
)


@st.composite
def slots(draw: st.DrawFn, max_ns: st.SearchStrategy[int] = times) -> Slot:
    first, second = draw(max_ns), draw(max_ns)
    distribution = draw(st.sampled_from(["", *DISTRIBUTIONS]))
    low, high = (first, second) if distribution else sorted((first, second))
    return Slot(low, high, distribution, draw(st.integers(0, 5)), draw(st.integers(0, 500)))


@st.composite
def profiles(draw: st.DrawFn, max_ns: st.SearchStrategy[int] = times) -> LinkProfile:
    delay, jitter = draw(max_ns), draw(max_ns)
    cell = draw(st.sampled_from([0, 48]))
    return LinkProfile(
        delay_ns=delay,
        jitter_ns=jitter,
        delay_correlation=draw(fractions),
        distribution=draw(st.sampled_from(DISTRIBUTIONS)) if jitter else "uniform",
        loss=draw(loss_models),
        resend=draw(resends),
        corrupt=draw(fractions),
        corrupt_correlation=draw(fractions),
        reorder=draw(fractions) if delay else 0.0,
        reorder_correlation=draw(fractions),
        gap=draw(st.integers(1, 6)),
        rate_bit_s=draw(st.one_of(st.just(0), st.integers(1000, 10**10))),
        overhead=draw(st.integers(-20, 60)),
        cell_size=cell,
        cell_overhead=draw(st.integers(-cell, 5)),
        slot=draw(st.one_of(st.none(), slots(max_ns))),
        limit=draw(st.one_of(st.just(1000), st.integers(1, 20))),
        seed=draw(st.one_of(st.none(), st.integers(0, 2**64 - 1))),
    )


@st.composite
def traced_profiles(draw: st.DrawFn, max_ns: st.SearchStrategy[int]) -> LinkProfile:
    """Profiles as above, also with traces, which no file holds."""
    profile = draw(profiles(max_ns))
    if draw(st.booleans()):
        times = sorted(draw(st.lists(max_ns, max_size=5)))
        trace = CapacityTrace("memory", (*times, draw(st.integers(51 * 10**6, 80 * 10**6))))
        profile = profile.replace(trace=trace, rate_bit_s=0, overhead=0, cell_size=0, cell_overhead=0)
    if draw(st.booleans()):
        times = sorted(draw(st.sets(max_ns.filter(bool), max_size=4)))
        steps = [(draw(max_ns), draw(fractions)) for _ in range(len(times) + 1)]
        profile = profile.replace(csv=ConditionTrace("memory", (0, *times), *zip(*steps, strict=True)))
    return profile


def recorded(name: str) -> NDArray[np.int64]:
    """What the kernel did: columns sequence, arrival order (-1: lost), delay in ns, duplicates."""
    path = RECORDED / f"{name}.txt.gz"
    if not path.exists():
        pytest.skip("the recorded kernel output is not beside the project (../shared/data/tc-netem)")
    with gzip.open(path) as file:
        return np.loadtxt(file, dtype=np.int64)


def drive(link: Link[int], count: int, interval_ns: int, size: int = 100) -> list[tuple[int, int]]:
    """Send the numbers 0..count-1 at a steady pace, poll after each and until all is out: (release time, number)."""
    out = []
    for number in range(count):
        link.send(number * interval_ns, number, size)
        out += link.poll(number * interval_ns)
    while (due_ns := link.next_due_ns) is not None:
        out += link.poll(due_ns)
    return out


def burst_lengths(lost: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(np.int8)))
    return edges[1::2] - edges[::2]


def link_of(words: str, seed: int = 1) -> Link[int]:
    return Link(LinkProfile.parse(words), seed)


def release_times(link: Link[int], count: int) -> dict[int, int]:
    """When each of `count` messages that are offered 1 ms apart is released [ns], by its number."""
    return {number: due_ns for due_ns, number in drive(link, count, MS)}
