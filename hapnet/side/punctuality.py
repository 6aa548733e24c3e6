"""Counts the late ticks of a servo, and reports stalls while they last."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.recording.samples import Event

REPEAT_NS = 1_000_000_000
"""A continuing stall is reported again after this time [ns]."""

WINDOW_NS = 10_000_000_000
"""The window over which the servo's rate is measured [ns]."""

KEPT = 0.95
"""A servo that makes a smaller share of its ticks than this does not keep its rate."""

_CHANGED = 0.1
_REMIND_NS = 60_000_000_000


class Punctuality:
    """Counts the late ticks of a servo, and the time without force; `see` takes each tick, in their order.

    period_ns : of the servo. watchdog_ns : a tick that comes later than this after its due time counts as late and
        renders no force; None: no tick counts as late.

    Attributes
    ----------
    late : the number of late ticks. max_ns : the longest time between two ticks [ns].
    without_force_ns : the time before each late tick, and from a tick that rendered no force to the next [ns].
    """

    def __init__(self, period_ns: int, watchdog_ns: int | None) -> None:
        self.late: int = 0
        self.max_ns: int = 0
        self.without_force_ns: int = 0
        self._period_ns = period_ns
        self._most_ns = 2**63 if watchdog_ns is None else period_ns + watchdog_ns
        self._released = False
        self._row = 0  # the number of late ticks in a row
        self._row_ns = self._reported_ns = self._reported_row = 0
        self._window_ns: int | None = None
        self._made = 0
        self._kept = 1.0
        self._kept_ns = 0

    def is_late(self, since_ns: int) -> bool:
        """Whether a tick that comes `since_ns` after the previous tick is late."""
        return since_ns > self._most_ns

    def see(self, now_ns: int, since_ns: int, *, released: bool, excused: bool = False) -> Sequence[Event]:
        """Count the tick at `now_ns`, `since_ns` after the previous tick; returns the events to report.

        released : the tick renders no force, since it is late or the force is withheld. excused : it is late because
        the device was silent, which is counted elsewhere; only the time without force counts here.
        """
        if since_ns > self.max_ns:
            self.max_ns = since_ns
        late = since_ns > self._most_ns
        if late or self._released:
            self.without_force_ns += since_ns
        self._released = released
        self._made += 1
        reports = self._count(now_ns, since_ns, late=late and not excused) if late or self._row else ()
        if self._window_ns is None or now_ns - self._window_ns >= WINDOW_NS:
            return (*reports, *self._rate(now_ns))
        return reports

    def made(self, ticks: int) -> None:
        """Count ticks that were made elsewhere, each in time."""
        self._made += ticks
        if ticks:
            self.max_ns = max(self.max_ns, self._period_ns)

    def _count(self, now_ns: int, since_ns: int, *, late: bool) -> Sequence[Event]:
        """Count a late tick, or the end of a row of them."""
        if late:
            self.late += 1
            self._row += 1
            self._row_ns += since_ns
            return [self._stalled(now_ns)] if self._row == 1 or now_ns - self._reported_ns >= REPEAT_NS else ()
        unreported = self._row > self._reported_row
        reports = [self._stalled(now_ns)] if unreported else ()
        self._row = self._row_ns = self._reported_row = 0
        return reports

    def _stalled(self, now_ns: int) -> Event:
        self._reported_ns, self._reported_row = now_ns, self._row
        if self._row == 1:
            how_long = f"{self._row_ns * 1e-6:.1f} ms"
        else:
            how_long = f"{seconds(self._row_ns * 1e-9)} s, late at each of {self._row} ticks"
        text = f"the servo stalled for {how_long} (machine too busy): no force until it is on time again"
        if self.late > self._row:
            text += f" ({self.late} late ticks so far, {seconds(self.without_force_ns * 1e-9)} s without force)"
        return Event(now_ns, "overrun", text, "warning")

    def _rate(self, now_ns: int) -> Sequence[Event]:
        """Report the rate when it gets too low or recovers; while it is too low, when it changes and once a minute."""
        began_ns, made = self._window_ns, self._made
        self._window_ns, self._made = now_ns, 0
        if began_ns is None:
            return ()
        lasted_ns = now_ns - began_ns
        kept = made * self._period_ns / lasted_ns
        slow, was_slow = kept < KEPT, self._kept < KEPT
        again = abs(kept - self._kept) >= _CHANGED or now_ns - self._kept_ns >= _REMIND_NS
        if not (again if slow and was_slow else slow != was_slow):
            return ()
        self._kept, self._kept_ns = kept, now_ns
        wanted, per_s = 1e9 / self._period_ns, made * 1e9 / lasted_ns
        ticks = f"{per_s:.0f} of {wanted:.0f} ticks a second over the last {lasted_ns * 1e-9:.0f} s"
        return [Event(now_ns, "rate", f"the servo made {ticks}", "warning" if slow else "info")]


def seconds(value: float) -> str:
    """Format a time [s] with three digits, without an exponent."""
    return f"{value:.3g}" if value < 100.0 else f"{value:.0f}"


def periods_until(now_ns: int, advanced_ns: int, period_ns: int) -> int:
    """The number of whole periods by which a device that was advanced to `advanced_ns` keeps up with `now_ns`."""
    return 1 + round((now_ns - advanced_ns - period_ns) / period_ns)
