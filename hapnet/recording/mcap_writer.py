"""Writes MCAP files of any length in constant memory.

The library's writer keeps the index of every chunk until the end: a kilobyte per chunk, some ten megabytes an hour. The
file itself contains the data of this index, so here it is read from the file at the end. The written file is the same,
byte by byte.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import IO, Any

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC as MAGIC

_RECORD = struct.Struct("<BQ")  # opcode and length
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
_LONG, _SHORT = struct.Struct("<Q"), struct.Struct("<H")
_BLOCK_BYTES = 1 << 16


class McapWriter:
    """A replacement of `mcap.writer.Writer`, with lz4 and all indices; its memory does not grow with the file.

    file : open for writing and reading, and empty. chunk_bytes : a chunk ends after the message that passes this size.
    """

    def __init__(self, file: IO[bytes], chunk_bytes: int) -> None:
        self._file, self._chunk_bytes = file, chunk_bytes
        self._make: Any = RecordBuilder  # Any: some of the class's methods have no annotations
        self._chunk: Any = self._make()
        self._places: dict[int, MessageIndex] = {}
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._attachments: list[Any] = []
        self._metadata: list[Any] = []
        self._count = Statistics(
            attachment_count=0, channel_count=0, channel_message_counts={}, chunk_count=0, message_count=0,
            message_end_time=0, message_start_time=0, metadata_count=0, schema_count=0,
        )  # fmt: skip

    def start(self) -> None:
        """Begin the file."""
        self._file.write(MAGIC)
        self._write(Header("", LIBRARY_IDENTIFIER))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema; returns its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._schemas[-1].write(self._chunk)
        self._end_full_chunk()
        return len(self._schemas)

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """Register a channel; returns its number."""
        number = len(self._channels) + 1
        self._channels.append(Channel(number, topic, message_encoding, metadata or {}, schema_id))
        self._channels[-1].write(self._chunk)
        self._end_full_chunk()
        return number

    @property
    def chunks(self) -> int:
        """The number of written chunks."""
        return int(self._count.chunk_count)

    def repeat_channels(self) -> None:
        """Write all schemas and channels once more, into the present chunk: a reader may have lost the first ones."""
        for record in (*self._schemas, *self._channels):
            record.write(self._chunk)

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Append a message to the chunk; times in ns."""
        count = self._count
        count.message_start_time = min(count.message_start_time, log_time) if count.message_count else log_time
        count.message_end_time = max(count.message_end_time, log_time)
        count.message_count += 1
        count.channel_message_counts[channel] = count.channel_message_counts.get(channel, 0) + 1
        if (places := self._places.get(channel)) is None:
            places = self._places[channel] = MessageIndex(channel, [])
        places.records.append((log_time, self._chunk.count))
        head = _MESSAGE.pack(Opcode.MESSAGE, 22 + len(data), channel, sequence, log_time, publish_time)
        self._chunk.write(head + data)
        self._end_full_chunk()

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write a metadata record, before the present chunk."""
        offset = self._file.tell()
        length = self._write(Metadata(name=name, metadata=data))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))
        self._count.metadata_count += 1

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment, before the present chunk."""
        offset = self._file.tell()
        length = self._write(Attachment(create_time, log_time, name, media_type, data))
        self._attachments.append(
            AttachmentIndex(offset, length, log_time, create_time, len(data), name, media_type)
        )  # fmt: skip
        self._count.attachment_count += 1

    def flush(self) -> None:
        """End the chunk, and pass everything to the operating system."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the summary with all indices; the file stays open."""
        self._end_chunk()
        data_end = self._file.tell()
        self._write(DataEnd(0))
        start = at = self._file.tell()
        self._count.channel_count, self._count.schema_count = len(self._channels), len(self._schemas)
        groups: tuple[tuple[int, Iterator[bytes]], ...] = (
            (Opcode.SCHEMA, self._blocks(self._schemas)),
            (Opcode.CHANNEL, self._blocks(self._channels)),
            (Opcode.STATISTICS, self._blocks([self._count])),
            (Opcode.CHUNK_INDEX, self._chunk_index(data_end)),
            (Opcode.ATTACHMENT_INDEX, self._blocks(self._attachments)),
            (Opcode.METADATA_INDEX, self._blocks(self._metadata)),
        )
        checksum = 0
        offsets = []
        for opcode, blocks in groups:
            began = at
            for block in blocks:
                self._file.seek(at)
                self._file.write(block)
                at, checksum = at + len(block), zlib.crc32(block, checksum)
            offsets.append(SummaryOffset(opcode, began, at - began))
        written = b"".join(self._blocks(offsets))
        self._file.seek(at)
        self._file.write(written)
        checksum = zlib.crc32(written, checksum)
        checksum = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at), checksum)
        self._write(Footer(summary_start=start, summary_offset_start=at, summary_crc=checksum))
        self._file.write(MAGIC)
        self._file.flush()

    def _write(self, *records: Any) -> int:
        """Write records to the file; returns their length."""
        builder = self._make()
        for record in records:
            record.write(builder)
        data: bytes = builder.end()
        self._file.write(data)
        return len(data)

    def _end_full_chunk(self) -> None:
        if self._chunk.count > self._chunk_bytes:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the chunk with the index of its messages, if it has any message."""

        if not self._places:
            return
        data = self._chunk.end()
        times = [time for places in self._places.values() for time, _ in places.records]
        packed = lz4.frame.compress(data)
        self._write(Chunk("lz4", packed, max(times), min(times), zlib.crc32(data), len(data)), *self._places.values())
        self._places.clear()
        self._count.chunk_count += 1

    def _blocks(self, records: Sequence[Any]) -> Iterator[bytes]:
        """Records as bytes, all at once: there are few."""
        builder = self._make()
        for record in records:
            record.write(builder)
        yield builder.end()

    def _chunk_index(self, data_end: int) -> Iterator[bytes]:
        """The index of all chunks in blocks of bytes; `data_end` is where the data section ends."""
        builder = self._make()
        for index in self._chunks(data_end):
            index.write(builder)
            if builder.count > _BLOCK_BYTES:
                yield builder.end()
        yield builder.end()

    def _chunks(self, data_end: int) -> Iterator[Any]:
        """Yield the entries of the file's index for its chunks. The file may be written to between two of them."""
        index: ChunkIndex | None = None
        at = len(MAGIC)
        while at < data_end:
            opcode, length = _RECORD.unpack(self._read(at, _RECORD.size))
            if opcode == Opcode.MESSAGE_INDEX and index is not None:
                (channel,) = _SHORT.unpack(self._file.read(_SHORT.size))
                index.message_index_offsets[channel] = at
                index.message_index_length += _RECORD.size + length
            elif opcode == Opcode.CHUNK:
                if index is not None:
                    yield index
                    self._file.seek(at + _RECORD.size)
                first, last, size, _, letters = _CHUNK.unpack(self._file.read(_CHUNK.size))
                kind = self._file.read(letters).decode()
                (packed,) = _LONG.unpack(self._file.read(_LONG.size))
                index = ChunkIndex(_RECORD.size + length, at, kind, packed, last, 0, {}, first, size)
            at += _RECORD.size + length
        if index is not None:
            yield index

    def _read(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        return self._file.read(size)
