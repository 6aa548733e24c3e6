"""Timelines: text and back, what is refused and how, and changes applied at their times without losing anything."""

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from netem import Link, LinkProfile, ProfileError, Timeline, TimelinePlayer, units
from netem.timeline import Entry
from tests.netem.support import profiles

MS = 1_000_000
S = 1_000_000_000

short_times = st.integers(0, 50).map(lambda n: n * MS)
actions = st.one_of(st.sampled_from(["down", "up"]), profiles(short_times))


@st.composite
def timelines(draw: st.DrawFn, max_ns: int = units.MAX_TIME_NS) -> Timeline:
    times = sorted(draw(st.lists(st.integers(0, max_ns), min_size=1, max_size=6)))
    repeat = draw(st.one_of(st.just(0), st.integers(max(times[-1], 1), max_ns)))
    return Timeline(tuple(Entry(at, draw(actions)) for at in times), repeat)


@settings(max_examples=50)
@given(timelines())
@pytest.mark.long
def test_text_round_trip(timeline: Timeline) -> None:
    assert Timeline.parse(str(timeline)) == timeline


def test_the_example_as_text_and_as_a_file(tmp_path: Path) -> None:
    expected = Timeline((Entry(5 * S, LinkProfile(delay_ns=200 * MS)), Entry(8 * S, "down"), Entry(9 * S, "up")))
    assert Timeline.parse("at 5s: delay 200ms; at 8s: down; at 9s: up") == expected
    assert str(expected) == "at 5s: delay 200ms; at 8s: down; at 9s: up"
    path = tmp_path / "outage.txt"
    path.write_text("# an outage\n\nat 5s: delay 200ms  # slower\nat 8s: down;\n  at 9000ms : up\n")
    assert Timeline.load(str(path)) == Timeline.read(str(path)) == expected
    assert Timeline.read(str(expected)) == expected


def test_names_of_profiles_and_repetition() -> None:
    timeline = Timeline.parse("at 0s: geo; at 1s: ideal; at 2s: repeat")
    assert timeline == Timeline((Entry(0, LinkProfile.preset("geo")), Entry(S, LinkProfile())), repeat_ns=2 * S)
    assert Timeline.parse(str(timeline)) == timeline


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "at TIME"),
        ("# nothing", "at TIME"),
        ("at 5s", "entry 1.*at TIME"),
        ("at 5s:", "entry 1.*at TIME"),
        ("in 5s: down", "entry 1.*at TIME"),
        ("at 1s: up; at 5: down", r"entry 2.*at: '5'"),
        ("at 1s: up; at -5s: down", r"entry 2.*'-5s'"),
        ("at 1s: dely 3ms", r"entry 1 \('at 1s: dely 3ms'\).*'dely'.*did you mean delay"),
        ("at 1s: up; at 2s: delay 3", r"entry 2.*delay: '3'"),
        ("at 1s: up; at 2s: duplicate 300%", r"entry 2.*duplicate.*300%"),
        ("at 2s: up; at 1s: down", r"entry 2.*'1s'.*not before"),
        ("at 1s: up; at 2s: repeat; at 3s: down", "entry 3.*after 'repeat'"),
        ("at 1s: repeat", "entry 1.*after at least one entry"),
        ("at 0s: up; at 0s: repeat", "entry 2.*above 0"),
        ('at 1s: trace "a', "entry 1.*double quotes"),
        ("at 1s: trace /no/such/file", "entry 1.*/no/such/file"),
    ],
)
def test_malformed_entries_are_named(text: str, named: str) -> None:
    with pytest.raises(ProfileError, match=named) as caught:
        Timeline.parse(text)
    assert "\n" not in str(caught.value)


@given(
    st.text(max_size=40) | st.lists(st.sampled_from(["at 1s", ":", ";", "up", "\n", '"', "#", "repeat"])).map("".join)
)
@pytest.mark.long
def test_any_text_is_parsed_or_refused(text: str) -> None:
    try:
        timeline = Timeline.parse(text)
    except ProfileError:
        return
    assert Timeline.parse(str(timeline)) == timeline


@pytest.mark.parametrize("text", ["at 1s down", "at 1s", "# nothing", " at down", "1s: down", "down"])
def test_what_was_to_be_a_timeline_is_told_its_form(text: str) -> None:
    """Only what does not begin like one may be meant as a file's name."""
    with pytest.raises(ProfileError, match="'at TIME: PROFILE'") as caught:
        Timeline.read(text)
    assert ("file" in str(caught.value)) == (text in ("1s: down", "down"))


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="/no/such/timeline"):
        Timeline.read("/no/such/timeline")
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with pytest.raises(ProfileError, match="text"):
        Timeline.load(str(tmp_path / "binary"))


@pytest.mark.parametrize(
    ("entries", "repeat_ns"),
    [((Entry(5, "up"), Entry(4, "down")), 0), ((Entry(5, "up"),), 4), ((Entry(-1, "up"),), 0), ((Entry(0, "up"),), -1)],
)
def test_timelines_made_in_a_program_are_checked(entries: tuple[Entry, ...], repeat_ns: int) -> None:
    with pytest.raises(ProfileError):
        Timeline(entries, repeat_ns)


