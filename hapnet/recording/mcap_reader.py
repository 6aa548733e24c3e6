"""Reads the records of MCAP files that may be anybody's: every size in them is a claim.

A chunk is unpacked only as far as it says that it goes, and all chunks together only as far as a file of this size can
go: hapnet's own unpack to twice their size.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

from hapnet.errors import RecordingError
from hapnet.file_content import MCAP, open_plain

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord


LARGEST_CHUNK = 8 << 20
"""No chunk unpacks to more [bytes]."""

MOST_TIMES, AT_LEAST = 30, 1 << 20
"""All chunks together unpack to at most so many times the file's size, and so many bytes."""

_WINDOW = 32 << 20  # of zstd [bytes]: what the decompressor may keep


class Records:
    """The records of an MCAP file in order, up to the first that is not whole; `torn` is known after the last.

    Raises RecordingError, while it is iterated: the file cannot be read, is no MCAP file, or unpacks to too much.
    """

    def __init__(self, path: Path) -> None:
        self.torn = False
        self._path = path
        self._left = 0

    def __iter__(self) -> Iterator[McapRecord]:
        import zstandard
        from mcap.exceptions import McapError
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader

        # what the reader and the decompressors raise on a record that is cut short or damaged (lz4: RuntimeError)
        damage = (McapError, ValueError, struct.error, RuntimeError, zstandard.ZstdError)
        try:
            with open_plain(self._path) as file:
                if file.read(len(MCAP)) != MCAP:
                    raise RecordingError(f"{self._path} is not a recording: expected an MCAP file written by hapnet")
                file.seek(0)
                size = os.fstat(file.fileno()).st_size
                self._left = max(MOST_TIMES * size, AT_LEAST)
                whole = _Claimed(file, size)
                reader = StreamReader(whole, emit_chunks=True, validate_crcs=True, record_size_limit=size)  # type: ignore[arg-type]
                records = iter(reader.records)
                while not self.torn:
                    try:
                        record = next(records, None)
                        inside = self._in_chunk(record) if isinstance(record, Chunk) else None
                    except damage:
                        self.torn = True
                        return
                    if record is None:
                        return
                    if inside is None:
                        yield record
                    else:
                        yield from inside
        except OSError as error:
            raise RecordingError(f"cannot read recording {self._path}: {error.strerror or error}") from error

    def _in_chunk(self, chunk: Chunk) -> list[McapRecord]:
        """The records in a chunk. Raises RecordingError: it is too large; else as the decompressors do."""
        from mcap.records import Chunk
        from mcap.stream_reader import breakup_chunk

        claimed = len(chunk.data) if not chunk.compression else chunk.uncompressed_size
        if claimed > min(LARGEST_CHUNK, self._left):
            raise RecordingError(
                f"{self._path} is not a recording: a chunk of {len(chunk.data)} bytes unpacks to {claimed}; at most "
                f"{LARGEST_CHUNK} a chunk are allowed, and {MOST_TIMES} times the file's size in all"
            )
        data = _unpacked(chunk, claimed)
        self._left -= len(data)
        plain = Chunk("", data, chunk.message_end_time, chunk.message_start_time, chunk.uncompressed_crc, len(data))
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("the checksum of a chunk is wrong")
        return breakup_chunk(plain)


def _unpacked(chunk: Chunk, size: int) -> bytes:
    """A chunk's data, of `size` bytes. Raises ValueError: it is of another size, or of an unknown compression."""
    if not chunk.compression:
        return chunk.data
    if chunk.compression == "zstd":
        import zstandard

        data: bytes = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise ValueError(f"chunks are compressed by {chunk.compression}")
    if len(data) != size:
        raise ValueError(f"a chunk says that it has {size} bytes, and has others")
    return data


class _Claimed:
    """A file that is never asked for more than there is: to read a gigabyte, Python takes a gigabyte first."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._left = file, size

    def read(self, length: int) -> bytes:
        data = self._file.read(min(max(length, 0), self._left))
        self._left -= len(data)
        return data
