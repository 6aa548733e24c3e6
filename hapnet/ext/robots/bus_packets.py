"""The packets of two makers' servo buses, as bytes: Robotis' Dynamixel protocol 2.0, and Feetech's.

Sources: e-manual, docs/en/dxl/protocol2 (header, length, byte stuffing, CRC-16 of polynomial 0x8005 from 0, status
packets); Feetech's communication manual and its SDK (header, checksum). A damaged packet is dropped.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import ClassVar, NamedTuple

PING, READ, WRITE, REBOOT, STATUS, SYNC_READ, SYNC_WRITE, BULK_READ = 0x01, 0x02, 0x03, 0x08, 0x55, 0x82, 0x83, 0x92
ALL = 0xFE
"""The address of all servos on the bus."""

_LONGEST = 128


class BusPacket(NamedTuple):
    """An instruction to the servo `servo`, or its status."""

    servo: int
    code: int
    """The instruction; in a status of Feetech, its error."""
    data: bytes


class Reply(NamedTuple):
    """The answer of a servo. error : 0, or as on the maker's pages."""

    error: int
    data: bytes


class Packets(ABC):
    """Encodes the packets of one maker, and finds them in a stream of bytes with losses and damage."""

    header: ClassVar[bytes]
    smallest: ClassVar[int]
    """Bytes of an instruction without data."""
    status_bytes: ClassVar[int]
    """Bytes of a status without data."""
    place: ClassVar[Struct]
    """The format of an address and a size."""

    def __init__(self) -> None:
        self._unread = b""
        self.damaged: int = 0
        """The number of bytes so far that belonged to no complete packet."""

    @abstractmethod
    def packet(self, servo: int, code: int, data: bytes = b"") -> bytes:
        """The bytes of a packet."""

    @abstractmethod
    def status(self, servo: int, reply: Reply) -> bytes:
        """The bytes of a servo's status."""

    @abstractmethod
    def reply(self, packet: BusPacket) -> Reply | None:
        """The answer in a packet; None: the packet is no answer."""

    @abstractmethod
    def _length(self, data: bytes) -> int:
        """The length of the packet that begins with these bytes (at least `smallest` of them); 0: no packet does."""

    @abstractmethod
    def _whole(self, data: bytes) -> BusPacket | None:
        """Decode the bytes of a packet; None: it is damaged."""

    def read(self, servo: int, address: int, size: int) -> bytes:
        """A request to one servo for `size` bytes of its table."""
        return self.packet(servo, READ, self.place.pack(address, size))

    def write(self, servo: int, address: int, data: bytes) -> bytes:
        """An instruction that writes into a servo's table."""
        return self.packet(servo, WRITE, self._at(address) + data)

    def sync_read(self, address: int, size: int, servos: Sequence[int]) -> bytes:
        """A request to several servos, which answer in this order."""
        return self.packet(ALL, SYNC_READ, self.place.pack(address, size) + bytes(servos))

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> bytes:
        """An instruction that writes at one address of several servos, different bytes to each; they do not answer."""
        size = len(next(iter(values.values())))
        each = b"".join(bytes((servo,)) + value for servo, value in values.items())
        return self.packet(ALL, SYNC_WRITE, self.place.pack(address, size) + each)

    def feed(self, came: bytes) -> list[BusPacket]:
        """Take new bytes; returns the packets that they complete."""
        data, found = self._unread + came, []
        while (begin := data.find(self.header)) >= 0 and len(data) - begin >= self.smallest:
            self.damaged += begin
            data = data[begin:]
            length = self._length(data)
            if length > len(data):
                break
            packet = self._whole(data[:length]) if length else None
            if packet is None:
                self.damaged += 1
            else:
                found.append(packet)
            data = data[1 if packet is None else length :]
        self._unread = data[-_LONGEST:]
        return found

    def forget(self) -> None:
        """Drop the bytes of an incomplete packet."""
        self._unread = b""

    def _at(self, address: int) -> bytes:
        return self.place.pack(address, 0)[: self.place.size // 2]


def _table() -> tuple[int, ...]:
    found = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x18005 if value & 0x8000 else 0)
        found.append(value & 0xFFFF)
    return tuple(found)


_CRC = _table()


def crc(data: bytes) -> int:
    """CRC-16 of polynomial 0x8005 from 0, high bit first."""
    value, table = 0, _CRC
    for byte in data:
        value = (value << 8) & 0xFFFF ^ table[value >> 8 ^ byte]
    return value


class Dynamixel2(Packets):
    """Protocol 2.0: ``FF FF FD 00``, servo, length (2), instruction, data, CRC (2); in a status the error first."""

    header = b"\xff\xff\xfd\x00"
    smallest = 10
    status_bytes = 11
    place = Struct("<HH")

    def packet(self, servo: int, code: int, data: bytes = b"") -> bytes:
        body = (bytes((code,)) + data).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        whole = self.header + bytes((servo,)) + (len(body) + 2).to_bytes(2, "little") + body
        return whole + crc(whole).to_bytes(2, "little")

    def status(self, servo: int, reply: Reply) -> bytes:
        return self.packet(servo, STATUS, bytes((reply.error,)) + reply.data)

    def reply(self, packet: BusPacket) -> Reply | None:
        return Reply(packet.data[0], packet.data[1:]) if packet.code == STATUS and packet.data else None

    def _length(self, data: bytes) -> int:
        length = 7 + data[5] + (data[6] << 8)
        return length if self.smallest <= length <= _LONGEST else 0

    def _whole(self, data: bytes) -> BusPacket | None:
        if crc(data[:-2]) != data[-2] + (data[-1] << 8):
            return None
        body = data[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return BusPacket(data[4], body[0], body[1:])


class FeetechPackets(Packets):
    """``FF FF``, servo, length, instruction (or error), data, and the complement of their sum."""

    header = b"\xff\xff"
    smallest = status_bytes = 6
    place = Struct("<BB")

    def packet(self, servo: int, code: int, data: bytes = b"") -> bytes:
        body = bytes((servo, len(data) + 2, code)) + data
        return self.header + body + bytes((~sum(body) & 0xFF,))

    def status(self, servo: int, reply: Reply) -> bytes:
        return self.packet(servo, reply.error, reply.data)

    def reply(self, packet: BusPacket) -> Reply | None:
        return Reply(packet.code, packet.data)

    def _length(self, data: bytes) -> int:
        return 4 + data[3] if data[2] != 0xFF and data[3] >= 2 else 0

    def _whole(self, data: bytes) -> BusPacket | None:
        return BusPacket(data[2], data[4], data[5:-1]) if ~sum(data[2:-1]) & 0xFF == data[-1] else None
