"""The gate of a link that releases in slots."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop
from typing import Generic, TypeVar

from netem.effects import Slot

T = TypeVar("T")

Entry = tuple[int, int, T, int, int]
"""A message on a link: due time, number, item, send time, size. Each number is used once."""


class SlotGate(Generic[T]):
    """Opens at random intervals, and each time lets the slot's packets and bytes through.

    slot : the limits. intervals : draws the time to the next slot [ns]. now_ns : the first slot opens now.
    """

    def __init__(self, slot: Slot, intervals: Callable[[], int], now_ns: int) -> None:
        self.opens_ns = now_ns
        self._slot, self._intervals = slot, intervals
        self._packets = self._bytes = 0

    def run(self, queue: list[Entry[T]], ready: list[Entry[T]], now_ns: int) -> None:
        """Move the messages that the slots up to now let through from the queue, a heap, to `ready`."""
        slot = self._slot
        while queue:
            due_ns = queue[0][0]
            release_ns = max(due_ns, self.opens_ns)
            if release_ns > now_ns:
                return
            if self.opens_ns < due_ns:
                self._open(release_ns)
                continue
            _, order, item, sent_ns, size = heappop(queue)
            ready.append((release_ns, order, item, sent_ns, size))
            self._packets += 1
            self._bytes += size
            if self._packets == slot.packets or 0 < slot.bytes <= self._bytes:
                self._open(release_ns)
            self.look(queue, release_ns)

    def look(self, queue: list[Entry[T]], now_ns: int) -> None:
        """Skip a slot too early for the head of the queue, as the kernel does after each arrival and release."""
        if queue and self.opens_ns < queue[0][0]:
            self._open(now_ns)

    def _open(self, now_ns: int) -> None:
        self.opens_ns = now_ns + self._intervals()
        self._packets = self._bytes = 0
