"""Recordings with damaged bytes: all chunks but the damaged ones are read, and the time of what is missing is named.

The positions of the chunks, and the samples in each, come from the `mcap` library and the undamaged file.
"""

import random
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from hapnet.errors import RecordingError
from hapnet.recording.mcap import RecordingWriter, read_recording, repair
from hapnet.recording.samples import Recording
from tests.conftest import mostly_slow
from tests.recording.test_samples import META, device_sample, world_sample

CHUNKS = 35
PER_CHUNK = 40
NANO = 1e9


def written(path: Path, *, closed: bool = True) -> bytes:
    """A recording of 35 chunks with 40 ms of both sides each; not `closed`: as a process leaves it that is killed."""
    writer = RecordingWriter(path, META)
    for chunk in range(CHUNKS):
        for i in range(chunk * PER_CHUNK, (chunk + 1) * PER_CHUNK):
            writer.write(device_sample(i))
            writer.write(world_sample(i)._replace(time_ns=device_sample(i).time_ns))
        writer.flush(chunk * 500_000_000)
    size = path.stat().st_size
    writer.close({"seed": 7})
    if not closed:
        path.write_bytes(path.read_bytes()[:size])
    return path.read_bytes()


class Place:
    """A chunk in a file: the bytes of its record, and the numbers of the samples in it."""

    def __init__(self, begin: int, end: int, rows: int, first_ns: int, last_ns: int) -> None:
        self.begin, self.end, self.rows = begin, end, rows
        self.first_ns, self.last_ns = first_ns, last_ns


def places(path: Path) -> list[Place]:
    """The chunks of a sound file."""
    found = []
    data = path.read_bytes()
    with path.open("rb") as file:
        reader = iter(StreamReader(file, emit_chunks=True).records)
        while len(found) < CHUNKS:
            record = next(reader)
            if isinstance(record, Chunk):
                end = file.tell()
                begin = end - len(record.data) - 49 - len(record.compression)
                assert data[begin] == 6
                assert struct.unpack_from("<Q", data, begin + 1)[0] == end - begin - 9
                messages = [one for one in breakup_chunk(record) if isinstance(one, Message)]
                times = [one.log_time for one in messages]
                found.append(Place(begin, end, len(messages), min(times), max(times)))
    return found


@pytest.fixture(scope="module", params=[True, False], ids=["closed", "killed"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Place], bool]:
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    written(path, closed=request.param)
    return path, places(path), request.param


def damaged(data: bytes, place: Place, how: str, rng: random.Random) -> bytes:
    """The file with one damage inside the record of a chunk."""
    at = rng.randrange(place.begin + 60, place.end - 40)
    if how == "bit":
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    if how == "head":  # the bytes before the content: length, times, size, checksum, compression
        at = rng.randrange(place.begin, place.begin + 9)
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    size = 30
    return data[:at] + (bytes(size) if how == "zeros" else b"") + data[at + size :]


def rows(recording: Recording) -> int:
    return sum(len(side["time_ns"]) for side in (recording.device, recording.world) if side is not None)


@pytest.mark.parametrize("numbers", mostly_slow([((0, 17, CHUNKS - 1),), (range(CHUNKS),)], 1, 1), ids=["three", "all"])
@pytest.mark.parametrize("how", mostly_slow(["bit", "head", "zeros", "cut"], 1))
@pytest.mark.long
def test_one_damaged_chunk_of_thirty_five_costs_one_chunk(
    whole: tuple[Path, list[Place], bool], tmp_path: Path, how: str, numbers: Sequence[int]
) -> None:
    path, chunks, closed = whole
    data, rng = path.read_bytes(), random.Random(how)
    original = read_recording(path)
    assert (rows(original), original.lost, original.torn) == (2 * CHUNKS * PER_CHUNK, (), not closed)
    every = set(original.device["time_ns"].tolist())
    for number in numbers:
        file = tmp_path / f"{number}.mcap"
        file.write_bytes(damaged(data, chunks[number], how, rng))
        found = read_recording(file)
        last_of_killed = not closed and number == CHUNKS - 1
        assert rows(found) >= 2 * (CHUNKS - 1) * PER_CHUNK, number
        assert found.meta == META
        assert found.summary == original.summary
        assert found.torn == (not closed)
        missing = sorted(every - set(found.device["time_ns"].tolist()))
        np.testing.assert_array_equal(
            found.device["position_m"],
            original.device["position_m"][np.isin(original.device["time_ns"], found.device["time_ns"])],
        )
        if last_of_killed:  # nothing shows that more came
            assert found.lost == ()
            continue
        [span] = found.lost
        if how == "head" and not missing:  # only the length was damaged, by a few bytes
            continue
        assert len(missing) == PER_CHUNK
        assert span.begin_ns is None if number == 0 else span.begin_ns < missing[0]
        assert span.end_ns > missing[-1] - (number == CHUNKS - 1)
        spare_ns = 2_000_000  # the distance of two samples, on both sides of what is missing
        if number:
            assert span.end_ns - span.begin_ns <= missing[-1] - missing[0] + spare_ns


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.long
def test_a_repaired_copy_has_all_that_is_left(tmp_path: Path, closed: bool) -> None:
    path = tmp_path / "a.mcap"
    data = written(path, closed=closed)
    place = places(path)[0]
    path.write_bytes(damaged(data, place, "bit", random.Random(1)))
    found = read_recording(path)
    copy = read_recording(repair(path))
    assert not copy.torn
    assert rows(copy) == rows(found) == 2 * (CHUNKS - 1) * PER_CHUNK
    assert copy.meta == META


