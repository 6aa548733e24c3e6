import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from hapnet.errors import RecordingError
from hapnet.realtime import recorder as module
from hapnet.realtime.recorder import Recorder
from hapnet.recording.mcap import FLUSH_NS, RecordingWriter, read_recording
from hapnet.recording.samples import Event, WorldSample
from tests.support.processes import no_room

META = {"origin_ns": 0, "clock": "test", "role": "world"}


def meta() -> dict[str, Any]:
    return META


def sample(index: int) -> WorldSample:
    one = (0.001 * index,)
    return WorldSample(
        index * 10_000_000, 0.01, one, one, one, one, one, one, 0.0, 0.1 + 1e-6 * index, 0.0, 0.0, 0.0, 1.0, 0.5
    )


def test_samples_are_written_in_their_order_with_the_summary(tmp_path: Path) -> None:
    reported: list[str] = []
    recorder = Recorder(tmp_path / "new" / "x.mcap", reported.append)
    assert not (tmp_path / "new").exists()  # nothing before it is known what the recording is of
    for index in range(500):
        recorder.keep(sample(index))
        if index % 50 == 0:
            recorder.drain(index * FLUSH_NS, meta)
    recorder.keep(Event(5_000_000_000, "paired", "paired with the device"))
    recorder.drain(501 * FLUSH_NS, meta)
    recorder.close({"seed": 3}, 0)
    recording = read_recording(tmp_path / "new" / "x.mcap")
    assert not recording.torn
    assert recording.summary == {"seed": 3}
    assert recording.world["time_ns"].tolist() == [index * 10_000_000 for index in range(500)]
    assert [event.kind for event in recording.events] == ["paired"]
    assert (reported, recorder.missing, recorder.broken) == ([], None, False)


def test_of_thousands_of_samples_none_is_missing(tmp_path: Path) -> None:
    """Kept in one go, and in many; and written without a recorder."""
    times = [index * 10_000_000 for index in range(3_500)]
    for together in (3_500, 7):
        path = tmp_path / f"{together}.mcap"
        recorder = Recorder(path, print)
        for index in range(3_500):
            recorder.keep(sample(index))
            if index % together == together - 1:
                recorder.drain(index, meta)
        recorder.drain(3_500, meta)
        recorder.close({}, 0)
        world = read_recording(path).world
        assert world["time_ns"].tolist() == times
        assert recorder.missing is None
    writer = RecordingWriter(tmp_path / "plain.mcap", META)
    for index in range(3_500):
        writer.write(sample(index))
    writer.close()
    world = read_recording(tmp_path / "plain.mcap").world
    assert world["time_ns"].tolist() == times


def test_a_recording_that_never_began_leaves_no_file_and_spares_one_that_is_there(tmp_path: Path) -> None:
    old = tmp_path / "old.mcap"
    old.write_bytes(b"of another run")
    for path in (tmp_path / "x.mcap", old):
        recorder = Recorder(path, print)
        recorder.keep(sample(0))
        recorder.close({}, 0)
        assert recorder.missing is None
    assert list(tmp_path.iterdir()) == [old]
    assert old.read_bytes() == b"of another run"


def test_a_file_that_cannot_be_written_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "x.mcap", Path("/proc/x.mcap")):
        with pytest.raises(RecordingError, match=r"cannot write recording .*: "):
            Recorder(path, print)


def test_a_full_disk_ends_the_recording_and_is_told_once(tmp_path: Path) -> None:
    reported: list[str] = []
    recorder = Recorder(tmp_path / "x.mcap", reported.append)
    with no_room(16000):
        for index in range(5000):
            recorder.keep(sample(index))
            recorder.drain(index * FLUSH_NS, meta)
        recorder.close({}, 0)
    assert recorder.broken
    path = tmp_path / "x.mcap"
    assert reported == [f"cannot write recording {path}: File too large; the run goes on without a recording"]
    assert recorder.missing == reported[0]
    assert not recorder._samples  # it keeps nothing that it will never write
    assert path.stat().st_size == 16000
    torn = read_recording(path)
    assert torn.torn
    assert torn.world["time_ns"].tolist() == [index * 10_000_000 for index in range(len(torn.world["time_ns"]))]
    assert len(torn.world["time_ns"]) > 10


def test_a_disk_that_is_full_only_at_the_end_is_told_too(tmp_path: Path) -> None:
    reported: list[str] = []
    recorder = Recorder(tmp_path / "x.mcap", reported.append)
    recorder.keep(sample(0))
    recorder.drain(0, meta)
    with no_room(os.stat(tmp_path / "x.mcap").st_size):
        recorder.close({"seed": 1}, 0)
    assert reported == [f"cannot write recording {tmp_path / 'x.mcap'}: File too large; its end is missing"]
    torn = read_recording(tmp_path / "x.mcap")
    assert torn.torn
    assert len(torn.world["time_ns"]) == 1


def test_a_recording_that_is_removed_is_missed(tmp_path: Path) -> None:
    reported: list[str] = []
    recorder = Recorder(tmp_path / "d" / "x.mcap", reported.append)
    recorder.keep(sample(0))
    recorder.drain(0, meta)
    (tmp_path / "d").rename(tmp_path / "e")  # moved is not removed
    recorder.drain(FLUSH_NS, meta)
    assert not reported
    shutil.rmtree(tmp_path / "e")
    recorder.drain(2 * FLUSH_NS, meta)
    assert reported == [f"cannot write recording {tmp_path / 'd' / 'x.mcap'}: it was removed; "
                    "the run goes on without a recording"]  # fmt: skip


def test_samples_that_find_no_room_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_SAMPLES", 100)
    reported: list[str] = []
    recorder = Recorder(tmp_path / "x.mcap", reported.append)
    for index in range(130):
        recorder.keep(sample(index))
    recorder.drain(0, meta)
    recorder.close({}, 7)
    assert reported == ["37 samples are missing: they came faster than they could be written"]
    assert recorder.missing == reported[0]
    assert not recorder.broken
    recording = read_recording(tmp_path / "x.mcap")
    assert len(recording.world["time_ns"]) == 100
