"""The telemetry of a side for its watchers: its newest sample many times a second, its status twice.

Each message is one msgpack array whose first element is the version and whose second says what it holds: ``device`` or
``world`` (the fields of a `DeviceSample` or `WorldSample` in order), ``event`` (those of an `Event`), ``planes`` (those
of a `KnownPlanes`), ``posture`` (those of a `PostureSample`), ``drawing`` and ``scene`` (those of a `Drawing` and a
`SceneSample`: what the world looks like) or ``status`` (a `Status`, one map). The checks of what is read are made from
these classes' types.
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
"""No message but a drawing is longer [bytes]."""

_MAX_DRAWING = LARGEST + 64

_SAMPLES: dict[str, type[DeviceSample] | type[WorldSample]] = {"device": DeviceSample, "world": WorldSample}
_LATEST_NS = 2**63 - 1  # of an array's times


@dataclass(frozen=True)
class Status:
    """How one side is, as of `time_ns` on its clock.

    incarnation : of the process. paired : it has a peer. paused : what is simulated stands still.
    recording : the path of the running recording, or "".
    about : the description of a recording (parameters, seed, scene, surfaces, coupling, clock), session and name.
    link : `netem.LinkStats` of what this side sends, with ``delay_now_ms`` and ``loss_now``: the mean emulated delay
    and the share lost since the last status (None: nothing was sent).
    path : the path between the sides since the last status, as in the summary, the real network included. This side
    knows the round trip and the direction to it.
    account : this side's half of the summary so far, as it reports it to its peer; empty: it has none yet.
    final : it has stopped, and this is its last account.
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
    """The planes that the device knows, from the world's newest message; None: the world sends none."""

    planes: tuple[Plane, ...] | None


Telemetry: TypeAlias = Sample | Status | KnownPlanes


_KINDS: dict[type, str] = {
    DeviceSample: "device", WorldSample: "world", Event: "event", KnownPlanes: "planes", SceneSample: "scene",
    PostureSample: "posture", Drawing: "drawing",
}  # fmt: skip
_DRAWING_BEGINS = msgpack.packb((VERSION, "drawing", 0, b""))[:10]


def encode(message: Sample | Status | KnownPlanes) -> bytes:
    """The bytes to publish."""
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
    """The message that was published. Raises BadMessage: these bytes are not a message of this version."""
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
        case (_, str(kind), *reported) if kind in _SAMPLES:
            return _sample(_SAMPLES[kind], reported)
        case (_, "event", int(time_ns), str(kind), str(text), "info" | "warning" | "error" as level):
            return Event(time_ns, kind, text, level)
        case (_, "scene", int(time_ns), bytes(poses), bytes(touches), bytes(soft)) if _is_time(time_ns):
            scene = SceneSample(time_ns, poses, touches, soft)
            if (problem := scene.problem()) is not None:
                raise BadMessage("telemetry", problem)
            return scene
        case (_, "posture", int(time_ns), tuple(angles)) if _is_time(time_ns) and _are_angles(angles):
            return PostureSample(time_ns, angles)
        case (_, "drawing", int(time_ns), bytes(reported)) if _is_time(time_ns):
            unpack(reported)
            return Drawing(time_ns, reported)
        case (_, "planes", reported) | (_, "planes", reported, _) | (_, "planes", reported, _, _):
            fields.planes(reported)
            bends, friction = (*frame[3:], None, None)[:2]
            about = {fields.CURVATURES: bends, fields.FRICTION: friction}
            known = {name: each for name, each in about.items() if each is not None}
            fields.surfaces(fields.checked(known, fields.OfProxy), reported)
            return KnownPlanes(Plane.all_of(reported, bends, friction))
        case (_, "status", dict(reported)):
            return _status(reported)
    raise BadMessage("telemetry", "neither a sample, an event, planes, a scene, a drawing nor a status")


def _parts_of(planes: tuple[Plane, ...] | None) -> tuple[Any, ...]:
    """Planes as a message has them; then the curvatures of each, if any has some; then the friction, likewise."""
    if planes is None:
        return (None,)
    flat = [plane[:5] for plane in planes]
    bends = [plane.curvatures for plane in planes] if any(plane.curvatures for plane in planes) else None
    if any(plane.friction for plane in planes):
        return flat, bends, [plane.friction for plane in planes]
    return (flat,) if bends is None else (flat, bends)


def _sample(kind: type[DeviceSample] | type[WorldSample], reported: list[Any]) -> DeviceSample | WorldSample:
    names = kind._fields
    if len(reported) != len(names):
        raise BadMessage("telemetry", f"{len(reported)} fields of a {kind.__name__}, which has {len(names)}")
    for name, value in zip(names, reported, strict=True):
        if not _FITS[kind][name](value):
            raise BadMessage("telemetry", f"{name} of a {kind.__name__} is {value!r:.60}")
    if len({len(value) for name, value in zip(names, reported, strict=True) if name in VECTORS and value}) > 1:
        raise BadMessage("telemetry", f"vectors of a {kind.__name__} with different numbers of axes")
    return kind._make(reported)


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


def _status(reported: dict[str, Any]) -> Status:
    if set(reported) != set(_STATUS_TYPES):
        raise BadMessage("telemetry", "a status with other fields")
    for name, allowed in _STATUS_TYPES.items():
        if not isinstance(reported[name], allowed):
            raise BadMessage("telemetry", f"{name} of a status is {reported[name]!r:.60}")
    if reported["role"] not in get_args(Role):
        raise BadMessage("telemetry", f"role of a status is {reported['role']!r:.60}")
    if not (_is_about(reported["about"]) and _is_link(reported["link"]) and _is_path(reported["path"])):
        raise BadMessage("telemetry", "a status whose parameters, surfaces, link or path are not valid")
    fields.signals(reported["account"], fields.AccountMap)
    return Status(**reported)


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
