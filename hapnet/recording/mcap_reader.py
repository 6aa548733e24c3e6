"""Reads the records of MCAP files from any source: the sizes given in them are not trusted.

A chunk is unpacked only to its declared size, and all chunks together only to a limit that depends on the file's size:
hapnet's own files unpack to twice their size.
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
"""Largest size of an unpacked chunk [bytes]."""

MOST_TIMES, AT_LEAST = 30, 1 << 20
"""All chunks together unpack to at most this many times the file's size, but at least this many bytes are allowed."""

_WINDOW = 32 << 20  # largest window of zstd [bytes]


class Records:
    """The records of an MCAP file in order, up to the first incomplete record; `torn` is valid after the last.

    Raises RecordingError during iteration: the file cannot be read, is not an MCAP file, or unpacks to too much.
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

        # the errors of reader and decompressors for a record that is cut short or damaged (lz4: RuntimeError)
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
        raise ValueError(f"a chunk declares {size} bytes and does not have this size")
    return data


class _Claimed:
    """A file that limits each read to its size: to read a gigabyte, Python would first allocate a gigabyte."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._left = file, size

    def read(self, length: int) -> bytes:
        data = self._file.read(min(max(length, 0), self._left))
        self._left -= len(data)
        return data
