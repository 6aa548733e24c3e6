"""The messages of the protocol and their frames: `encode` and `decode` (README.md beside this file is the reference).

A frame is a msgpack array whose first element is the protocol version and whose second is the kind of message. The
rest are the fields of the message's dataclass in their order. `decode` takes whatever a network brings: the result is
a message whose every field was checked, or `BadMessage`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from math import isfinite
from operator import attrgetter
from typing import Any, ClassVar, Literal, NamedTuple

import msgpack

from hapnet.errors import BadMessage

VERSION = 1
MAX_FRAME_BYTES = 4096
MAX_DOF = 64
MAX_TEXT = 256
MAX_ABOUT = 32
MAX_COORDINATE = 1e6  # m or rad; keeps every square and product of the control layer finite
MAX_TOTAL_NJ = 2**63  # exclusive: totals fit a signed 64-bit integer
MAX_SPAN_NS = 10**10  # of a wave: nobody sends so seldom
MAX_ARRAY = MAX_DOF + 1  # msgpack allots what an array announces: 4 kB of nested headers took 20 ms and 30 MB

_POSITION_KIND = 1

Role = Literal["device", "world"]
Scalar = str | int | float | bool | None
Channel = Literal["position", "energy", "control"]


class _PositionFields(NamedTuple):
    incarnation: int
    sequence: int
    sent_ns: int
    position: tuple[float, ...]


class Position(_PositionFields):
    """A set-position, `position` in m (or rad), numbered and stamped with its sender's own clock. Best effort.

    A named tuple and no dataclass, as it is made hundreds of times a second.
    """

    __slots__ = ()
    KIND: ClassVar[int] = _POSITION_KIND
    CHANNEL: ClassVar[Channel] = "position"


class _EnergyFields(NamedTuple):
    incarnation: int
    addressee: int
    total_nJ: int
    acked_nJ: int


class Energy(_EnergyFields):
    """All the energy sent to `addressee` so far, and all that was credited from it, in nJ.

    `total_nJ` 0 marks an acknowledgement alone, which is never answered. A named tuple as `Position` is.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 2
    CHANNEL: ClassVar[Channel] = "energy"


class _MotionFields(NamedTuple):
    incarnation: int
    sequence: int
    sent_ns: int
    position: tuple[float, ...]
    velocity: tuple[float, ...]


class Motion(_MotionFields):
    """A position [m or rad] with its velocity [m/s or rad/s]; else as `Position`, in whose place it is sent."""

    __slots__ = ()
    KIND: ClassVar[int] = 7
    CHANNEL: ClassVar[Channel] = "position"


class _PortFields(NamedTuple):
    incarnation: int
    sequence: int
    sent_ns: int
    value: tuple[float, ...]
    energy_nJ: int


class Port(_PortFields):
    """What one port shows the other, the device's position [m] or the world's force [N], and the energy that went in.

    `energy_nJ` is all that ever went into the channel at the sender's port, for the peer to take out.
    """

    __slots__ = ()
    KIND: ClassVar[int] = 8
    CHANNEL: ClassVar[Channel] = "position"


class _WaveFields(NamedTuple):
    incarnation: int
    sequence: int
    sent_ns: int
    wave: tuple[float, ...]
    span_ns: int


class Wave(_WaveFields):
    """A wave variable [sqrt(W)], the mean over the `span_ns` of its sender's time that it stands for."""

    __slots__ = ()
    KIND: ClassVar[int] = 9
    CHANNEL: ClassVar[Channel] = "position"


Stream = Position | Motion | Port | Wave
"""What a side sends all the time, one kind of these a coupling and role."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a side is: one process start (`incarnation`), what it plays and how many degrees of freedom it has."""

    incarnation: int
    role: Role
    dof: int
    name: str
    about: dict[str, Scalar]


@dataclass(frozen=True, slots=True)
class Hello:
    """ "Who is there?", to anyone. `number` counts the hellos of this incarnation from 1; a welcome repeats it."""

    KIND: ClassVar[int] = 3
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: int
    number: int
    role: Role
    dof: int
    name: str
    about: dict[str, Scalar]


@dataclass(frozen=True, slots=True)
class Welcome:
    """The answer to hello `number` of `addressee`: proof that this sender was alive after that hello was sent."""

    KIND: ClassVar[int] = 4
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: int
    addressee: int
    number: int
    role: Role
    dof: int
    name: str
    about: dict[str, Scalar]


