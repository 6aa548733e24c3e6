"""Messages of doubles and their descriptors: inverses of one another, and read by Google's implementation."""

from __future__ import annotations

import math
import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapnet import protobuf
from hapnet.mcap_file import _LOG
from hapnet.protobuf import Doubles

NAMES = [f"force_{i}_N" for i in range(40)]  # numbers above 15 have tags of two bytes


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=40))
def test_what_is_packed_is_unpacked_and_described(values: list[float]) -> None:
    message = Doubles(NAMES[: len(values)])
    data = message.pack(values)
    assert message.unpack(data) == tuple(values)
    again = Doubles.described(message.describe("hapnet", "Sample"))
    assert again.names == message.names
    assert again.unpack(data) == tuple(values)


def test_the_wire_format_is_that_of_the_documentation() -> None:
    """Tag: number * 8 + 1 as a base-128 varint, low bits first; then the double, little-endian."""
    data = Doubles(NAMES[:16]).pack([1.5] * 16)
    assert data[:9] == b"\x09" + struct.pack("<d", 1.5)
    assert data[-10:] == b"\x81\x01" + struct.pack("<d", 1.5)
    assert protobuf.field(1, 150) == b"\x08\x96\x01"
    assert protobuf.field(2, "testing") == b"\x12\x07testing"
    assert list(protobuf.fields(b"\x08\x96\x01\x12\x07testing\x1d\x01\x00\x00\x00")) == [
        (1, 150),
        (2, b"testing"),
        (3, b"\x01\x00\x00\x00"),
    ]


def test_what_is_no_such_message_is_refused() -> None:
    message = Doubles(NAMES[:2])
    for data in (b"", message.pack([1.0, 2.0])[:-1], b"\x11" + message.pack([1.0, 2.0])[1:]):
        with pytest.raises(ValueError, match="instead of 2 doubles"):
            message.unpack(data)
    with pytest.raises(ValueError, match=r"size 1"):
        message.pack([1.0])
    for data in (b"\x08", b"\x08\xff", b"\x12\x05abc", b"\x09abc", b"\x0b", b"\xff" * 11):
        with pytest.raises(ValueError, match="a message"):
            list(protobuf.fields(data))
    for descriptor in (b"", b"\x0a\x00", _LOG, b"\xff\xff"):
        with pytest.raises(ValueError, match=r"."):
            Doubles.described(descriptor)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with suppress(ValueError):
        assert all(number >= 0 for number, _ in protobuf.fields(data))
    with suppress(ValueError):
        Doubles.described(data)


def test_googles_implementation_reads_it() -> None:
    pytest.importorskip("google.protobuf", reason="protobuf is not installed")
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    message = Doubles(NAMES)
    values = [math.pi * i for i in range(len(NAMES))]
    for descriptor in (message.describe("hapnet", "Sample"), _LOG):
        files = descriptor_pb2.FileDescriptorSet.FromString(descriptor)
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        if descriptor is _LOG:
            decode = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.Log"))
            line = decode.FromString(protobuf.field(1, protobuf.field(1, 5)) + protobuf.field(2, 3))
            assert (line.timestamp.seconds, decode.Level.Name(line.level)) == (5, "WARNING")
        else:
            decode = message_factory.GetMessageClass(pool.FindMessageTypeByName("hapnet.Sample"))
            line = decode.FromString(message.pack(values))
            assert [getattr(line, name) for name in NAMES] == values
