"""Reads the records of MCAP files from any source, around what is damaged: the sizes given in them are not trusted.

A record that cannot be read, or whose checksum is wrong, is left out; reading continues at the next record that can be
recognized by its bytes. A chunk is unpacked only to its declared size, and all chunks together only to a limit that
depends on the file's size: hapnet's own files unpack to twice their size.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from hapnet.errors import RecordingError
from hapnet.file_content import MCAP, open_plain

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord


LARGEST_CHUNK = 8 << 20
"""Largest size of an unpacked chunk [bytes]."""

MOST_TIMES, AT_LEAST = 30, 1 << 20
"""All chunks together unpack to at most this many times the file's size, but at least this many bytes are allowed."""

CHECKSUM = "crc32"
"""The key under which a metadata record has the checksum of its text: MCAP has none for such records."""

_WINDOW = 32 << 20  # largest window of zstd [bytes]
_RECORD = struct.Struct("<BQ")  # opcode and length
_LONG = struct.Struct("<I")
_INDEX, _DATA_END, _FOOTER = 0x07, 0x0F, b"\x02\x14" + bytes(7)
_END_BYTES = _RECORD.size + 20 + len(MCAP)  # footer and magic
_LATE_START = 1 << 20  # a damaged beginning is searched for the first record up to here [bytes]

_PLACES = re.compile(
    rb"\x06.{5}\0{3}.{28}(?:\x03\0\0\0lz4|\x04\0\0\0zstd)"  # a chunk: length, times, size, checksum, compression
    rb"|\x0c.{5}\0{3}(?:\x06\0\0\0hapnet|\x0e\0\0\0hapnet\.summary)"  # settings and summary
    rb"|\x09.{5}\0{3}.{16}\x07\0\0\0drawing"  # the world's parts
    rb"|\x0f\x04\0{7}"  # the end of the data
    rb"|\x02\x14\0{7}.{20}\x89MCAP0\r\n",  # the end of the file
    re.DOTALL,
)
_LONGEST_PLACE, _BLOCK = 64, 1 << 20


