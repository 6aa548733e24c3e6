"""Which numbers were seen already: what must be used once at the most, but may come late."""

from __future__ import annotations

WINDOW = 1024


class ReplayWindow:
    """The anti-replay window of RFC 6479 and its like: a bit a number, for the newest `WINDOW` of them."""

    def __init__(self) -> None:
        self._newest = -1
        self._bits = 0

    def accept(self, number: int) -> bool:
        """Is this the first time that `number` is seen? What lies behind the window counts as seen."""
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
        """Another run of numbers is believed, which goes on with this one; what comes before it counts as seen.

        Within the window nothing needs to be forgotten, and is not.
        """
        if self._newest - number >= WINDOW:
            self._newest, self._bits = number - 1, (1 << WINDOW) - 1
