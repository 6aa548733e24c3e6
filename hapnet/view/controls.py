"""What the page may do to a running pair."""

from __future__ import annotations

from typing import Literal, Protocol

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from netem.units import split_words

Way = Literal["up", "down"]


def require_no_file(words: str) -> None:
    """A page may be open to others: no file is read for it, or what is wrong with its content would be shown there.

    Raises
    ------
    InvalidParameter, netem.NetemError : the link that these words describe is read from a file, or they are no words.
    """
    if {"trace", "csv"} & set(split_words(words)):
        raise InvalidParameter("link", words, "a link without files: those are for the command line")


class Controls(Protocol):
    """Called from the page's threads, several at once perhaps.

    `coupling`, `smoothing` and `reset` start a new episode: the processes begin anew, and for about a second there is
    no telemetry. All but `lead` may block, and may raise HapnetError or netem.NetemError: the page shows the line.
    """

    def lead(self, position: Vector) -> None:
        """Where the hand wants to be, (n,) [m]. Called some 20 times a second during a drag: returns at once."""

    def link(self, way: Way, words: str) -> None:
        """Change the emulated link of a direction; `words` are tc-netem's, "" for the ideal link."""

    def coupling(self, name: str) -> None:
        """Couple the sides with PSPM, or with another coupling."""

    def smoothing(self, seconds: float) -> None:
        """Time constant of the device's smoothing filter [s]; 0: none."""

    def pause(self, on: bool) -> None:
        """Pause both sides, or resume."""

    def reset(self) -> None:
        """Start a new pair with the same settings."""

    def record(self, on: bool) -> None:
        """Start or stop a recording."""
