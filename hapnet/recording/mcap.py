"""Recordings as files: MCAP with one protobuf message per topic, written during the run, readable even if torn.

Topics: ``/device/state`` (`DeviceSample`), ``/world/state`` (`WorldSample`), ``/events`` (`Event` as ``foxglove.Log``),
for an arm's tip ``/device/posture`` (`PostureSample`), and for a world that can be drawn ``/world/scene``
(`SceneSample`). The world's parts are an attachment, ``drawing`` (`Drawing`).
A sample's time is its message's log time, in nanoseconds of UTC: a `Sample` has its recording process's monotonic
clock, and the settings have UTC at its origin. A simulation counts from 1970. The other fields are doubles, NaN
where a value is unknown; a vector has one field per axis: ``position_m`` is ``position_x_m``, ``position_y_m``, ...,
and ``position_x_rad`` where an axis is in radians.
The settings are an MCAP metadata record at the start of the file (``hapnet``), and again behind the first chunk; the
final summary is another at the end (``hapnet.summary``). Each is a JSON text under the key ``json``, with its checksum
under ``crc32``. Schemas and channels are repeated in later chunks, so that no chunk is needed to read the others. For
viewers only, each side's position is written as a ``foxglove.FrameTransform`` and its set-position as a
``foxglove.PoseInFrame`` (foxglove.py), some 60 times a second, as are moving bodies and links; all shapes are a
``foxglove.SceneUpdate``, once.

Protobuf is used because Foxglove, PlotJuggler and Rerun all decode it; Rerun keeps JSON as a text. Each axis has its
own field because they plot numbers, not lists. Older recordings can be read: JSON, or log times on the process's clock.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from errno import ENOENT
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from hapnet.checks import Vector
from hapnet.errors import BadMessage, InvalidParameter, RecordingError
from hapnet.file_content import read_json
from hapnet.installing import require
from hapnet.loading import cause, extension
from hapnet.recording import schemas
from hapnet.recording.drawing import Drawing, SceneSample, unpack
from hapnet.recording.foxglove import PERIOD_NS, Shapes, Shown, bodies, shapes, shown
from hapnet.recording.mcap_reader import CHECKSUM, Records, checksum
from hapnet.recording.samples import (
    DeviceSample,
    Event,
    Lost,
    PostureSample,
    Recording,
    Sample,
    WorldSample,
    from_samples,
    plain,
    utc_less_clock_ns,
)
from hapnet.recording.whole_file import complete_or_absent
from hapnet.units import text_in

if TYPE_CHECKING:
    from mcap.records import Attachment, Channel, McapRecord, Message, Schema

    from hapnet.recording.mcap_writer import McapWriter

CHUNK_BYTES = 128 * 1024
"""Largest size of a chunk. A torn file can lose one chunk, and all samples after the last flush."""

FLUSH_NS = 500_000_000
"""Largest age of unwritten samples while `RecordingWriter.flush` is called [ns]. Each flush ends a chunk."""

_MESSAGE_ROOM = 1024  # mcap closes a chunk after the message that passes its limit; a sample is smaller than this
_META, _SUMMARY, _KEY = "hapnet", "hapnet.summary", "json"
_DRAWING, _PACKED = "drawing", "application/zlib"
_BODY, _LINK, _ARM = "/world/body", "/device/link", "/device/shapes"
_TOPICS: dict[type[Sample], str] = {
    DeviceSample: "/device/state", WorldSample: "/world/state", Event: "/events", SceneSample: "/world/scene",
    PostureSample: "/device/posture",
}  # fmt: skip
_KINDS = {topic: kind for kind, topic in _TOPICS.items()}


class RecordingWriter:
    """Writes a recording during the run; the file on disk can be read at any time.

    path : the file; an existing one is overwritten.
    meta : settings, seed, versions, role. ``origin_ns`` is the instant from which ``time_s`` counts; ``clock`` names
        the clock (`join` can align recordings of the same clock). ``utc_origin_ns`` is UTC at that instant, and
        ``utc_clock`` names the clock of UTC: without it, log times are those of the samples.

    Raises RecordingError: from any method, when the file cannot be written (no such directory, disk full, ...).
    """

    def __init__(self, path: str | os.PathLike[str], meta: Mapping[str, Any]) -> None:
        require("record", "a recording")
        self._path = Path(path)
        self._channels: dict[str, tuple[int, Callable[[Any], bytes]]] = {}
        self._meta, self._arm = meta, extension("arms").picture(meta) if "arm" in meta else None
        self._utc_ns = utc_less_clock_ns(meta)
        self._shown_ns: dict[type[Sample], int] = {}
        self._flushed_ns: int | None = None
        self._repeat_at, self._settings_again = 1, False
        self._encode = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode
        text = self._encode(plain(meta))
        self._settings = {_KEY: text, CHECKSUM: checksum(text)}
        try:
            self._file = self._path.open("w+b")
        except OSError as error:
            raise self._error(error) from error
        self._writer = _mcap_writer(self._file)
        try:
            self._writer.start()
            self._writer.add_metadata(_META, self._settings)
            self._writer.flush()
        except OSError as error:
            self._give_up(error)

    def write(self, sample: Sample) -> None:
        """Append one sample. Samples of one kind must come in the order of their times, and have the same axes."""
        self._check_open()
        utc_ns = sample[0] + self._utc_ns
        try:
            if isinstance(sample, Drawing):
                self._writer.add_attachment(utc_ns, utc_ns, _DRAWING, _PACKED, sample.data)
                if (found := shapes(_BODY, utc_ns, unpack(sample.data))).parts:
                    self._add(utc_ns, "/world/shapes", found)
            elif isinstance(sample, Event):
                self._add(utc_ns, _TOPICS[Event], sample._replace(time_ns=utc_ns))
            else:
                self._add(utc_ns, _TOPICS[type(sample)], sample)
                if isinstance(sample, DeviceSample | WorldSample):
                    self._show(utc_ns, sample)
                elif isinstance(sample, PostureSample):
                    self._show_arm(utc_ns, sample.angles_rad)
                elif isinstance(sample, SceneSample):
                    self._add_all(bodies(_BODY, utc_ns, sample.bodies().tolist()))
        except OSError as error:
            self._give_up(error)
        except (TypeError, ValueError) as error:
            raise RecordingError(f"a {type(sample).__name__} does not fit those before it ({error})") from None

    def flush(self, now_ns: int) -> None:
        """Pass everything to the operating system if the last flush is `FLUSH_NS` old; call it often."""
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
            self._repeat()
            if summary is not None:
                text = self._encode(plain(summary))
                self._writer.add_metadata(_SUMMARY, {_KEY: text, CHECKSUM: checksum(text)})
            self._writer.finish()
            self._require_name()
            self._file.close()
        except OSError as error:
            self._give_up(error)

    def _add_all(self, frames: Iterable[tuple[str, Shown]]) -> None:
        for topic, one in frames:
            self._add(one.time_ns, topic, one)

    def _add(self, utc_ns: int, topic: str, sample: Sample | Shown | Shapes) -> None:
        channel, encode = self._channels.get(topic) or self._register(topic, sample)
        data = encode(sample)
        if len(data) > _MESSAGE_ROOM or topic == _TOPICS[Event]:
            self._writer.flush()  # a long message starts a chunk, so that no chunk passes its limit
        if self._writer.chunks >= self._repeat_at:
            self._repeat()
        self._writer.add_message(channel, utc_ns, data, utc_ns)

    def _repeat(self) -> None:
        """Write the settings a second time, and the channels in chunk 2, 4, 8, ... after a new one, so that no chunk is
        needed to read the others.
        """
        if (chunks := self._writer.chunks) == 0:
            return
        if not self._settings_again:
            self._settings_again = True
            self._writer.add_metadata(_META, self._settings)
        self._writer.repeat_channels()
        self._repeat_at = 2 * chunks

    def _show(self, utc_ns: int, sample: DeviceSample | WorldSample) -> None:
        """Write this side's pose for viewers, if it is due."""
        if self._arm is not None and self._arm.by_joints and isinstance(sample, DeviceSample):
            self._show_arm(utc_ns, self._arm.angles(sample.position_m, ()))
        if self._is_due(type(sample), utc_ns):
            self._add_all(shown(utc_ns, sample, text_in(self._meta, len(sample.position_m))))

    def _show_arm(self, utc_ns: int, angles: Vector) -> None:
        """Write the poses of an arm's links for viewers, if they are due."""
        if self._arm is not None and self._is_due(PostureSample, utc_ns):
            if _ARM not in self._channels:
                self._add(utc_ns, _ARM, shapes(_LINK, utc_ns, self._arm.parts))
            self._add_all(bodies(_LINK, utc_ns, self._arm.poses(angles).tolist()))

    def _is_due(self, kind: type[Sample], utc_ns: int) -> bool:
        due_ns = self._shown_ns.get(kind, utc_ns)
        if utc_ns >= due_ns:
            self._shown_ns[kind] = max(utc_ns, due_ns + PERIOD_NS)
        return utc_ns >= due_ns

    def _register(self, topic: str, sample: Sample | Shown | Shapes) -> tuple[int, Callable[[Any], bytes]]:
        """The channel of all samples like this one, and the function that encodes them."""
        schema = schemas.schema_for(sample, self._meta)
        schema_id: int = self._writer.register_schema(schema.name, "protobuf", schema.descriptor)
        channel: int = self._writer.register_channel(topic, "protobuf", schema_id)
        self._channels[topic] = (channel, schema.encode)
        self._repeat_at = min(self._repeat_at, self._writer.chunks + 1)
        return channel, schema.encode

    def _require_name(self) -> None:
        """Raise FileNotFoundError if the file was removed: it could still be written, but never read."""
        if os.fstat(self._file.fileno()).st_nlink == 0:
            raise FileNotFoundError(ENOENT, "it was removed")

    def _check_open(self) -> None:
        if self._file.closed:
            raise RecordingError(f"recording {self._path} is closed")

    def _error(self, error: OSError) -> RecordingError:
        return RecordingError(f"cannot write recording {self._path}: {error.strerror or error}")

    def _give_up(self, error: OSError) -> NoReturn:
        with suppress(OSError):  # closing flushes again and fails again, but does close the file
            self._file.close()
        raise self._error(error) from error


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read a recording, complete or torn; without its damaged chunks, which `Recording.lost` lists.

    Raises RecordingError: the file cannot be read, or is not a recording. InvalidParameter: `path` is not a path.
    """
    require("record", "reading a recording")
    from google.protobuf.message import DecodeError

    if not isinstance(path, str | os.PathLike):
        raise InvalidParameter("path", path, "a recording's file, such as run.mcap")
    found, records = _Found(), Records(Path(path))
    try:
        for record in records:
            found.take(record)
        if _META not in found.texts:
            why = "its settings are damaged" if records.lost else f"it has no metadata record {_META!r}"
            raise RecordingError(f"{path} is not a recording: it is an MCAP file, but {why}")
        summary = _summary(found.texts[_SUMMARY], path) if _SUMMARY in found.texts else None
        recording = from_samples(found.settings, found.all_samples(), summary, records.torn)
        lost = [[None if at is None else at - found.utc_ns for at in span] for span in records.lost]
        return replace(recording, lost=tuple(Lost(begin_ns, end_ns) for begin_ns, end_ns in lost))
    except (ArithmeticError, AttributeError, BadMessage, DecodeError, KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{path} is not a recording: its content does not fit ({cause(error)})") from error


class _Found:
    """The content of a recording, collected from its records.

    Attributes
    ----------
    texts : settings and summary as JSON, by name. settings : their table; empty before they are found. utc_ns : what to
    subtract from log times.
    """

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.settings: dict[str, Any] = {}
        self.utc_ns: int = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders: dict[int, Callable[[int, bytes], Sample] | None] = {}
        self._samples: list[Sample] = []
        self._early: list[Message | Attachment] = []

    def take(self, record: McapRecord) -> None:
        """Take the next record. The first of several that are repeated counts. Raises as `_decoder`, if it misfits."""
        from mcap.records import Attachment, Channel, Message, Metadata, Schema

        if isinstance(record, Message):
            if record.channel_id not in self._decoders or not self.texts:
                self._early.append(record)  # its channel, or the settings, were damaged: they come later again
            elif (decode := self._decoders[record.channel_id]) is not None:
                self._samples.append(decode(_time(record.log_time - self.utc_ns), record.data))
        elif isinstance(record, Schema):
            self._schemas.setdefault(record.id, record)
            for channel in self._channels.values():
                self._know(channel)
        elif isinstance(record, Channel):
            self._know(self._channels.setdefault(record.id, record))
        elif isinstance(record, Metadata) and _KEY in record.metadata and record.name not in self.texts:
            self.texts[record.name] = record.metadata[_KEY]
            if record.name == _META:
                self.settings = _settings(self.texts[_META])
                self.utc_ns = _time(utc_less_clock_ns(self.settings))
        elif isinstance(record, Attachment) and record.name == _DRAWING:
            unpack(record.data)
            self._early.append(record)

    def _know(self, channel: Channel) -> None:
        """Make the decoder of a channel, once its schema is known."""
        if channel.id not in self._decoders and (channel.schema_id in self._schemas or channel.schema_id == 0):
            kind = _KINDS.get(channel.topic)
            schema = self._schemas.get(channel.schema_id)
            self._decoders[channel.id] = None if kind is None else _decoder(kind, channel, schema)

    def all_samples(self) -> list[Sample]:
        """The samples of each kind in their order."""
        from mcap.records import Attachment

        early: list[Sample] = []
        for record in self._early:
            time_ns = _time(record.log_time - self.utc_ns)
            if isinstance(record, Attachment):
                early.append(Drawing(time_ns, record.data))
            elif (decode := self._decoders.get(record.channel_id)) is not None:
                early.append(decode(time_ns, record.data))
        return early + self._samples


def _settings(text: str) -> dict[str, Any]:
    found = read_json(text)
    if not isinstance(found, dict):
        raise ValueError("its settings are not a table")
    return found


def _summary(text: str, path: str | os.PathLike[str]) -> dict[str, Any]:
    found = read_json(text)
    if not isinstance(found, dict):
        raise RecordingError(f"{path} is not a recording: its summary does not fit (it is not a table)")
    return found


def _time(time_ns: int) -> int:
    """Return the time; ValueError if differences of such times may exceed 64 bits."""
    if abs(time_ns) >= 1 << 62:
        raise ValueError(f"a time of {time_ns} ns")
    return time_ns


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write `recording` to `path`; the file appears only when it is complete.

    Raises RecordingError: the file cannot be written.
    """
    with complete_or_absent(Path(path)) as part:
        writer = RecordingWriter(part, recording.meta)
        for sample in recording.samples():
            writer.write(sample)
        writer.close(recording.summary)


