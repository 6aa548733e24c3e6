"""Recordings: MCAP with one JSON schema a topic, written as the run goes, readable when torn.

Topics: ``/device/state`` (`DeviceSample`), ``/world/state`` (`WorldSample`), ``/events`` (`Event` as ``foxglove.Log``).
A sample's time is its message's log time in nanoseconds on the recording process's clock; its other fields are the JSON
object, vectors as arrays, null where a value is unknown. The settings are an MCAP metadata record at the start of the
file (``hapnet``), the final summary one at the end (``hapnet.summary``), each a JSON text under the key ``json``.

The schemas use one plain type a field, though null may stand in its place: Foxglove's schema parser refuses a whole
topic when a type is a list such as ``["number", "null"]``.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple, NoReturn, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapnet.errors import RecordingError

if TYPE_CHECKING:
    from mcap.records import McapRecord

CHUNK_BYTES = 16 * 1024
"""No chunk is larger: what one chunk holds is what a torn file can lose beside the last flush."""

FLUSH_NS = 100_000_000
"""How old unwritten samples may become while `RecordingWriter.flush` is called [ns]."""

_MESSAGE_ROOM = 1024  # mcap closes a chunk after the message that passes its limit; a sample is smaller than this
_TEXT_LIMIT = 2000
_META, _SUMMARY, _KEY = "hapnet", "hapnet.summary", "json"

Vector: TypeAlias = tuple[float, ...]
Columns: TypeAlias = dict[str, NDArray[Any]]


class DeviceSample(NamedTuple):
    """The device's side at one servo tick. Vectors have one element an axis.

    `set_position_m` is PSPM's modulated ybar, `target_m` the y that was asked for, `force_N` the coupling's force on
    the device, `operator_force_N` the simulated hand's (None where it is unknown). Energies are those of the
    modulator and the ledger: `sent_J` and `credited_J` are running totals, `margin_J` and `slack_J` those of the
    half-theorem at this instant.
    """

    time_ns: int
    position_m: Vector
    set_position_m: Vector
    target_m: Vector
    force_N: Vector
    operator_force_N: Vector | None
    reservoir_J: float
    deficit_J: float
    potential_J: float
    sent_J: float
    credited_J: float
    margin_J: float
    slack_J: float


class WorldSample(NamedTuple):
    """The world's side at the start of one step of length `step_s`; `position_m` is the proxy's.

    `penetration_m` is the depth in the deepest wall (0 or less outside), `contact_force_N` the walls' force on the
    proxy, `coupling_force_N` the virtual coupling's. The rest is as in `DeviceSample`.
    """

    time_ns: int
    step_s: float
    position_m: Vector
    velocity_mps: Vector
    set_position_m: Vector
    target_m: Vector
    coupling_force_N: Vector
    contact_force_N: Vector
    penetration_m: float
    reservoir_J: float
    potential_J: float
    sent_J: float
    credited_J: float
    margin_J: float
    slack_J: float


class Event(NamedTuple):
    """Something worth a line: `kind` is one word a program can match, `text` is for people (2000 characters kept)."""

    time_ns: int
    kind: str
    text: str


Sample: TypeAlias = DeviceSample | WorldSample | Event

_TOPICS: dict[type[Sample], str] = {DeviceSample: "/device/state", WorldSample: "/world/state", Event: "/events"}
_SCALARS = ("time_ns", "step_s", "penetration_m")  # these, and the energies; all else is a vector
_VECTORS = frozenset(
    name
    for kind in (DeviceSample, WorldSample)
    for name in kind._fields
    if name not in _SCALARS and not name.endswith("_J")
)


@dataclass(frozen=True)
class Recording:
    """A whole run, or one side of it, as columns.

    `device` and `world` map field names to arrays: ``time_ns`` (N,) int64, ``time_s`` (N,) seconds since
    ``meta["origin_ns"]``, vectors (N, n), all else (N,); NaN where a value is unknown. A side that was not recorded is
    None. `torn` says that the file ended before its writer closed it.
    """

    meta: dict[str, Any]
    device: Columns | None
    world: Columns | None
    events: list[Event]
    summary: dict[str, Any] | None
    torn: bool = False


class MemoryRecorder:
    """Keeps samples in memory; `write` is one list append."""

    def __init__(self, meta: Mapping[str, Any]) -> None:
        self._meta = meta
        self._samples: list[Sample] = []

    def write(self, sample: Sample) -> None:
        self._samples.append(sample)

    def recording(self, summary: Mapping[str, Any] | None = None) -> Recording:
        """What was written, as `read_recording` would return it."""
        return _recording(_plain(self._meta), self._samples, _plain(summary), torn=False)


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
        self._flushed_ns: int | None = None
        self._encode = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode
        text = self._encode(_plain(meta))
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
        """Append one sample; samples of one kind come in the order of their times."""
        self._check_open()
        kind = type(sample)
        time_ns = sample[0]
        try:
            if isinstance(sample, Event):
                self._writer.flush()  # a long text starts a chunk, so that no chunk passes its limit
                data = self._encode(_log_message(sample))
            else:
                fields = dict(zip(kind._fields, sample, strict=True))
                del fields["time_ns"]
                try:
                    data = self._encode(fields)
                except ValueError:
                    data = self._encode(_plain(fields))
            channel = self._channels.get(kind) or self._register(kind)
            self._writer.add_message(channel, time_ns, data.encode(), time_ns)
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
        except OSError as error:
            self._give_up(error)

    def close(self, summary: Mapping[str, Any] | None = None) -> None:
        """Write the summary and the index, and close the file. Closing again does nothing."""
        if self._file.closed:
            return
        try:
            self._writer.flush()
            if summary is not None:
                self._writer.add_metadata(_SUMMARY, {_KEY: self._encode(_plain(summary))})
            self._writer.finish()
            self._file.close()
        except OSError as error:
            self._give_up(error)

    def _register(self, kind: type[Sample]) -> int:
        name, schema = _schema(kind)
        schema_id: int = self._writer.register_schema(name, "jsonschema", self._encode(schema).encode())
        channel: int = self._writer.register_channel(_TOPICS[kind], "json", schema_id)
        self._channels[kind] = channel
        return channel

    def _check_open(self) -> None:
        if self._file.closed:
            raise RecordingError(f"recording {self._path} is closed")

    def _error(self, error: OSError) -> RecordingError:
        return RecordingError(f"cannot write recording {self._path}: {error.strerror or error}")

    def _give_up(self, error: OSError) -> NoReturn:
        with suppress(OSError):  # closing flushes again, and fails again; the file is closed all the same
            self._file.close()
        raise self._error(error) from error


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read a recording, complete or torn; of a torn one, everything up to its last whole chunk.

    Raises
    ------
    RecordingError : the file cannot be read, or is not a recording.
    """
    from mcap.records import Channel, Message, Metadata

    kinds = {topic: kind for kind, topic in _TOPICS.items()}
    channels: dict[int, type[Sample]] = {}
    samples: list[Sample] = []
    texts: dict[str, str] = {}
    records = _Records(Path(path))
    try:
        for record in records:
            if isinstance(record, Message) and record.channel_id in channels:
                samples.append(_sample(channels[record.channel_id], record.log_time, json.loads(record.data)))
            elif isinstance(record, Channel) and record.topic in kinds:
                channels[record.id] = kinds[record.topic]
            elif isinstance(record, Metadata) and _KEY in record.metadata:
                texts[record.name] = record.metadata[_KEY]
        if _META not in texts:
            raise RecordingError(f"{path} is not a recording: an MCAP file, but without the metadata record {_META!r}")
        summary = json.loads(texts[_SUMMARY]) if _SUMMARY in texts else None
        return _recording(json.loads(texts[_META]), samples, summary, records.torn)
    except (AttributeError, TypeError, ValueError) as error:
        raise RecordingError(f"{path} is not a recording: its content does not fit ({error})") from error


