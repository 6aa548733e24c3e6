"""The frames of the serial axis, version 2. Its page is serial_axis.md; examples/serial_axis is the board's end.

A frame begins with a letter, which determines its kind and length, and ends in a CRC-16, high byte first: so the CRC of
a complete frame is 0. All other numbers are little-endian. A damaged frame is dropped; nothing is sent twice.
"""

from __future__ import annotations

import statistics
from binascii import crc_hqx
from collections.abc import Sequence
from itertools import pairwise
from struct import Struct
from typing import NamedTuple

VERSION = 2
WRAP = 2**32
"""The modulus of times and impulses, for small processors."""

FULL = 32767
"""The number of a force equal to the maximum."""

IMPULSE_US = 256
"""The unit of an impulse: so many microseconds times the unit of forces."""

OLDEST_US = 0xFFFF
"""The greatest age of a position in a state [us]; it stands for older ones, too."""

_STATE, _ABOUT, _COMMAND = Struct("<cBHIiHI"), Struct("<cBHHHIIIIIBb"), Struct("<cHh")
_SIZE = {ord(b"S"): _STATE.size + 2, ord(b"A"): _ABOUT.size + 2}
COMMAND_SIZE = _COMMAND.size + 2
_START = 0xFFFF
_BUTTONS, _HOMED, _UP, _DOWN = 0x0F, 0x10, 0x20, 0x40


class BoardState(NamedTuple):
    """The message that the board sends once a period."""

    flags: int
    command: int
    """Number of the last command that arrived complete, modulo 2^16."""
    time_us: int
    """The board's clock, modulo `WRAP`."""
    position_nm: int
    age_us: int
    """The age of the position [us], counted or sampled; `OLDEST_US`: at least so old."""
    impulse: int
    """The integral of the actuator's force since the board's start, modulo `WRAP`."""

    @property
    def homed(self) -> bool:
        """Whether the position is counted from the centre of the axis."""
        return bool(self.flags & _HOMED)

    @property
    def buttons(self) -> int:
        """The buttons as bits: bit k is set if button k is pressed."""
        return self.flags & _BUTTONS

    @property
    def counted(self) -> int:
        """The direction of the encoder's last count: 1 up, -1 down; 0: the position was sampled."""
        return bool(self.flags & _UP) - bool(self.flags & _DOWN)


class About(NamedTuple):
    """The board's description, sent on request."""

    version: int
    period_us: int
    """The period of its states, as promised by its sketch."""
    made_us: int
    """The period of its states, as measured by the board; 0: not known yet."""
    watchdog_ms: int
    limit_uN: int
    continuous_uN: int
    """The continuous force; 0: not known."""
    count_nm: int
    noise_nm: int
    """The peak-to-peak noise of the positions at their times."""
    reach_um: int
    """The reach of the handle from its centre, in both directions."""
    buttons: int
    """The number of buttons."""
    dead_man: int
    """The number of the button that must be held; -1: none."""


class BoardCommand(NamedTuple):
    """A command to the board: ``F`` a force, ``Q`` a request for its description, ``H`` the handle is at its centre."""

    mark: bytes
    number: int = 0
    force: int = 0
    """The force, in units of the maximum over `FULL`."""


def state(found: BoardState) -> bytes:
    """The frame of a state."""
    return _whole(_STATE.pack(b"S", *found))


def about(found: About) -> bytes:
    """The frame of a description."""
    return _whole(_ABOUT.pack(b"A", *found))


def command(found: BoardCommand) -> bytes:
    """The frame of a command."""
    return _whole(_COMMAND.pack(*found))


def flags(buttons: int, *, homed: bool, counted: int = 0) -> int:
    """The flags of a state."""
    return buttons & _BUTTONS | (_HOMED if homed else 0) | (_UP if counted > 0 else _DOWN if counted < 0 else 0)


def _whole(body: bytes) -> bytes:
    return body + crc_hqx(body, _START).to_bytes(2, "big")


class FrameParser:
    """Finds the frames of a board in a stream of bytes with losses, damage and other bytes."""

    def __init__(self) -> None:
        self._unread = b""
        self.damaged: int = 0
        """The number of bytes that belonged to no complete frame."""

    def feed(self, came: bytes) -> list[BoardState | About]:
        """Take new bytes; returns the frames that they complete."""
        data = self._unread + came
        found: list[BoardState | About] = []
        at = 0
        while at < len(data):
            size = _SIZE.get(data[at], 0)
            if size > len(data) - at:
                break
            frame = data[at : at + size]
            if size == 0 or crc_hqx(frame, _START):
                self.damaged += 1
                at += 1
            elif data[at] == _STATE_MARK:
                found.append(BoardState._make(_STATE.unpack_from(frame)[1:]))
                at += size
            else:
                found.append(About._make(_ABOUT.unpack_from(frame)[1:]))
                at += size
        self._unread = data[at:]
        return found


_STATE_MARK = ord(b"S")


def commands(unread: bytes) -> tuple[list[BoardCommand], bytes]:
    """The complete commands in the bytes that a board received, and the bytes left for later."""
    found = []
    while len(unread) >= COMMAND_SIZE:
        if crc_hqx(unread[:COMMAND_SIZE], _START):
            unread = unread[1:]
        else:
            found.append(BoardCommand(*_COMMAND.unpack_from(unread)))
            unread = unread[COMMAND_SIZE:]
    return found, unread


def signed(difference: int) -> int:
    """A difference of two numbers that wrap, between -2^31 and 2^31."""
    return (difference + WRAP // 2) % WRAP - WRAP // 2


_LEAST = 8
"""The number of states that suffice for a result."""

_LATE_PERIODS = 2.5
"""States count as coming in bursts if their median distance is above this number of periods."""

_CLOCK = 0.1
"""The greatest relative difference of the board's clock from this machine's, as states may be delayed."""

MICRO = 1e-6


class Untimely(Exception):
    """The states do not arrive in time; the text describes how. bursts : whether they come in bursts."""

    def __init__(self, text: str, bursts: bool = False) -> None:
        super().__init__(text)
        self.bursts: bool = bursts


def period_us(arrivals: Sequence[tuple[float, Sequence[int]]]) -> float:
    """The period of the board's states [us]: the first quartile of their distances, as some may be lost.

    arrivals : times by this machine's clock [s], each with the times of its states by the board's clock [us].

    Raises Untimely: too few states, the board's clock is wrong, or the states come in bursts.
    """
    times_us = [time_us for _, together in arrivals for time_us in together]
    if len(times_us) < _LEAST:
        raise Untimely(f"only {len(times_us)} states came")
    took_s = arrivals[-1][0] - arrivals[0][0]
    clock = (arrivals[-1][1][-1] - arrivals[0][1][-1]) % WRAP * MICRO / took_s if took_s > 0.0 else 0.0
    if abs(clock - 1.0) > _CLOCK:
        raise Untimely(f"the board's clock goes {clock:.2g} times as fast as it should: does a PWM use its timer?")
    made_us = statistics.quantiles([(b - a) % WRAP for a, b in pairwise(times_us)])[0]
    apart_us = statistics.median(b - a for (a, _), (b, _) in pairwise(arrivals)) / MICRO
    if apart_us > _LATE_PERIODS * made_us:
        together = f"one each {made_us * 1e-3:.2g} ms, but arrive {apart_us * 1e-3:.2g} ms apart, several together"
        raise Untimely(f"the board makes {together}", bursts=True)
    return made_us
