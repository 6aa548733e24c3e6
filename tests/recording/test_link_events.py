"""Texts of a link's changes are read back as the changes, and make the link of a run from any instant on."""

import pytest

from hapnet.recording.link_events import played, read, text_of
from netem import LinkProfile, Timeline
from netem.profile import PRESETS
from netem.timeline import Entry

SLOW, LOSSY = LinkProfile.parse("delay 200ms 10ms distribution normal"), LinkProfile.parse("loss gemodel 1% 20%")


@pytest.mark.parametrize("change", [LinkProfile(), "down", "up", *map(LinkProfile.preset, PRESETS)], ids=str)
def test_what_is_told_is_read(change: LinkProfile) -> None:
    assert read(text_of(change)) == change
    assert read(text_of(Entry(1_234_567_891, change))) == change


@pytest.mark.parametrize(
    "text",
    ["", "delay 3ms", "emulated link, ", "emulated link, dealy 3ms", "emulated link, down; at 2s: up", "paused"],
)
def test_other_texts_are_none(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(text)


def test_what_was_before_the_run_is_in_force_at_its_start() -> None:
    changes = [
        (-9, text_of(SLOW)),
        (-5, text_of("down")),
        (0, text_of(LOSSY)),
        (7, text_of("up")),
        (7, text_of(Entry(3, SLOW))),
    ]
    start, entries, notes = played("delay 1ms", changes)
    assert start == str(LOSSY)
    assert entries == (Entry(0, "down"), Entry(7, "up"), Entry(7, SLOW))
    assert notes == []
    assert Timeline.parse(str(Timeline(entries))).entries == entries
    assert played("delay 1ms", []) == ("delay 1ms", (), [])
    assert played("", [(-2, text_of("down")), (-1, text_of("up"))]) == ("", (), [])


def test_what_cannot_be_read_is_left_out_and_told() -> None:
    start, entries, notes = played("", [(1, text_of("up")), (2, "emulated link, trace gone.txt"), (3, text_of("down"))])
    assert (start, [entry.action for entry in entries]) == ("", ["up", "down"])
    assert len(notes) == 1
    assert "gone.txt" in notes[0]