@dataclass(frozen=True, slots=True)
class Refuse:
    """`addressee` does not fit, for good, and why. Its frame is the same in every version of the protocol."""

    KIND: ClassVar[int] = 5
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: int
    addressee: int
    reason: str


@dataclass(frozen=True, slots=True)
class Bye:
    """The sender ends. `acked_nJ` is final: what it credited from `addressee` (0: nobody), and will ever have."""

    KIND: ClassVar[int] = 6
    CHANNEL: ClassVar[Channel] = "control"
    incarnation: int
    addressee: int
    acked_nJ: int
    reason: str


Message = Stream | Energy | Hello | Welcome | Refuse | Bye


class OtherVersion(BadMessage):
    """A frame of another protocol version; what every version shares is readable: its kind and its sender."""

    def __init__(self, kind: str, detail: str, *, message_kind: int = 0, incarnation: int = 0) -> None:
        self.message_kind, self.incarnation = message_kind, incarnation
        super().__init__(kind, detail)


def encode(message: Message) -> bytes:
    """The frame of `message`. Fields are taken as they are: coordinates must be floats, not integers."""
    return _pack((VERSION, message.KIND, *_FIELDS[type(message)](message)))


def encode_position(
    incarnation: int, sequence: int, sent_ns: int, position: tuple[float, ...], pack: Callable[..., bytes] | None = None
) -> bytes:
    """`encode` of a `Position`, without making one: a servo does this all day.

    `pack` : of a `msgpack.Packer` that the calling thread keeps for it, which is faster than a new one each time.
    """
    return (pack or _pack)((VERSION, _POSITION_KIND, incarnation, sequence, sent_ns, position))


def decode(data: bytes) -> Message:
    """The message in `data`.

    Raises
    ------
    BadMessage : for anything else, `kind` being one of size, malformed, version, kind, length, type, range, dimension.
    """
    if len(data) > MAX_FRAME_BYTES:
        raise BadMessage("size", f"a frame of {len(data)} bytes; allowed: up to {MAX_FRAME_BYTES}")
    try:
        frame = _unpack(data, use_list=False, max_array_len=MAX_ARRAY)
    except (ValueError, msgpack.UnpackException) as error:
        raise BadMessage("malformed", f"not a msgpack array: {type(error).__name__}") from None
    if _is_position(frame):
        return Position(*frame[2:])
    return _examined(frame)


def _is_position(frame: Any) -> bool:
    """Is that a position as it should be? Nearly every frame is, and its way to the servo should be short."""
    if type(frame) is not tuple or len(frame) != 6:
        return False
    version, kind, incarnation, sequence, sent_ns, position = frame
    if not (type(version) is type(kind) is type(incarnation) is type(sequence) is type(sent_ns) is int):
        return False
    if version != VERSION or kind != _POSITION_KIND or incarnation <= 0 or sequence < 0 or sent_ns < 0:
        return False
    if type(position) is not tuple or not 1 <= len(position) <= MAX_DOF:
        return False
    for x in position:
        if type(x) is not float or not -MAX_COORDINATE <= x <= MAX_COORDINATE:
            break
    else:
        return True
    return False


def _examined(frame: Any) -> Message:
    """The message that a frame holds, or what is wrong with it, element by element."""
    if type(frame) is not tuple or len(frame) < 3 or type(frame[0]) is not int or type(frame[1]) is not int:
        raise BadMessage("malformed", "not an array that begins with version, kind and incarnation")
    version, kind, incarnation = frame[:3]
    if type(incarnation) is not int or incarnation <= 0:
        raise BadMessage("range", "incarnation is not an integer from 1 to 2^64 - 1")
    if version != VERSION and kind != Refuse.KIND:
        detail = f"peer speaks protocol {version}, this side speaks {VERSION}"
        raise OtherVersion("version", detail, message_kind=kind, incarnation=incarnation)
    layout = _INDEXED.get(kind)
    if layout is None:
        raise BadMessage("kind", f"message kind {kind}; allowed: 1 to {max(_INDEXED)}")
    cls, checks = layout
    if len(frame) != len(checks) + 3:
        raise BadMessage("length", f"{cls.__name__} of {len(frame)} elements; allowed: {len(checks) + 3}")
    for index, check in checks:
        check(frame[index])
    message: Message = cls(*frame[2:])
    if type(message) is Motion and len(message.position) != len(message.velocity):
        raise BadMessage("dimension", f"{len(message.position)} coordinates with {len(message.velocity)} velocities")
    return message


