"""End a side in order: wait until energy in flight is acknowledged and its account answered, then send the bye.

`PeerAbsence` handles a side whose peer has left: it reports what the side waits for, and how long, or ends it (--once).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hapnet.realtime.link_driver import LinkDriver
from hapnet.side.device import Clock
from hapnet.side.endpoint import NANO
from hapnet.side.notices import Notice
from hapnet.wire.events import Event, Paired, PeerHeard, PeerLeft, PeerSilent
from hapnet.wire.messages import Role
from hapnet.wire.session import Session

LINGER_S = 2.0
"""After control has stopped, a side waits at most this time until the energy in flight is acknowledged [s]."""

FAILED_LINGER_S = 0.5
"""The shorter wait of a side that has failed [s]: its account may still be reported."""

QUIET_S = 0.3
"""A side leaves when nothing was credited for this time [s]: the other side, which ends a little later, has then sent
all its energy."""

MAX_TRIP_S = 10.0
"""Longest round trip of the emulated link that is waited for [s]. It adds once to `QUIET_S` and twice to `LINGER_S`,
as one message may get lost."""

_GOODBYE_S = 1.0
_LOOK_S = 0.005


class GracefulShutdown:
    """Ends a side whose control has stopped; on the event loop.

    session, link_driver, clock : the side's. pump : sends due messages. report : reports the account to the peer, and
    returns whether the peer has answered.
    lingers : returns whether to wait for the energy in flight. hurried : returns whether to end at once.
    """

    def __init__(
        self,
        session: Session,
        link_driver: LinkDriver,
        clock: Clock,
        pump: Callable[[], None],
        report: Callable[[], bool],
        lingers: Callable[[], bool],
        hurried: Callable[[], bool],
    ) -> None:
        self._session, self._link_driver, self._clock = session, link_driver, clock
        self._pump, self._report, self._lingers, self._hurried = pump, report, lingers, hurried

    async def run(self, reason: str, linger_s: float, delay_s: float) -> None:
        """Wait at most `linger_s`, plus time for the emulated link's delay of `delay_s`, then leave; 0: do not wait."""
        loop, session = asyncio.get_running_loop(), self._session
        trip_s = min(2.0 * delay_s, MAX_TRIP_S)
        deadline = loop.time() + (linger_s + 2.0 * trip_s if linger_s else 0.0)
        self._report()
        self._pump()
        credited, quiet_until = -1, 0.0
        while loop.time() < deadline and self._lingers() and not self._hurried():
            with self._link_driver.lock:
                paired, settled, now = session.peer is not None, session.settled, session.credited_nJ
            if now != credited:
                credited, quiet_until = now, loop.time() + QUIET_S + trip_s
            if not paired or (self._report() and settled and loop.time() >= quiet_until):
                break
            await asyncio.sleep(_LOOK_S)
        with self._link_driver.lock:
            session.close(self._clock(), reason)
        self._pump()
        closed = loop.time()
        while self._link_driver.pending and not self._hurried():
            if loop.time() >= (deadline if self._lingers() else min(closed, deadline)) + _GOODBYE_S:
                break
            await asyncio.sleep(_LOOK_S)


GONE_NS = 10_000_000_000
"""A peer counts as gone when it has been silent for this time [ns] and has no connection of Zenoh's either."""

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
                    self._part(now_ns, f"this side ends, as its first {self._other} has left")
                elif left_s is None or left_s >= _WORTH_REPORTING_S:
                    how_long = "until it is stopped" if left_s is None else f"for the {left_s:.0f} s that are left"
                    text = f"waits for another {self._other} {how_long} (--once would end it now)"
                    self._notify(Notice("waiting", text, now_ns))

    def watch(self, now_ns: int, partners: int) -> None:
        """End a side with `--once` whose peer is gone. partners : the other side's processes, by Zenoh."""
        since_ns = self._silent_since_ns
        if self._once and since_ns is not None and not partners and now_ns - since_ns > GONE_NS:
            silent_s = (now_ns - since_ns) * NANO
            self._part(
                now_ns, f"this side ends: no data from its {self._other} for {silent_s:.0f} s, and no connection"
            )

    def _part(self, now_ns: int, text: str) -> None:
        self._once = False
        self._notify(Notice("once", f"{text} (--once)", now_ns))
        self._end()