@pytest.mark.parametrize(("before", "behind"), mostly_slow([(809, 541), (211, 139), (73, 47)], 1, 2))
@pytest.mark.long
def test_damage_outside_chunks_costs_no_samples(tmp_path: Path, before: int, behind: int) -> None:
    """Each copy of the settings, the header, the summary, the index, and the end; byte by byte of the small ones.

    before, behind : the distance in bytes of the damages before and behind all chunks.
    """
    path = tmp_path / "a.mcap"
    data = written(path)
    chunks = places(path)
    for at in [*range(8), *range(8, chunks[0].begin, before), *range(chunks[-1].end, len(data), behind), len(data) - 3]:
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        found = read_recording(path)
        assert rows(found) == 2 * CHUNKS * PER_CHUNK, at
        assert found.meta == META, at


def test_other_versions_settings_without_a_checksum_are_read() -> None:
    """Of a file of version 0.1.0, which this version must go on reading."""
    recording = read_recording(Path(__file__).parent.parent / "data" / "recording-0.1.0.mcap")
    assert recording.lost == ()
    assert not recording.torn


@pytest.mark.long
def test_a_swapped_number_in_the_settings_is_found(tmp_path: Path) -> None:
    """Damage that leaves valid JSON: the second copy counts."""
    path = tmp_path / "a.mcap"
    data = written(path)
    at = data.index(b'"origin_ns":') + len(b'"origin_ns":')
    path.write_bytes(data[:at] + b"9" + data[at + 1 :])
    assert read_recording(path).meta == META


def broken(rng: random.Random, data: bytes) -> bytes:
    """One to four damages anywhere: bits, zeros, cuts, swapped blocks, repeated blocks."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at = rng.randrange(len(data))
        size = min(int(2 ** rng.uniform(0, 15)), len(data) - at)
        kind = rng.randrange(6)
        if kind == 0:
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + bytes(size) + data[at + size :]
        elif kind == 2:
            data = data[:at] + data[at + size :]
        elif kind == 3:
            data = data[:at] + rng.randbytes(size) + data[at + size :]
        elif kind == 4:
            data = data[:at] + data[at : at + size] + data[at:]
        else:
            data = data[: max(at, 1)]
        data = data or b"\0"
    return data


def try_damages(path: Path, count: int, seed: int) -> None:
    """Read so many damaged copies; anything but a recording or a line is an error."""
    rng = random.Random(seed)
    original = written(path, closed=bool(seed % 2))
    for _ in range(count):
        path.write_bytes(broken(rng, original))
        if (line := refusal(path)) is not None:
            assert line.strip()
            assert "\n" not in line


def refusal(path: Path) -> str | None:
    """The line with which a file is refused; None: it was read, with its settings."""
    try:
        assert read_recording(path).meta == META
    except RecordingError as error:
        return str(error)
    return None


@pytest.mark.parametrize("seed", mostly_slow([1, 2], 1))
@pytest.mark.long
def test_random_damages_are_read_or_refused_in_one_line(tmp_path: Path, seed: int) -> None:
    try_damages(tmp_path / "a.mcap", 40, seed)


@pytest.mark.parametrize(("seed", "count"), mostly_slow([(40, 60), *((seed, 250) for seed in range(40))], 0, 1))
def test_ten_thousand_random_damages_in_forty_parts(tmp_path: Path, seed: int, count: int) -> None:
    """And a few of others among the slow tests."""
    try_damages(tmp_path / "a.mcap", count, 100 + seed)
