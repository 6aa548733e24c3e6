import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from hapnet.commands.log import EVERY_NS, REPEATING, Repeats
from tests.support.processes import started

SECOND = 1_000_000_000


def notice(kind: str, text: str, at_ns: int, **values: float) -> dict[str, Any]:
    return {"kind": kind, "text": text, "monotonic_ns": at_ns, "values": values}


def silence(number: int, lasts_s: float) -> list[dict[str, Any]]:
    """A silence that begins after `number` times 3 s: one notice when it is noticed, one when it is over."""
    at_ns = number * 3 * SECOND
    return [
        notice("silent", "no data from the world for 0.5 s; holding its last position", at_ns, silence_s=0.5),
        notice("heard", f"data from the world again after {lasts_s} s", at_ns + SECOND, silence_s=lasts_s),
    ]


def test_ten_silences_are_two_lines_and_one_that_counts() -> None:
    repeats = Repeats()
    lasts_s = [0.9, 0.6, 0.7, 0.8, 0.6, 1.2, 0.6, 0.7, 0.6, 0.6]
    found = [repeats.line("device", one) for number, lasts in enumerate(lasts_s) for one in silence(number, lasts)]
    assert [line for line in found if line] == [
        "no data from the world for 0.5 s; holding its last position",
        "data from the world again after 0.9 s",
    ]
    rest = "no data from the world for 0.5 s; holding its last position ... 9 more times, the longest 1.2 s"
    assert repeats.rest() == [("device", rest)]
    assert repeats.rest() == []


def test_one_more_is_one_more_time() -> None:
    repeats = Repeats()
    for at in range(2):
        repeats.line("world", notice("rate", "the servo made 900 ticks", at))
    assert repeats.rest() == [("world", "the servo made 900 ticks ... 1 more time")]


def test_after_a_minute_a_line_counts_what_was_left_out() -> None:
    repeats = Repeats()
    for at in range(10):
        repeats.line("world", notice("overrun", f"stalled for {at} ms", at))
    assert (
        repeats.line("world", notice("overrun", "stalled for 7 ms", EVERY_NS)) == "stalled for 7 ms ... 10 more times"
    )
    assert repeats.rest() == []


def test_a_lost_connection_and_its_return_are_different_things() -> None:
    repeats = Repeats()
    lost, back = "the connection to the world is lost", "the connection is back after {} s"
    shown = [
        repeats.line("device", one)
        for gone_s in (1.25, 4.0, 2.0)
        for one in (notice("link", lost, 0), notice("link", back.format(gone_s), 1, gone_s=gone_s))
    ]
    assert [line for line in shown if line] == [lost, back.format(1.25)]
    assert repeats.rest() == [
        ("device", f"{lost} ... 2 more times"), ("device", f"{back.format(2.0)} ... 2 more times, the longest 4 s")
    ]  # fmt: skip


def test_what_is_said_on_purpose_and_what_others_say_is_shown() -> None:
    repeats = Repeats()
    for at in range(50):
        assert repeats.line("device", notice("netem", "emulated link, at 1s: down", at))
    for kind in REPEATING:
        for who in ("device", "world"):
            assert repeats.line(who, notice(kind, "once", 0)) == "once"


@given(st.lists(st.tuples(st.sampled_from(sorted({*REPEATING} - {"heard"})), st.integers(0, EVERY_NS)), max_size=60))
def test_every_notice_is_shown_or_counted(steps: list[tuple[str, int]]) -> None:
    """But for the end of a silence, which its begin stands for."""
    repeats, now, shown, counted = Repeats(), 0, 0, 0
    for kind, step in steps:
        now += step
        line = repeats.line("device", notice(kind, "x", now))
        if line is not None:
            more = int(line.split("... ")[1].split()[0]) if "..." in line else 0
            shown, counted = shown + (not more), counted + more
    counted += sum(int(line.split("... ")[1].split()[0]) for _, line in repeats.rest())
    assert shown + counted == len(steps)


@pytest.mark.slow
def test_a_run_whose_link_is_down_ten_times(tmp_path: Path) -> None:
    """Each side prints its first silence, its end, and a line that counts the nine others."""
    changes = "; ".join(f"at {1 + k}s: down; at {1 + k}.{6 if k == 4 else 4}s: up" for k in range(10))
    quick = ("--silence-after", "0.1", "--link", "delay 5ms", "--timeline", changes)
    with started("run", "--duration", 12, "--out", tmp_path / "run", *quick) as program:
        code, said, err = program.end()
    assert code == 0, said + err
    for side, other in (("device", "world"), ("world", "device")):
        lines = [
            line for line in said.splitlines() if line.startswith(f"{side}: ") and f"data from the {other}" in line
        ]
        assert len(lines) == 3, said
        assert re.fullmatch(rf"{side}: no data from the {other} for 0\.1\d? s; holding its last position", lines[0])
        assert re.fullmatch(rf"{side}: data from the {other} again after 0\.[3-5]\d? s.*", lines[1])
        count = rf"{side}: no data from the {other} for 0\.1\d? s; holding its last position \.\.\. 9 more times, "
        longest = re.fullmatch(count + r"the longest (0\.\d+) s", lines[2])
        assert longest is not None, said
        assert 0.5 <= float(longest[1]) <= 0.8
    log = (tmp_path / "run" / "log.jsonl").read_text("utf-8")
    assert log.count('"kind": "silent"') >= 20
