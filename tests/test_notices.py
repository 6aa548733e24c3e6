from __future__ import annotations

import re
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapnet.runtime.notices import DROPS_EVERY_NS, ROUTINE, Drops, Notice, notice_of
from hapnet.wire.events import (
    EnergyCredited,
    Event,
    Mismatch,
    Paired,
    PeerHeard,
    PeerLeft,
    PeerRefused,
    PeerSilent,
    PositionReceived,
)
from hapnet.wire.messages import Identity

SECOND = 1_000_000_000
PEER = Identity(role="world", incarnation=5, name="there", dof=1, about={})


def about(value: float) -> Any:
    return pytest.approx(value)


def of(event: Event, on_silence: str = "hold") -> Notice | None:
    return notice_of(event, 7 * SECOND, "world", on_silence)


@pytest.mark.parametrize(
    ("event", "expected"),
    [
        (Paired(PEER, 1), Notice("paired", "paired with the world", 7 * SECOND, values={"pair": 1})),
        (
            Paired(PEER, 3),
            Notice("paired", "paired with the world (it restarted; pair 3)", 7 * SECOND, values={"pair": 3}),
        ),
        (PeerLeft("bye now"), Notice("left", "the world left: bye now", 7 * SECOND, values={"reason": "bye now"})),
        *(
            (
                event("2 axes, not 1"),
                Notice("refused", f"the world {says}: 2 axes, not 1", 7 * SECOND, "error", {"reason": "2 axes, not 1"}),
            )
            for event, says in ((Mismatch, "does not fit"), (PeerRefused, "refuses this side"))
        ),
        (
            PeerSilent(6_250_000_000),
            Notice(
                "silent",
                "nothing from the world for 0.75 s: the set-position is held",
                7 * SECOND,
                "warning",
                {"since_ns": 6_250_000_000, "silence_s": about(0.75)},
            ),
        ),
        (
            PeerHeard(2 * SECOND, 0, 0),
            Notice(
                "heard",
                "the world is heard again after 2.00 s",
                7 * SECOND,
                values={"silence_s": about(2.0), "recovery_s": 0.0, "missing": 0},
            ),
        ),
        (
            PeerHeard(2 * SECOND, 30_000_000, 12),
            Notice(
                "heard",
                "the world is heard again after 2.00 s, 30 ms after its first word; 12 positions are missing",
                7 * SECOND,
                values={"silence_s": about(2.0), "recovery_s": about(0.03), "missing": 12},
            ),
        ),
        (PositionReceived(3, 1, (0.0,)), None),
        (EnergyCredited(5), None),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_said_of_each_event(event: Event, expected: Notice | None) -> None:
    assert of(event) == expected


def test_what_a_side_does_in_silence_is_what_it_was_told_to_do() -> None:
    released = of(PeerSilent(6 * SECOND), "release")
    assert released is not None
    assert released.text == "nothing from the world for 1.00 s: the spring is let go"


def test_the_first_of_a_kind_is_told_at_once_and_others_wait() -> None:
    drops = Drops()
    assert drops.look(0, {}, {}) is None
    first = drops.look(SECOND, {"range": 1}, {"range": "4 J at once"})
    assert first is not None
    assert (first.kind, first.level, first.at_ns) == ("dropped", "warning", SECOND)
    assert first.text == "dropped 1 message: 1 range (4 J at once)"
    assert first.values == {"range": 1}
    assert drops.look(2 * SECOND, {"range": 50}, {"range": "x"}) is None
    new = drops.look(3 * SECOND, {"range": 60, "size": 2}, {"range": "x", "size": "5000 bytes"})
    assert new is not None
    assert new.text == "dropped 61 messages in the last 2 s: 59 range (x), 2 size (5000 bytes)"
    assert drops.look(3 * SECOND + DROPS_EVERY_NS - 1, {"range": 61, "size": 2}, {}) is None
    later = drops.look(3 * SECOND + DROPS_EVERY_NS, {"range": 61, "size": 2}, {"range": "y"})
    assert later is not None
    assert later.text == "dropped 1 message in the last 10 s: 1 range (y)"


def test_nothing_new_is_nothing_to_say_and_routine_is_never_said() -> None:
    drops = Drops()
    assert drops.look(0, dict.fromkeys(ROUTINE, 100), {}) is None
    assert drops.look(0, {"kind": 1, "stale": 5}, {"kind": "9"}) is not None
    for at in range(1, 100):
        assert drops.look(at * DROPS_EVERY_NS, {"kind": 1, "stale": 5 + at}, {"kind": "9"}) is None


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
    """At most one notice per `DROPS_EVERY_NS`, and one for each kind's first; the counts told and those owed add up."""
    drops, dropped, told = Drops(), Counter[str](), Counter[str]()
    now = 0
    notices = []
    for kind, count, later_ns in arrivals:
        now += later_ns
        dropped[kind] += count
        notice = drops.look(now, dropped, {})
        if notice is not None:
            notices.append(notice)
            told.update({name: int(value) for name, value in notice.values.items()})
            said = re.match(r"dropped (\d+) message", notice.text)
            assert said is not None
            assert int(said[1]) == sum(int(value) for value in notice.values.values())
        assert all(told[kind] for kind in dropped if kind not in ROUTINE)  # the first of a kind does not wait
    assert len(notices) <= now // DROPS_EVERY_NS + 1 + len(KINDS)
    assert all(told[kind] <= dropped[kind] for kind in told)
    last = drops.look(now + DROPS_EVERY_NS, dropped, {})
    if last is not None:
        told.update({name: int(value) for name, value in last.values.items()})
    assert told == {kind: count for kind, count in dropped.items() if kind not in ROUTINE}
