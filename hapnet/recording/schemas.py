"""Samples and events as protobuf messages, and the schemas of these messages, with which anyone can read them.

A sample's fields are doubles; a vector has one field per axis. An event is a ``foxglove.Log``. A file is read by its
own schema: fields that the schema lacks are unknown, and fields that have no name here are ignored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from hapnet.recording.samples import VECTORS, DeviceSample, Event, Sample, WorldSample

_TEXT_LIMIT = 2000
_PACKAGE = "hapnet"


@dataclass(frozen=True)
class Schema:
    """How samples of one kind and number of axes are written.

    name : of the message. descriptor : a serialised ``FileDescriptorSet``.
    encode : gives the message of a sample; ValueError or TypeError if the sample does not have these fields.
    """

    name: str
    descriptor: bytes
    encode: Callable[[Any], bytes]


def schema_for(sample: Sample) -> Schema:
    """The schema of this sample, and of all samples of its kind and number of axes."""
    return _log_schema() if isinstance(sample, Event) else _sample_schema(type(sample), len(sample.position_m))


def decoder(kind: type[Sample], name: str, descriptor: bytes) -> Callable[[int, bytes], Sample]:
    """The function from a log time [ns] and data to a sample, for messages called `name` in `descriptor`.

    Raises
    ------
    KeyError, TypeError, ValueError, google.protobuf.message.DecodeError : from here or from the returned function, if
        these are not such samples.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    message = _message_class(name, FileDescriptorSet.FromString(descriptor))
    if kind is Event:
        return lambda time_ns, data: _event(time_ns, message.FromString(data))
    there = {field.name for field in message.DESCRIPTOR.fields}
    n = 0
    while _names("position_m", n + 1)[-1] in there:
        n += 1
    readers: list[Callable[[Any], Any]] = []
    for field in kind._fields[1:]:
        names = _names(field, n)
        known = bool(names) and there.issuperset(names)
        readers.append(_reader(names, field in VECTORS) if known else lambda _: None)

    def sample(time_ns: int, data: bytes) -> Sample:
        read = message.FromString(data)
        return kind._make((time_ns, *[reader(read) for reader in readers]))

    return sample


def _reader(names: Sequence[str], vector: bool) -> Callable[[Any], Any]:
    """The function that reads a sample's field from its message."""
    get = attrgetter(*names)
    return (lambda message: (get(message),)) if vector and len(names) == 1 else get


def _names(field: str, n: int) -> Sequence[str]:
    """The names of a sample's field in its message, for `n` axes: position_m becomes position_x_m and so on."""
    if field not in VECTORS:
        return (field,)
    stem, _, unit = field.rpartition("_")
    return [f"{stem}_{'xyz'[axis] if axis < 3 else axis + 1}_{unit}" for axis in range(n)]


def _sample_schema(kind: type[DeviceSample] | type[WorldSample], n: int) -> Schema:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    names = [name for field in kind._fields[1:] for name in _names(field, n)]
    fields = [
        {"name": name, "number": number, "type": "TYPE_DOUBLE", "label": "LABEL_OPTIONAL"}
        for number, name in enumerate(names, 1)
    ]
    name = kind.__name__
    # proto2 writes a field that is 0 too, so that no viewer takes it for missing
    file = FileDescriptorProto(name=f"{_PACKAGE}/{name}.proto", package=_PACKAGE, syntax="proto2")
    file.message_type.add(name=name, field=fields)
    described = FileDescriptorSet(file=[file])
    message = _message_class(f"{_PACKAGE}.{name}", described)
    unknown = (math.nan,) * n

    def encode(sample: DeviceSample | WorldSample) -> bytes:
        values: list[float] = []
        for value in sample[1:]:
            if isinstance(value, tuple | list):
                values += value
            elif value is None:
                values += unknown
            else:
                values.append(value)
        data: bytes = message(**dict(zip(names, values, strict=True))).SerializeToString()
        return data

    return Schema(f"{_PACKAGE}.{name}", described.SerializeToString(), encode)


def _log_schema() -> Schema:
    """Foxglove's schema of a line in a log."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
    from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIME

    stamp = FileDescriptorProto()
    TIME.CopyToProto(stamp)
    file = FileDescriptorProto(name="foxglove/Log.proto", package="foxglove", syntax="proto3", dependency=[stamp.name])
    log = file.message_type.add(name="Log")
    for number, (field, kind, of) in enumerate(
        (
            ("timestamp", "TYPE_MESSAGE", ".google.protobuf.Timestamp"),
            ("level", "TYPE_ENUM", ".foxglove.Log.Level"),
            ("message", "TYPE_STRING", None),
            ("name", "TYPE_STRING", None),
            ("file", "TYPE_STRING", None),
            ("line", "TYPE_FIXED32", None),
        ),
        1,
    ):
        log.field.add(name=field, number=number, type=kind, type_name=of, label="LABEL_OPTIONAL")
    levels = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
    log.enum_type.add(name="Level", value=[{"name": level, "number": i} for i, level in enumerate(levels)])
    described = FileDescriptorSet(file=[stamp, file])
    message = _message_class("foxglove.Log", described)

    def encode(event: Event) -> bytes:
        seconds, nanoseconds = divmod(event.time_ns, 1_000_000_000)
        line = message(
            timestamp={"seconds": seconds, "nanos": nanoseconds},
            level="INFO",
            message=event.text[:_TEXT_LIMIT],
            name=event.kind,
        )
        data: bytes = line.SerializeToString()
        return data

    return Schema("foxglove.Log", described.SerializeToString(), encode)


def _event(time_ns: int, line: Any) -> Event:
    return Event(time_ns, line.name, line.message)


def _message_class(name: str, files: Any) -> Any:
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name))
