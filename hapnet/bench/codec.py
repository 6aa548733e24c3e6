"""What a position message costs to encode and decode."""

from __future__ import annotations

from itertools import count
from typing import Any

import msgpack

from hapnet.bench.cost import Call, cost
from hapnet.bench.row import Options, Row, row
from hapnet.wire.messages import Position, decode
from hapnet.wire.stream_frames import echo_of, encode_position, start_of

_INCARNATION = 2**63 - 25
_ECHO = (123_450_000_000, 123_451_000_000)
_POSITION = (0.0123, -0.0045, 0.0307)


def codec_position(options: Options) -> Row:
    """Encode and decode with validation, beside msgpack with the same list and no validation."""
    numbers = count()
    start, echo = start_of(Position.KIND, _INCARNATION, 1), echo_of(*_ECHO)

    def ours() -> object:
        return decode(encode_position(start, next(numbers), 123_456_789_012, _POSITION, echo))

    def theirs() -> Any:
        return msgpack.unpackb(msgpack.packb([2, 1, _INCARNATION, next(numbers), 123_456_789_012, _POSITION, *_ECHO]))

    subject, bare = cost(Call(ours), Call(theirs), options)
    what = "encode and decode of a 3-DOF position, validated"
    return row("codec_position", "us", what, subject, "msgpack.packb and unpackb of the list", bare)
