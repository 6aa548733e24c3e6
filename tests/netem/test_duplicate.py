"""``duplicate P [C]``: its rate, what a copy goes through, and what it leaves as it was."""

import json
from collections import Counter
from math import sqrt

import numpy as np
import pytest

from hapnet import InvalidParameter, simulate
from netem import LinkProfile, ProfileError, expect
from netem.cli import main
from tests.netem.support import MS, drive, link_of

COUNT = 50_000


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("duplicate 1%", "duplicate 1%"),
        ("delay 5ms duplicate 10% 25% loss 2%", "delay 5ms loss 2% duplicate 10% 25%"),
    ],
)
def test_its_words_are_tcs(words: str, written: str) -> None:
    profile = LinkProfile.parse(words)
    assert str(profile) == written
    assert LinkProfile.parse(written) == profile


@pytest.mark.parametrize("words", ["duplicate", "duplicate 101%", "duplicate 5% 101%", "duplicate 5% duplicate 5%"])
def test_what_is_no_share_is_refused(words: str) -> None:
    with pytest.raises(ProfileError, match="duplicate"):
        LinkProfile.parse(words)


@pytest.mark.parametrize("share", [0.02, 0.3, 1.0])
def test_so_many_arrive_twice_and_none_three_times(share: float) -> None:
    """A binomial count: within four standard deviations."""
    link = link_of(f"delay 5ms duplicate {100 * share:g}%")
    times = Counter(number for _, number in drive(link, COUNT, MS))
    twice = sum(count == 2 for count in times.values())
    assert set(times.values()) <= {1, 2}
    assert len(times) == COUNT
    assert twice / COUNT == pytest.approx(share, abs=4 * sqrt(share * (1.0 - share) / COUNT))
    found = link.stats
    assert (found.duplicated, found.offered, found.delivered) == (twice, COUNT + twice, COUNT + twice)
    expected = expect(link.profile).duplicated
    assert expected == pytest.approx(share / (1.0 + share))
    assert found.duplicated / found.offered == pytest.approx(expected, abs=4 * sqrt(share * (1.0 - share) / COUNT))


def test_a_correlation_groups_them() -> None:
    """P(true | true) = P + C (1 - P)."""
    counts = Counter(number for _, number in drive(link_of("duplicate 20% 50%"), COUNT, MS))
    twice = np.array([counts[number] == 2 for number in range(COUNT)])
    assert np.corrcoef(twice[:-1], twice[1:])[0, 1] == pytest.approx(0.5, abs=0.03)
    assert twice.mean() == pytest.approx(0.2, abs=4 * sqrt(0.16 * 3.0 / COUNT))  # (1 + C)/(1 - C) times the variance


def test_a_copy_is_lost_delayed_and_queued_as_any_message() -> None:
    """Each of the two arrives with 0.9: 81 % of pairs arrive twice, 18 % once, 1 % never; delays are independent."""
    arrived = drive(link_of("delay 40ms 10ms loss 10% duplicate 100%"), COUNT, 100 * MS)
    counts = Counter(number for _, number in arrived)
    for times, share in ((2, 0.81), (1, 0.18)):
        found = sum(count == times for count in counts.values()) / COUNT
        assert found == pytest.approx(share, abs=4 * sqrt(share * (1.0 - share) / COUNT))
    due: dict[int, list[int]] = {}
    for due_ns, number in arrived:
        due.setdefault(number, []).append(due_ns - number * 100 * MS)
    pairs = np.array([delays for delays in due.values() if len(delays) == 2], dtype=float)
    apart = np.diff(pairs, axis=1)[:, 0] / MS  # of two uniform delays, sorted: a mean of a third of the width
    assert apart.mean() == pytest.approx(20.0 / 3.0, rel=0.02)


def test_a_line_takes_as_long_for_a_copy() -> None:
    """1000 bytes at 1 Mbit/s are 8 ms each."""
    due = [due_ns for due_ns, _ in drive(link_of("rate 1mbit duplicate 100%"), 3, 100 * MS, size=1000)]
    assert due == [100 * k * MS + wait for k in range(3) for wait in (8 * MS, 16 * MS)]


def test_a_full_queue_drops_copies_too() -> None:
    link = link_of("delay 1s limit 3 duplicate 100%")
    for number in range(2):
        link.send(0, number, 10)
    assert (link.stats.in_flight, link.stats.dropped_limit, link.stats.duplicated) == (3, 1, 2)


def test_without_it_every_draw_stays() -> None:
    """The first message that is offered twice is the first whose delay differs."""
    words = "delay 40ms 10ms loss 5%"
    plain, never = (drive(link_of(one), 2000, MS) for one in (words, f"{words} duplicate 0%"))
    assert plain == never


def test_the_survey_says_what_was_asked_and_what_came(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "delay 5ms duplicate 25%", "--count", "4000"]) == 0
    said = capsys.readouterr().out
    (line,) = [line for line in said.splitlines() if line.startswith("duplicated")]
    assert "expected 20.00 %" in line
    assert main(["show", "delay 5ms duplicate 25%", "--count", "4000", "--json", "-"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert 0.15 < whole["duplicated"] / whole["offered"] < 0.25


@pytest.mark.parametrize("name", ["link.up", "link.down", "link.up_timeline"])
def test_hapnet_refuses_it_with_the_reason(name: str) -> None:
    words = "at 1s: duplicate 1%" if name.endswith("timeline") else "delay 5ms duplicate 1%"
    with pytest.raises(InvalidParameter, match=rf"^{name} is .*without duplicate: Theorem 1 .*no energy arrives twice"):
        simulate({name: words})
