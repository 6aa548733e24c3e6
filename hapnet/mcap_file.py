"""Recordings as files: MCAP with one protobuf message a topic, written as the run goes, readable when torn.

Topics: ``/device/state`` (`DeviceSample`), ``/world/state`` (`WorldSample`), ``/events`` (`Event` as ``foxglove.Log``).
A sample's time is its message's log time in nanoseconds on the recording process's clock. Its other fields are doubles,
vectors one field an axis (``position_m`` is ``position_x_m``, ``position_y_m``, ...), NaN where a value is unknown. The
settings are an MCAP metadata record at the start of the file (``hapnet``), the final summary one at the end
(``hapnet.summary``), each a JSON text under the key ``json``.

Why protobuf, and why axes apart: Foxglove, PlotJuggler and Rerun all decode it, where Rerun keeps JSON as a text, and
they plot numbers, not lists. Recordings of before that, in JSON, can be read.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from errno import ENOENT
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from hapnet import protobuf
from hapnet.errors import RecordingError
from hapnet.protobuf import Doubles
from hapnet.record import VECTORS, DeviceSample, Event, Recording, Sample, WorldSample, from_samples, plain

if TYPE_CHECKING:
    from mcap.records import Channel, McapRecord, Schema

CHUNK_BYTES = 128 * 1024
"""No chunk is larger: what one chunk holds is what a torn file can lose beside the last flush."""

FLUSH_NS = 500_000_000
"""How old unwritten samples may become while `RecordingWriter.flush` is called [ns].

Each flush ends a chunk, and the file's index, kept in memory until the end, has half a kilobyte for each: at ten a
second it grew by 4 MB in ten minutes.
"""

_MESSAGE_ROOM = 1024  # mcap closes a chunk after the message that passes its limit; a sample is smaller than this
_TEXT_LIMIT = 2000
_MAGIC = b"\x89MCAP0\r\n"
_META, _SUMMARY, _KEY = "hapnet", "hapnet.summary", "json"
_TOPICS: dict[type[Sample], str] = {DeviceSample: "/device/state", WorldSample: "/world/state", Event: "/events"}


class RecordingWriter:
    """Writes a recording while the run goes; what is on disk can be read at any time.

    Parameters
    ----------
    path : the file; one that exists is overwritten.
    meta : settings, seed, versions, role; ``origin_ns`` is the instant that ``time_s`` counts from, ``clock`` names the
        clock (recordings of the same clock can be aligned by `join`).

    Raises
    ------
    RecordingError : from any method, when the file cannot be written (no such directory, disk full, ...).
    """

    def __init__(self, path: str | os.PathLike[str], meta: Mapping[str, Any]) -> None:
        self._path = Path(path)
        self._channels: dict[type[Sample], int] = {}
        self._layouts: dict[type[Sample], _Layout] = {}
        self._flushed_ns: int | None = None
        self._encode = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode
        text = self._encode(plain(meta))
        try:
            self._file = self._path.open("wb")
        except OSError as error:
            raise self._error(error) from error
        self._writer = _mcap_writer(self._file)
        try:
            self._writer.start()
            self._writer.add_metadata(_META, {_KEY: text})
            self._writer.flush()
        except OSError as error:
            self._give_up(error)

    def write(self, sample: Sample) -> None:
        """Append one sample; samples of one kind come in the order of their times, and have the same axes."""
        self._check_open()
        kind = type(sample)
        time_ns = sample[0]
        try:
            if isinstance(sample, Event):
                self._writer.flush()  # a long text starts a chunk, so that no chunk passes its limit
                channel = self._channels.get(kind) or self._register(kind, "foxglove.Log", _LOG)
                data = _log_message(sample)
            else:
                layout = self._layouts.get(kind)
                if layout is None:
                    layout = self._layouts[kind] = _Layout.of(sample)
                    self._register(kind, f"hapnet.{kind.__name__}", layout.message.describe("hapnet", kind.__name__))
                data, channel = layout.pack(sample), self._channels[kind]
            self._writer.add_message(channel, time_ns, data, time_ns)
        except OSError as error:
            self._give_up(error)

    def flush(self, now_ns: int) -> None:
        """Hand everything to the operating system if `FLUSH_NS` passed since that was last done; call it often."""
        self._check_open()
        if self._flushed_ns is not None and 0 <= now_ns - self._flushed_ns < FLUSH_NS:
            return
        self._flushed_ns = now_ns
        try:
            self._writer.flush()
            self._require_name()
        except OSError as error:
            self._give_up(error)

    def close(self, summary: Mapping[str, Any] | None = None) -> None:
        """Write the summary and the index, and close the file. Closing again does nothing."""
        if self._file.closed:
            return
        try:
            self._writer.flush()
            if summary is not None:
                self._writer.add_metadata(_SUMMARY, {_KEY: self._encode(plain(summary))})
            self._writer.finish()
            self._require_name()
            self._file.close()
        except OSError as error:
            self._give_up(error)

    def _register(self, kind: type[Sample], name: str, descriptor: bytes) -> int:
        schema_id: int = self._writer.register_schema(name, "protobuf", descriptor)
        channel: int = self._writer.register_channel(_TOPICS[kind], "protobuf", schema_id)
        self._channels[kind] = channel
        return channel

    def _require_name(self) -> None:
        """A file that is removed can still be written, to nobody's use."""
        if os.fstat(self._file.fileno()).st_nlink == 0:
            raise FileNotFoundError(ENOENT, "it was removed")

    def _check_open(self) -> None:
        if self._file.closed:
            raise RecordingError(f"recording {self._path} is closed")

    def _error(self, error: OSError) -> RecordingError:
        return RecordingError(f"cannot write recording {self._path}: {error.strerror or error}")

    def _give_up(self, error: OSError) -> NoReturn:
        with suppress(OSError):  # closing flushes again, and fails again; the file is closed all the same
            self._file.close()
        raise self._error(error) from error


