"""Samples and events as protobuf messages, and the schemas of these messages, which are stored with them.

A sample's fields are doubles; a vector has one field per axis. Events and poses have Foxglove's schemas (foxglove.py).
A file is read with its own schema: fields that the schema lacks are unknown, and fields with unknown names are
ignored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from hapnet.recording.drawing import SceneSample
from hapnet.recording.foxglove import (
    LEVELS,
    Schema,
    Shapes,
    Shown,
    frame_schema,
    log_schema,
    message_class,
    pose_schema,
    shapes_schema,
)
from hapnet.recording.samples import VECTORS, DeviceSample, Event, Level, PostureSample, Sample, WorldSample
from hapnet.units import METRES, RADIANS, column, units_in

_PACKAGE = "hapnet"


def schema_for(sample: Sample | Shown | Shapes, meta: Mapping[str, Any]) -> Schema:
    """The schema of this sample, and of all samples of its kind and number of axes. `meta`: of the recording."""
    if isinstance(sample, Event):
        return log_schema()
    if isinstance(sample, Shown):
        return frame_schema() if sample.child else pose_schema()
    if isinstance(sample, Shapes):
        return shapes_schema()
    if isinstance(sample, DeviceSample | WorldSample):
        return _sample_schema(type(sample), units_in(meta, len(sample.position_m)))
    if isinstance(sample, PostureSample):
        return _lists_schema(PostureSample, "TYPE_DOUBLE", lambda sample: [sample.angles_rad])
    assert isinstance(sample, SceneSample), "a drawing is an attachment"
    return _lists_schema(
        SceneSample, "TYPE_FLOAT", lambda sample: [np.frombuffer(data, "<f4").tolist() for data in sample[1:]]
    )


def decoder(kind: type[Sample], name: str, descriptor: bytes) -> Callable[[int, bytes], Sample]:
    """The function from a log time [ns] and data to a sample, for messages called `name` in `descriptor`.

    Raises KeyError, TypeError, ValueError, google.protobuf.message.DecodeError: from here or from the returned
    function, if these are not such samples.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    message = message_class(name, FileDescriptorSet.FromString(descriptor))
    if kind is Event:
        return lambda time_ns, data: _event(time_ns, message.FromString(data))
    if kind is PostureSample:
        return lambda time_ns, data: PostureSample(time_ns, tuple(message.FromString(data).angles_rad))
    if kind is SceneSample:
        return lambda time_ns, data: _scene(time_ns, message.FromString(data))
    there = {field.name for field in message.DESCRIPTOR.fields}
    units: tuple[str, ...] = ()
    while found := [unit for unit in (METRES, RADIANS) if _names("position_m", (*units, unit))[-1] in there]:
        units += (found[0],)
    readers: list[Callable[[Any], Any]] = []
    for field in kind._fields[1:]:
        names = _names(field, units)
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


def _names(field: str, units: Sequence[str]) -> Sequence[str]:
    """The names of a sample's field in its message, for axes in `units`: position_m becomes position_x_m and so on, or
    position_x_rad."""
    if field not in VECTORS:
        return (field,)
    parts = [column(field, unit).rpartition("_") for unit in units]
    return [f"{stem}_{'xyz'[axis] if axis < 3 else axis + 1}_{unit}" for axis, (stem, _, unit) in enumerate(parts)]


def _sample_schema(kind: type[DeviceSample] | type[WorldSample], units: Sequence[str]) -> Schema:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    names = [name for field in kind._fields[1:] for name in _names(field, units)]
    fields = [
        {"name": name, "number": number, "type": "TYPE_DOUBLE", "label": "LABEL_OPTIONAL"}
        for number, name in enumerate(names, 1)
    ]
    name = kind.__name__
    # proto2 writes a field that is 0 too, so that no viewer takes it for missing
    file = FileDescriptorProto(name=f"{_PACKAGE}/{name}.proto", package=_PACKAGE, syntax="proto2")
    file.message_type.add(name=name, field=fields)
    described = FileDescriptorSet(file=[file])
    message = message_class(f"{_PACKAGE}.{name}", described)
    unknown = (math.nan,) * len(units)

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


def _event(time_ns: int, line: Any) -> Event:
    levels: dict[int, Level] = {LEVELS.index("WARNING"): "warning", LEVELS.index("ERROR"): "error"}
    return Event(time_ns, line.name, line.message, levels.get(line.level, "info"))


def _lists_schema(
    kind: type[SceneSample] | type[PostureSample], number_type: str, numbers: Callable[[Any], list[Any]]
) -> Schema:
    """The schema of samples whose fields except the time are lists of numbers; `numbers` returns these lists."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    name, lists = kind.__name__, kind._fields[1:]
    file = FileDescriptorProto(name=f"{_PACKAGE}/{name}.proto", package=_PACKAGE, syntax="proto2")
    described = file.message_type.add(name=name)
    for number, field in enumerate(lists, 1):
        added = described.field.add(name=field, number=number, type=number_type, label="LABEL_REPEATED")
        added.options.packed = True
    files = FileDescriptorSet(file=[file])
    message = message_class(f"{_PACKAGE}.{name}", files)

    def encode(sample: Any) -> bytes:
        data: bytes = message(**dict(zip(lists, numbers(sample), strict=True))).SerializeToString()
        return data

    return Schema(f"{_PACKAGE}.{name}", files.SerializeToString(), encode)


def _scene(time_ns: int, message: Any) -> SceneSample:
    sample = SceneSample(
        time_ns, *[np.array(getattr(message, field), "<f4").tobytes() for field in SceneSample._fields[1:]]
    )
    if (problem := sample.problem()) is not None:
        raise ValueError(problem)
    return sample