def repair(path: str | os.PathLike[str]) -> Path:
    """Copy everything readable in `path` to an indexed, complete ``NAME.repaired.mcap`` beside it; returns its path.

    The original is not touched. Raises `RecordingError` as `read_recording` and `RecordingWriter` do.
    """
    from mcap.records import Attachment, Channel, Message, Metadata, Schema

    source = Path(path)
    target = source.with_name(source.name.removesuffix(".mcap") + ".repaired.mcap")
    known, channels, written = {0: 0}, dict[int, int](), list[Metadata]()
    with complete_or_absent(target) as part, part.open("w+b") as file:
        writer = _mcap_writer(file)
        writer.start()
        definitions = [r for r in Records(source) if isinstance(r, Schema | Channel)]  # the first ones may be damaged
        for d in sorted(definitions, key=lambda d: isinstance(d, Channel)):
            if isinstance(d, Schema) and d.id not in known:
                known[d.id] = writer.register_schema(d.name, d.encoding, d.data)
            elif isinstance(d, Channel) and d.id not in channels and d.schema_id in known:
                channels[d.id] = writer.register_channel(d.topic, d.message_encoding, known[d.schema_id], d.metadata)
        for r in Records(source):
            if isinstance(r, Message) and r.channel_id in channels:
                writer.add_message(channels[r.channel_id], r.log_time, r.data, r.publish_time, r.sequence)
            elif isinstance(r, Metadata) and r not in written:
                written.append(r)
                writer.flush()  # metadata is outside chunks: first write the chunk that came before it
                writer.add_metadata(r.name, r.metadata)
            elif isinstance(r, Attachment):
                writer.flush()  # as are attachments
                writer.add_attachment(r.create_time, r.log_time, r.name, r.media_type, r.data)
        writer.finish()
    return target


