"""A side whose peer has left: it reports what it waits for, and how long; with `--once` it ends."""

from __future__ import annotations

from collections.abc import Callable

from hapnet.side.endpoint import NANO
from hapnet.side.notices import Notice
from hapnet.wire.events import Event, Paired, PeerHeard, PeerLeft, PeerSilent
from hapnet.wire.messages import Role

GONE_NS = 10_000_000_000
"""A peer counts as gone when it has been silent for this time [ns] and Zenoh does not see it either."""

_WORTH_REPORTING_S = 1.0


class PeerAbsence:
    """The behaviour of one side without its peer; on the event loop.

    role : this side's. once : end with the first peer. notify : called with each notice. end : ends the side.
    """

    def __init__(self, role: Role, once: bool, notify: Callable[[Notice], None], end: Callable[[], None]) -> None:
        self._other = "world" if role == "device" else "device"
        self._once, self._notify, self._end = once, notify, end
        self._silent_since_ns: int | None = None

    def happened(self, event: Event, now_ns: int, left_s: float | None) -> None:
        """Act on an event of the session. This side runs for another `left_s` seconds; None: until it is stopped."""
        match event:
            case Paired() | PeerHeard():
                self._silent_since_ns = None
            case PeerSilent(since_ns):
                self._silent_since_ns = since_ns
            case PeerLeft():
                self._silent_since_ns = None
                if self._once:
                    self._part(now_ns, f"ends with its first {self._other}")
                elif left_s is None or left_s >= _WORTH_REPORTING_S:
                    how_long = "until it is stopped" if left_s is None else f"for the {left_s:.0f} s that are left"
                    text = f"waits for another {self._other} {how_long} (--once would end it now)"
                    self._notify(Notice("waiting", text, now_ns))

    def watch(self, now_ns: int, partners: int) -> None:
        """End a side with `--once` whose peer is gone. `partners`: how many play the other side, by Zenoh's count."""
        since_ns = self._silent_since_ns
        if self._once and since_ns is not None and not partners and now_ns - since_ns > GONE_NS:
            gone_s = (now_ns - since_ns) * NANO
            self._part(now_ns, f"ends: nothing from its {self._other} for {gone_s:.0f} s, and nobody there")

    def _part(self, now_ns: int, text: str) -> None:
        self._once = False
        self._notify(Notice("once", f"{text} (--once)", now_ns))
        self._end()
