"""The messages of the protocol and their frames: `encode` and `decode` (README.md beside this file is the reference).

A frame is a msgpack array: the protocol version, the kind of message, and the fields of its class in their order. A
field's type defines what a receiver checks, and `check` does what a type cannot. The last element, a map of further
entries, may be absent; a receiver ignores unknown entries. `decode` accepts any bytes from a network: its result is
fully checked, or it raises `BadMessage`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar, Literal, get_args

import msgpack
import msgspec

from hapnet.errors import BadMessage
from hapnet.wire import fields
from hapnet.wire.fields import (
    MAX_DOF,
    U64,
    About,
    AccountMap,
    Ciphertext,
    Coordinates,
    Dof,
    Incarnation,
    More,
    Nanojoules,
    OfPositions,
    Planes,
    Role as Role,
    Scalar as Scalar,
    SignalMap,
    Span,
    Text,
)
from hapnet.wire.stream_frames import VERSION as VERSION, echo_of, encode_stream, start_of

MAX_FRAME_BYTES = 4096
MAX_ARRAY = MAX_DOF + 1  # msgpack allocates what an array announces: 4 kB of nested headers took 20 ms and 30 MB

Channel = Literal["position", "energy", "control", "signals"]


class _Message(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """KIND : its number in a frame. CHANNEL : the last part of its key. FURTHER : its known further entries.

    incarnation : the sender's.
    """

    KIND: ClassVar[int]
    CHANNEL: ClassVar[Channel]
    FURTHER: ClassVar[Any] = None
    incarnation: Incarnation

    def check(self, known: Any) -> None:
        """Check what the fields' types cannot. known : its further entries as `FURTHER`; None: it has none.

        Raises BadMessage: the fields do not fit together.
        """


class _Worded(_Message, frozen=True):
    """A message with texts."""

    def check(self, known: Any) -> None:
        fields.all_printable(*msgspec.structs.astuple(self)[:-1])


class Position(_Message, frozen=True):
    """A set-position, `position` in m (or rad), numbered and stamped with its sender's own clock. Best effort.

    echo_ns : the stamp of the addressee's message that came last.
    came_ns : when the message with that stamp came, on the sender's clock; both are 0 before there is one.

    Each kind of stream has these two stamps. With the time of arrival they give the round trip (as in NTP: RFC 5905,
    section 8). The further entry `fields.LEVEL` is the level of the sender's reservoir.
    """

    KIND = 1
    CHANNEL = "position"
    FURTHER = fields.OfPosition
    sequence: U64
    sent_ns: U64
    position: Coordinates
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: OfPositions | None = None

    vector = property(attrgetter("position"))
    level = property(fields.level_in)


class Energy(_Message, frozen=True):
    """The total energy sent to `addressee` so far, and the total credited to it, in nJ.

    `total_nJ` 0 marks an acknowledgement alone, which is never answered.
    """

    KIND = 2
    CHANNEL = "energy"
    FURTHER = fields.OfEnergy
    addressee: U64
    total_nJ: Nanojoules
    acked_nJ: Nanojoules
    more: More | None = None

    def check(self, known: Any) -> None:
        number, _, seen = known.sums if known and known.sums else (1, 0, 0)
        if max(number, seen) > fields.MAX_TOTAL_NJ:
            raise BadMessage("range", f"message {number}, which has seen {seen}; allowed: up to 2^63")


class Motion(_Message, frozen=True):
    """A position [m or rad] with its velocity [m/s or rad/s], sent in place of a `Position`."""

    KIND = 7
    CHANNEL = "position"
    sequence: U64
    sent_ns: U64
    position: Coordinates
    velocity: Coordinates
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None

    vector = property(attrgetter("position"))

    def check(self, known: Any) -> None:
        if len(self.position) != len(self.velocity):
            raise BadMessage("dimension", f"{len(self.position)} coordinates with {len(self.velocity)} velocities")


class Port(_Message, frozen=True):
    """A port's message to the other: the device's position [m] or the world's force [N], and the energy that went in.

    `energy_nJ` is the total that went into the channel at the sender's port. The peer may take it out there.
    """

    KIND = 8
    CHANNEL = "position"
    sequence: U64
    sent_ns: U64
    value: Coordinates
    energy_nJ: Nanojoules
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None

    vector = property(attrgetter("value"))


class Wave(_Message, frozen=True):
    """A wave variable [sqrt(W)]: the mean over `span_ns` of the sender's time.

    The further entry `fields.INTEGRAL` has the integral of all waves of this stream so far, this one included, and the
    sum of their spans. The difference to the last message that arrived contains the waves lost in between.
    """

    KIND = 9
    CHANNEL = "position"
    FURTHER = fields.OfWave
    sequence: U64
    sent_ns: U64
    wave: Coordinates
    span_ns: Span
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None

    vector = property(attrgetter("wave"))

    def check(self, known: Any) -> None:
        integral, _ = known.integral if known and known.integral else (self.wave, 0)
        if len(integral) != len(self.wave):
            raise BadMessage("dimension", f"an integral of {len(integral)} components; allowed: {len(self.wave)}")


class Proxy(_Message, frozen=True):
    """The world's virtual mass with the planes that it touches or is near, sent in place of a `Position`.

    aimed_ns : the time on the device's clock for which the position stands; 0: unknown.
    force : the force of the environment on the mass in the last step [N].
    planes : each is a unit normal that points into the solid, an offset along it [m], a stiffness [N/m], a damping
        [Ns/m] and a velocity along the normal [m/s]. None: this world can send no planes.

    The further entry `fields.CURVATURES` has the curvatures of the surface that each plane touches: an array of a
    direction and a curvature [1/m] each; `fields.FRICTION` has each plane's coefficient of friction. `fields.REACH` is
    the distance within which there are no other planes [m], `fields.LEVEL` is how full the world's reservoir is.
    """

    KIND = 10
    CHANNEL = "position"
    FURTHER = fields.OfProxy
    sequence: U64
    sent_ns: U64
    position: Coordinates
    aimed_ns: U64
    force: Coordinates
    planes: Planes
    echo_ns: U64 = 0
    came_ns: U64 = 0
    more: More | None = None

    vector = property(attrgetter("position"))

    def check(self, known: Any) -> None:
        fields.unit_normals(self.planes)
        vectors = self.force, *(plane[0] for plane in self.planes or ())
        if any(len(vector) != len(self.position) for vector in vectors):
            raise BadMessage("dimension", f"{len(self.position)} coordinates with a force or a normal of others")
        if known is not None:
            fields.surfaces(known, self.planes)
            fields.unfolded(known.curvatures or (), self.planes, self.position)


Stream = Position | Motion | Port | Wave | Proxy
"""A message of a side's stream; coupling and role decide which of these kinds it is. `vector` is the element
with one number per axis, whatever its name in the kind."""


@dataclass(frozen=True, slots=True)
class Identity:
    """The identity of a side: one start of a process (`incarnation`), its role and its number of degrees of freedom."""

    incarnation: int
    role: Role
    dof: int
    name: str
    about: dict[str, Scalar]


class Hello(_Worded, frozen=True):
    """A search for a peer, sent to all. `number` counts the hellos of this incarnation from 1; a welcome repeats it.

    With the further entry `fields.ANSWERS` it is addressed to the side whose hello it answers, and sealed for it.
    """

    KIND = 3
    CHANNEL = "control"
    FURTHER = fields.OfHello
    number: U64
    role: Role
    dof: Dof
    name: Text
    about: About
    more: More | None = None


class Welcome(_Worded, frozen=True):
    """The answer to hello `number` of `addressee`: proof that this sender was alive after that hello was sent."""

    KIND = 4
    CHANNEL = "control"
    FURTHER = fields.OfWelcome
    addressee: U64
    number: U64
    role: Role
    dof: Dof
    name: Text
    about: About
    more: More | None = None


class Refuse(_Worded, frozen=True):
    """`addressee` does not fit and never will, for `reason`.

    Without further entries the frame is the same in every protocol version.
    """

    KIND = 5
    CHANNEL = "control"
    addressee: U64
    reason: Text
    more: More | None = None


class Bye(_Worded, frozen=True):
    """The sender ends. `acked_nJ` is all the energy that it credited to `addressee` (0: it has no peer)."""

    KIND = 6
    CHANNEL = "control"
    addressee: U64
    acked_nJ: Nanojoules
    reason: Text
    more: More | None = None


class Signals(_Worded, frozen=True):
    """All values that the sender reports to `addressee` beside the stream, as of now; the newest frame counts."""

    KIND = 11
    CHANNEL = "signals"
    addressee: U64
    sequence: U64
    values: SignalMap
    more: More | None = None


class Account(_Worded, frozen=True):
    """The account of the sender's half of a pair with `addressee`, as a summary has it.

    number : counts this incarnation's accounts from 1. heard : the newest of the addressee's that came before the
    values were made; 0: none. asks : an answer is requested. final : the sender's control has stopped.
    """

    KIND = 12
    CHANNEL = "control"
    addressee: U64
    number: U64
    heard: U64
    asks: bool
    final: bool
    values: AccountMap
    more: More | None = None


class Encrypted(_Message, frozen=True):
    """A whole frame of the sender, encrypted. `number` is its nonce: the message's own, or from 2^63 on.

    content : the frame's bytes, encrypted, and a tag of 16 bytes that shows that it was not changed.
    """

    KIND = 13
    CHANNEL = "position"
    number: U64
    content: Ciphertext
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
    *elements, further = msgspec.structs.astuple(message)
    more = (further,) if further else ()
    if isinstance(message, _STREAM):
        values, echo = tuple(elements[3:-2]), echo_of(elements[-2], elements[-1])
        start = start_of(message.KIND, message.incarnation, len(values) + len(more))
        data = encode_stream(start, message.sequence, message.sent_ns, values, echo)
        return data + b"".join(map(_pack, more))
    return _pack((VERSION, message.KIND, *elements, *more))


def decode(data: bytes) -> Message:
    """The message in `data`.

    Raises BadMessage: `data` is not a valid message. Its `kind` is one of size, malformed, version, kind, length, type,
    range, dimension.
    """
    if len(data) > MAX_FRAME_BYTES:
        raise BadMessage("size", f"a frame of {len(data)} bytes; allowed: up to {MAX_FRAME_BYTES}")
    if (known := _QUICK.get(data[:3])) is not None:
        start, read, further = known
        try:
            message = read(start + data[3:])
        except ValueError:  # msgspec raises only this: `examined` finds what is wrong
            pass
        else:
            if bool(message.more) is further:
                message.check(None)
                return message
    try:
        frame = _unpack(data, use_list=False, max_array_len=MAX_ARRAY)
    except (ValueError, msgpack.UnpackException) as error:
        raise BadMessage("malformed", f"not a msgpack array: {type(error).__name__}") from None
    return examined(frame)


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
    make = _KINDS.get(kind)
    if make is None:
        raise BadMessage("kind", f"message kind {kind}; allowed: 1 to {max(_KINDS)}")
    names = make.__struct_fields__
    least = len(names) + 1
    if not least <= len(frame) <= least + 1:
        raise BadMessage("length", f"{make.__name__} of {len(frame)} elements; allowed: {least} to {least + 1}")
    message: Message = fields.checked(frame[2:least], make, names)
    known = None
    if len(frame) > least:
        fields.more(frame[-1])
        known = None if make.FURTHER is None else fields.checked(frame[-1], make.FURTHER)
        message = msgspec.structs.replace(message, more=frame[-1] or None)
    message.check(known)
    return message


_STREAM = (Position, Motion, Port, Wave, Proxy)
_KINDS = {cls.KIND: cls for cls in get_args(Message)}
_QUICK: dict[bytes, tuple[bytes, Callable[[bytes], Message], bool]] = {
    bytes((0x91 + n, VERSION, make.KIND)): (bytes((0x8F + n,)), msgspec.msgpack.Decoder(make).decode, further)
    for make, further in (*((make, False) for make in _KINDS.values()), (Position, True))
    for n in [len(make.__struct_fields__) + further]
}
"""The first bytes of `encode`'s frames without further entries, or with a position's level: nearly all frames, which
must reach the servo soon. Values: how the array of their fields begins, its decoder, and whether it has a level."""
_pack: Callable[..., bytes] = msgpack.packb
_unpack: Callable[..., Any] = msgpack.unpackb
