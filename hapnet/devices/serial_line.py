"""The line protocol of the serial axis, version 1: text lines with a checksum. serial_axis.md beside it is its page.

A line is a letter and whole numbers, separated by blanks, then ``*``, the CRC-16 of all before it as four hexadecimal
digits, and a newline. What is damaged on the way is dropped; nothing is sent twice.
"""

from __future__ import annotations

from typing import NamedTuple

WRAP = 2**32
"""Times and impulses are counted modulo this, as a small processor does."""

MAX_LENGTH = 200
"""A line is never longer [bytes]."""


class State(NamedTuple):
    """``S``: what the device sends once a period."""

    time_us: int
    """The device's clock, modulo `WRAP`."""
    position_nm: int
    velocity_um_s: int
    impulse_nNs: int
    """The integral of the actuator's force since the device's start, modulo `WRAP`."""
    sequence: int
    """Of the last command that arrived whole, modulo 2^16."""
    buttons: int
    """Bit k: button k is pressed."""


class About(NamedTuple):
    """``I``: what the device is, sent when it is asked."""

    version: int
    rate_hz: int
    limit_mN: int
    continuous_mN: int
    """0: not declared."""
    resolution_nm: int
    reach_um: int
    """How far the handle goes from its centre, either way."""
    watchdog_ms: int
    homed: int
    """1: the position is counted from the centre of the axis."""
    buttons: int
    """How many it has."""
    dead_man: int
    """The number of the button that must be held; -1: none."""


class Command(NamedTuple):
    """``F``: the force to hold from now on."""

    sequence: int
    force_uN: int


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF): it finds any damage of up to 16 bits in a row."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[(crc >> 8) ^ byte]
    return crc


def _table() -> tuple[int, ...]:
    table = []
    for top in range(256):
        crc = top << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_TABLE = _table()


def line(letter: str, *numbers: int) -> bytes:
    """The line with its checksum and newline."""
    body = " ".join([letter, *map(str, numbers)]).encode("ascii")
    return b"%b*%04X\n" % (body, crc16(body))


def parse(raw: bytes) -> tuple[str, tuple[int, ...]] | None:
    """The letter and the numbers of a line without its newline; None if it is damaged."""
    body, star, check = raw.rstrip(b"\r").rpartition(b"*")
    if not star or len(check) != 4 or len(raw) > MAX_LENGTH:
        return None
    try:
        if int(check, 16) != crc16(body):
            return None
        letter, *words = body.decode("ascii").split(" ")
        return letter, tuple(map(int, words))
    except ValueError:
        return None


def state(raw: bytes) -> State | None:
    """The state in a line; None if it is damaged or another line."""
    found = parse(raw)
    return State(*found[1]) if found and found[0] == "S" and len(found[1]) == len(State._fields) else None


def about(raw: bytes) -> About | None:
    """The description in a line; None if it is damaged or another line."""
    found = parse(raw)
    return About(*found[1]) if found and found[0] == "I" and len(found[1]) == len(About._fields) else None


def command(raw: bytes) -> Command | None:
    """The command in a line; None if it is damaged or another line."""
    found = parse(raw)
    return Command(*found[1]) if found and found[0] == "F" and len(found[1]) == len(Command._fields) else None


def signed(difference: int) -> int:
    """A difference of two numbers that wrap, between -2^31 and 2^31."""
    return (difference + WRAP // 2) % WRAP - WRAP // 2
