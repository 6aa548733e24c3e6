"""Messages in flight to one side in many scenarios at once: the newest position, and energy messages in order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.simulation.batch.arrays import NEVER, Index, Whole


class Positions:
    """Positions for a side that may look at any time; it finds the newest that has arrived.

    Each scenario has a ring buffer with position number q at q modulo its length. It grows before it would overwrite a
    position that may still be used.
    """

    def __init__(self, count: int, dof: int, newest: Whole) -> None:
        self.newest = newest
        """Number of the newest position seen."""
        self._due = np.full((count, 64), NEVER, dtype=np.int64)
        self._number = np.full((count, 64), -1, dtype=np.int64)
        self._x = np.zeros((count, 64, dof))

    def put(self, at: Index, number: Whole, due_ns: Whole, x: Array) -> None:
        """Add positions x (n, M) in flight."""
        column = number % self._due.shape[1]
        ahead = int((number - self.newest[at]).max())
        while ahead > self._due.shape[1] and self._still_counts(at, column):
            self._grow()
            column = number % self._due.shape[1]
        self._due[at, column], self._number[at, column], self._x[at, column] = due_ns, number, x.T

    def look(self, at: Index, now_ns: Whole) -> tuple[Index, Array]:
        """(which of `at` have a new position by `now_ns` (M,), their positions (n, k))."""
        here = self._due[at] <= now_ns[:, None]
        newest = np.where(here, self._number[at], -1).max(axis=1)
        fresh = (newest > self.newest[at]).nonzero()[0]
        which, number = at[fresh], newest[fresh]
        self.newest[which] = number
        return fresh, self._x[which, number % self._due.shape[1]].T

    def position(self, i: int, number: int) -> tuple[float, ...]:
        """The position with this number, if it is still stored [m]."""
        return tuple(self._x[i, number % self._due.shape[1]].tolist())

    def _still_counts(self, at: Index, column: Whole) -> bool:
        """True if one of these places holds a position that may still become the newest."""
        return bool(np.any((self._number[at, column] > self.newest[at]) & (self._due[at, column] < NEVER)))

    def _grow(self) -> None:
        count, length = self._due.shape
        known = self._number >= 0
        rows, old = np.nonzero(known)
        number = self._number[rows, old]
        new = number % (2 * length)
        due, numbers = np.full((count, 2 * length), NEVER, dtype=np.int64), np.full((count, 2 * length), -1)
        x = np.zeros((count, 2 * length, self._x.shape[2]))
        due[rows, new], numbers[rows, new], x[rows, new] = self._due[rows, old], number, self._x[rows, old]
        self._due, self._number, self._x = due, numbers, x


class TickedPositions(Positions):
    """Positions for a side that looks only on ticks of `period_ns`: a calendar of ticks replaces the search."""

    def __init__(self, count: int, dof: int, newest: Whole, period_ns: int) -> None:
        super().__init__(count, dof, newest)
        self._period_ns = period_ns
        self._tick = 0
        self._calendar = np.full((128, count), -1, dtype=np.int64)

    def put(self, at: Index, number: Whole, due_ns: Whole, x: Array) -> None:
        super().put(at, number, due_ns, x)
        arriving = due_ns < NEVER
        at, tick, number = at[arriving], -(-due_ns[arriving] // self._period_ns), number[arriving]
        if not at.size:
            return
        while int(tick.max()) - self._tick >= len(self._calendar):
            self._lengthen()
        row = tick % len(self._calendar)
        self._calendar[row, at] = np.maximum(self._calendar[row, at], number)

    def tick(self, tick: int) -> tuple[Index, Array]:
        """(the scenarios in which a new position has arrived by this tick, their positions)."""
        self._tick = tick
        row = self._calendar[tick % len(self._calendar)]
        fresh = (row > self.newest).nonzero()[0]
        number = row[fresh]
        self.newest[fresh] = number
        row.fill(-1)
        return fresh, self._x[fresh, number % self._due.shape[1]].T

    def _lengthen(self) -> None:
        length = len(self._calendar)
        longer = np.full((2 * length, self._calendar.shape[1]), -1, dtype=np.int64)
        for tick in range(self._tick, self._tick + length):
            longer[tick % (2 * length)] = self._calendar[tick % length]
        self._calendar = longer


class EnergyQueue:
    """Energy messages in flight to one side, a few per scenario; `next_due_ns` is when the next one arrives."""

    def __init__(self, count: int) -> None:
        self._due = np.full((8, count), NEVER, dtype=np.int64)
        self._order = np.zeros((8, count), dtype=np.int64)
        self._total_nJ = np.zeros((8, count), dtype=np.int64)
        self._acked_nJ = np.zeros((8, count), dtype=np.int64)
        self.next_due_ns = np.full(count, NEVER, dtype=np.int64)

    def put(self, at: Index, order: Whole, due_ns: Whole, total_nJ: Whole, acked_nJ: Whole) -> None:
        """Add message `order` of the link in each of `at`, unless it is lost."""
        arriving = due_ns < NEVER
        if not arriving.all():
            at, order, due_ns = at[arriving], order[arriving], due_ns[arriving]
            total_nJ, acked_nJ = total_nJ[arriving], acked_nJ[arriving]
        slot = self._due[:, at].argmax(axis=0)
        if np.any(self._due[slot, at] != NEVER):
            for name, empty in (("_due", NEVER), ("_order", 0), ("_total_nJ", 0), ("_acked_nJ", 0)):
                log = getattr(self, name)
                setattr(self, name, np.vstack([log, np.full_like(log, empty)]))
            slot = self._due[:, at].argmax(axis=0)
        self._due[slot, at], self._order[slot, at] = due_ns, order
        self._total_nJ[slot, at], self._acked_nJ[slot, at] = total_nJ, acked_nJ
        self.next_due_ns[at] = np.minimum(self.next_due_ns[at], due_ns)

    def take(self, at: Index) -> tuple[Whole, Whole]:
        """Remove the next message of each: (total_nJ, acked_nJ)."""
        due = self._due[:, at]
        first = due == due.min(axis=0)
        slot = np.where(first, self._order[:, at], NEVER).argmin(axis=0)
        due[slot, np.arange(len(at))] = NEVER
        self._due[slot, at] = NEVER
        self.next_due_ns[at] = due.min(axis=0)
        return self._total_nJ[slot, at], self._acked_nJ[slot, at]

    def greatest_nJ(self) -> Whole:
        """The highest total in flight in each scenario."""
        greatest: Whole = np.where(self._due < NEVER, self._total_nJ, 0).max(axis=0)
        return greatest

    def find(self, i: int, order: int) -> tuple[int, int]:
        """(total_nJ, acked_nJ) of scenario i's message with this number."""
        there = (self._due[:, i] != NEVER) & (self._order[:, i] == order)
        slot = int(there.argmax())
        return int(self._total_nJ[slot, i]), int(self._acked_nJ[slot, i])


