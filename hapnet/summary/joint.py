"""The margin of both ports together while a pair runs, from both sides' samples on one clock.

As `from_samples.total_margin` of a recording, it is the sum of both margins at every sample of either side; the other
side contributes its last sample up to that time.
"""

from __future__ import annotations

import math
from collections import deque

from hapnet.summary.from_samples import START_S
from hapnet.summary.structure import SIDES
from hapnet.wire.messages import Role

_MOST_WAITING = 4096
"""Most samples of a side that wait for the other's; beyond that the oldest are dropped."""


class JointMargin:
    """The sum since both sides began. The samples of each side must come in order; the sides may interleave freely."""

    def __init__(self) -> None:
        self._waiting: dict[Role, deque[tuple[int, float]]] = {side: deque(maxlen=_MOST_WAITING) for side in SIDES}
        self._newest_ns: dict[Role, int] = {}
        self._forget()

    def _forget(self) -> None:
        self._last: dict[Role, float] = {}
        self._first_ns: int | None = None
        self._total: float | None = None
        self._end: float | None = None
        self._later: float | None = None

    def begin(self, role: Role) -> None:
        """Start again after a restart of that side: earlier samples belong to another pair."""
        self._waiting[role].clear()
        self._newest_ns.pop(role, None)
        self._forget()

    def take(self, role: Role, time_ns: int, margin_J: float) -> None:
        """Add the next sample of that side."""
        self._waiting[role].append((time_ns, margin_J))
        self._newest_ns[role] = time_ns
        if len(self._newest_ns) < len(SIDES):
            return
        until_ns = min(self._newest_ns.values())
        while due := [samples[0][0] for samples in self._waiting.values() if samples]:
            at_ns = min(due)
            if at_ns > until_ns:
                return
            for other, samples in self._waiting.items():
                if samples and samples[0][0] == at_ns:
                    self._last[other] = samples.popleft()[1]
            self._add(at_ns)

    def _add(self, at_ns: int) -> None:
        if len(self._last) < len(SIDES):
            return
        self._first_ns = at_ns if self._first_ns is None else self._first_ns
        total = sum(self._last.values())
        if not math.isfinite(total):
            return
        self._total = total if self._total is None else min(self._total, total)
        self._end = total
        if at_ns - self._first_ns >= START_S * 1e9:
            self._later = total if self._later is None else min(self._later, total)

    def margins(self) -> dict[str, float | None]:
        """The minimum, the present sum and the minimum from `START_S` on [J], by the parameters of `combine`."""
        return {"total_margin_J": self._total, "total_end_J": self._end, "total_later_J": self._later}
