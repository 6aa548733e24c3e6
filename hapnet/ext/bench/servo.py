"""The servo's lateness beside a bare deadline loop in a process of its own: alone, and with a busy second thread."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hapnet.ext.bench.row import Distribution, Limit, Options, Row
from hapnet.processes.child import Child, WaitForStart, together
from hapnet.realtime.servo import DeadlineGrid, Servo, request_realtime, set_timer_slack, tuned_interpreter
from hapnet.records.histogram import Histogram
from hapnet.side.punctuality import KEPT

PERIOD_NS = 1_000_000
SKIPPED_EXCESS = 0.01
"""The amount by which the share of skipped deadlines may exceed the bare loop's: a percentage point."""

BARE = "time.sleep to absolute deadlines in a process of its own"


@dataclass(frozen=True)
class Lateness:
    """The lateness of a loop: (lateness [ns], count) pairs, and the number of skipped deadlines.

    Every deadline, also a skipped one, counts as late until the first tick after it.
    """

    bins: tuple[tuple[int, int], ...]
    skipped: int
    refusal: str | None = None
    period_ns: int = PERIOD_NS

    @property
    def deadlines(self) -> int:
        return sum(count for _, count in self.bins)

    @property
    def late(self) -> int:
        """The number of deadlines that were late by a period or more."""
        return sum(count for edge, count in self.bins if edge >= self.period_ns)

    @property
    def distribution(self) -> Distribution:
        """The distribution of the lateness [us]."""
        return Distribution.of_bins(self.bins, 1e-3)


def bare_loop(wait_for_start: WaitForStart, seconds: float, realtime: bool, period_ns: int = PERIOD_NS) -> Lateness:
    """The reference: a loop that only wakes at each deadline."""
    set_timer_slack()
    late: list[tuple[int, int]] = []
    clock, sleep = time.monotonic_ns, time.sleep
    wait_for_start()
    refusal = request_realtime() if realtime else None
    gc.disable()
    grid = DeadlineGrid(clock() + period_ns, period_ns)
    waiting_ns = grid.deadline_ns  # the earliest deadline that no tick has followed yet
    end_ns = grid.deadline_ns + round(seconds * 1e9)
    while grid.deadline_ns < end_ns:
        now_ns = clock()
        while now_ns < grid.deadline_ns:
            sleep((grid.deadline_ns - now_ns) * 1e-9)
            now_ns = clock()
        count = (now_ns - waiting_ns) // period_ns + 1
        late.append((now_ns - waiting_ns, count))
        waiting_ns += count * period_ns
        grid.advance(clock())
    histogram = Histogram()  # with the servo's bins, so that both are rounded equally
    for value, count in late:
        histogram.add_steps(value, period_ns, count)
    return Lateness(tuple(histogram.bins()), grid.skipped, refusal, period_ns)


def servo_loop(wait_for_start: WaitForStart, seconds: float, realtime: bool, busy_thread: bool) -> Lateness:
    """The servo with an empty tick and, if `busy_thread`, a second thread that computes all the time."""
    stop = threading.Event()

    def compute() -> None:
        count = 0
        while not stop.is_set():
            count += 1

    servo = Servo(PERIOD_NS, lambda now_ns: None, realtime=realtime)
    thread = threading.Thread(target=compute, daemon=True)
    wait_for_start()
    with tuned_interpreter():
        if busy_thread:
            thread.start()
        refusal = servo.start()
        time.sleep(seconds)
        servo.stop()
        stop.set()
    stats = servo.stats()
    return Lateness(stats.late_histogram_ns, stats.skipped, refusal)


def servo_idle(options: Options) -> Row:
    """The servo with an empty tick, and nothing else in its process."""
    return _beside_bare("servo_idle", "lateness of the servo, empty tick, idle process", options, busy_thread=False)


def servo_busy_thread(options: Options) -> Row:
    """The servo with an empty tick beside a Python thread that never waits."""
    what = "lateness of the servo, empty tick, beside a busy Python thread in its process"
    return _beside_bare("servo_busy_thread", what, options, busy_thread=True)


def late_share(subject: list[Lateness], bare: list[Lateness]) -> dict[str, float]:
    """The shares of late (by a period or more) and skipped deadlines of servo and bare loop, and their differences."""

    def share(parts: list[Lateness], counts: Callable[[Lateness], int]) -> float:
        return sum(map(counts, parts)) / max(1, sum(part.deadlines for part in parts))

    late, bare_late = (share(parts, lambda part: part.late) for parts in (subject, bare))
    skipped, bare_skipped = (share(parts, lambda part: part.skipped) for parts in (subject, bare))
    return {
        "late_period": late, "late_period_bare": bare_late, "late_period_excess": late - bare_late,
        "skipped": skipped, "skipped_bare": bare_skipped, "skipped_excess": skipped - bare_skipped,
    }  # fmt: skip


def rate_kept(subject: list[Lateness], bare: list[Lateness]) -> str:
    """A note with the rates of servo and bare loop if the servo did not keep its rate; empty: it did."""
    shares = late_share(subject, bare)
    kept, theirs = 1.0 - shares["skipped"], 1.0 - shares["skipped_bare"]
    nominal = 1e9 / subject[0].period_ns
    if kept >= KEPT:
        return ""
    return f"did not keep its rate: {kept * nominal:.0f} of {nominal:.0f} Hz, the bare loop {theirs * nominal:.0f} Hz"


def late_row(
    name: str,
    what: str,
    subject: list[Lateness],
    against: str,
    bare: list[Lateness],
    more: Mapping[str, float] | None = None,
    limits: tuple[Limit, ...] = (),
    note: str = "",
) -> Row:
    """A row of lateness, with a part for each round; its further figures begin with `late_share`."""
    ours, theirs = ([part.distribution for part in parts] for parts in (subject, bare))
    note_text = "; ".join(filter(None, (rate_kept(subject, bare), note, subject[0].refusal)))
    figures, limits = late_share(subject, bare) | dict(more or {}), (*limits, Limit("skipped_excess", SKIPPED_EXCESS))
    return Row(name, "us", what, ours, against, theirs, more=figures, limits=limits, note=note_text)


def _beside_bare(name: str, what: str, options: Options, *, busy_thread: bool) -> Row:
    subject: list[Lateness] = []
    bare: list[Lateness] = []
    seconds, realtime = options.seconds, options.realtime
    for _ in range(options.rounds):
        with Child(servo_loop, seconds, realtime, busy_thread) as one, Child(bare_loop, seconds, realtime) as other:
            ours, theirs = together([one, other], seconds + 30.0)
        subject.append(ours)
        bare.append(theirs)
    return late_row(name, what, subject, BARE, bare)
