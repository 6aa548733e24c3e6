"""The messages of the protocol and their frames: `encode` and `decode` (README.md beside this file is the reference).

A frame is a msgpack array: the protocol version, the kind of message, and the fields of its class in their order. A
field's type says what a receiver checks. The last element, a map of further entries, may be absent; a receiver ignores
those that it does not know. `decode` takes whatever a network brings: all was checked in its result, or `BadMessage`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, get_args

import msgpack

from hapnet.errors import BadMessage
from hapnet.wire import fields
from hapnet.wire.account import Account as Account
from hapnet.wire.encryption import Encrypted as Encrypted
from hapnet.wire.fields import (
    MAX_COORDINATE,
    MAX_DOF,
    U64,
    About,
    Coordinates,
    Dof,
    More,
    Nanojoules,
    Planes,
    Role as Role,
    RoleName,
    Scalar as Scalar,
    SignalMap,
    Span,
    Text,
)
from hapnet.wire.stream_frames import VERSION as VERSION, echo_of, encode_stream, start_of

MAX_FRAME_BYTES = 4096
MAX_ARRAY = MAX_DOF + 1  # msgpack allocates what an array announces: 4 kB of nested headers took 20 ms and 30 MB

Channel = Literal["position", "energy", "control", "signals"]


class _PositionFields(NamedTuple):
    incarnation: U64
    sequence: U64
    sent_ns: U64
    position: Coordinates
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None


class Position(_PositionFields):
    """A set-position, `position` in m (or rad), numbered and stamped with its sender's own clock. Best effort.

    echo_ns : the stamp of the addressee's message that came last.
    came_ns : when the message with that stamp came, on the sender's clock; both are 0 before there is one.

    Each kind of stream has these two stamps. With the time of arrival they give the round trip (as in NTP: RFC 5905,
    section 8). The further entry `fields.LEVEL` is of the sender's reservoir.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 1
    CHANNEL: ClassVar[Channel] = "position"
    vector: Coordinates = _PositionFields.position

    level = property(fields.level_in)


class _EnergyFields(NamedTuple):
    incarnation: U64
    addressee: U64
    total_nJ: Nanojoules
    acked_nJ: Nanojoules
    more: More | None = None


class Energy(_EnergyFields):
    """The total energy sent to `addressee` so far, and the total credited to it, in nJ.

    `total_nJ` 0 marks a mere acknowledgement, which is never answered.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 2
    CHANNEL: ClassVar[Channel] = "energy"


class _MotionFields(NamedTuple):
    incarnation: U64
    sequence: U64
    sent_ns: U64
    position: Coordinates
    velocity: Coordinates
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None


class Motion(_MotionFields):
    """A position [m or rad] with its velocity [m/s or rad/s], sent in place of a `Position`."""

    __slots__ = ()
    KIND: ClassVar[int] = 7
    CHANNEL: ClassVar[Channel] = "position"
    vector: Coordinates = _MotionFields.position


class _PortFields(NamedTuple):
    incarnation: U64
    sequence: U64
    sent_ns: U64
    value: Coordinates
    energy_nJ: Nanojoules
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None


class Port(_PortFields):
    """What one port shows the other: the device's position [m] or the world's force [N], and the energy that went in.

    `energy_nJ` is the total that went into the channel at the sender's port. The peer may take it out.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 8
    CHANNEL: ClassVar[Channel] = "position"
    vector: Coordinates = _PortFields.value


class _WaveFields(NamedTuple):
    incarnation: U64
    sequence: U64
    sent_ns: U64
    wave: Coordinates
    span_ns: Span
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None


class Wave(_WaveFields):
    """A wave variable [sqrt(W)]: the mean over `span_ns` of the sender's time.

    The further entry `fields.INTEGRAL` has the integral of all waves of this stream so far, this one included, and the
    sum of their spans. What a lost wave carried is the difference to the last message that arrived.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 9
    CHANNEL: ClassVar[Channel] = "position"
    vector: Coordinates = _WaveFields.wave


class _ProxyFields(NamedTuple):
    incarnation: U64
    sequence: U64
    sent_ns: U64
    position: Coordinates
    aimed_ns: U64
    force: Coordinates
    planes: Planes
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None


class Proxy(_ProxyFields):
    """The world's virtual mass with the planes that it touches or is near, sent in place of a `Position`.

    aimed_ns : the time on the device's clock for which the position stands; 0: the world does not know.
    force : of the environment on the mass in the last step [N].
    planes : each is a unit normal that points into the solid, an offset along it [m], a stiffness [N/m], a damping
        [Ns/m] and a velocity along the normal [m/s]. None: this world can send no planes.

    The further entry `fields.CURVATURES` has for each plane how the surface bends that it touches: an array of a
    direction and a curvature [1/m] each; `fields.FRICTION` has for each its coefficient of friction. `fields.REACH`
    says within which distance there are no other planes [m], `fields.LEVEL` how full the world's reservoir is.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 10
    CHANNEL: ClassVar[Channel] = "position"
    vector: Coordinates = _ProxyFields.position


