"""Recordings that are torn, damaged, or cannot be written: what can be read is read, the rest is named in one line."""

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from hapnet.errors import RecordingError
from hapnet.recording.mcap import RecordingWriter, read_recording, repair, save
from tests.recording.test_mcap import write
from tests.recording.test_samples import META, device_sample, memory, run, same

CHILD = """
import sys, time
from hapnet.recording.mcap import RecordingWriter
from tests.recording.test_samples import META, device_sample
writer = RecordingWriter(sys.argv[1], META)
start, i = time.monotonic_ns(), 0
while True:
    now = time.monotonic_ns() - start
    while i * 1_000_000 <= now:
        writer.write(device_sample(i))
        i += 1
    writer.flush(now)
    print(i, flush=True)
    time.sleep(0.002)
"""


def test_a_killed_process_loses_at_most_the_last_half_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, text=True)
    written = 0
    for line in child.stdout:
        written = int(line)
        if written > 1200:
            break
    child.send_signal(signal.SIGKILL)
    written = max([written, *map(int, child.stdout.read().split())])
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    recording = read_recording(path)
    assert recording.torn
    assert recording.meta == META
    assert recording.summary is None
    assert written - 600 <= len(recording.device["time_s"])
    before = path.read_bytes()
    repaired = repair(path)
    assert repaired == tmp_path / "killed.repaired.mcap"
    assert path.read_bytes() == before
    copy = read_recording(repaired)
    assert not copy.torn
    assert same(copy, recording)
    with repaired.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary.chunk_indexes


def test_a_file_cut_anywhere_gives_a_prefix(tmp_path: Path) -> None:
    write(tmp_path / "whole.mcap", run(1))
    data = (tmp_path / "whole.mcap").read_bytes()
    whole = read_recording(tmp_path / "whole.mcap")
    assert whole.device is not None
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in [*range(600, len(data), 997), len(data) - 1]:
        for tail in (b"", bytes(64), b"\x06" + b"\xff" * 40):
            cut.write_bytes(data[:size] + tail)
            recording = read_recording(cut)
            assert recording.torn
            assert recording.meta == META
            count = 0 if recording.device is None else len(recording.device["time_s"])
            if recording.device is not None:
                np.testing.assert_array_equal(recording.device["position_m"], whole.device["position_m"][:count])
        counts.append(count)
    assert counts == sorted(counts)
    assert counts[-1] == 300


@pytest.mark.parametrize("content", [b"", b"time,x\n0,1\n" * 9, b"\x89MCAP0\r\n"])
def test_not_a_recording(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"data\.csv is not a recording: .*MCAP") as info:
        read_recording(path)
    assert "\n" not in str(info.value)


def test_repairing_what_is_not_a_recording_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"something else")
    with pytest.raises(RecordingError, match=r"a\.mcap is not a recording"):
        repair(tmp_path / "a.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_a_file_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot read recording .*nothing\.mcap: No such file"):
        read_recording(tmp_path / "nothing.mcap")
    with pytest.raises(RecordingError, match=r"cannot read recording .*Is a directory"):
        read_recording(tmp_path)
    with pytest.raises(RecordingError, match=r"cannot write recording .*a\.mcap: No such file"):
        RecordingWriter(tmp_path / "no" / "a.mcap", META)
    with pytest.raises(RecordingError, match=r"cannot write recording .*a\.mcap"):
        save(memory(run()), tmp_path / "no" / "a.mcap")
    with pytest.raises(RecordingError, match="cannot write recording /dev/full: No space left on device"):
        RecordingWriter("/dev/full", META)


def test_a_disk_that_fills_up_is_told_once_and_leaves_a_torn_file(tmp_path: Path) -> None:
    code = (
        "import resource, signal, sys\n"
        "from hapnet.errors import RecordingError\n"
        "from hapnet.recording.mcap import RecordingWriter\n"
        "from tests.recording.test_samples import META, device_sample\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))\n"
        "writer = RecordingWriter(sys.argv[1], META)\n"
        "try:\n"
        "    for i in range(10_000): writer.write(device_sample(i))\n"
        "except RecordingError as error: print(error)\n"
        "writer.close({})\n"
        "try: writer.write(device_sample(0))\n"
        "except RecordingError as error: print(error)\n"
    )
    path = tmp_path / "a.mcap"
    done = subprocess.run([sys.executable, "-X", "dev", "-c", code, path], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        f"cannot write recording {path}: File too large",
        f"recording {path} is closed",
    ]
    assert read_recording(path).torn


def test_flush_writes_only_when_half_a_second_has_passed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path, META)
    sizes = [os.path.getsize(path)]
    for now_ms in (0, 250, 499, 500, 750, 450):  # the last: a clock set back
        writer.write(device_sample(now_ms))
        writer.flush(now_ms * 1_000_000)
        sizes.append(os.path.getsize(path))
    grown = [later > earlier for earlier, later in itertools.pairwise(sizes)]
    assert grown == [True, False, False, True, False, True]
    writer.close()
