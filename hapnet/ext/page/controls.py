"""The settings that the page may change in a running pair."""

from __future__ import annotations

from typing import Literal, Protocol

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from netem.units import split_words

Direction = Literal["up", "down"]


def require_no_file(text: str) -> None:
    """Refuse a link that is read from a file: others may see the page, and its errors would show the file's content.

    Raises InvalidParameter, netem.NetemError: the text names a file, or does not describe a link.
    """
    if {"trace", "csv"} & set(split_words(text)):
        raise InvalidParameter("link", text, "", why="the page reads no files; give the file on the command line")


class Controls(Protocol):
    """The page's threads call these methods, perhaps several at once.

    `coupling`, `scene`, `mesh`, `smoothing` and `reset` start a new episode: the force goes to zero, the processes
    restart at the hand's place (another world at its own start), with a new energy account, and for about a second
    there is no telemetry. All methods but `lead` and `let_go` may block, and may raise HapnetError or
    netem.NetemError, whose line the page shows.

    fixed : the reason why only `lead`, the link from the device and `pause` work here. Empty: all methods work.
    """

    fixed: str

    def lead(self, position: Vector) -> None:
        """Lead the hand to `position`, (n,) [m]. Returns at once: a drag calls it some 20 times a second."""

    def let_go(self, why: str) -> None:
        """Stop leading the hand, for this reason; empty: start again. Returns at once."""

    def link(self, direction: Direction, text: str) -> None:
        """Change the emulated link of one direction; `text` is in tc-netem's syntax, "" for the ideal link."""

    def coupling(self, name: str, rendering: str) -> None:
        """Couple the sides with this coupling and rendering."""

    def scene(self, label: str) -> None:
        """Change to another world: one of `hapnet.ext.page.choices.SCENES`, or the run's own."""

    def mesh(self, name: str, content: bytes) -> None:
        """Change to a world with this mesh, from a file with this name, in millimetres."""

    def smoothing(self, seconds: float) -> None:
        """Set the time constant of the device's smoothing filter [s]; 0: no filter."""

    def pause(self, on: bool) -> None:
        """Pause both sides, or resume."""

    def reset(self) -> None:
        """Start a new pair with the same settings."""

    def record(self, on: bool) -> None:
        """Start or stop a recording."""
