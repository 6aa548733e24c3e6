"""The line of a link with a rate: one message after the other crosses it."""

from __future__ import annotations

from netem import models
from netem.profile import LinkProfile


class RateLine:
    """A line that takes a message's size over the profile's rate to carry it.

    profile : with a rate. free_ns : when the line is free; until then it carries others.
    """

    __slots__ = ("_profile", "_size", "_takes_ns", "free_ns")

    def __init__(self, profile: LinkProfile, free_ns: int) -> None:
        self.free_ns = free_ns
        self._profile = profile
        self._size = -1  # the last one that was timed, as many messages are alike
        self._takes_ns = 0

    def release_ns(self, ready_ns: int, size: int) -> int:
        """When a message of `size` bytes has crossed that is ready, behind all others, at `ready_ns`."""
        if size != self._size:
            self._size, self._takes_ns = size, models.transmission_ns(size, self._profile)
        free_ns = self.free_ns
        self.free_ns = released_ns = (ready_ns if ready_ns > free_ns else free_ns) + self._takes_ns
        return released_ns
