"""The frames of a stream's messages, assembled from parts: the servo makes hundreds of them in a second."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Any

import msgpack

from hapnet.wire.fields import LEVEL

VERSION = 2

_AROUND = 7
"""The number of elements in a stream's message besides its values."""
_ARRAY, _U64 = 0x90, 0xCF
"""msgpack's first bytes of an array of up to 15 elements, and of an integer of 8 bytes."""
_START, _TWO = Struct(">BBBBQ").pack, Struct(">BQBQ").pack
_LEVEL: bytes = msgpack.packb({LEVEL: 0.0})[:-8]
_FLOAT = Struct(">d").pack
_NUMBER, _AT = Struct(">Q").unpack_from, Struct(">BBBBQB").size
"""Reads a number, and the offset of a message's number."""
_STAMP, _STAMPED = Struct(">Q").pack, _AT + 9
"""Writes a stamp, and the offset of a message's stamp."""


def encode_stream(
    start: bytes,
    sequence: int,
    sent_ns: int,
    values: tuple[Any, ...],
    echo: bytes,
    pack: Callable[..., bytes] = msgpack.packb,
) -> bytes:
    """`encode` for a message of a stream, from its parts.

    Integers take nine bytes even if they are small, as msgpack allows. So the length of a position depends on its
    dimension only, and its delay on a link with a rate does not depend on the clock.

    start : made by `start_of`, once. values : the elements between `sent_ns` and `echo_ns`.
    echo : made by `echo_of`, once for all messages with the same echo.
    pack : the method of a `msgpack.Packer` that the calling thread keeps, which is faster than a new one each time.
    """
    return start + _TWO(_U64, sequence, _U64, sent_ns) + b"".join(map(pack, values)) + echo


def encode_position(
    start: bytes,
    sequence: int,
    sent_ns: int,
    position: tuple[float, ...],
    echo: bytes,
    pack: Callable[..., bytes] = msgpack.packb,
) -> bytes:
    """`encode_stream` for a `Position`, which a servo sends at every update."""
    return start + _TWO(_U64, sequence, _U64, sent_ns) + pack(position) + echo


def start_of(kind: int, incarnation: int, values: int) -> bytes:
    """The first bytes of a stream's messages; `values` is the number of elements between `sent_ns` and `echo_ns`."""
    return _START(_ARRAY + _AROUND + values, VERSION, kind, _U64, incarnation)


def echo_of(echo_ns: int, came_ns: int) -> bytes:
    """The two stamps of the echo, as `encode_stream` takes them."""
    return _TWO(_U64, echo_ns, _U64, came_ns)


def sequence_of(frame: bytes) -> int | None:
    """The number of a stream's message made by `encode_stream`; None: the frame is too short."""
    number: tuple[int] | None = _NUMBER(frame, _AT) if len(frame) >= _AT + 8 else None
    return None if number is None else number[0]


def stamped(frame: bytes, sent_ns: int) -> bytes:
    """The stream's message with another stamp, as it is sent later than it was made."""
    return frame[:_STAMPED] + _STAMP(sent_ns) + frame[_STAMPED + 8 :]


def level_of(level: float) -> bytes:
    """The map of further entries that holds a level and nothing else."""
    return _LEVEL + _FLOAT(level)
