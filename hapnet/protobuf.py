"""Protocol buffers as far as recordings need them: descriptors, small messages, and long ones made of doubles only.

A message whose fields are all doubles always has the same length, so one `struct` call makes or takes apart the whole
of it, exactly and in a microsecond. Format: "Encoding" of the Protocol Buffers documentation, `descriptor.proto`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

DOUBLE, INT64, INT32, FIXED32, STRING, MESSAGE, ENUM = 1, 3, 5, 7, 9, 11, 14
"""Types of a field, in `descriptor.proto`'s numbers."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_OPTIONAL = 1


class Doubles:
    """A message of doubles, its fields numbered from 1 in the order of `names`."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        tags = [_varint(number << 3 | _FIXED64) for number in range(1, len(names) + 1)]
        self._struct = struct.Struct("<" + "".join(f"{len(tag)}sd" for tag in tags))
        self._tags = tags
        self._frame: list[bytes | float] = list(chain.from_iterable((tag, 0.0) for tag in tags))

    def pack(self, values: Sequence[float]) -> bytes:
        """The message; ValueError if there are not as many values as names."""
        frame = self._frame
        frame[1::2] = values
        return self._struct.pack(*frame)

    def unpack(self, data: bytes) -> tuple[float, ...]:
        """The values of a message that `pack` made; ValueError if it is none."""
        if len(data) == self._struct.size:
            frame = self._struct.unpack(data)
            if list(frame[::2]) == self._tags:
                return frame[1::2]
        raise ValueError(f"a message of {len(data)} bytes instead of {len(self.names)} doubles")

    def describe(self, package: str, name: str) -> bytes:
        """The descriptor set of a file with this message only."""
        message = describe_message(name, [(field, DOUBLE, "") for field in self.names])
        return descriptor_set(describe_file(f"{package}/{name}.proto", package, [message]))

    @classmethod
    def described(cls, descriptor: bytes) -> Doubles:
        """The message that `describe` made this of; ValueError if it is no such descriptor."""
        found: bytes = descriptor
        for number in (1, 4):  # the file, its message
            [found] = [content for at, content in fields(found) if at == number and isinstance(content, bytes)]
        entries = [dict(fields(content)) for at, content in fields(found) if at == 2 and isinstance(content, bytes)]
        names = [name.decode() for entry in entries if isinstance(name := entry.get(1), bytes)]
        kinds = {(entry.get(3, 0), entry.get(5, 0)) for entry in entries}
        if kinds != {(number, DOUBLE) for number in range(1, len(names) + 1)}:
            raise ValueError("a schema that is not of doubles only")
        return cls(names)


def field(number: int, value: int | str | bytes) -> bytes:
    """One field of a message: a whole number of 0 or above, a text, or a message."""
    if isinstance(value, int):
        return _varint(number << 3 | _VARINT) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | _BYTES) + _varint(len(data)) + data


def fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and content of each field: what is of fixed length as its bytes. ValueError if `data` is cut short."""
    at = 0
    while at < len(data):
        tag, at = _read_varint(data, at)
        number, kind = divmod(tag, 8)
        if kind == _VARINT:
            value, at = _read_varint(data, at)
            yield number, value
            continue
        if kind == _BYTES:
            length, at = _read_varint(data, at)
        elif kind in (_FIXED64, _FIXED32):
            length = 8 if kind == _FIXED64 else 4
        else:
            raise ValueError(f"a message with a field of the wire type {kind}")
        if at + length > len(data):
            raise ValueError("a message that is cut short")
        yield number, data[at : at + length]
        at += length


def describe_message(
    name: str, content: Iterable[tuple[str, int, str]], enums: Mapping[str, Sequence[str]] | None = None
) -> bytes:
    """Descriptor of a message: (name, type, name of the message or enum if it is one) of its fields, from number 1."""
    parts = [field(1, name)]
    for number, (label, kind, of) in enumerate(content, 1):
        entry = field(1, label) + field(3, number) + field(4, _OPTIONAL) + field(5, kind)
        parts.append(field(2, entry + (field(6, of) if of else b"")))
    for enum, values in (enums or {}).items():
        entries = [field(2, field(1, value) + field(2, number)) for number, value in enumerate(values)]
        parts.append(field(4, field(1, enum) + b"".join(entries)))
    return b"".join(parts)


def describe_file(name: str, package: str, messages: Iterable[bytes], imported: Iterable[str] = ()) -> bytes:
    """Descriptor of a .proto file."""
    parts = [field(1, name), field(2, package), *(field(3, file) for file in imported)]
    return b"".join([*parts, *(field(4, message) for message in messages), field(12, "proto3")])


def descriptor_set(*files: bytes) -> bytes:
    """A `FileDescriptorSet`; files come after those that they import."""
    return b"".join(field(1, file) for file in files)


def _varint(value: int) -> bytes:
    result = bytearray()
    while value > 0x7F:
        result.append(value & 0x7F | 0x80)
        value >>= 7
    result.append(value)
    return bytes(result)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """The number at `at`, and where it ends."""
    value = 0
    for shift in range(0, 64, 7):
        if at >= len(data):
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a message that is cut short")
