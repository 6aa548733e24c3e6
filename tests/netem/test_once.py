"""Nothing is delivered twice: thousands of messages through every named profile and every effect."""

import pytest

from netem import PRESETS, CapacityTrace, ConditionTrace, Link, LinkProfile
from tests.conftest import mostly_slow

MS = 1_000_000
COUNT = 4_000
EFFECTS = {
    **{name: LinkProfile.preset(name) for name in PRESETS},
    "delay and jitter": LinkProfile.parse("delay 40ms 10ms 25% distribution paretonormal"),
    "loss, corruption": LinkProfile.parse("loss gemodel 5% 20% corrupt 5%"),
    "reordering": LinkProfile.parse("delay 10ms reorder 25% 50% gap 3"),
    "resends": LinkProfile.parse("delay 5ms loss 20% resend 4 7ms"),
    "resends out of order over a line": LinkProfile.parse("delay 5ms loss 20% resend 4 7ms unordered rate 2mbit"),
    "slots": LinkProfile.parse("delay 3ms 1ms slot 2ms 9ms packets 20"),
    "slots over a line": LinkProfile.parse("slot 2ms bytes 900 rate 5mbit loss 5% resend 2 3ms unordered"),
    "a full queue": LinkProfile.parse("delay 50ms 20ms limit 30"),
    "a recorded line": LinkProfile(trace=CapacityTrace("memory", tuple(n * MS for n in (1, 1, 4, 9, 12)))),
    "recorded conditions": LinkProfile(csv=ConditionTrace("memory", (0, 9 * MS), (3 * MS, MS), (0.3, 0.0))),
}


@pytest.mark.parametrize("profile", mostly_slow([(one,) for one in EFFECTS.values()], 4), ids=EFFECTS)
@pytest.mark.long
def test_of_thousands_of_messages_each_is_delivered_once_or_counted(profile: LinkProfile) -> None:
    """Also across a link that goes down and up, and one that is changed while messages are under way."""
    link: Link[int] = Link(profile, 1)
    out: list[int] = []
    for number in range(COUNT):
        now = number * MS
        if number % 1000 == 400:
            link.down()
        if number % 1000 == 450:
            link.up()
        if number == 2500:
            link.change(profile.replace(seed=5), now)
        if link.passes():
            out.append(number)
        else:
            link.send(now, number, 100)
        out += [item for _, item in link.poll(now)]
    while (due_ns := link.next_due_ns) is not None:
        out += [item for _, item in link.poll(due_ns)]
    found = link.stats
    assert len(out) > 1500
    assert len(set(out)) == len(out) == found.delivered
    assert found.delivered + found.lost + found.lost_down + found.dropped_limit == found.offered == COUNT
    assert found.in_flight == 0
