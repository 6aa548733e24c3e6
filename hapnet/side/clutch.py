"""Re-indexing: while the clutch is open the device moves alone, and its follower stands still.

The coupling uses the device's position in a frame of its own. While the clutch is open there is no force, and the frame
moves with the device: for the coupling the device rests. Nothing need be sent. The accounts count the work of the force
that is really held: the motion counts until that force is zero. When the clutch closes there is no jump, however far
the hand moved.
"""

from __future__ import annotations

from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.frame import Frame

ALLOWED = "spans of time as in 2-3, 5-6.5 [s], a button's number as in button 1, or empty"

ENABLED = "auto, hold, or spans of time in which the device is held as in 0-2, 3-6.5 [s]"

IsOpen = Callable[[float], bool]
"""Returns whether the clutch is open at a time after control began [s]."""


class Clutch:
    """Converts between a device's own axes and the coupling's, and moves them while the clutch is open.

    frame : relates the two. is_open : see `IsOpen`. meets : whether the device begins at the other side's position.

    Attributes
    ----------
    open : whether the device moves alone. disengaged : whether `is_open` is the reason.
    """

    def __init__(self, frame: Frame, is_open: IsOpen = lambda t: False, *, meets: bool = False) -> None:
        self.frame = frame
        self.meets = meets
        self.open = self.disengaged = False
        self._is_open = is_open
        self._rest: Vector = ()  # while it is open

    def move(self, t: float, own: Vector, v: Vector, force: Vector, *, lets_go: bool = False) -> tuple[Vector, Vector]:
        """Take the device's position `own` [m] and velocity v [m/s], `t` seconds after control began; returns both in
        the coupling's axes.

        lets_go : open the clutch for another reason than `is_open`.
        force : the force held until now [N]. While it is not zero, the motion counts even after the clutch has
            opened: an actuator may be slow, or may not have received the command.
        """
        place = self.place(own, force)
        if self.open and not any(force):
            self.frame.meet(own, place)
        self.disengaged = self._is_open(t)
        self.open = lets_go or self.disengaged
        self._rest = place
        return place, (0.0,) * len(v) if self.open else self.frame.velocity(v)

    def place(self, own: Vector, force: Vector) -> Vector:
        """The coupling's position of a device at `own` [m], with this force [N] on it since the last tick."""
        return self._rest if self.open and not any(force) else self.frame.coupled(own)


def spans(name: str, text: str, allowed: str) -> list[tuple[float, float]]:
    """The spans of time in a text such as ``2-3, 5-6.5`` [s].

    Raises InvalidParameter: the text is not valid; the error has the parameter's `name` and what is `allowed`.
    """
    found = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            begin, end = float(first), float(last)
        except ValueError:
            raise InvalidParameter(name, text, allowed) from None
        if not begin < end < float("inf"):  # none begins with a minus
            raise InvalidParameter(name, text, allowed)
        found.append((begin, end))
    return found


def button(text: str) -> int | None:
    """The number in ``button 1``; None: the text names no button."""
    word, _, number = text.strip().partition(" ")
    return int(number) if word == "button" and number.isdecimal() else None