def save(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write `recording` to `path`, which appears only when it is complete.

    Raises
    ------
    RecordingError : the file cannot be written.
    """
    samples = [*_rows(DeviceSample, recording.device), *_rows(WorldSample, recording.world), *recording.events]
    with _complete_or_absent(Path(path)) as part:
        writer = RecordingWriter(part, recording.meta)
        for sample in sorted(samples, key=attrgetter("time_ns")):
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


def join(a: Recording, b: Recording) -> Recording:
    """One recording of a device's and a world's, given in either order.

    With the same ``meta["clock"]`` both are put on that clock, counted from the later origin. Otherwise each starts at
    its own origin, and ``meta["aligned"]`` is False: what happened first on the two sides cannot be known. The settings
    of both stay under ``meta["sides"]``. ``theorem`` becomes the sum of the two ledgers (a lower bound of the margin).

    Raises
    ------
    RecordingError : the two are not one device's and one world's.
    """
    if a.device is None and b.device is not None:
        a, b = b, a
    if a.device is None or b.world is None or a.world is not None or b.device is not None:
        raise RecordingError(
            "cannot join these recordings: one must hold a device's samples and the other a world's; "
            f"the first holds {_sides(a)}, the second {_sides(b)}"
        )
    device_origin, world_origin = _origin(a), _origin(b)
    aligned = a.meta.get("clock") is not None and a.meta.get("clock") == b.meta.get("clock")
    origin = max(device_origin, world_origin) if aligned else device_origin
    shift = 0 if aligned else device_origin - world_origin
    events = sorted([*a.events, *(e._replace(time_ns=e.time_ns + shift) for e in b.events)], key=attrgetter("time_ns"))
    meta = {**b.meta, **a.meta, "role": "both", "origin_ns": origin, "aligned": aligned}
    meta["sides"] = {"device": a.meta, "world": b.meta}
    return Recording(
        meta,
        _on_clock(a.device, 0, origin),
        _on_clock(b.world, shift, origin),
        events,
        _join_summaries(a.summary, b.summary),
        a.torn or b.torn,
    )


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
        from mcap.writer import MCAP0_MAGIC

        # what the reader and the decompressors raise on a record that is cut short or damaged (lz4: RuntimeError)
        damage = (McapError, ValueError, struct.error, RuntimeError, zstandard.ZstdError)
        try:
            with self._path.open("rb") as file:
                if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
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


def _recording(
    meta: dict[str, Any], samples: Iterable[Sample], summary: dict[str, Any] | None, torn: bool
) -> Recording:
    device, world, events = list[DeviceSample](), list[WorldSample](), list[Event]()
    for sample in samples:
        if isinstance(sample, DeviceSample):
            device.append(sample)
        elif isinstance(sample, WorldSample):
            world.append(sample)
        else:
            events.append(sample)
    first = min((rows[0].time_ns for rows in (device, world, events) if rows), default=0)
    origin = int(meta.setdefault("origin_ns", first))
    return Recording(meta, _columns(device, origin), _columns(world, origin), events, summary, torn)


def _columns(samples: list[DeviceSample] | list[WorldSample], origin_ns: int) -> Columns | None:
    if not samples:
        return None
    kind = type(samples[0])
    unknown = (math.nan,) * len(samples[0].position_m)
    columns: Columns = {}
    for name, values in zip(kind._fields, zip(*samples, strict=True), strict=True):
        if name in _VECTORS:
            columns[name] = np.array([unknown if v is None else v for v in values], dtype=float)
            if columns[name].shape != (len(samples), len(unknown)):
                raise RecordingError(f"{name} does not have {len(unknown)} axes, as position_m has")
        elif name == "time_ns":
            columns[name] = np.array(values, dtype=np.int64)
        else:
            columns[name] = np.array(values, dtype=float)
    return _on_clock(columns, 0, origin_ns)


def _on_clock(columns: Columns, shift_ns: int, origin_ns: int) -> Columns:
    time_ns = columns["time_ns"] + shift_ns
    return {**columns, "time_ns": time_ns, "time_s": (time_ns - origin_ns) / 1e9}


def _rows(kind: type[DeviceSample] | type[WorldSample], columns: Columns | None) -> Iterator[Sample]:
    """The samples that `_columns` made `columns` of."""
    if columns is None:
        return
    lists = [columns[name].tolist() for name in kind._fields]
    for values in zip(*lists, strict=True):
        yield kind._make((None if all(map(math.isnan, v)) else tuple(v)) if isinstance(v, list) else v for v in values)


def _sample(kind: type[Sample], time_ns: int, fields: Mapping[str, Any]) -> Sample:
    """A sample from its message; a field that is missing is unknown, one that has no name here is passed over."""
    if kind is Event:
        return Event(time_ns, str(fields.get("name")), str(fields.get("message")))
    return kind._make((time_ns, *map(fields.get, kind._fields[1:])))


def _log_message(event: Event) -> dict[str, Any]:
    seconds, nanoseconds = divmod(event.time_ns, 1_000_000_000)
    return {
        "timestamp": {"sec": seconds, "nsec": nanoseconds},
        "level": 2,
        "message": event.text[:_TEXT_LIMIT],
        "name": event.kind,
        "file": "",
        "line": 0,
    }


def _schema(kind: type[Sample]) -> tuple[str, dict[str, Any]]:
    """Name and JSON schema of the messages that carry `kind`."""
    number, integer, text = {"type": "number"}, {"type": "integer"}, {"type": "string"}
    if kind is Event:
        levels = enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"))
        time = {"type": "object", "title": "time", "properties": {"sec": integer, "nsec": integer}}
        level = {"oneOf": [{"title": title, "const": value} for value, title in levels]}
        fields = {"timestamp": time, "level": level, "message": text, "name": text, "file": text, "line": integer}
        return "foxglove.Log", {"type": "object", "properties": fields}
    properties = {f: {"type": "array", "items": number} if f in _VECTORS else number for f in kind._fields[1:]}
    return f"hapnet.{kind.__name__}", {"type": "object", "properties": properties}


def _plain(value: Any) -> Any:
    """`value` as strict JSON can hold it: numbers that are not finite become None, numpy's become Python's."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return str(value) if isinstance(value, os.PathLike) else value


def _origin(recording: Recording) -> int:
    return int(recording.meta["origin_ns"])


def _sides(recording: Recording) -> str:
    sides = [name for name in ("device", "world") if getattr(recording, name) is not None]
    return " and ".join(sides) or "no samples"


def _join_summaries(device: dict[str, Any] | None, world: dict[str, Any] | None) -> dict[str, Any] | None:
    if device is None and world is None:
        return None
    merged: dict[str, Any] = _filled_in(device or {}, world or {})
    ledgers = [(merged.get(side) or {}).get("ledger") or {} for side in ("device", "world")]
    merged["theorem"] = {key: _sum(ledger.get(key) for ledger in ledgers) for key in ("margin_J", "bound_J")}
    return merged


def _filled_in(first: Any, second: Any) -> Any:
    """`first`, with what it lacks (missing or None, at any depth) taken from `second`."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        keys = dict.fromkeys([*first, *second])
        return {key: _filled_in(first.get(key), second.get(key)) for key in keys}
    return second if first is None else first


def _sum(values: Iterable[float | None]) -> float | None:
    known = list(values)
    return None if None in known else float(sum(v for v in known if v is not None))