Stream = Position | Motion | Port | Wave | Proxy
"""The message that a side sends all the time; coupling and role decide which of these kinds. `vector` is the element
with one number per axis, whatever the kind calls it."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a side is: one start of a process (`incarnation`), its role and its number of degrees of freedom."""

    incarnation: int
    role: Role
    dof: int
    name: str
    about: dict[str, Scalar]


@dataclass(frozen=True, slots=True)
class Hello:
    """ "Who is there?", to anyone. `number` counts the hellos of this incarnation from 1; a welcome repeats it.

    With the further entry `fields.ANSWERS` it is to the side whose hello it answers, and sealed for it.
    """

    KIND: ClassVar[int] = 3
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: U64
    number: U64
    role: RoleName
    dof: Dof
    name: Text
    about: About
    more: More | None = None


@dataclass(frozen=True, slots=True)
class Welcome:
    """The answer to hello `number` of `addressee`: proof that this sender was alive after that hello was sent."""

    KIND: ClassVar[int] = 4
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: U64
    addressee: U64
    number: U64
    role: RoleName
    dof: Dof
    name: Text
    about: About
    more: More | None = None


@dataclass(frozen=True, slots=True)
class Refuse:
    """`addressee` does not fit and never will; `reason` says why.

    Without further entries the frame is the same in every protocol version.
    """

    KIND: ClassVar[int] = 5
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: U64
    addressee: U64
    reason: Text
    more: More | None = None


@dataclass(frozen=True, slots=True)
class Bye:
    """The sender ends. `acked_nJ` is all the energy that it credited to `addressee` (0: it has no peer)."""

    KIND: ClassVar[int] = 6
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: U64
    addressee: U64
    acked_nJ: Nanojoules
    reason: Text
    more: More | None = None


@dataclass(frozen=True, slots=True)
class Signals:
    """All values that the sender reports to `addressee` beside the stream, as of now; the newest frame wins."""

    KIND: ClassVar[int] = 11
    CHANNEL: ClassVar[Channel] = "signals"
    incarnation: U64
    addressee: U64
    sequence: U64
    values: SignalMap
    more: More | None = None


Message = Stream | Energy | Hello | Welcome | Refuse | Bye | Signals | Account | Encrypted


class OtherVersion(BadMessage):
    """A frame of another protocol version. Its kind and its sender can be read, as in every version."""

    def __init__(self, kind: str, detail: str, *, message_kind: int = 0, incarnation: int = 0) -> None:
        self.message_kind: int = message_kind
        self.incarnation: int = incarnation
        super().__init__(kind, detail)


