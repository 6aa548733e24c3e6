"""The peer monitors of one direction's receivers in many scenarios at once: `PeerMonitor` for positions in bulk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.wire.peer_monitor import PeerMonitor


class PeerMonitors:
    """One receiver per scenario. shift_ns : time on their clocks when the batch's clock shows 0."""

    def __init__(self, monitors: list[PeerMonitor], shift_ns: Whole) -> None:
        self._monitors, self._shift_ns = monitors, shift_ns
        self.newest = np.array([one.numbers.newest for one in monitors])
        """Number of the newest position received in each scenario."""
        self._heard_ns = np.array([one.heard_ns or 0 for one in monitors]) - shift_ns
        self._silence_ns = np.array([one.silence_ns for one in monitors])
        self._received = np.zeros(len(monitors), dtype=np.int64)
        self._missing = np.zeros(len(monitors), dtype=np.int64)

    def fold(self, at: Index, due_ns: Whole, number: Whole, counted: NDArray[np.bool_], new: NDArray[np.bool_]) -> None:
        """Count the arrivals in the scenarios `at`, one column each: `counted` marks messages, `new` new positions."""
        since = np.maximum.accumulate(np.where(new, due_ns, self._heard_ns[at]))
        before = np.vstack([self._heard_ns[at], since[:-1]])
        silent = np.any(counted & (due_ns - before > self._silence_ns[at]), axis=0)
        for column in silent.nonzero()[0].tolist():
            rows = counted[:, column].nonzero()[0]
            self._one_by_one(int(at[column]), due_ns[rows, column], number[rows, column], new[rows, column])
        steady = ~silent & new.any(axis=0)
        at, new, number, since = at[steady], new[:, steady], number[:, steady], since[:, steady]
        if not at.size:
            return
        newest, received = np.where(new, number, -1).max(axis=0), new.sum(axis=0)
        first = np.where(self.newest[at] < 0, number[new.argmax(axis=0), np.arange(len(at))] - 1, self.newest[at])
        self._missing[at] += newest - first - received
        self._received[at] += received
        self.newest[at], self._heard_ns[at] = newest, since[-1]

    def write_back(self, i: int) -> None:
        """Give scenario i's state back."""
        heard_ns = int(self._heard_ns[i] + self._shift_ns[i])
        received, missing = int(self._received[i]), int(self._missing[i])
        self._monitors[i].resume(heard_ns, int(self.newest[i]), received, missing)
        self._received[i] = self._missing[i] = 0

    def _one_by_one(self, i: int, due_ns: Whole, number: Whole, new: NDArray[np.bool_]) -> None:
        """Count a scenario with a silence, which is rare, with its own `PeerMonitor`."""
        self.write_back(i)
        one, shift = self._monitors[i], int(self._shift_ns[i])
        for k in np.argsort(due_ns, kind="stable").tolist():
            now_ns = int(due_ns[k]) + shift
            one.on_any_message(now_ns)
            if new[k]:
                newest = one.numbers.newest
                one.on_position(now_ns, 1 if newest < 0 else int(number[k]) - newest)
                one.numbers.resume(now_ns, int(number[k]))
        self.newest[i] = one.numbers.newest
        self._heard_ns[i] = (one.heard_ns or 0) - shift
