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
from hapnet.simulation.batch.channels import NEVER, Whole
from hapnet.simulation.batch.couplings import Index
from hapnet.simulation.batch.lines import Lines
from hapnet.simulation.batch.peer_monitors import PeerMonitors
from hapnet.simulation.batch.resends import Resends
from hapnet.wire.peer_monitor import PeerMonitor
from netem import Link, models, stats
from netem.draws import Fates
from netem.line import RateLine

_BLOCK = models.BLOCK
_ROWS = 512
_CHUNK = 64
"""Number of scenarios counted together: their part of the log fits the processor's fast cache."""
_LOST, _AHEAD = -1, -2
ENERGY, DONE = -1, -2
"""The note of a message that is not a position (a position's note is its number): energy; counted or lost."""
_LONG_AGO = -NEVER

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
        self._since_reorder = [link.since_reorder for link in links]
        self._any_ahead = any(link.profile.reorder for link in links)
        self._lines = Lines([link.profile for link in links])
        self.timed = self._lines.timed
        """True if the size of a message matters."""
        released = [_free_ns(link) for link in links]
        self._released_ns = np.maximum(np.array(released) - shift_ns, _LONG_AGO)
        nothing = np.zeros(0, dtype=np.bool_)
        self._draws = [Fates(nothing, nothing, nothing.astype(np.int64), nothing.astype(float)) for _ in links]
        self._fates = np.zeros((count, _BLOCK), dtype=np.int64)
        self._block = self.offered - _BLOCK  # number of messages offered before the block of draws in `_fates`
        # The log: messages `_base` and later, one column per scenario; a lost message is never due.
        first = [min((entry[1] for entry in link.queue), default=link.counters.offered + 1) for link in links]
        self._base = np.array(first)
        self.safe_ns = 0
        """All messages with send times up to this one have been sent [ns]."""
        rows = _ROWS + max(int((self.offered - self._base).max()), 0)
        self._due = np.full((rows, count), NEVER, dtype=np.int64)
        self._delay = np.zeros((rows, count), dtype=np.int64)
        self._note = np.full((rows, count), DONE, dtype=np.int64)
        self._bins = np.zeros((count, len(links[0].counters.delays._counts)), dtype=np.int64)
        self._sums = np.zeros((4, count), dtype=np.int64)
        self._count = np.zeros(count, dtype=np.int64)
        self._least = np.full(count, NEVER, dtype=np.int64)
        self._most = np.full(count, -1, dtype=np.int64)

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
        draw = offered - self._block[at]
        if int(draw.max()) >= _BLOCK:
            for i in at[draw >= _BLOCK].tolist():
                self._draw(i)
            draw = offered - self._block[at]
        fate = self._fates[at, draw]
        order = offered + 1
        self.offered[at] = order
        offered_ns = now_ns if self._resends is None else self._resends.offered_ns(at, draw, now_ns, fate == _LOST)
        due = offered_ns + np.maximum(fate, 0) if self._any_ahead else offered_ns + fate
        if size is not None:
            queued = self._lines.release(at, due, self._released_ns[at], size)
            timed = (fate >= 0) & (queued < NEVER)
            due = np.where(timed, queued, due)
            which = at[timed]
            self._released_ns[which] = due[timed]
        if self._any_ahead:
            self._ahead[at] += fate == _AHEAD
        row = order - self._base[at]
        if int(row.max()) >= len(self._due):
            self._make_room(int(row.max() - row.min()))
            row = order - self._base[at]
        delay = due - now_ns
        if (gone := (fate == _LOST).nonzero()[0]).size:
            due[gone] = NEVER
            which = at[gone]
            self._lost[which] += 1
            self._loss_bursts[which] += self._last_lost[which] != order[gone] - 1
            self._last_lost[which] = order[gone]
            note = np.where(fate == _LOST, DONE, note)
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
        self._count_delays(at, counted)
        note[counted] = DONE
        self._note[:, at] = note

    def land(self, i: int, packet: Callable[[int, int, int], Packet]) -> None:
        """Write scenario i's folded state back; `packet(order, note, sent_ns)` makes the packets in flight again."""
        self._peer_monitors.land(i)
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
        lost, ahead, delays, luck = self._draws[i]
        done = offered - (int(self._block[i]) + _BLOCK - len(lost))
        if link.profile.reorder:
            _, link.since_reorder = _ahead(lost[:done], ahead[:done], self._since_reorder[i], link.profile.gap)
        if self._resends is not None:
            self._resends.land(i, link)
        link.streams.put_back(Fates(lost[done:], ahead[done:], delays[done:], luck[done:]))
        link.queue.clear()
        if isinstance(link.line, RateLine) and self._released_ns[i] > _LONG_AGO:
            link.line.free_ns = int(self._released_ns[i]) + shift
        for row in (self._note[:, i] > DONE).nonzero()[0].tolist():
            order, due = row + int(self._base[i]), int(self._due[row, i]) + shift
            sent = due - int(self._delay[row, i])
            link.queue.append((due, order, packet(order, int(self._note[row, i]), sent), sent, 0))
        heapify(link.queue)
        self._land_delays(i, link)

    # -- draws -------------------------------------------------------------------------------------------------------

    def _draw(self, i: int) -> None:
        """Take the next block of draws of scenario i, and reduce it to each message's delay or loss."""
        link = self._links[i]
        gap = link.profile.gap if link.profile.reorder else 0
        if gap:  # it continues to count from the previous block
            before = self._draws[i]
            _, self._since_reorder[i] = _ahead(before.lost, before.ahead, self._since_reorder[i], gap)
        offered = int(self.offered[i])
        begun = offered % _BLOCK  # what is left of the link's own block first
        fates = self._draws[i] = link.streams.many(offered, _BLOCK - begun)
        row = self._fates[i, begun:]
        row[:] = fates.delay_ns
        lost = fates.lost if self._resends is None else self._resends.decide(i, begun, fates)
        row[lost] = _LOST
        if gap:
            row[_ahead(fates.lost, fates.ahead, self._since_reorder[i], gap)[0]] = _AHEAD
        self._block[i] = offered - begun

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

    def _count_delays(self, at: Index, counted: Flags) -> None:
        column = counted.nonzero()[1]
        delay = self._delay.take(at, axis=1)
        seen = delay[counted]
        octaves = np.log2(np.maximum(seen, stats._FLOOR_NS) / stats._FLOOR_NS)
        bin_of = np.minimum((octaves * stats._PER_OCTAVE).astype(np.intp), self._bins.shape[1] - 1)
        if seen.size:
            low, bins = int(bin_of.min()), int(bin_of.max()) + 1 - int(bin_of.min())
            counts = np.bincount(column * bins + bin_of - low, minlength=len(at) * bins)
            self._bins[at, low : low + bins] += counts.reshape(len(at), bins)
        self._count[at] += counted.sum(axis=0)
        self._least[at] = np.minimum(self._least[at], np.where(counted, delay, NEVER).min(axis=0))
        self._most[at] = np.maximum(self._most[at], np.where(counted, delay, -1).max(axis=0))
        delay *= counted
        high, rest = delay >> 20, delay & 0xFFFFF  # the square of a long delay takes more than 64 bits
        for total, term in zip(self._sums, (delay, high * high, high * rest, rest * rest), strict=True):
            total[at] += term.sum(axis=0)

    def _land_delays(self, i: int, link: Link[Packet]) -> None:
        histogram = link.counters.delays
        histogram.fold()
        count = int(self._count[i])
        if not count:
            return
        least, most = int(self._least[i]), int(self._most[i])
        histogram._least_ns = min(histogram._least_ns, least) if histogram._count else least
        histogram._most_ns = max(histogram._most_ns, most) if histogram._count else most
        total, high, mixed, low = self._sums[:, i].tolist()
        histogram._total_ns += total
        histogram._total_square += (high << 40) + (mixed << 21) + low
        histogram._count += count
        histogram._counts += self._bins[i]


def _free_ns(link: Link[Packet]) -> int:
    """When its line is free [ns]; long ago if it has no line."""
    return max(link.line.free_ns, _LONG_AGO) if isinstance(link.line, RateLine) else _LONG_AGO


def _ahead(lost: Flags, ahead: Flags, since: int, gap: int) -> tuple[list[int], int]:
    """Which messages are sent ahead of the others, and the number of messages since the last of these."""
    which = []
    for k in (~lost).nonzero()[0].tolist():
        since += 1
        if ahead[k] and since >= gap:
            since = 0
            which.append(k)
    return which, since


def _overtaken(due: Whole) -> Flags:
    """Whether each message is due after one of a later row."""
    least = np.minimum.accumulate(due[::-1])[::-1]
    result = np.zeros(due.shape, dtype=np.bool_)
    result[:-1] = least[1:] < due[:-1]
    return result