def encode(message: Message) -> bytes:
    """The frame of `message`. Its fields are not checked: coordinates must be floats, not integers."""
    elements = message if isinstance(message, tuple) else tuple(getattr(message, name) for name in message.__slots__)
    elements, more = elements[:-1], elements[-1:] if elements[-1] else ()
    if isinstance(message, _STREAM):
        values, echo = elements[3:-2], echo_of(elements[-2], elements[-1])
        start = start_of(message.KIND, message.incarnation, len(values) + len(more))
        data = encode_stream(start, message.sequence, message.sent_ns, values, echo)
        return data + b"".join(map(_pack, more))
    return _pack((VERSION, message.KIND, *elements, *more))


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the frames of one kind look, by the fields of its class.

    make : the class. checks : of each element after the incarnation, with its place in the frame.
    least, most : the frame's number of elements.
    """

    make: Callable[..., Any]
    checks: tuple[tuple[int, Callable[[object], object]], ...]
    minimum: int
    most: int

    @classmethod
    def of(cls, message: type[Message]) -> _Layout:
        names = field_names(message)
        own = tuple(name for name in names if name != "more")
        checks = tuple(enumerate(fields.checks_of(message, own), 2))
        return cls(message, checks[1:], len(own) + 2, len(names) + 2)


def field_names(message: type[Message]) -> tuple[str, ...]:
    """The fields of a message in the order of its frame, which begins with version and kind."""
    return message._fields if issubclass(message, tuple) else message.__slots__


def decode(data: bytes) -> Message:
    """The message in `data`.

    Raises BadMessage: `data` is not a valid message. Its `kind` is one of size, malformed, version, kind, length, type,
    range, dimension.
    """
    if len(data) > MAX_FRAME_BYTES:
        raise BadMessage("size", f"a frame of {len(data)} bytes; allowed: up to {MAX_FRAME_BYTES}")
    try:
        frame = _unpack(data, use_list=False, max_array_len=MAX_ARRAY)
    except (ValueError, msgpack.UnpackException) as error:
        raise BadMessage("malformed", f"not a msgpack array: {type(error).__name__}") from None
    if _is_position(frame):
        return _new(Position, frame[2:] if len(frame) == 9 else (*frame[2:], None))
    return examined(frame)


def _is_position(frame: Any) -> bool:
    """Is the frame a valid position? Nearly every frame is, and must reach the servo soon: `examined` takes longer."""
    if type(frame) is not tuple:
        return False
    if len(frame) != 8 and not (len(frame) == 9 and fields.is_only_level(frame[8])):
        return False
    version, kind, incarnation, sequence, sent_ns, position, echo_ns, came_ns = frame[:8]
    if not (type(version) is type(kind) is type(incarnation) is type(sequence) is type(sent_ns) is int):
        return False
    if not type(echo_ns) is type(came_ns) is int or echo_ns < 0 or came_ns < 0:
        return False
    if version != VERSION or kind != Position.KIND or incarnation <= 0 or sequence < 0 or sent_ns < 0:
        return False
    if type(position) is not tuple or not 1 <= len(position) <= MAX_DOF:
        return False
    for x in position:
        if type(x) is not float or not -MAX_COORDINATE <= x <= MAX_COORDINATE:
            break
    else:
        return True
    return False


def examined(frame: Any) -> Message:
    """The message in a frame, checked element by element."""
    if type(frame) is not tuple or len(frame) < 3 or type(frame[0]) is not int or type(frame[1]) is not int:
        raise BadMessage("malformed", "not an array that begins with version, kind and incarnation")
    version, kind, incarnation = frame[:3]
    if type(incarnation) is not int or incarnation <= 0:
        raise BadMessage("range", "incarnation is not an integer from 1 to 2^64 - 1")
    if version != VERSION and kind != Refuse.KIND:
        detail = f"peer speaks protocol {version}, this side speaks {VERSION}"
        raise OtherVersion("version", detail, message_kind=kind, incarnation=incarnation)
    layout = _LAYOUTS.get(kind)
    if layout is None:
        raise BadMessage("kind", f"message kind {kind}; allowed: 1 to {max(_LAYOUTS)}")
    if not layout.minimum <= len(frame) <= layout.most:
        name = layout.make.__name__
        raise BadMessage("length", f"{name} of {len(frame)} elements; allowed: {layout.minimum} to {layout.most}")
    for index, check in layout.checks:
        check(frame[index])
    if len(frame) > layout.minimum:
        fields.more(frame[-1])
        frame = (*frame[:-1], frame[-1] or None)
    message: Message = layout.make(*frame[2:])
    further = message.more or {}
    for name, check in _FURTHER.get(type(message), {}).items():
        if name in further:
            check(further[name])
    if type(message) is Wave and message.more and fields.INTEGRAL in message.more:
        fields.integral(message.more[fields.INTEGRAL], len(message.wave))
    if type(message) is Motion and len(message.position) != len(message.velocity):
        raise BadMessage("dimension", f"{len(message.position)} coordinates with {len(message.velocity)} velocities")
    if type(message) is Proxy:
        fields.surroundings(message.position, message.force, message.planes, message.more or {})
    return message


_FURTHER: dict[type[Message], dict[str, Callable[[object], object]]] = {
    Position: {fields.LEVEL: fields.level},
    Proxy: {fields.LEVEL: fields.level, fields.REACH: fields.reach},
    Energy: {fields.SUMS: fields.sums},
    Hello: {fields.KEY: fields.public_key, fields.ENCRYPTS: fields.flag, fields.ANSWERS: fields.answers},
    Welcome: {fields.KEY: fields.public_key, fields.ENCRYPTS: fields.flag},
}
_STREAM = (Position, Motion, Port, Wave, Proxy)
_LAYOUTS = {cls.KIND: _Layout.of(cls) for cls in get_args(Message)}
_new = tuple.__new__  # takes half the time, and the fields are checked already
_pack: Callable[..., bytes] = msgpack.packb
_unpack: Callable[..., Any] = msgpack.unpackb