def play(words: str, text: str, count: int, start_ns: int = 0) -> tuple[list[tuple[int, int]], Link[int]]:
    """One message a millisecond, the timeline advanced before each: release times in ms, and the link."""
    link: Link[int] = Link(LinkProfile.parse(words), 1)
    player = TimelinePlayer(link, Timeline.parse(text), start_ns)
    out = []
    for number in range(count):
        player.advance(number * MS)
        link.send(number * MS, number, 100)
        out += link.poll(number * MS)
    return [(due // MS, number) for due, number in out + link.poll(10**18)], link


def test_changes_happen_at_their_times_and_lose_nothing_in_flight() -> None:
    out, link = play("delay 10ms", "at 3ms: delay 2ms; at 5ms: down; at 6ms: up", 8)
    assert out == [(5, 3), (6, 4), (8, 6), (9, 7), (10, 0), (11, 1), (12, 2)]
    assert (link.stats.lost_down, link.stats.in_flight) == (1, 0)


def test_a_late_caller_applies_a_change_with_the_time_it_was_due(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("10\n")
    link: Link[int] = Link(LinkProfile())
    TimelinePlayer(link, Timeline.parse(f"at 2ms: trace {tmp_path}/t"), 0).advance(7 * MS)
    link.send(7 * MS, 0, 1500)
    assert link.next_due_ns == 12 * MS


def test_a_repeated_timeline_starts_over_on_its_own_clock() -> None:
    _, link = play("", "at 2ms: down; at 3ms: up; at 5ms: repeat", 30, start_ns=4 * MS)
    # down from 6, 11, 16, 21 and 26 ms on, for a millisecond each
    assert link.stats.lost_down == 5


def test_advance_tells_what_it_did_and_when_the_next_is_due() -> None:
    link: Link[int] = Link(LinkProfile())
    timeline = Timeline.parse("at 1s: down; at 1s: up; at 3s: delay 1ms")
    player = TimelinePlayer(link, timeline, 10 * S)
    assert player.next_due_ns == 11 * S
    assert player.advance(11 * S - 1) == []
    assert link.is_up
    assert player.advance(11 * S) == [(11 * S, timeline.entries[0]), (11 * S, timeline.entries[1])]
    assert link.is_up
    assert player.next_due_ns == 13 * S
    assert player.advance(99 * S) == [(13 * S, timeline.entries[2])]
    assert link.profile == LinkProfile(delay_ns=MS)
    assert player.next_due_ns is None
    assert player.advance(10**18) == []


def test_a_caller_who_is_late_by_many_repetitions_ends_in_the_same_state() -> None:
    timeline = Timeline.parse("at 1ms: delay 3ms; at 2ms: down; at 4ms: delay 5ms; at 5ms: repeat")
    for late_ns in (10**15 + k * MS for k in range(6)):
        link: Link[int] = Link(LinkProfile())
        player = TimelinePlayer(link, timeline, 0)
        assert len(player.advance(late_ns)) < 12
        phase = late_ns % (5 * MS)
        assert link.profile.delay_ns == (3 * MS if MS <= phase < 4 * MS else 5 * MS)
        assert late_ns < player.next_due_ns <= late_ns + 2 * MS


@pytest.mark.parametrize("seen_ns", [0, 1 * MS, 3 * MS, 5 * MS - 1])
@pytest.mark.parametrize("late", [3, 4, 40])
@pytest.mark.parametrize("phase_ns", [0, 1 * MS, 3 * MS, 5 * MS - 1])
def test_a_caller_who_is_late_is_told_the_last_whole_repetition(seen_ns: int, late: int, phase_ns: int) -> None:
    """And the one begun since then; not all that it missed, one repetition more at the most."""
    timeline = Timeline.parse("at 1ms: delay 3ms; at 2ms: down; at 4ms: delay 5ms; at 5ms: repeat")
    player = TimelinePlayer(Link(LinkProfile()), timeline, 0)
    player.advance(seen_ns)
    now = late * 5 * MS + phase_ns
    reported = player.advance(now)
    cycles = [[(c * 5 * MS + e.at_ns, e) for e in timeline.entries] for c in (late - 1, late)]
    expected = [change for cycle in cycles for change in cycle if change[0] <= now]
    assert reported[-len(expected) :] == expected
    assert len(reported) <= len(expected) + len(timeline.entries)


@settings(max_examples=50, deadline=None)
@given(timelines(60 * MS), st.integers(0, 2**32))
@pytest.mark.long
def test_no_timeline_repeats_a_message_or_loses_it_uncounted(timeline: Timeline, seed: int) -> None:
    link: Link[int] = Link(LinkProfile(), seed)
    player = TimelinePlayer(link, timeline, 0)
    out = []
    for number in range(100):
        player.advance(number * MS)
        link.send(number * MS, number, 50)
        out += link.poll(number * MS)
    while (due_ns := link.next_due_ns) is not None:
        out += link.poll(due_ns)
    assert len({number for _, number in out}) == len(out)
    assert all(due >= number * MS for due, number in out)
    assert all(earlier <= later for (earlier, _), (later, _) in pairwise(out))
    found = link.stats
    assert len(out) + found.lost + found.lost_down + found.dropped_limit == 100
