"""The writer of recordings against the library's own: the same file, byte by byte, and no memory that grows."""

import random
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from hapnet.recording.mcap_writer import McapWriter

CHUNK_BYTES = 4000


def fill(writer: Any, seed: int, length: int) -> None:
    """Messages of several channels, late ones too, between flushes, attachments and metadata."""
    random_ = random.Random(seed)
    writer.start()
    writer.add_metadata("settings", {"a": "1", "ü": "2"})
    channels = []
    for number in range(length):
        time_ns = 1000 * number + random_.randrange(5000)
        if number % 40 == 0 and len(channels) < 5:
            schema = writer.register_schema(f"kind{number}", "protobuf", random_.randbytes(100))
            channels.append(writer.register_channel(f"/topic{number}", "protobuf", schema, {"k": "v"}))
        writer.add_message(
            random_.choice(channels), time_ns, random_.randbytes(random_.randrange(200)), time_ns, number
        )
        if random_.random() < 0.05:
            writer.flush()
        if random_.random() < 0.02:
            writer.add_attachment(time_ns, time_ns, "drawing", "application/zlib", random_.randbytes(3000))
        if random_.random() < 0.02:
            writer.add_metadata("summary", {"number": str(number)})
    writer.finish()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("length", [0, 1, 1000])
def test_the_same_bytes_as_by_the_librarys_writer(tmp_path: Path, seed: int, length: int) -> None:
    with (tmp_path / "ours.mcap").open("w+b") as file:
        fill(McapWriter(file, CHUNK_BYTES), seed, length)
    with (tmp_path / "theirs.mcap").open("wb") as file:
        fill(Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4), seed, length)
    assert (tmp_path / "ours.mcap").read_bytes() == (tmp_path / "theirs.mcap").read_bytes()


@pytest.mark.slow
@pytest.mark.long
def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """Ten thousand chunks, as in more than an hour of a run. The library's writer keeps 0.4 kB of each chunk here."""
    with (tmp_path / "long.mcap").open("w+b") as file:
        writer = McapWriter(file, CHUNK_BYTES)
        writer.start()
        channel = writer.register_channel("/topic", "protobuf", writer.register_schema("kind", "protobuf", b""))

        def chunks(first: int, end: int) -> None:
            for number in range(first, end):
                writer.add_message(channel, number, b"x", number)
                writer.flush()

        chunks(0, 100)
        tracemalloc.start()
        chunks(100, 10_000)
        kept, most = tracemalloc.get_traced_memory()
        writer.finish()
        most_at_end = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert kept < 5_000
    assert most < 50_000
    assert most_at_end < 500_000
    with (tmp_path / "long.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert len(summary.chunk_indexes) == 10_000
