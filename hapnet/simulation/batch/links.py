"""One direction of the link in many scenarios at once: `netem.link` for constant and random delays, losses, resends,
reordering and rates. The draws come in blocks from each scenario's own `Link`.

Messages delivered out of order are found without delivering anything: a message is late iff one sent after it is due
before it. So the least due time of all later messages decides.
"""

from __future__ import annotations

from collections.abc import Callable
from heapq import heapify

import numpy as np
from numpy.typing import NDArray

from hapnet.side.packet import Packet
from hapnet.simulation.batch.arrays import NEVER, Index, Whole
from hapnet.simulation.batch.delays import DelayHistograms
from hapnet.simulation.batch.draws import AHEAD, LOST, Draws
from hapnet.simulation.batch.lines import Lines
from hapnet.simulation.batch.peer_monitors import PeerMonitors
from hapnet.simulation.batch.resends import Resends
from hapnet.wire.peer_monitor import PeerMonitor
from netem import Link

_ROWS = 512
_CHUNK = 64
"""Number of scenarios counted together: their part of the log fits the processor's fast cache."""
ENERGY, DONE = -1, -2
"""The note of a message that is not a position (a position's note is its number): energy; counted or lost."""

Flags = NDArray[np.bool_]


class Links:
    """One direction. Messages are offered in the order of their link, so a message's number determines its draws.

    Parameters
    ----------
    links : the scenarios' own. shift_ns : time on their clocks when the batch's clock shows 0.
    monitors : those at the receiving sides.
    """

    def __init__(self, links: list[Link[Packet]], shift_ns: Whole, monitors: list[PeerMonitor]) -> None:
        count = len(links)
        self._links, self._shift_ns = links, shift_ns
        self.offered = np.array([link.counters.offered for link in links])
        self._lost = np.zeros(count, dtype=np.int64)
        self._loss_bursts = np.zeros(count, dtype=np.int64)
        self._last_lost = np.array([link.counters.last_lost for link in links])
        self._ahead = np.zeros(count, dtype=np.int64)
        self._reordered = np.zeros(count, dtype=np.int64)
        self._resends = Resends(links, shift_ns) if any(link.profile.resend for link in links) else None
        self.stale = np.zeros(count, dtype=np.int64)
        """Positions that arrived after newer ones."""
        self._newest = np.array([link.counters.newest for link in links])
        self._peer_monitors = PeerMonitors(monitors, shift_ns)
        self._lines = Lines(links, shift_ns)
        self._draws = Draws(links, self._resends)
        # The log: messages `_base` and later, one column per scenario; a lost message is never due.
        first = [min((entry[1] for entry in link.queue), default=link.counters.offered + 1) for link in links]
        self._base = np.array(first)
        self.safe_ns = 0
        """All messages with send times up to this one have been sent [ns]."""
        rows = _ROWS + max(int((self.offered - self._base).max()), 0)
        self._due = np.full((rows, count), NEVER, dtype=np.int64)
        self._delay = np.zeros((rows, count), dtype=np.int64)
        self._note = np.full((rows, count), DONE, dtype=np.int64)
        self._delays = DelayHistograms(count)

    @property
    def timed(self) -> bool:
        """True if the size of a message matters."""
        return self._lines.timed

    def under_way(self, i: int, order: int, due_ns: int, sent_ns: int, note: int) -> None:
        """Add a message that is in scenario i's queue when the scenario is loaded."""
        at = order - int(self._base[i]), i
        self._due[at], self._delay[at], self._note[at] = due_ns, due_ns - sent_ns, note

    def send(self, at: Index, now_ns: Whole, note: Whole | int, size: Whole | None) -> tuple[Whole, Whole]:
        """Offer one message per scenario: (its number on the link, its due time). `note`: the position's number or
        `ENERGY`.

        `size` [bytes] is needed if the links are `timed`. A lost message is due `NEVER`.
        """
        offered = self.offered[at]
        place, fate = self._draws.next(at, offered)
        order = offered + 1
        self.offered[at] = order
        offered_ns = now_ns if self._resends is None else self._resends.offered_ns(at, place, now_ns, fate == LOST)
        due = offered_ns + np.maximum(fate, 0) if self._draws.any_ahead else offered_ns + fate
        if size is not None:
            due = self._lines.release(at, due, size, fate >= 0)
        if self._draws.any_ahead:
            self._ahead[at] += fate == AHEAD
        row = order - self._base[at]
        if int(row.max()) >= len(self._due):
            self._make_room(int(row.max() - row.min()))
            row = order - self._base[at]
        delay = due - now_ns
        if (gone := (fate == LOST).nonzero()[0]).size:
            due[gone] = NEVER
            which = at[gone]
            self._lost[which] += 1
            self._loss_bursts[which] += self._last_lost[which] != order[gone] - 1
            self._last_lost[which] = order[gone]
            note = np.where(fate == LOST, DONE, note)
        self._due[row, at], self._delay[row, at], self._note[row, at] = due, delay, note
        return order, due

    def fold(self, at: Index, now_ns: int) -> None:
        """Count the deliveries up to `now_ns` in the scenarios `at`; the log must contain everything sent by then."""
        for first in range(0, len(at), _CHUNK):
            self._fold(at[first : first + _CHUNK], now_ns)

    def _fold(self, at: Index, now_ns: int) -> None:
        due, note = self._due.take(at, axis=1), self._note.take(at, axis=1)
        order = np.arange(len(due))[:, None] + self._base[at]
        counted = (due <= now_ns) & (note > DONE)
        late = counted & (_overtaken(due) | (order <= self._newest[at]))
        self._reordered[at] += late.sum(axis=0)
        self._newest[at] = np.maximum(self._newest[at], np.where(counted, order, 0).max(axis=0))
        position = counted & (note >= 0)
        stale = _overtaken(np.where(note >= 0, due, NEVER)) | (note <= self._peer_monitors.newest[at])
        self.stale[at] += (stale & position).sum(axis=0)
        self._peer_monitors.fold(at, due, note, counted, position & ~stale)
        self._delays.add(at, self._delay.take(at, axis=1), counted)
        note[counted] = DONE
        self._note[:, at] = note

    def write_back(self, i: int, packet: Callable[[int, int, int], Packet]) -> None:
        """Write scenario i's folded state back; `packet(order, note, sent_ns)` makes the packets in flight again."""
        self._peer_monitors.write_back(i)
        link = self._links[i]
        shift = int(self._shift_ns[i])
        offered = int(self.offered[i])
        counters = link.counters
        counters.offered = offered
        counters.lost += int(self._lost[i])
        counters.loss_bursts += int(self._loss_bursts[i])
        counters.last_lost = int(self._last_lost[i])
        counters.sent_ahead += int(self._ahead[i])
        counters.reordered += int(self._reordered[i])
        counters.newest = int(self._newest[i])
        self._draws.write_back(i, link, offered)
        if self._resends is not None:
            self._resends.write_back(i, link)
        self._lines.write_back(i, link)
        self._delays.write_back(i, counters.delays)
        link.queue.clear()
        for row in (self._note[:, i] > DONE).nonzero()[0].tolist():
            order, due = row + int(self._base[i]), int(self._due[row, i]) + shift
            sent = due - int(self._delay[row, i])
            link.queue.append((due, order, packet(order, int(self._note[row, i]), sent), sent, 0))
        heapify(link.queue)

    # -- the log -----------------------------------------------------------------------------------------------------

    def _make_room(self, spread: int) -> None:
        """Count deliveries and drop them from the log; make the log longer if that is not enough."""
        everyone = np.arange(len(self._base))
        self.fold(everyone, self.safe_ns)
        length = len(self._due)
        pending = self._note > DONE
        first = np.where(pending.any(axis=0), pending.argmax(axis=0), length)
        first = np.minimum(first, self.offered - self._base)  # including the message that is being logged
        longest = int((self.offered - self._base - first).max()) + spread
        row = np.arange(length)[:, None] + first
        beyond = row >= length
        row[beyond] = 0
        more = length if longest > length // 2 else 0
        for name, empty in (("_due", NEVER), ("_delay", 0), ("_note", DONE)):
            log = np.take_along_axis(getattr(self, name), row, axis=0)
            log[beyond] = empty
            setattr(self, name, np.pad(log, ((0, more), (0, 0)), constant_values=empty) if more else log)
        self._base += first


def _overtaken(due: Whole) -> Flags:
    """Whether each message is due after one of a later row."""
    least = np.minimum.accumulate(due[::-1])[::-1]
    result = np.zeros(due.shape, dtype=np.bool_)
    result[:-1] = least[1:] < due[:-1]
    return result