# Each check raises BadMessage or returns; msgpack itself bounds integers to -2^63 .. 2^64 - 1.


def _natural(value: object) -> int:
    if type(value) is not int:
        raise BadMessage("type", f"a {type(value).__name__} where an integer belongs")
    if value < 0:
        raise BadMessage("range", f"{value}; allowed: not negative")
    return value


def _total(value: object) -> None:
    if _natural(value) >= MAX_TOTAL_NJ:
        raise BadMessage("range", f"{value} nJ; allowed: below 2^63")


def _span(value: object) -> None:
    if not 1 <= _natural(value) <= MAX_SPAN_NS:
        raise BadMessage("range", f"a span of {value} ns; allowed: 1 to {MAX_SPAN_NS}")


def _coordinates(value: object) -> None:
    if type(value) is not tuple:
        raise BadMessage("type", f"a {type(value).__name__} where an array of floats belongs")
    if not 1 <= len(value) <= MAX_DOF:
        raise BadMessage("dimension", f"a position of {len(value)} coordinates; allowed: 1 to {MAX_DOF}")
    for x in value:
        if type(x) is not float:
            raise BadMessage("type", f"a {type(x).__name__} where a float coordinate belongs")
        if not -MAX_COORDINATE <= x <= MAX_COORDINATE:  # false for NaN as well
            raise BadMessage("range", f"coordinate {x}; allowed: finite, within +-{MAX_COORDINATE:g}")


def _text(value: object) -> None:
    if type(value) is not str:
        raise BadMessage("type", f"a {type(value).__name__} where text belongs")
    if len(value) > MAX_TEXT or not value.isprintable():
        raise BadMessage("range", f"text of {len(value)} characters; allowed: up to {MAX_TEXT}, all printable")


def _role(value: object) -> None:
    _text(value)
    if value not in ("device", "world"):
        raise BadMessage("range", f"role {value!r}; allowed: device, world")


def _dof(value: object) -> None:
    if not 1 <= _natural(value) <= MAX_DOF:
        raise BadMessage("dimension", f"{value} degrees of freedom; allowed: 1 to {MAX_DOF}")


def _about(value: object) -> None:
    if type(value) is not dict:
        raise BadMessage("type", f"a {type(value).__name__} where a map belongs")
    if len(value) > MAX_ABOUT:
        raise BadMessage("range", f"about has {len(value)} entries; allowed: up to {MAX_ABOUT}")
    for key, entry in value.items():
        _text(key)
        if type(entry) is float:
            if not isfinite(entry):
                raise BadMessage("range", f"about has {entry}; allowed: finite numbers")
        elif type(entry) not in (int, bool, type(None)):
            _text(entry)


_IDENTITY = (_role, _dof, _text, _about)
_LAYOUTS: dict[int, tuple[Callable[..., Any], tuple[Callable[[object], object], ...]]] = {
    Position.KIND: (Position, (_natural, _natural, _coordinates)),
    Energy.KIND: (Energy, (_natural, _total, _total)),
    Hello.KIND: (Hello, (_natural, *_IDENTITY)),
    Welcome.KIND: (Welcome, (_natural, _natural, *_IDENTITY)),
    Refuse.KIND: (Refuse, (_natural, _text)),
    Bye.KIND: (Bye, (_natural, _total, _text)),
    Motion.KIND: (Motion, (_natural, _natural, _coordinates, _coordinates)),
    Port.KIND: (Port, (_natural, _natural, _coordinates, _total)),
    Wave.KIND: (Wave, (_natural, _natural, _coordinates, _span)),
}
_INDEXED = {kind: (cls, tuple(enumerate(checks, 3))) for kind, (cls, checks) in _LAYOUTS.items()}
"""The same with each check's place in the frame."""
_FIELDS: dict[type, Callable[[Any], tuple[Any, ...]]] = {
    cls: attrgetter(*(field.name for field in fields(cls))) for cls in (Hello, Welcome, Refuse, Bye)
}
_FIELDS |= dict.fromkeys((Position, Energy, Motion, Port, Wave), tuple)
_pack: Callable[..., bytes] = msgpack.packb
_unpack: Callable[..., Any] = msgpack.unpackb
