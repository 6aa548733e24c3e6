"""The line of a link with a rate, which messages cross one after the other."""

from __future__ import annotations

from netem import models
from netem.profile import LinkProfile


class RateLine:
    """A line that needs a message's size divided by the profile's rate to carry it.

    profile : has a rate. free_ns : when the line is free; until then it carries earlier messages.
    """

    __slots__ = ("cell_overhead", "cell_size", "free_ns", "overhead", "rate_bit_s", "size", "takes_ns")

    def __init__(self, profile: LinkProfile, free_ns: int) -> None:
        self.rate_bit_s, self.overhead = profile.rate_bit_s, profile.overhead
        self.cell_size, self.cell_overhead = profile.cell_size, profile.cell_overhead
        self.free_ns = free_ns
        self.size = -1  # of the last message; its time is kept, as many messages have the same size
        self.takes_ns = 0

    def release_ns(self, ready_ns: int, size: int) -> int:
        """The time at which a message of `size` bytes, ready at `ready_ns`, has crossed the line after all others."""
        return release_ns(self, ready_ns, size)


def release_ns(line: RateLine, ready_ns: int, size: int) -> int:
    """The time at which a message has crossed the line after all others [ns]: `RateLine.release_ns`."""
    if size != line.size:
        line.size, line.takes_ns = size, models.transmission_ns(size, line)
    free_ns = line.free_ns
    line.free_ns = released_ns = (ready_ns if ready_ns > free_ns else free_ns) + line.takes_ns
    return released_ns