def preload() -> None:
    """Import the modules of a writer. This takes 30 ms, so call it before control starts."""
    require("record", "a recording")
    for module in ("hapnet.recording.mcap_writer", "google.protobuf.message_factory", "google.protobuf.timestamp_pb2"):
        import_module(module)


def _mcap_writer(file: IO[bytes]) -> McapWriter:
    from hapnet.recording.mcap_writer import McapWriter

    return McapWriter(file, CHUNK_BYTES - _MESSAGE_ROOM)


def _decoder(kind: type[Sample], channel: Channel, schema: Schema | None) -> Callable[[int, bytes], Sample]:
    """The function from log time [ns] and data to a channel's samples. Raises ValueError for another encoding."""
    if channel.message_encoding == "json":
        return lambda time_ns, data: _json_sample(kind, time_ns, read_json(data))
    if channel.message_encoding != "protobuf" or schema is None:
        raise ValueError(f"{channel.topic} is encoded as {channel.message_encoding}")
    return schemas.decoder(kind, schema.name, schema.data)


def _json_sample(kind: type[Sample], time_ns: int, fields: Mapping[str, Any]) -> Sample:
    """Make a sample from JSON: a missing field is unknown, and a field with an unknown name is ignored."""
    if kind is Event:
        return Event(time_ns, str(fields.get("name")), str(fields.get("message")))
    return kind._make((time_ns, *map(fields.get, kind._fields[1:])))
