"""The elements of a frame: types for the messages' fields, which msgspec checks, and checks beyond msgspec's.

`checked` returns a value of such a type, or raises BadMessage. msgpack itself bounds integers to -2^63 .. 2^64 - 1.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from math import sqrt
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from hapnet.checks import (
    MAX_DOF as MAX_DOF,
    MOST_FRICTION,
    MOST_TOOL_PLANES,
    UNIT_TOLERANCE,
    Scalar as Scalar,
    Signal as Signal,
    wrong_curvatures,
    wrong_effects,
)
from hapnet.errors import BadMessage
from hapnet.records.vectors import added

MAX_TEXT = 256
MAX_MORE = 32
MAX_COORDINATE = 1e6  # m or rad; keeps every square and product of the control layer finite
MAX_TOTAL_NJ = 2**63  # exclusive: totals fit a signed 64-bit integer
MAX_INTEGRAL = 1e12  # sqrt(W) s: differences, and their squares over a nanosecond, stay finite
KEY_BYTES = 32
ENCRYPTION_BYTES = 16
"""The bytes that encryption adds to a frame, besides the message that carries it."""

INTEGRAL = "integral"
"""The further entry of a wave: the integral of all waves of its sender's stream, and the sum of their spans in ns."""

CURVATURES = "curvatures"
"""The further entry of a proxy: the curvatures of the surfaces that its planes touch."""

EFFECTS = "effects"
"""The further entry of a proxy: the effects of each plane's surface, computed at the device's rate; nil: none."""

FRICTION = "friction"
"""The further entry of a proxy: Coulomb's mu of each of its planes."""

LEVEL: Final = "level"
"""The further entry of a position or a proxy: how full its sender's reservoir is, 0 to 1."""

REACH = "reach"
"""The further entry of a proxy: the distance [m] within which there are no planes but the proxy's."""

ENCRYPTS = "encrypts"
"""The further entry of a hello or a welcome whose sender can encrypt: whether this pair must encrypt."""

KEY = "key"
"""The further entry of a hello or a welcome: its sender's public key, of X25519."""

ANSWERS = "answers"
"""The further entry of an addressed hello: incarnation and hello number of the side that it answers."""

TAG = "tag"
"""The last further entry of a sealed frame, which ends with these 8 bytes."""

SUMS = "sums"
"""The further entry of an energy message: its number, all that its sender sent [nJ], and the highest number it saw."""

_NEVER = 2**62
_NoInteger = Annotated[int, Meta(ge=_NEVER, le=-_NEVER)]
"""Prevents integers in place of floats: msgspec would convert an integer to a float."""
_Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]  # false for NaN as well
_Real = float | _NoInteger
_Coordinate = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)] | _NoInteger
_Positive = Annotated[float, Meta(gt=0.0, le=MAX_COORDINATE)] | _NoInteger
_NotNegative = Annotated[float, Meta(ge=0.0, le=MAX_COORDINATE)] | _NoInteger

Role = Literal["device", "world"]
U64 = Annotated[int, Meta(ge=0)]
Incarnation = Annotated[int, Meta(ge=1)]
Nanojoules = Annotated[int, Meta(ge=0, le=MAX_TOTAL_NJ - 1)]
Span = Annotated[int, Meta(ge=1, le=10**10)]  # ns: every side sends far more often
Coordinates = Annotated[tuple[_Coordinate, ...], Meta(min_length=1, max_length=MAX_DOF)]
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Dof = Annotated[int, Meta(ge=1, le=MAX_DOF)]
_Plane = tuple[Coordinates, _Coordinate, _Positive, _NotNegative, _Coordinate]
Planes = Annotated[tuple[_Plane, ...], Meta(max_length=MOST_TOOL_PLANES)] | None
"""Nothing, or planes: unit normal, offset, stiffness above 0, damping and velocity."""
About = Annotated[dict[Text, Text | int | _Finite | bool | None], Meta(max_length=32)]
_Numbers = Annotated[tuple[int | _Finite | bool, ...], Meta(max_length=MAX_DOF)]
_Signal = Text | int | _Finite | bool | None | _Numbers
SignalMap = Annotated[dict[Text, _Signal], Meta(max_length=32)]
AccountMap = Annotated[dict[Text, _Signal], Meta(max_length=64)]
Ciphertext = Annotated[bytes, Meta(min_length=ENCRYPTION_BYTES + 1)]
_Friction = Annotated[float, Meta(ge=0.0, le=MOST_FRICTION)] | _NoInteger
_Grain = tuple[tuple[_Real, ...], _Real, bytes]
_Integral = Annotated[float, Meta(ge=-MAX_INTEGRAL, le=MAX_INTEGRAL)] | _NoInteger
_PublicKey = Annotated[bytes, Meta(min_length=KEY_BYTES, max_length=KEY_BYTES)]
Level = Annotated[float, Meta(ge=0.0, le=1.0)] | _NoInteger
More = dict[str, Any]
"""A frame's map of further entries, of any types: a receiver ignores entries that are unknown to it."""


