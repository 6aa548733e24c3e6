import re
from collections import Counter

from hypothesis import given, settings, strategies as st

from hapnet.realtime.notifier import MOST_REPORTED, PATIENCE_NS, REPORT_EVERY_NS, ROUTINE, Drops, Notifier
from hapnet.side.notices import Notice
from hapnet.wire.events import Mismatch, PeerLeft, PeerRefused, PeerSilent

SECOND = 1_000_000_000


def notifier_of(role: str = "device") -> tuple[Notifier, list[Notice]]:
    seen: list[Notice] = []
    return Notifier(role, "hold", seen.append), seen


def test_what_it_waits_for_is_told_when_it_changes() -> None:
    side, seen = notifier_of()
    for at in range(3):
        side.waiting(at, "dialling x", 0)
    side.waiting(3, "connected", 1)
    side.waiting(3 + PATIENCE_NS, "connected", 1)
    side.waiting(4 + PATIENCE_NS, "connected", 1)
    first, *more = [notice.text for notice in seen]
    assert first == "waiting for the world: dialling x"
    assert more == [
        "waiting for the world: connected",
        "waiting for the world: connected, which does not answer: it may be ending, or paired with another device",
    ]


def test_who_waits_beside_one_that_was_refused_says_so() -> None:
    """In a text that a stranger cannot vary: each of them would be reported."""
    side, seen = notifier_of("world")
    for number, event in enumerate((Mismatch("another secret word"), PeerRefused("no", by_peer=True))):
        side.happened(event, number)
        side.waiting(number, "connected to the device", 1)
    side.waiting(2, "no peer yet", 0)
    side.waiting(3, "connected to the device", 1)
    assert [notice.text.removeprefix("waiting for the device: ") for notice in seen if notice.kind == "waiting"] == [
        "the connected device was refused", "the connected device refuses this side",
        "no peer yet", "connected to the device",
    ]  # fmt: skip


def test_keys_that_are_silent_are_told_at_a_bounded_rate() -> None:
    side, seen = notifier_of()
    for at in range(30):
        side.keys(at * SECOND, ["energy"] if at >= 5 else [])
    assert [notice.at_ns for notice in seen] == [at * SECOND for at in (5, 15, 25)]
    assert seen[0].text.startswith("no energy messages arrive from the world, although others do")


def test_refusals_are_told_at_a_bounded_rate() -> None:
    side, seen = notifier_of("world")
    for at in range(100):
        side.happened((Mismatch if at % 2 else PeerRefused)(f"reason {at}"), at * SECOND)
    assert [notice.at_ns for notice in seen] == list(range(0, 100 * SECOND, REPORT_EVERY_NS))


def test_whoever_comes_and_goes_does_not_fill_the_log() -> None:
    """Pairs and ends, a hundred times a second for a minute: 20 in 10 s, and how many were left out."""
    seen: list[Notice] = []
    notifier = Notifier("world", "hold", seen.append)
    for k in range(6000):
        notifier.happened(PeerLeft("over") if k % 2 else PeerSilent(0), k * 10_000_000)
    assert len(seen) == 6 * MOST_REPORTED
    left_out = [int(found[1]) for notice in seen if (found := re.search(r"\((\d+) events", notice.text))]
    assert left_out == [1000 - MOST_REPORTED] * 5


def test_a_lost_connection_is_told_once_and_how_long_it_was_gone() -> None:
    side, seen = notifier_of()
    for at, up in enumerate((True, False, False, False, True, True)):
        side.link(at * SECOND, up=up)
    assert [(notice.at_ns, notice.level, notice.text) for notice in seen] == [
        (SECOND, "warning", "the connection to the world is lost"),
        (4 * SECOND, "info", "the connection is back after 3.00 s"),
    ]


def test_the_first_of_a_kind_is_told_at_once_and_others_wait() -> None:
    drops = Drops()
    assert drops.look(0, {}, {}) is None
    first = drops.look(SECOND, {"range": 1}, {"range": "4 J at once"})
    assert (first.kind, first.level, first.at_ns) == ("dropped", "warning", SECOND)
    assert first.text == "dropped 1 message: 1 range (4 J at once)"
    assert first.values == {"range": 1}
    assert drops.look(2 * SECOND, {"range": 50}, {"range": "x"}) is None
    new = drops.look(3 * SECOND, {"range": 60, "size": 2}, {"range": "x", "size": "5000 bytes"})
    assert new.text == "dropped 61 messages in the last 2 s: 59 range (x), 2 size (5000 bytes)"
    assert drops.look(3 * SECOND + REPORT_EVERY_NS - 1, {"range": 61, "size": 2}, {}) is None
    later = drops.look(3 * SECOND + REPORT_EVERY_NS, {"range": 61, "size": 2}, {"range": "y"})
    assert later.text == "dropped 1 message in the last 10 s: 1 range (y)"


def test_nothing_new_is_nothing_to_say_and_routine_is_never_said() -> None:
    drops = Drops()
    assert drops.look(0, dict.fromkeys(ROUTINE, 100), {}) is None
    assert drops.look(0, {"kind": 1, "stale": 5}, {"kind": "9"}) is not None
    for at in range(1, 100):
        assert drops.look(at * REPORT_EVERY_NS, {"kind": 1, "stale": 5 + at}, {"kind": "9"}) is None


KINDS = ("size", "malformed", "kind", "type", "range", "stranger", "stale", "closed")


@settings(max_examples=200, deadline=None)
@given(
    arrivals=st.lists(
        st.tuples(st.sampled_from(KINDS), st.integers(1, 10**6), st.integers(0, 3 * SECOND)), max_size=200
    )
)
def test_whatever_arrives_the_rate_is_bounded_and_nothing_is_counted_twice(
    arrivals: list[tuple[str, int, int]],
) -> None:
    """At most one notice per `REPORT_EVERY_NS`, and one for each kind's first; all counts add up."""
    drops, dropped, seen = Drops(), Counter[str](), Counter[str]()
    now = 0
    notices = []
    for kind, count, later_ns in arrivals:
        now += later_ns
        dropped[kind] += count
        notice = drops.look(now, dropped, {})
        if notice is not None:
            notices.append(notice)
            seen.update({name: int(value) for name, value in notice.values.items()})
            said = re.match(r"dropped (\d+) message", notice.text)
            assert int(said[1]) == sum(int(value) for value in notice.values.values())
        assert all(seen[kind] for kind in dropped if kind not in ROUTINE)  # the first of a kind does not wait
    assert len(notices) <= now // REPORT_EVERY_NS + 1 + len(KINDS)
    assert all(seen[kind] <= dropped[kind] for kind in seen)
    last = drops.look(now + REPORT_EVERY_NS, dropped, {})
    if last is not None:
        seen.update({name: int(value) for name, value in last.values.items()})
    assert seen == {kind: count for kind, count in dropped.items() if kind not in ROUTINE}
