from hypothesis import given, strategies as st

from hapnet.commands.log import EVERY_NS, REPEATING, REPORTED, Repeats

SILENT = "no data from the world for 0.5 s; holding its last position"


def test_a_thing_that_happens_29_times_is_three_lines_and_one_that_counts() -> None:
    repeats = Repeats()
    shown = [repeats.line("device", "silent", SILENT, at * EVERY_NS // 30) for at in range(29)]
    assert [line for line in shown if line] == [SILENT] * REPORTED
    assert repeats.rest() == [("device", f"{SILENT} (the last of 26 more like this)")]
    assert repeats.rest() == []


def test_after_a_while_it_is_told_again_with_what_was_left_out() -> None:
    repeats = Repeats()
    for at in range(10):
        repeats.line("world", "overrun", f"away for {at} ms", at)
    assert repeats.line("world", "overrun", "away for 7 ms", EVERY_NS) == "away for 7 ms (7 more like this before it)"
    assert repeats.rest() == []


def test_what_is_said_on_purpose_and_what_others_say_is_shown() -> None:
    repeats = Repeats()
    for at in range(50):
        assert repeats.line("device", "netem", "emulated link, at 1s: down", at)
    for kind in REPEATING:
        for who in ("device", "world"):
            assert repeats.line(who, kind, "once", 0) == "once"


@given(st.lists(st.tuples(st.sampled_from(sorted(REPEATING)), st.integers(0, EVERY_NS)), max_size=60))
def test_every_notice_is_shown_or_counted(steps: list[tuple[str, int]]) -> None:
    repeats, now, shown, counted = Repeats(), 0, 0, 0
    for kind, step in steps:
        now += step
        line = repeats.line("device", kind, "x", now)
        shown += line is not None
        counted += int(line.split("(")[1].split()[0]) if line is not None and "(" in line else 0
    counted += sum(int(line.split("last of ")[1].split()[0]) for _, line in repeats.rest())
    assert shown + counted == len(steps)
