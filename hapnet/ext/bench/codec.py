"""The cost of encoding and decoding messages: a position, and an energy message with its seal."""

from __future__ import annotations

from itertools import count
from typing import Any

import msgpack

from hapnet.ext.bench.cost import Call, cost
from hapnet.ext.bench.row import Options, Row
from hapnet.wire.fields import TAG
from hapnet.wire.messages import Energy, Position, decode
from hapnet.wire.secret import TAG_BYTES, is_sealed, sealed
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
    return Row("codec_position", "us", what, subject, "msgpack.packb and unpackb of the list", bare)


def codec_energy(options: Options) -> Row:
    """Seal, encode, decode with validation and check the seal, beside msgpack with the same list."""
    totals = count()
    key, peer = bytes(range(32)), _INCARNATION - 1

    def ours() -> object:
        data = sealed(Energy(_INCARNATION, peer, next(totals), 98_765), key)
        return is_sealed(key, decode(data).more, data)

    def theirs() -> Any:
        more = {TAG: bytes(TAG_BYTES)}
        return msgpack.unpackb(msgpack.packb([2, 2, _INCARNATION, peer, next(totals), 98_765, more]))

    subject, bare = cost(Call(ours), Call(theirs), options)
    what = "encode, seal, decode and check of an energy message"
    return Row("codec_energy", "us", what, subject, "msgpack.packb and unpackb of the list", bare)
