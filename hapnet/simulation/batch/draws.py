"""The draws of one direction of the link in many scenarios at once: each message's delay or loss."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.side.packet import Packet
from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.simulation.batch.resends import Resends
from netem import Link, models
from netem.draws import Fates

LOST, AHEAD = -1, -2
"""In place of a delay: the message is lost for good, or it is sent ahead of the others."""

_BLOCK = models.BLOCK


class Draws:
    """The draws of one direction, taken from each scenario's own link in blocks.

    Parameters
    ----------
    links : the scenarios' own. resends : theirs, None if none has any.
    """

    def __init__(self, links: list[Link[Packet]], resends: Resends | None) -> None:
        self._links, self._resends = links, resends
        self.any_ahead = any(link.profile.reorder for link in links)
        """True if messages may be sent ahead of others."""
        self._since_reorder = [link.since_reorder for link in links]
        nothing = np.zeros(0, dtype=np.bool_)
        self._drawn = [Fates(nothing, nothing, nothing.astype(np.int64), nothing.astype(float)) for _ in links]
        self._fates = np.zeros((len(links), _BLOCK), dtype=np.int64)
        # number of messages offered before the block of draws in `_fates`
        self._before = np.array([link.counters.offered for link in links]) - _BLOCK

    def next(self, at: Index, offered: Whole) -> tuple[Whole, Whole]:
        """For the message after the first `offered` ones: (its place in its block, its delay [ns] or LOST or AHEAD)."""
        place = offered - self._before[at]
        if int(place.max()) >= _BLOCK:
            for i, count in zip(at[place >= _BLOCK].tolist(), offered[place >= _BLOCK].tolist(), strict=True):
                self._draw(i, count)
            place = offered - self._before[at]
        fates: Whole = self._fates[at, place]
        return place, fates

    def _draw(self, i: int, offered: int) -> None:
        """Take the next block of draws of scenario i, and reduce it to each message's delay or loss."""
        link = self._links[i]
        gap = link.profile.gap if link.profile.reorder else 0
        if gap:  # it continues to count from the previous block
            before = self._drawn[i]
            _, self._since_reorder[i] = _ahead(before.lost, before.ahead, self._since_reorder[i], gap)
        begun = offered % _BLOCK  # what is left of the link's own block first
        fates = self._drawn[i] = link.streams.many(offered, _BLOCK - begun)
        row = self._fates[i, begun:]
        row[:] = fates.delay_ns
        lost = fates.lost if self._resends is None else self._resends.decide(i, begun, fates)
        row[lost] = LOST
        if gap:
            row[_ahead(fates.lost, fates.ahead, self._since_reorder[i], gap)[0]] = AHEAD
        self._before[i] = offered - begun

    def write_back(self, i: int, link: Link[Packet], offered: int) -> None:
        """Give the draws that were not used back to scenario i's link."""
        lost, ahead, delays, luck = self._drawn[i]
        done = offered - (int(self._before[i]) + _BLOCK - len(lost))
        if link.profile.reorder:
            _, link.since_reorder = _ahead(lost[:done], ahead[:done], self._since_reorder[i], link.profile.gap)
        link.streams.put_back(Fates(lost[done:], ahead[done:], delays[done:], luck[done:]))


def _ahead(lost: NDArray[np.bool_], ahead: NDArray[np.bool_], since: int, gap: int) -> tuple[list[int], int]:
    """Which messages are sent ahead of the others, and the number of messages since the last of these."""
    which = []
    for k in (~lost).nonzero()[0].tolist():
        since += 1
        if ahead[k] and since >= gap:
            since = 0
            which.append(k)
    return which, since