if TYPE_CHECKING:
    OfPositions = More
else:
    OfPositions = dict[Literal["level"], Level]
    """The further entries of nearly every position: they are read together with its fields."""


class _Further(msgspec.Struct, frozen=True, gc=False):
    """The known further entries of a kind of message."""


class OfPosition(_Further, frozen=True):
    """The further entries of a position."""

    level: Level | UnsetType = UNSET


class OfProxy(_Further, frozen=True):
    """The further entries of a proxy. curvatures, friction, effects : one for each plane."""

    level: Level | UnsetType = UNSET
    reach: _NotNegative | UnsetType = UNSET
    curvatures: tuple[tuple[tuple[tuple[_Real, ...], _Real], ...], ...] | UnsetType = UNSET
    friction: tuple[_Friction, ...] | UnsetType = UNSET
    effects: tuple[tuple[_Real, _Real, _Real, _Real, _Grain | None] | None, ...] | UnsetType = UNSET


class OfWave(_Further, frozen=True):
    """The further entries of a wave. integral : as many numbers as the wave has, and a time [ns]."""

    integral: tuple[tuple[_Integral, ...], U64] | UnsetType = UNSET


class OfEnergy(_Further, frozen=True):
    """The further entries of an energy message. sums : its number, a total, and the number of a message or 0."""

    sums: tuple[Incarnation, Nanojoules, U64] | UnsetType = UNSET


class OfWelcome(_Further, frozen=True):
    """The further entries of a welcome."""

    key: _PublicKey | UnsetType = UNSET
    encrypts: bool | UnsetType = UNSET


class OfHello(OfWelcome, frozen=True):
    """The further entries of a hello. answers : an incarnation, and the number of one of its hellos."""

    answers: tuple[Incarnation, Incarnation] | UnsetType = UNSET


def checked(value: object, kind: Any, names: Sequence[str] = ()) -> Any:
    """Return `value` as `kind`, a type of this module or a message's class. names : its elements' names, for errors.

    Raises BadMessage: it is of another type.
    """
    try:
        return msgspec.convert(value, kind, builtin_types=_BYTES)
    except msgspec.ValidationError as error:
        raise _bad(str(error), value, names) from None


_BYTES = (bytes,)
"""The types that msgspec does not convert: it would read a text as bytes in base 64."""
_STEP = re.compile(r"\[(\d+)\]|\.(\w+)")


def _bad(error: str, value: Any, names: Sequence[str]) -> BadMessage:
    """Convert msgspec's error, such as "Expected `int` >= 0 - at `$[1]`", to a `BadMessage` that shows the
    element.
    """
    expected, at, place = error.rpartition(" - at ")
    expected, place = (expected, place) if at else (place, "")
    allowed = expected.removeprefix("Expected ").partition(", got ")[0].replace("`", "").replace("object", "map")
    where = ""
    for number, key in _STEP.findall(place.partition("[...]")[0]):
        value = value[int(number) if number else key]
        where += key or (names[int(number)] if names and not where else f"[{number}]")
    if expected.startswith("Invalid"):  # followed by a text of the peer
        kind, allowed = "range", "device, world"
    elif allowed == "int | float" or str(_NEVER) in allowed:
        kind, allowed = "type", "a float"
    elif ", got " in expected or "bytes" in allowed or allowed == "str":
        kind = "type"
    elif (where == "dof" and value >= 0) or ("array" in allowed and where not in ("planes", "values")):
        kind = "dimension"
    else:
        kind, allowed = "range", "finite numbers" if "e+308" in allowed else allowed
    shown = f" is of length {len(value)}" if "of length" in allowed else f" is {value!r:.60}"
    if "[...]" in place or "`key` in" in place:
        where, shown = f"a part of {where}", ""
    return BadMessage(kind, f"{where}{shown}; allowed: {allowed}".lstrip())


