"""Re-indexing: while the clutch is open the device moves alone, and what follows it stands still.

The coupling has the device's position less an offset, x - c. While the clutch is open there is no force, and c goes
with the device: so for the coupling it rests. Nothing need be sent, the accounts count the work of the force that is
really held, which is none, and when the clutch closes there is no jump, however far the hand went.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import sub

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter

ALLOWED = "spans of time as in 2-3, 5-6.5 [s], a button's number as in button 1, or empty"

IsOpen = Callable[[float], bool]
"""Is it open, so many seconds after control began?"""


class Clutch:
    """Of a device with n axes.

    is_open : see `IsOpen`.
    """

    def __init__(self, is_open: IsOpen, n: int) -> None:
        self._is_open = is_open
        self.open = False
        self.offset: Vector = (0.0,) * n
        """c [m]."""
        self._rest: Vector = ()  # while it is open

    def coupled(self, x: Vector) -> Vector:
        """The position that the coupling has of x [m]."""
        return tuple(map(sub, x, self.offset))

    def move(self, t: float, x: Vector, v: Vector) -> tuple[Vector, Vector]:
        """The device has come to x [m] with velocity v [m/s], `t` seconds after control began. Returns both as the
        coupling has them.

        A force is held up to the reading with which the clutch opens, so that motion still counts.
        """
        if self.open:
            self.offset = tuple(map(sub, x, self._rest))
            place = self._rest
        else:
            place = self.coupled(x)
        self.open = self._is_open(t)
        self._rest = place
        return place, (0.0,) * len(v) if self.open else v


def spans(text: str) -> list[tuple[float, float]]:
    """The spans of time in a text such as ``2-3, 5-6.5`` [s]. Raises InvalidParameter."""
    found = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            begin, end = float(first), float(last)
        except ValueError:
            raise InvalidParameter("device.clutch", text, ALLOWED) from None
        if not 0.0 <= begin < end < float("inf"):
            raise InvalidParameter("device.clutch", text, ALLOWED)
        found.append((begin, end))
    return found


def button(text: str) -> int | None:
    """The number in ``button 1``; None: the text names no button."""
    word, _, number = text.strip().partition(" ")
    return int(number) if word == "button" and number.isdecimal() else None
