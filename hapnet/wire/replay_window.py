"""Which numbers were seen already, for messages that may come late but must be used at most once."""

from __future__ import annotations

WINDOW = 1024


class ReplayWindow:
    """An anti-replay window as in RFC 6479: one bit for each of the newest `WINDOW` numbers."""

    def __init__(self) -> None:
        self._newest = -1
        self._bits = 0

    def accept(self, number: int) -> bool:
        """Mark `number` as seen; True if it was not seen before. A number behind the window counts as seen."""
        if number > self._newest:
            ahead = min(number - self._newest, WINDOW)
            self._bits = (self._bits << ahead | 1) & ((1 << WINDOW) - 1)
            self._newest = number
            return True
        behind = self._newest - number
        if behind >= WINDOW or self._bits >> behind & 1:
            return False
        self._bits |= 1 << behind
        return True

    def restart(self, number: int) -> None:
        """The peer's numbers continue from here after all (see `Numbering`); those before this one count as seen.

        If this number is within the window, nothing changes: the window says which numbers were seen.
        """
        if self._newest - number >= WINDOW:
            self._newest, self._bits = number - 1, (1 << WINDOW) - 1