class Queues:
    """One queue per scenario of deferred work, in order of time; each entry has the same few numbers.

    Parameters
    ----------
    types : the types of an entry's numbers.
    """

    def __init__(self, count: int, *types: type) -> None:
        self._times = np.zeros((8, count), dtype=np.int64)
        self._values: list[NDArray[Any]] = [np.zeros((8, count), dtype=kind) for kind in types]
        self._first = np.zeros(count, dtype=np.int64)
        self._end = np.zeros(count, dtype=np.int64)
        self.next_due_ns = np.full(count, NEVER, dtype=np.int64)

    def put(self, at: Index, due_ns: Whole, *values: Array | Whole) -> None:
        """Add an entry for each of `at`, not earlier than those already there."""
        end = self._end[at]
        if int(end.max()) >= len(self._times):
            self._times = np.vstack([self._times, np.zeros_like(self._times)])
            self._values = [np.vstack([table, np.zeros_like(table)]) for table in self._values]
        self._times[end, at] = due_ns
        for table, value in zip(self._values, values, strict=True):
            table[end, at] = value
        self._end[at] = end + 1
        self.next_due_ns[at] = np.minimum(self.next_due_ns[at], due_ns)

    def take(self, at: Index) -> list[NDArray[Any]]:
        """Remove the first entry of each of `at`; an empty queue starts again."""
        first = self._first[at]
        values = [table[first, at] for table in self._values]
        first += 1
        more = first < self._end[at]
        self.next_due_ns[at] = np.where(more, self._times[np.where(more, first, 0), at], NEVER)
        self._end[at] *= more
        self._first[at] = first * more
        return values
