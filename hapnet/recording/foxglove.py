"""Foxglove's own schemas, as protobuf: events as lines of a log, handle and proxy as frames, set-positions as poses.

Viewers support these schemas, so they show the lines and draw the rest in 3D without configuration. Names, numbers and
types of the fields are those that Foxglove publishes. All poses are in the frame `FRAME`, in metres; missing axes are
0. Frames and poses of a tool that turns have its orientation. The shapes of the world and of an arm are an update of a
scene, each part in the frame that it moves with. More than three axes are not a place in space, so they are
not drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, NamedTuple

from hapnet.checks import Vector
from hapnet.mechanics.pose import Pose, Quaternion, pose
from hapnet.plant.worlds.picture import RESTS, Part
from hapnet.recording.samples import DeviceSample, Event, WorldSample
from hapnet.units import METRES, POSE, RADIANS

if TYPE_CHECKING:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto

PERIOD_NS = 16_000_000
"""The minimum time between two poses of a side [ns]: some 60 a second."""

FRAME = "scene"
TEXT_LIMIT = 2000

_CHILD = {DeviceSample: "device", WorldSample: "proxy"}
_SIDE = {DeviceSample: "device", WorldSample: "world"}
_TIME = "google.protobuf.Timestamp"
LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
MOST_BODIES = 16
"""Further bodies that move have neither frame nor shape."""

MOST_VERTICES = 20_000
"""Most vertices of all shapes together; beyond that shapes are left out."""

_FIELDS = {  # with a field's number if earlier numbers are not used
    "Vector3": {"x": "double", "y": "double", "z": "double"},
    "Quaternion": {"x": "double", "y": "double", "z": "double", "w": "double"},
    "Pose": {"position": "Vector3", "orientation": "Quaternion"},
    "FrameTransform": {
        "timestamp": _TIME, "parent_frame_id": "string", "child_frame_id": "string", "translation": "Vector3",
        "rotation": "Quaternion",
    },
    "PoseInFrame": {"timestamp": _TIME, "frame_id": "string", "pose": "Pose"},
    "Point3": {"x": "double", "y": "double", "z": "double"},
    "Color": {"r": "double", "g": "double", "b": "double", "a": "double"},
    "TriangleListPrimitive": {
        "pose": "Pose", "points": "Point3[]", "color": "Color", "indices": "5 fixed32[]",
    },
    "SceneEntity": {
        "timestamp": _TIME, "frame_id": "string", "id": "string", "frame_locked": "5 bool",
        "triangles": "12 TriangleListPrimitive[]",
    },
    "SceneUpdate": {"entities": "2 SceneEntity[]"},
    "Log": {
        "timestamp": _TIME, "level": "Level", "message": "string", "name": "string", "file": "string",
        "line": "fixed32",
    },
}  # fmt: skip


class Schema(NamedTuple):
    """The schema of one kind of message.

    name : of the message. descriptor : a serialised ``FileDescriptorSet``.
    encode : turns a sample into a message; ValueError or TypeError if the sample does not have these fields.
    """

    name: str
    descriptor: bytes
    encode: Callable[[Any], bytes]


class Shown(NamedTuple):
    """A pose at a time [ns]: of a frame (`child` is its name), or in `FRAME`. Missing axes are 0."""

    time_ns: int
    position: Vector
    quaternion: Quaternion
    child: str = ""

    @property
    def translation(self) -> dict[str, float]:
        return dict(zip("xyz", self.position, strict=False))

    @property
    def rotation(self) -> dict[str, float]:
        return dict(zip("wxyz", self.quaternion, strict=True))


def shown(time_ns: int, sample: DeviceSample | WorldSample, units: str = METRES) -> Iterator[tuple[str, Shown]]:
    """Yield the drawing of a sample at this time [ns], each part with its topic; its axes are in `units`."""
    if RADIANS in units:  # not a place in space
        return
    kind = type(sample)
    turns, places = units == POSE, (sample.position_m, sample.set_position_m)
    if (turns or len(sample.position_m) <= 3) and all(map(math.isfinite, chain(*places))):
        at, tied = (pose(place) if turns else Pose(place, (1.0, 0.0, 0.0, 0.0)) for place in places)
        yield f"/{_SIDE[kind]}/frame", Shown(time_ns, *at, _CHILD[kind])
        yield f"/{_SIDE[kind]}/set_position", Shown(time_ns, *tied)


def bodies(name: str, time_ns: int, poses: Iterable[Sequence[float]]) -> Iterator[tuple[str, Shown]]:
    """Yield the moving bodies as frames, ``/device/link`` as link_1, link_2, ...

    name : a topic without the number. poses : place [m] and quaternion w, x, y, z of each.
    """
    for number, (x, y, z, w, i, j, k) in enumerate(islice(poses, MOST_BODIES), 1):
        yield f"{name}_{number}", Shown(time_ns, (x, y, z), (w, i, j, k), _frame(name, number))


class Shapes(NamedTuple):
    """Surfaces in frames: resting surfaces in `FRAME`, the others in the frames that `bodies` names."""

    time_ns: int
    parts: tuple[tuple[str, Part], ...]


def shapes(name: str, time_ns: int, parts: Iterable[Part]) -> Shapes:
    """The shapes of the parts in `bodies` and of the resting parts; soft parts have none."""
    found: list[tuple[str, Part]] = []
    room = MOST_VERTICES
    for part in parts:
        if RESTS <= part.body < MOST_BODIES and len(part.vertices) <= room:
            room -= len(part.vertices)
            found.append((FRAME if part.body == RESTS else _frame(name, part.body + 1), part))
    return Shapes(time_ns, tuple(found))


def _frame(name: str, number: int) -> str:
    return f"{name.rpartition('/')[2]}_{number}"


def log_schema() -> Schema:
    """``foxglove.Log``, from an `Event`."""

    def line(event: Event) -> dict[str, Any]:
        return {
            "timestamp": _stamp(event.time_ns), "level": event.level.upper(), "message": event.text[:TEXT_LIMIT],
            "name": event.kind,
        }  # fmt: skip

    return _schema("Log", line)


def frame_schema() -> Schema:
    """``foxglove.FrameTransform``, from a `Shown`."""

    def transform(one: Shown) -> dict[str, Any]:
        return {
            "timestamp": _stamp(one.time_ns), "parent_frame_id": FRAME, "child_frame_id": one.child,
            "translation": one.translation, "rotation": one.rotation,
        }  # fmt: skip

    return _schema("FrameTransform", transform)


def pose_schema() -> Schema:
    """``foxglove.PoseInFrame``, from a `Shown`."""

    def in_frame(one: Shown) -> dict[str, Any]:
        place = {"position": one.translation, "orientation": one.rotation}
        return {"timestamp": _stamp(one.time_ns), "frame_id": FRAME, "pose": place}

    return _schema("PoseInFrame", in_frame)


def shapes_schema() -> Schema:
    """``foxglove.SceneUpdate``, from `Shapes`."""

    def update(one: Shapes) -> dict[str, Any]:
        return {"entities": [entity(one.time_ns, k, *part) for k, part in enumerate(one.parts, 1)]}

    def entity(time_ns: int, number: int, frame: str, part: Part) -> dict[str, Any]:
        surface = {
            "pose": {"position": {}, "orientation": {"w": 1.0}},
            "points": [dict(zip("xyz", vertex, strict=True)) for vertex in part.vertices.tolist()],
            "color": {name: channel / 255.0 for name, channel in zip("rgba", part.color, strict=True)},
            "indices": part.triangles.ravel().tolist(),
        }
        return {
            "timestamp": _stamp(time_ns), "frame_id": frame, "id": f"part {number}", "frame_locked": True,
            "triangles": [surface],
        }  # fmt: skip

    return _schema("SceneUpdate", update)


def message_class(name: str, files: Any) -> Any:
    """The class of the message `name` in a ``FileDescriptorSet``."""
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name))


def _schema(name: str, values: Callable[[Any], dict[str, Any]]) -> Schema:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    described = FileDescriptorSet(file=_files(name))
    message = message_class(f"foxglove.{name}", described)

    def encode(one: Any) -> bytes:
        data: bytes = message(**values(one)).SerializeToString()
        return data

    return Schema(f"foxglove.{name}", described.SerializeToString(), encode)


def _files(name: str) -> list[FileDescriptorProto]:
    """The files that describe the message `name`, one for each message type; each follows the files that it needs."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto
    from google.protobuf.timestamp_pb2 import DESCRIPTOR

    if name == _TIME:
        stamp = FileDescriptorProto()
        DESCRIPTOR.CopyToProto(stamp)
        return [stamp]
    file = FileDescriptorProto(name=f"foxglove/{name}.proto", package="foxglove", syntax="proto3")
    message = file.message_type.add(name=name)
    files: list[FileDescriptorProto] = []
    for place, (field, words) in enumerate(_FIELDS[name].items(), 1):
        number, _, kind = words.removesuffix("[]").rpartition(" ")
        label = "LABEL_REPEATED" if words.endswith("[]") else "LABEL_OPTIONAL"
        added = message.field.add(name=field, number=int(number or place), label=label)
        if kind in _FIELDS or kind == _TIME:
            added.type, added.type_name = added.TYPE_MESSAGE, f".{kind}" if kind == _TIME else f".foxglove.{kind}"
            needed = _files(kind)
            file.dependency.append(needed[-1].name)
            files += [one for one in needed if one not in files]
        elif kind == "Level":
            added.type, added.type_name = added.TYPE_ENUM, f".foxglove.{name}.Level"
            values = [{"name": level, "number": i} for i, level in enumerate(LEVELS)]
            message.enum_type.add(name="Level", value=values)
        else:
            added.type = getattr(added, f"TYPE_{kind.upper()}")
    return [*files, file]


def _stamp(time_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return {"seconds": seconds, "nanos": nanos}
