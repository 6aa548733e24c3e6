"""Resends on many links at once (`netem.resend`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.simulation.batch.arrays import LONG_AGO, Index, Whole
from netem import Link, models
from netem.draws import Fates


class Resends:
    """The resends of one direction. Links without resends are included and change nothing.

    Parameters
    ----------
    links : the scenarios' own. shift_ns : time on their clocks when the batch's clock shows 0.
    """

    def __init__(self, links: list[Link[Any]], shift_ns: Whole) -> None:
        self._links, self._shift_ns = links, shift_ns
        kinds = [link.profile.resend for link in links]
        self._after_ns = np.array([0 if kind is None else kind.after_ns for kind in kinds])
        self._ordered = np.array([kind is not None and kind.ordered for kind in kinds])
        in_order = [max(link.in_order_ns, LONG_AGO) for link in links]
        self._in_order_ns = np.maximum(np.array(in_order) - shift_ns, LONG_AGO)
        self._taken = np.zeros((len(links), models.BLOCK), dtype=np.int64)
        self._resent = np.zeros(len(links), dtype=np.int64)
        self._recovered = np.zeros(len(links), dtype=np.int64)

    def decide(self, i: int, begun: int, fates: Fates) -> NDArray[np.bool_]:
        """Which messages of scenario i's next draws are lost for good; the draws fill its block from `begun` on."""
        resends = self._links[i].resends
        if resends is None:
            return fates.lost
        self._taken[i, begun:], lost = resends.taken_by_all(fates.lost, fates.luck)
        return lost

    def offered_ns(self, at: Index, draw: Whole, now_ns: Whole, lost: NDArray[np.bool_]) -> Whole:
        """When messages are offered for the last time [ns]; `draw` is the place of each in its block of draws."""
        taken = self._taken[at, draw]
        self._resent[at] += taken
        self._recovered[at] += (taken > 0) & ~lost
        offered = now_ns + taken * self._after_ns[at]
        in_order = np.maximum(offered, self._in_order_ns[at])
        self._in_order_ns[at] = in_order
        found: Whole = np.where(self._ordered[at], in_order, offered)
        return found

    def write_back(self, i: int, link: Link[Any]) -> None:
        """Give scenario i's state back."""
        link.counters.resent += int(self._resent[i])
        link.counters.recovered += int(self._recovered[i])
        if self._in_order_ns[i] > LONG_AGO:
            link.in_order_ns = int(self._in_order_ns[i] + self._shift_ns[i])
