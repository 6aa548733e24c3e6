"""The line of a link with a rate, which messages cross one after the other."""

from __future__ import annotations

from netem import models
from netem.profile import LinkProfile


class RateLine:
    """A line that needs a message's size divided by the profile's rate to carry it.

    profile : has a rate. free_ns : when the line is free; until then it carries earlier messages.
    """

    __slots__ = ("_profile", "_size", "_takes_ns", "free_ns")

    def __init__(self, profile: LinkProfile, free_ns: int) -> None:
        self.free_ns = free_ns
        self._profile = profile
        self._size = -1  # size of the last message: many have the same, so its time is kept
        self._takes_ns = 0

    def release_ns(self, ready_ns: int, size: int) -> int:
        """When a message of `size` bytes has crossed the line, if it is ready at `ready_ns`, behind all others."""
        if size != self._size:
            self._size, self._takes_ns = size, models.transmission_ns(size, self._profile)
        free_ns = self.free_ns
        self.free_ns = released_ns = (ready_ns if ready_ns > free_ns else free_ns) + self._takes_ns
        return released_ns
