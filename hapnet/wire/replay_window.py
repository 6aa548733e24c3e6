"""Which numbers were seen already, for messages that may come late but must be used once at most."""

from __future__ import annotations

WINDOW = 1024


class ReplayWindow:
    """An anti-replay window as in RFC 6479: one bit for each of the newest `WINDOW` numbers."""

    def __init__(self) -> None:
        self._newest = -1
        self._bits = 0

    def accept(self, number: int) -> bool:
        """Take `number` in: was it not seen before? A number behind the window counts as seen."""
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
        """The peer's numbers go on from here after all (see `Numbering`); those before this one count as seen.

        While they are within the window it already says which were seen, and stays as it is.
        """
        if self._newest - number >= WINDOW:
            self._newest, self._bits = number - 1, (1 << WINDOW) - 1
