"""The present faults of a running pair, as text: a servo that stalled, a reservoir that is empty."""

from __future__ import annotations

import numpy as np

from hapnet.ext.page.history import Snapshot, coupled
from hapnet.recording.samples import Event
from hapnet.summary.verdict import has_reservoirs

SHOWN_S = 5.0
"""How long a servo's absence is shown [s]."""

EMPTY_J = 1e-6
EMPTY_S = 0.3
"""A reservoir that held no more than `EMPTY_J` for so long is empty [s]: a moment without energy is normal."""

_EMPTY = {
    "device": "the device's reservoir is empty: the handle's spring cannot follow the world",
    "world": "the world's reservoir is empty: the proxy cannot follow the hand",
}


class Troubles:
    """Times `now_s` are those of the page."""

    def __init__(self) -> None:
        self._last: Event | None = None
        self._seen_s = -SHOWN_S

    def now(self, snapshot: Snapshot, now_s: float) -> list[str]:
        """A sentence for each trouble."""
        away = next((event for event in reversed(snapshot.events) if event.kind == "overrun"), None)
        if away is not None and away != self._last:
            self._last, self._seen_s = away, now_s
        found = []
        if self._last is not None and now_s - self._seen_s < SHOWN_S:
            found.append(f"{self._last.text}; this machine is too busy for its servo")
        coupling, _ = coupled(snapshot.device_status or snapshot.world_status)
        if has_reservoirs(coupling):
            for role, track in (("device", snapshot.device), ("world", snapshot.world)):
                if track is None or track.time_s[-1] - track.time_s[0] < EMPTY_S:
                    continue
                newest = track.reservoir_J[track.time_s >= track.time_s[-1] - EMPTY_S]
                if float(np.max(newest)) <= EMPTY_J:
                    found.append(_EMPTY[role])
        return found