def is_mcap(path: str | os.PathLike[str]) -> bool:
    """Is there such a file, and does it begin as MCAP files do?"""
    try:
        with open(path, "rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except (OSError, ValueError):
        return False


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read a recording, complete or torn; of a torn one, everything up to its last whole chunk.

    Raises
    ------
    RecordingError : the file cannot be read, or is not a recording.
    """
    from mcap.records import Channel, Message, Metadata, Schema

    kinds = {topic: kind for kind, topic in _TOPICS.items()}
    schemas = dict[int, Schema]()
    decoders: dict[int, Callable[[int, bytes], Sample]] = {}
    samples: list[Sample] = []
    texts: dict[str, str] = {}
    records = _Records(Path(path))
    try:
        for record in records:
            if isinstance(record, Message) and record.channel_id in decoders:
                samples.append(decoders[record.channel_id](record.log_time, record.data))
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.topic in kinds:
                decoders[record.id] = _decoder(kinds[record.topic], record, schemas.get(record.schema_id))
            elif isinstance(record, Metadata) and _KEY in record.metadata:
                texts[record.name] = record.metadata[_KEY]
        if _META not in texts:
            raise RecordingError(f"{path} is not a recording: an MCAP file, but without the metadata record {_META!r}")
        summary = json.loads(texts[_SUMMARY]) if _SUMMARY in texts else None
        return from_samples(json.loads(texts[_META]), samples, summary, records.torn)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{path} is not a recording: its content does not fit ({error})") from error


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write `recording` to `path`, which appears only when it is complete.

    Raises
    ------
    RecordingError : the file cannot be written.
    """
    with _complete_or_absent(Path(path)) as part:
        writer = RecordingWriter(part, recording.meta)
        for sample in recording.samples():
            writer.write(sample)
        writer.close(recording.summary)


def repair(path: str | os.PathLike[str]) -> Path:
    """Copy all that can be read of `path` to an indexed, complete ``NAME.repaired.mcap`` beside it; return its path.

    The original is not touched. Raises `RecordingError` as `read_recording` and `RecordingWriter` do.
    """
    from mcap.records import Channel, Message, Metadata, Schema

    source = Path(path)
    target = source.with_name(source.name.removesuffix(".mcap") + ".repaired.mcap")
    schemas, channels = {0: 0}, dict[int, int]()
    records = _Records(source)
    with _complete_or_absent(target) as part, part.open("wb") as file:
        writer = _mcap_writer(file)
        writer.start()
        for r in records:
            if isinstance(r, Message) and r.channel_id in channels:
                writer.add_message(channels[r.channel_id], r.log_time, r.data, r.publish_time, r.sequence)
            elif isinstance(r, Schema) and r.id not in schemas:
                schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
            elif isinstance(r, Channel) and r.id not in channels:
                channels[r.id] = writer.register_channel(r.topic, r.message_encoding, schemas[r.schema_id], r.metadata)
            elif isinstance(r, Metadata):
                writer.flush()  # metadata stands outside chunks: keep what came before it before it
                writer.add_metadata(r.name, r.metadata)
        writer.finish()
    return target


def preload() -> None:
    """Load what a writer needs, which takes 20 ms: before something runs that must not wait."""
    import_module("mcap.writer")


def _mcap_writer(file: IO[bytes]) -> Any:  # Any: some of the class's methods have no annotations
    from mcap.writer import CompressionType, Writer

    # lz4 halves the file for 1 us a sample; zstd, the library's default, takes three times as long
    return Writer(file, chunk_size=CHUNK_BYTES - _MESSAGE_ROOM, compression=CompressionType.LZ4)


@contextmanager
def _complete_or_absent(target: Path) -> Iterator[Path]:
    """The path to write to; it becomes `target` if the body succeeds and is removed if not."""
    part = target.with_name(target.name + ".part")
    try:
        yield part
        part.replace(target)
    except OSError as error:
        raise RecordingError(f"cannot write recording {target}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


class _Records:
    """The records of an MCAP file in order, up to the first that is not whole; `torn` is known after the last."""

    def __init__(self, path: Path) -> None:
        self.torn = False
        self._path = path

    def __iter__(self) -> Iterator[McapRecord]:
        import zstandard
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader

        # what the reader and the decompressors raise on a record that is cut short or damaged (lz4: RuntimeError)
        damage = (McapError, ValueError, struct.error, RuntimeError, zstandard.ZstdError)
        try:
            with self._path.open("rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise RecordingError(f"{self._path} is not a recording: expected an MCAP file written by hapnet")
                file.seek(0)
                size = os.fstat(file.fileno()).st_size
                records = iter(StreamReader(file, validate_crcs=True, record_size_limit=size).records)
                while not self.torn:
                    try:
                        record = next(records, None)
                    except damage:
                        self.torn = True
                    else:
                        if record is None:
                            return
                        yield record
        except OSError as error:
            raise RecordingError(f"cannot read recording {self._path}: {error.strerror or error}") from error


@dataclass(frozen=True)
class _Layout:
    """How the samples of one kind lie in their message: `places` of the fields after the time, None: not recorded."""

    kind: type[Sample]
    message: Doubles
    places: tuple[slice | int | None, ...]

    @classmethod
    def of(cls, sample: DeviceSample | WorldSample) -> _Layout:
        """As all samples of this kind and with these axes have it."""
        kind, n = type(sample), len(sample.position_m)
        return cls.found(kind, Doubles([name for field in kind._fields[1:] for name in _names(field, n)]))

    @classmethod
    def found(cls, kind: type[Sample], message: Doubles) -> _Layout:
        """As `message` has it; what it does not have is unknown."""
        names = message.names
        n = 0
        while _names("position_m", n + 1)[-1] in names:
            n += 1
        places: list[slice | int | None] = []
        for field in kind._fields[1:]:
            first, *others = _names(field, n) or (field,)
            at = names.index(first) if first in names else None
            if at is None or names[at + 1 : at + 1 + len(others)] != tuple(others):
                places.append(None)
            else:
                places.append(slice(at, at + n) if field in VECTORS else at)
        return cls(kind, message, tuple(places))

    def pack(self, sample: DeviceSample | WorldSample) -> bytes:
        """The message of a sample; RecordingError if it has not the axes of the first."""
        values: list[float] = []
        for value in sample[1:]:
            if isinstance(value, tuple | list):
                values += value
            elif value is None:
                values += (math.nan,) * len(sample.position_m)
            else:
                values.append(value)
        try:
            return self.message.pack(values)
        except (ValueError, struct.error) as error:
            raise RecordingError(f"a {type(sample).__name__} does not fit those before it ({error})") from None

    def unpack(self, time_ns: int, data: bytes) -> Sample:
        values = self.message.unpack(data)
        return self.kind._make((time_ns, *[None if place is None else values[place] for place in self.places]))


def _names(field: str, n: int) -> Sequence[str]:
    """What the field of a sample is called in its message, for `n` axes: position_m is position_x_m and so on."""
    if field not in VECTORS:
        return (field,)
    stem, _, unit = field.rpartition("_")
    return [f"{stem}_{'xyz'[axis] if axis < 3 else axis + 1}_{unit}" for axis in range(n)]


def _decoder(kind: type[Sample], channel: Channel, schema: Schema | None) -> Callable[[int, bytes], Sample]:
    """What makes samples of a channel's messages: log time [ns], data. ValueError if they cannot be such samples."""
    if channel.message_encoding == "json":
        return lambda time_ns, data: _json_sample(kind, time_ns, json.loads(data))
    if channel.message_encoding != "protobuf" or schema is None:
        raise ValueError(f"{channel.topic} is encoded as {channel.message_encoding}")
    if kind is Event:
        return _event
    return _Layout.found(kind, Doubles.described(schema.data)).unpack


def _json_sample(kind: type[Sample], time_ns: int, fields: Mapping[str, Any]) -> Sample:
    """A field that is missing is unknown, one that has no name here is passed over."""
    if kind is Event:
        return Event(time_ns, str(fields.get("name")), str(fields.get("message")))
    return kind._make((time_ns, *map(fields.get, kind._fields[1:])))


_INFO, _TEXT, _NAME = 2, 3, 4  # in foxglove.Log: a level, two fields


def _event(time_ns: int, data: bytes) -> Event:
    found = dict(protobuf.fields(data))
    text, name = (found.get(number, b"") for number in (_TEXT, _NAME))
    if not isinstance(text, bytes) or not isinstance(name, bytes):
        raise ValueError("an event without a text")
    return Event(time_ns, name.decode(), text.decode())


def _log_message(event: Event) -> bytes:
    field = protobuf.field
    seconds, nanoseconds = divmod(event.time_ns, 1_000_000_000)
    stamp = field(1, seconds) + field(2, nanoseconds)
    return field(1, stamp) + field(2, _INFO) + field(_TEXT, event.text[:_TEXT_LIMIT]) + field(_NAME, event.kind)


def _described_log() -> bytes:
    """Foxglove's schema of a log's line."""
    stamp = [("seconds", protobuf.INT64, ""), ("nanos", protobuf.INT32, "")]
    fields = [
        ("timestamp", protobuf.MESSAGE, ".google.protobuf.Timestamp"),
        ("level", protobuf.ENUM, ".foxglove.Log.Level"),
        ("message", protobuf.STRING, ""),
        ("name", protobuf.STRING, ""),
        ("file", protobuf.STRING, ""),
        ("line", protobuf.FIXED32, ""),
    ]
    levels = {"Level": ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")}
    time_file = "google/protobuf/timestamp.proto"
    return protobuf.descriptor_set(
        protobuf.describe_file(time_file, "google.protobuf", [protobuf.describe_message("Timestamp", stamp)]),
        protobuf.describe_file(
            "foxglove/Log.proto", "foxglove", [protobuf.describe_message("Log", fields, levels)], [time_file]
        ),
    )


_LOG = _described_log()
