"""The random streams of a link: repeatable, independent of each other, and the same in arrays."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence
from scipy import stats

from netem import Link, LinkProfile
from tests.netem.support import MS, drive, link_of, release_times

EVERYTHING = (
    "delay 40ms 10ms 25% distribution normal loss gemodel 1% 20% corrupt 1% reorder 5% 10% rate 10mbit slot 1ms 5ms"
)


def test_same_seed_same_releases() -> None:
    first, again, other = (drive(link_of(EVERYTHING, seed), 2000, MS) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_seed_sequences_and_the_words_seed() -> None:
    profile = LinkProfile.parse(EVERYTHING)
    up, down = SeedSequence(1).spawn(2)
    assert drive(Link(profile, up), 500, MS) != drive(Link(profile, down), 500, MS)
    assert drive(Link(profile, SeedSequence(1)), 500, MS) == drive(Link(profile, 1), 500, MS)
    seeded = profile.replace(seed=7)
    assert drive(Link(seeded, 1), 500, MS) == drive(Link(profile, 7), 500, MS)
    assert drive(Link(seeded, up), 500, MS) != drive(Link(seeded, down), 500, MS)


def test_directions_are_independent() -> None:
    """Neither the delays nor the losses of two spawned links are correlated; nor are a link's own."""
    count, profile = 20_000, LinkProfile.parse("delay 40ms 10ms loss 20%")
    series = []
    for seed in SeedSequence(1).spawn(2):
        delays = np.full(count, np.nan)
        for due, number in drive(Link(profile, seed), count, MS):
            delays[number] = due - number * MS
        series.append(delays)
    lost = [np.isnan(delays) for delays in series]
    both = ~(lost[0] | lost[1])
    assert stats.pearsonr(series[0][both], series[1][both]).pvalue > 1e-3
    assert stats.pearsonr(series[0][both], lost[1][np.roll(both, 1)]).pvalue > 1e-3
    assert stats.chi2_contingency(np.histogram2d(*lost, bins=2)[0]).pvalue > 1e-3


def test_a_change_without_a_seed_keeps_the_streams_and_one_with_another_starts_new_ones() -> None:
    def releases(*words: str) -> list[tuple[int, int]]:
        link = link_of("delay 5ms 1ms loss 10% seed 7")
        out = []
        for number in range(600):
            if number == 300:
                for some in words:
                    link.change(LinkProfile.parse(some), number * MS)
            link.send(number * MS, number)
            out += link.poll(number * MS)
        return out + link.poll(10**12)

    unchanged = releases()
    assert releases("delay 5ms 1ms loss 10%") == unchanged == releases("delay 5ms 1ms loss 10% seed 7")
    assert releases("delay 5ms 1ms loss 10% seed 8") != unchanged


@pytest.mark.parametrize("other", ["loss gemodel 5% 20%", "reorder 20%", "corrupt 50%", "loss 30% 50%"])
def test_another_effect_leaves_the_delays(other: str) -> None:
    """Messages that both links only delay are delayed alike: nobody's draws were reshuffled."""
    plain = release_times(link_of("delay 40ms 10ms"), 2000)
    changed = release_times(link_of(f"delay 40ms 10ms {other}"), 2000)
    delayed = {number: due for number, due in changed.items() if due > number * MS}
    assert len(delayed) > 1000
    assert all(plain[number] == due for number, due in delayed.items())


def test_another_delay_leaves_the_losses() -> None:
    def arrived(words: str) -> set[int]:
        return {number for _, number in drive(link_of(words), 2000, MS)}

    assert (
        arrived("loss 10%") == arrived("loss 10% delay 4ms 2ms distribution pareto") == arrived("loss 10% rate 9mbit")
    )


def test_a_live_change_leaves_the_other_effects_streams() -> None:
    def arrived(changed: bool) -> set[int]:
        link = link_of("loss 10% delay 5ms 1ms")
        out = []
        for number in range(2000):
            if changed and number == 700:
                link.change(LinkProfile.parse("loss 10% delay 50ms"), number * MS)
            link.send(number * MS, number)
            out += link.poll(number * MS)
        return {number for _, number in out + link.poll(10**12)}

    assert arrived(True) == arrived(False)


def test_draws_are_those_recorded_before() -> None:
    """A seed written down today gives the same link tomorrow: release times (ns) and numbers, made by it once."""
    golden = json.loads((Path(__file__).parent / "golden_link.json").read_text())
    for words, expected in golden.items():
        assert [list(entry) for entry in drive(link_of(words, 1), 40, MS)] == expected


@pytest.mark.parametrize(
    "words", ["delay 10ms 5ms loss 10%", "delay 10ms 3ms 40% distribution normal loss gemodel 5% 20%"]
)
def test_draws_taken_in_arrays_are_those_of_messages_sent(words: str) -> None:
    profile = LinkProfile.parse(words)
    sent: Link[int] = Link(profile, seed=4)
    taken: Link[int] = Link(profile, seed=4)
    for order in range(1000):
        sent.send(0, order)
    due = {order: due_ns for due_ns, order in sent.poll(10**12)}
    for order in range(100):
        taken.send(0, order)
    first, second = taken.streams.many(100, 600), taken.streams.many(700, 300)
    lost = [*first.lost.tolist(), *second.lost.tolist()]
    delays = [*first.delay_ns.tolist(), *second.delay_ns.tolist()]
    assert {k + 100: d for k, (d, gone) in enumerate(zip(delays, lost, strict=True)) if not gone} == {
        order: due_ns for order, due_ns in due.items() if order >= 100
    }
