"""The servo's lateness beside a bare deadline loop in a process of its own: alone, and with a busy second thread."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

from hapnet.bench.row import Distribution, Limit, Options, Row
from hapnet.processes.child import Child, WaitForStart, together
from hapnet.realtime.servo import DeadlineGrid, Histogram, Servo, request_realtime, set_timer_slack, tuned_interpreter

PERIOD_NS = 1_000_000
BARE = "time.sleep to absolute deadlines in a process of its own"


@dataclass(frozen=True)
class Lateness:
    """How a loop kept its deadlines: (lateness [ns], count) pairs, and how many deadlines it skipped."""

    bins: tuple[tuple[int, int], ...]
    skipped: int
    refusal: str | None = None
    period_ns: int = PERIOD_NS

    @property
    def ticks(self) -> int:
        return sum(count for _, count in self.bins)

    @property
    def late(self) -> int:
        """Ticks that were late by a period or more."""
        return sum(count for edge, count in self.bins if edge >= self.period_ns)

    @property
    def distribution(self) -> Distribution:
        """In microseconds."""
        return Distribution.of_bins(self.bins, 1e-3)


def bare_loop(wait_for_start: WaitForStart, seconds: float, realtime: bool, period_ns: int = PERIOD_NS) -> Lateness:
    """The reference: a loop that wakes at each deadline and does nothing else."""
    set_timer_slack()
    late: list[int] = []
    clock, sleep = time.monotonic_ns, time.sleep
    wait_for_start()
    refusal = request_realtime() if realtime else None
    gc.disable()
    grid = DeadlineGrid(clock() + period_ns, period_ns)
    end_ns = grid.deadline_ns + round(seconds * 1e9)
    while grid.deadline_ns < end_ns:
        now_ns = clock()
        while now_ns < grid.deadline_ns:
            sleep((grid.deadline_ns - now_ns) * 1e-9)
            now_ns = clock()
        late.append(now_ns - grid.deadline_ns)
        grid.advance(clock())
    histogram = Histogram()  # the servo's bins, so that both are rounded alike
    for value in late:
        histogram.add(value)
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
    """The same beside a Python thread that never waits."""
    what = "the same beside a busy Python thread in its process"
    return _beside_bare("servo_busy_thread", what, options, busy_thread=True)


def late_share(subject: list[Lateness], bare: list[Lateness]) -> dict[str, float]:
    """Shares of ticks: late by a period or more, in the servo and in the bare loop, and the difference; and skipped."""
    ours, theirs = (sum(part.late for part in parts) / sum(part.ticks for part in parts) for parts in (subject, bare))
    skipped, bare_skipped = (
        sum(part.skipped for part in parts) / sum(part.ticks for part in parts) for parts in (subject, bare)
    )
    return {
        "late_period": ours, "late_period_bare": theirs, "late_period_excess": ours - theirs,
        "skipped": skipped, "skipped_bare": bare_skipped,
    }  # fmt: skip


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
    """A row of lateness, a part for each round; its further figures begin with `late_share`."""
    ours, theirs = ([part.distribution for part in parts] for parts in (subject, bare))
    said, figures = "; ".join(filter(None, (note, subject[0].refusal))), late_share(subject, bare) | dict(more or {})
    return Row(name, "us", what, ours, against, theirs, more=figures, limits=limits, note=said)


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
