"""The telemetry of a side for its watchers: its newest sample many times a second, its status twice.

Each message is one msgpack array whose first element is the version and whose second names the kind: ``device`` or
``world`` (the fields of a `DeviceSample` or `WorldSample` in order), ``event`` (those of an `Event`), ``planes`` (those
of a `KnownPlanes`), ``posture`` (those of a `PostureSample`), ``drawing`` and ``scene`` (those of a `Drawing` and a
`SceneSample`: the world's picture) or ``status`` (a `Status`, one map). Received messages are checked against the
types of these classes.
Nothing depends on telemetry: it is dropped first and never repeated, and a watcher counts the messages that it cannot
read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias, get_args, get_origin, get_type_hints

import msgpack

from hapnet.checks import Vector
from hapnet.errors import BadMessage
from hapnet.mechanics.plane import Plane
from hapnet.recording.drawing import LARGEST, Drawing, SceneSample, unpack
from hapnet.recording.samples import VECTORS, DeviceSample, Event, PostureSample, Sample, WorldSample, plain
from hapnet.wire import fields
from hapnet.wire.fields import MAX_DOF, Signal
from hapnet.wire.messages import Role

VERSION = 6

MAX_LENGTH = 64 * 1024
"""Largest length of a message other than a drawing [bytes]."""

_MAX_DRAWING = LARGEST + 64

_SAMPLES: dict[str, type[DeviceSample] | type[WorldSample]] = {"device": DeviceSample, "world": WorldSample}
_LATEST_NS = 2**63 - 1  # of an array's times


@dataclass(frozen=True)
class Status:
    """The state of one side at `time_ns` on its clock.

    incarnation : of the process. paired : it has a peer. paused : the simulation stands still.
    recording : the path of the running recording, or "".
    about : the description of a recording (parameters, seed, scene, surfaces, coupling, clock), session and name.
    link : `netem.LinkStats` of this side's messages, with ``delay_now_ms`` and ``loss_now``: the mean emulated delay
    and the share lost since the last status (None: nothing was sent).
    path : the path between the sides since the last status, as in the summary, the real network included. This side
    measures the round trip and the direction to it.
    account : this side's half of the summary so far, as it reports it to its peer; empty: none yet.
    final : the side has stopped, and this is its last account.
    """

    role: Role
    time_ns: int
    incarnation: int
    paired: bool
    paused: bool
    recording: str
    about: dict[str, Any]
    link: dict[str, Any]
    path: dict[str, Any]
    account: Mapping[str, Signal] = field(default_factory=dict)
    final: bool = False


class KnownPlanes(NamedTuple):
    """The device's planes, from the world's newest message; None: the world sends none."""

    planes: tuple[Plane, ...] | None


Telemetry: TypeAlias = Sample | Status | KnownPlanes


_KINDS: dict[type, str] = {
    DeviceSample: "device", WorldSample: "world", Event: "event", KnownPlanes: "planes", SceneSample: "scene",
    PostureSample: "posture", Drawing: "drawing",
}  # fmt: skip
_DRAWING_BEGINS = msgpack.packb((VERSION, "drawing", 0, b""))[:10]


def encode(message: Sample | Status | KnownPlanes) -> bytes:
    """Encode a message as bytes."""
    packed: bytes
    if isinstance(message, KnownPlanes):
        packed = msgpack.packb((VERSION, "planes", *_parts_of(message.planes)))
    elif isinstance(message, Status):
        packed = msgpack.packb((VERSION, "status", plain(vars(message))))
    else:
        kind = _KINDS[type(message)]
        packed = msgpack.packb((VERSION, kind, *message))
    return packed


def decode(data: bytes) -> Telemetry:
    """Decode a message. Raises BadMessage: these bytes are not a message of this version."""
    maximum = _MAX_DRAWING if data.startswith(_DRAWING_BEGINS) else MAX_LENGTH
    if len(data) > maximum:
        raise BadMessage("size", f"{len(data)} bytes of telemetry; allowed: up to {maximum}")
    try:
        frame = msgpack.unpackb(data, use_list=False, strict_map_key=True)
    except (ValueError, msgpack.UnpackException) as error:
        raise BadMessage("msgpack", str(error)) from None
    match frame:
        case (version, *_) if version != VERSION:
            raise BadMessage("version", f"telemetry of version {version!r}; allowed: {VERSION}")
        case (_, str(kind), *content) if kind in _SAMPLES:
            return _sample(_SAMPLES[kind], content)
        case (_, "event", int(time_ns), str(kind), str(text), "info" | "warning" | "error" as level):
            return Event(time_ns, kind, text, level)
        case (_, "scene", int(time_ns), bytes(poses), bytes(touches), bytes(soft)) if _is_time(time_ns):
            scene = SceneSample(time_ns, poses, touches, soft)
            if (problem := scene.problem()) is not None:
                raise BadMessage("telemetry", problem)
            return scene
        case (_, "posture", int(time_ns), tuple(angles)) if _is_time(time_ns) and _are_angles(angles):
            return PostureSample(time_ns, angles)
        case (_, "drawing", int(time_ns), bytes(content)) if _is_time(time_ns):
            unpack(content)
            return Drawing(time_ns, content)
        case (_, "planes", content) | (_, "planes", content, _) | (_, "planes", content, _, _):
            fields.planes(content)
            bends, friction = (*frame[3:], None, None)[:2]
            about = {fields.CURVATURES: bends, fields.FRICTION: friction}
            known = {name: each for name, each in about.items() if each is not None}
            fields.surfaces(fields.checked(known, fields.OfProxy), content)
            return KnownPlanes(Plane.all_of(content, bends, friction))
        case (_, "status", dict(content)):
            return _status(content)
    raise BadMessage("telemetry", "neither a sample, an event, planes, a scene, a drawing nor a status")


def _parts_of(planes: tuple[Plane, ...] | None) -> tuple[Any, ...]:
    """Planes in the form of a message; then the curvatures of each, if any are curved; then the friction, likewise."""
    if planes is None:
        return (None,)
    flat = [plane[:5] for plane in planes]
    bends = [plane.curvatures for plane in planes] if any(plane.curvatures for plane in planes) else None
    if any(plane.friction for plane in planes):
        return flat, bends, [plane.friction for plane in planes]
    return (flat,) if bends is None else (flat, bends)


def _sample(kind: type[DeviceSample] | type[WorldSample], content: list[Any]) -> DeviceSample | WorldSample:
    names = kind._fields
    if len(content) != len(names):
        raise BadMessage("telemetry", f"{len(content)} fields of a {kind.__name__}, which has {len(names)}")
    for name, value in zip(names, content, strict=True):
        if not _FITS[kind][name](value):
            raise BadMessage("telemetry", f"{name} of a {kind.__name__} is {value!r:.60}")
    if len({len(value) for name, value in zip(names, content, strict=True) if name in VECTORS and value}) > 1:
        raise BadMessage("telemetry", f"vectors of a {kind.__name__} with different numbers of axes")
    return kind._make(content)


def _are_angles(values: tuple[object, ...]) -> bool:
    return len(values) <= MAX_DOF and all(isinstance(value, float) and math.isfinite(value) for value in values)


def _is_time(value: object) -> bool:
    return type(value) is int and value <= _LATEST_NS


def _is_number(value: object) -> bool:
    return type(value) is float


def _is_vector(value: object) -> bool:
    return isinstance(value, tuple) and 0 < len(value) <= MAX_DOF and all(type(v) is float for v in value)


def _is_vector_or_none(value: object) -> bool:
    return value is None or _is_vector(value)


_OF_TYPE: dict[Any, Callable[[object], bool]] = {
    int: _is_time, float: _is_number, Vector: _is_vector, Vector | None: _is_vector_or_none,
}  # fmt: skip
_FITS = {
    kind: {name: _OF_TYPE[hint] for name, hint in get_type_hints(kind).items()} for kind in (DeviceSample, WorldSample)
}
_STATUS_TYPES: dict[str, Any] = {
    name: str if hint is Role else get_origin(hint) or hint for name, hint in get_type_hints(Status).items()
}


def _status(content: dict[str, Any]) -> Status:
    if set(content) != set(_STATUS_TYPES):
        raise BadMessage("telemetry", "a status with other fields")
    for name, allowed in _STATUS_TYPES.items():
        if not isinstance(content[name], allowed):
            raise BadMessage("telemetry", f"{name} of a status is {content[name]!r:.60}")
    if content["role"] not in get_args(Role):
        raise BadMessage("telemetry", f"role of a status is {content['role']!r:.60}")
    if not (_is_about(content["about"]) and _is_link(content["link"]) and _is_path(content["path"])):
        raise BadMessage("telemetry", "a status whose parameters, surfaces, link or path are not valid")
    fields.signals(content["account"], fields.AccountMap)
    return Status(**content)


def _is_about(about: dict[str, Any]) -> bool:
    """Whether a page can draw its parameters and surfaces."""
    params, surfaces = about.get("params", {}), about.get("surfaces", ())
    device = params.get("device", {}) if isinstance(params, dict) else None
    if not isinstance(device, dict) or not isinstance(device.get("smoothing_s", 0.0), float | int):
        return False
    return isinstance(surfaces, tuple) and all(map(_is_surface, surfaces))


def _is_surface(surface: object) -> bool:
    match surface:
        case {"axis": int(axis), "solid": 1 | -1, "position_m": float(place) | int(place)}:
            return 0 <= axis < MAX_DOF and abs(place) < math.inf
    return False


def _is_link(link: dict[str, Any]) -> bool:
    return all(isinstance(link.get(name), float | int | None) for name in ("delay_now_ms", "loss_now"))


def _is_path(path: dict[str, Any]) -> bool:
    directions = [path.get(name) for name in ("up", "down")]
    if not all(
        direction is None or (isinstance(direction, dict) and isinstance(direction.get("loss"), float | int))
        for direction in directions
    ):
        return False
    return isinstance(path.get("round_trip_p50_ms"), float | int | None)