def printable(text: str) -> str:
    """Return the text as a receiver accepts it."""
    return "".join(c if c.isprintable() else " " for c in text)[:MAX_TEXT]


def all_printable(*values: object) -> None:
    """Check that the texts in checked values, also in maps, have no control characters."""
    for text in _texts(values):
        if not text.isprintable():
            raise BadMessage("range", f"text of {len(text)} characters; allowed: all printable")


def _texts(values: Iterable[object]) -> Iterator[str]:
    for value in values:
        if type(value) is str:
            yield value
        elif type(value) is dict:
            yield from _texts((*value, *value.values()))


def more(value: Any) -> None:
    """Check the map at a frame's end. An entry may be of any type: a receiver ignores unknown entries."""
    if type(value) is not dict:
        raise BadMessage("type", f"{value!r:.60}; allowed: the map of further entries")
    if len(value) > MAX_MORE:
        raise BadMessage("range", f"{len(value)} further entries; allowed: up to {MAX_MORE}")
    for key in value:
        if type(key) is not str:
            raise BadMessage("type", f"a further entry's name is {key!r:.60}; allowed: text")
        if len(key) > MAX_TEXT or not key.isprintable():
            raise BadMessage("range", f"a name of {len(key)} characters; allowed: up to {MAX_TEXT}, all printable")


def signals(value: object, kind: Any = SignalMap) -> None:
    """Check a map of names to numbers, texts, booleans, nil, or arrays of numbers."""
    if checked(value, kind) != value:
        raise BadMessage("type", "an array that is no tuple")
    all_printable(value)


def planes(value: Any) -> None:
    """Check that the value is nil, or up to eight planes with normals of length 1."""
    unit_normals(*checked((value,), tuple[Planes], ("planes",)))


def unit_normals(planes: Any) -> None:
    """Check that the normals of checked planes have length 1."""
    for normal, *_ in planes or ():
        square = added([n * n for n in normal])
        if abs(square - 1.0) > UNIT_TOLERANCE:
            raise BadMessage("range", f"a plane's normal of length {sqrt(square):g}; allowed: 1")


def surfaces(known: OfProxy, planes: Any) -> None:
    """Check the further entries about the surfaces of checked planes."""
    for name in (CURVATURES, FRICTION, EFFECTS):
        each = getattr(known, name)
        if each is not UNSET and (planes is None or len(each) != len(planes)):
            raise BadMessage("type", f"{name} {each!r:.60}; allowed: an array with one element for each plane")
    for k, (normal, *_) in enumerate(planes or ()):
        wrong = None if known.curvatures is UNSET else wrong_curvatures(known.curvatures[k], normal)
        if not wrong and known.effects is not UNSET and (effects := known.effects[k]) is not None:
            wrong = wrong_effects(effects, len(normal))
        if wrong:
            raise BadMessage("range", wrong)


def level_in(message: Any) -> float | None:
    """The level in a position's further entries; None: there is none."""
    return None if message.more is None else message.more.get(LEVEL)


def unfolded(curvatures: Any, planes: Any, position: tuple[float, ...]) -> None:
    """Check of checked curvatures that no centre lies between `position` and the surface's nearest point."""
    for (normal, offset, *_), bends in zip(planes or (), curvatures, strict=False):
        depth = added([n * x for n, x in zip(normal, position, strict=True)]) - offset
        if not all(per_m * depth < 1.0 for _, per_m in bends):
            raise BadMessage("range", f"a curvature whose centre is before the surface, {depth} m in")