class Records:
    """The records of an MCAP file in order, without those that are damaged.

    Attributes, valid after the last record
    ---------------------------------------
    torn : the file has no proper end.
    lost : for each damaged part, the log times of the last message before it and of the first after it [ns]; None:
        there is none. What is missing is of a time between them.

    Raises RecordingError during iteration: the file cannot be read, is not an MCAP file, or unpacks to too much.
    """

    def __init__(self, path: Path) -> None:
        self.torn = False
        self.lost: list[tuple[int | None, int | None]] = []
        self._path = path
        self._left = self._for_damage = 0
        self._size = 0
        self._in_damage = False
        self._before: list[Any] = []

    def __iter__(self) -> Iterator[McapRecord]:
        import zstandard
        from mcap.exceptions import McapError

        # the errors of reader and decompressors for a record that is cut short or damaged (lz4: RuntimeError)
        damage = (McapError, ValueError, struct.error, RuntimeError, OverflowError, zstandard.ZstdError)
        try:
            with open_plain(self._path) as file:
                self._size = os.fstat(file.fileno()).st_size
                self._left = int(max(MOST_TIMES * self._size, AT_LEAST))
                self._for_damage = self._left + 4 * LARGEST_CHUNK
                at: int | None = self._begin(file)
                while at is not None:
                    try:
                        opcode, records, end = self._read(file, at)
                    except damage:
                        self._in_damage = True
                        at = self._find(file, at + 1, self._size)
                        continue
                    self._note_times(records)
                    yield from records
                    if opcode == _DATA_END and not self._sound_index(file, end):
                        self.torn, at = True, None
                    else:
                        at = end if opcode != _FOOTER[0] else None
                if not self._ends_well(file):
                    self.torn = True
                elif self._in_damage:
                    self._add_gap(None)
        except OSError as error:
            raise RecordingError(f"cannot read recording {self._path}: {error.strerror or error}") from error

    def _begin(self, file: IO[bytes]) -> int | None:
        """The place of the first record. Raises RecordingError: this is not an MCAP file."""
        if file.read(len(MCAP)) == MCAP:
            return len(MCAP)
        self._in_damage = True
        if (at := self._find(file, 0, min(self._size, _LATE_START))) is None:
            raise self._refused("expected an MCAP file written by hapnet")
        return at

    def _find(self, file: IO[bytes], at: int, until: int) -> int | None:
        """The place of the next record that is recognized by its bytes, from `at` on."""
        while at < until:
            file.seek(at)
            found = _PLACES.search(file.read(_BLOCK + _LONGEST_PLACE))
            if found is not None and found.start() < _BLOCK:
                return at + found.start()
            at += _BLOCK
        return None

    def _read(self, file: IO[bytes], at: int) -> tuple[int, list[McapRecord], int]:
        """The record at this place: its opcode, its content as records, and its end. Raises `damage`."""
        file.seek(at)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        end = at + _RECORD.size + length
        if end > self._size:
            raise ValueError("a record that is longer than the file")
        if opcode == _INDEX:  # it is not needed; its length shows whether it is sound
            if length != 6 + _LONG.unpack(file.read(6)[2:])[0]:
                raise ValueError("an index of another length")
            return opcode, [], end
        self._for_damage -= length  # in a damaged file the same bytes may be read again and again
        if self._for_damage < 0:
            raise self._refused("it is damaged in too many places")
        return opcode, self._content(opcode, file.read(length)), end

    def _content(self, opcode: int, data: bytes) -> list[McapRecord]:
        from mcap import records as kinds
        from mcap.data_stream import ReadDataStream

        found = (
            kinds.Header, kinds.Footer, kinds.Schema, kinds.Channel, None, kinds.Chunk, None, kinds.ChunkIndex,
            kinds.Attachment, kinds.AttachmentIndex, kinds.Statistics, kinds.Metadata, kinds.MetadataIndex,
            kinds.SummaryOffset, kinds.DataEnd,
        )  # by opcode, from 1; messages are in chunks only  # fmt: skip
        if not 1 <= opcode <= len(found) or (kind := found[opcode - 1]) is None:
            raise ValueError("a record that does not belong here")
        stream = ReadDataStream(BytesIO(data))
        record: Any = kind.read(stream)
        if stream.count != len(data):
            raise ValueError("a record of another length than its content")
        if isinstance(record, kinds.Chunk):
            return self._in_chunk(record)
        if isinstance(record, kinds.Attachment) and _LONG.unpack(data[-4:])[0] not in (0, zlib.crc32(data[:-4])):
            raise ValueError("the checksum of an attachment is wrong")
        if isinstance(record, kinds.Metadata) and CHECKSUM in record.metadata:
            texts = [text for key, text in record.metadata.items() if key != CHECKSUM]
            if record.metadata[CHECKSUM] != checksum(*texts):
                raise ValueError("the checksum of a metadata record is wrong")
        return [record]

    def _in_chunk(self, chunk: Chunk) -> list[McapRecord]:
        """The records in a chunk. Raises RecordingError: it is too large; else as the decompressors do."""
        from mcap.records import Chunk
        from mcap.stream_reader import breakup_chunk

        claimed = len(chunk.data) if not chunk.compression else chunk.uncompressed_size
        allowed = max(0, min(LARGEST_CHUNK, self._left))
        data = _unpacked(chunk, min(claimed, allowed) + 1)
        self._for_damage -= len(data)
        if claimed > allowed and len(data) > allowed:
            raise self._refused(
                f"a chunk of {len(chunk.data)} bytes unpacks to {claimed}; at most {LARGEST_CHUNK} a chunk are "
                f"allowed, and {MOST_TIMES} times the file's size in all"
            )
        if len(data) != claimed:
            raise ValueError(f"a chunk declares {claimed} bytes and does not have this size")
        plain = Chunk("", data, chunk.message_end_time, chunk.message_start_time, chunk.uncompressed_crc, len(data))
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("the checksum of a chunk is wrong")
        self._left -= len(data)
        return breakup_chunk(plain)

    def _refused(self, why: str) -> RecordingError:
        return RecordingError(f"{self._path} is not a recording: {why}")

    def _note_times(self, records: list[McapRecord]) -> None:
        """Note the end of a damaged part, if these records have times."""
        from mcap.records import Message, Statistics

        if self._in_damage:
            times = [record.log_time for record in records if isinstance(record, Message)]
            times += [record.message_end_time for record in records if isinstance(record, Statistics)]
            if times:
                self._add_gap(min(times))
        if len(records) > 1:  # a chunk
            self._before = records

    def _add_gap(self, end_ns: int | None) -> None:
        from mcap.records import Message

        times = [record.log_time for record in self._before if isinstance(record, Message)]
        self.lost.append((max(times, default=None), end_ns))
        self._in_damage = False

    def _sound_index(self, file: IO[bytes], at: int) -> bool:
        """Whether the records from `at` to the footer have the footer's checksum."""
        file.seek(max(0, self._size - _END_BYTES))
        footer = file.read(_END_BYTES)
        if not footer.startswith(_FOOTER):
            return True  # `_ends_well` finds that
        expected = _LONG.unpack(footer[25:29])[0]
        file.seek(at)
        found, left = 0, self._size - at - len(MCAP) - _LONG.size
        while left > 0 and (block := file.read(min(_BLOCK, left))):
            found, left = zlib.crc32(block, found), left - len(block)
        return expected in (0, found)

    def _ends_well(self, file: IO[bytes]) -> bool:
        file.seek(max(0, self._size - _END_BYTES))
        end = file.read(_END_BYTES)
        return end.startswith(_FOOTER) and end.endswith(MCAP)


def checksum(*texts: str) -> str:
    """The checksum of a metadata record with these texts."""
    return str(zlib.crc32("".join(texts).encode()))


def _unpacked(chunk: Chunk, most: int) -> bytes:
    """A chunk's data, and at most this many bytes. Raises ValueError: it is of an unknown compression."""
    if not chunk.compression:
        return chunk.data
    if chunk.compression == "zstd":
        import zstandard

        data: bytes = zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(chunk.data).read(most)
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    else:
        raise ValueError(f"chunks are compressed by {chunk.compression}")
    return data
