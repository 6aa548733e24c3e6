"""Record which numbers were seen, so that a copy of a message is not counted, and a wave is used at most once."""

from __future__ import annotations

from typing import Annotated

from hapnet.records.record import Record, Wholes, equation
from hapnet.wire.numbering import SEEN

WINDOW = 1024


class ReplayWindow(Record):
    """An anti-replay window as in RFC 6479, over the newest `WINDOW` numbers.

    Attributes
    ----------
    newest : the highest number that was seen. first : all numbers before it count as seen. seen : the last number seen
        in each place modulo `WINDOW`; -1: none.
    """

    newest: int
    first: int
    seen: Annotated[Wholes, (WINDOW,)]

    def __init__(self) -> None:
        super().__init__()
        self.newest = -1
        self.seen = [-1] * WINDOW

    @equation
    def accept(self, number: int) -> bool:
        """Mark `number` as seen; True if it was not seen before. A number behind the window counts as seen."""
        place = number % WINDOW
        behind = number <= self.newest
        if behind and (number < self.first or self.newest - number >= WINDOW or self.seen[place] == number):
            return False
        self.newest = max(self.newest, number)
        self.seen[place] = number
        return True

    @equation
    def restart(self, number: int) -> None:
        """Let the peer's numbers continue from `number` (see `Numbering`); all lower numbers count as seen.

        If `number` is within the window, nothing changes: the window has the numbers that were seen.
        """
        if self.newest - number >= WINDOW:
            self.newest, self.first = number - 1, number
            for k in range(WINDOW):
                self.seen[k] = -1


accept, restart = ReplayWindow.accept, ReplayWindow.restart
"""These methods as functions, for calls from equations."""


def stale_detail(name: str, number: int, place: int) -> str:
    """Return why a message in this place is not used."""
    if place == SEEN:
        return f"{name} {number} came before, or comes long after later ones"
    return f"{name} {number} comes after a later one"
