"""The servo: one thread that calls ``tick`` once a period, on absolute deadlines.

* Deadlines lie on the grid ``start + k period``; lateness never accumulates. After an overrun there is no burst: the
  deadlines that passed meanwhile are skipped and counted (`DeadlineGrid`).
* The thread requests a timer slack of 1 ns (Linux would add its default of 50 us to every sleep).
* However the thread ends, ``safe`` is called after the last tick: it sets the force to zero.

A process that runs a servo should do its work inside `tuned_interpreter`, which sets a short switch interval and
prevents garbage collection inside ticks.

`Stepper` is the world's thread: a step begins when the time of the last step is over.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.records.histogram import Histogram

SWITCH_INTERVAL_S = 1e-4
"""Beside a busy Python thread the servo overslept by 5 ms with the default of 5 ms; 1e-5 s was worse than both."""

FIFO_PRIORITY = 80
"""Above the kernel's threaded interrupts (50), below its watchdogs (99)."""

COARSEST_S = 1e-4
"""The coarsest clock for a servo. Before Python 3.13 that of Windows made steps of 15.6 ms (gh-88494)."""

WINDOWS_TIMER_MS = 1
"""Windows wakes a waiting program at ticks of 15.6 ms; every program may ask for finer ones."""

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3


class DeadlineGrid:
    """The next deadline on the grid ``start_ns + k period_ns``: integer arithmetic, no clock.

    Attributes
    ----------
    deadline_ns : the next deadline.
    skipped : the number of deadlines so far that passed before the previous tick had ended.

    Raises InvalidParameter: the period is not positive.
    """

    def __init__(self, start_ns: int, period_ns: int) -> None:
        if period_ns <= 0:
            raise InvalidParameter("period_ns", period_ns, "a positive number of nanoseconds")
        self.deadline_ns: int = start_ns
        self.period_ns = period_ns
        self.skipped: int = 0

    def advance(self, now_ns: int) -> int:
        """Go to the first later grid point that has not passed at `now_ns`; return how many were skipped."""
        following = self.deadline_ns + self.period_ns
        missed = max(0, -((following - now_ns) // self.period_ns))  # ceil((now - following) / period)
        self.deadline_ns = following + missed * self.period_ns
        self.skipped += missed
        return missed


@dataclass(frozen=True, slots=True)
class ServoStats:
    """Statistics of how the servo kept its deadlines.

    Lateness is the time from a deadline to the first call of tick after it (None before the first). Every deadline has
    one, also the skipped ones, so the denominator of a fraction is `ticks` and `skipped` together.
    """

    ticks: int
    skipped: int
    """Deadlines that passed before the previous tick had ended."""
    late_period: int
    """Deadlines that were late by a period or more."""
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None
    late_histogram_ns: tuple[tuple[int, int], ...]
    """(upper edge, count), see `Histogram.bins`."""


class Servo:
    """A thread that calls ``tick(now_ns)`` once every `period_ns`.

    period_ns : the period [ns].
    tick : called on the servo's thread with the clock's reading [ns]. An exception ends the servo.
    safe : called on the servo's thread when it ends, for any reason: it must set the force to zero. An
        interpreter that exits stops its servos first.
    on_error : called with the exception that ended the servo, on its thread, after `safe`. It is kept in `error` too.
    paced : False: `tick` itself waits, for a device that sets the pace; it is called again as soon as it returns.
    realtime : request SCHED_FIFO and locked memory; `start` returns the reason if they are refused.
    clock, sleep : a monotonic clock [ns], and a function that sleeps a number of seconds on it.

    Raises InvalidParameter: the period is not positive.
    """

    def __init__(
        self,
        period_ns: int,
        tick: Callable[[int], None],
        *,
        safe: Callable[[], None] | None = None,
        on_error: Callable[[BaseException], None] | None = None,
        paced: bool = True,
        realtime: bool = False,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._grid = DeadlineGrid(0, period_ns)
        self._tick, self._safe, self._on_error = tick, safe, on_error
        self._realtime, self._clock, self._sleep = realtime, clock, sleep
        self._paced = paced
        self._lateness = Histogram()
        self._ticks = self._late_period = 0
        self._waiting_ns = 0  # the earliest deadline that no tick has followed yet
        self._stopping = threading.Event()
        self._ready = threading.Event()
        self._refusal: str | None = None
        self.unsafe: str | None = None
        """The failure of `safe`, once the servo has ended; None: it did not fail."""
        self._thread = threading.Thread(target=self._main, name="servo", daemon=True)
        self.error: BaseException | None = None

    @property
    def running(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def start(self) -> str | None:
        """Start the thread, once; returns one line on why real-time scheduling was refused, or None."""
        # An exiting interpreter kills a daemon thread at once, and waits for any other thread. So the servo is a
        # daemon, and atexit stops it in time for `safe`.
        atexit.register(self.stop)
        self._thread.start()
        self._ready.wait()
        return self._refusal

    def stop(self) -> None:
        """End the servo and wait until `safe` has returned (inside `tick`: without waiting). May be called again."""
        self._stopping.set()
        if self._thread is not threading.current_thread() and self._thread.ident is not None:
            self.join()
        atexit.unregister(self.stop)

    def count_anew(self) -> None:
        """Reset the lateness statistics, from inside a tick: the ticks before the sides have met are only start-up."""
        self._lateness = Histogram()
        self._ticks = self._late_period = self._grid.skipped = 0

    def join(self) -> None:
        """Wait until the servo has ended."""
        self._thread.join()

    def stats(self) -> ServoStats:
        """Return the statistics so far; from any thread."""
        late = self._lateness
        p50, p99 = late.quantile(0.50), late.quantile(0.99)
        return ServoStats(
            ticks=self._ticks,
            skipped=self._grid.skipped,
            late_period=self._late_period,
            late_p50_us=None if p50 is None else p50 / 1e3,
            late_p99_us=None if p99 is None else p99 / 1e3,
            late_max_us=None if p50 is None else late.max / 1e3,
            late_histogram_ns=late.bins(),
        )

    def _main(self) -> None:
        try:
            try:
                self._prepare_thread()
            finally:
                self._ready.set()
            self._run() if self._paced else self._follow()
        except BaseException as error:
            self.error = error
        try:
            if self._safe is not None:
                self._safe()
        except BaseException as error:
            self.unsafe = f"{type(error).__name__}: {error}"
            self.error = self.error or error
        if self.error is not None and self._on_error is not None:
            self._on_error(self.error)

    def _prepare_thread(self) -> None:
        set_timer_slack()
        if self._realtime:
            self._refusal = request_realtime()

    def _run(self) -> None:
        clock, sleep, tick, grid = self._clock, self._sleep, self._tick, self._grid
        grid.deadline_ns = self._waiting_ns = clock() + grid.period_ns
        while not self._stopping.is_set():
            now_ns = clock()
            while now_ns < grid.deadline_ns:
                sleep((grid.deadline_ns - now_ns) * 1e-9)
                now_ns = clock()
            if self._stopping.is_set():
                return
            self._count(now_ns)
            tick(now_ns)
            grid.advance(clock())

    def _follow(self) -> None:
        """Call a tick that waits by itself; it is late by the time that it takes beyond a period.

        A tick that fails to wait must not block the processor: each takes at least a tenth of a period.
        """
        clock, tick, period_ns = self._clock, self._tick, self._grid.period_ns
        before_ns = clock()
        while not self._stopping.is_set():
            tick(before_ns)
            if (left_ns := before_ns + period_ns // 10 - clock()) > 0:
                self._sleep(left_ns * 1e-9)
            now_ns = clock()
            self._waiting_ns = min(before_ns + period_ns, now_ns)
            self._grid.skipped += self._count(now_ns) - 1
            before_ns = now_ns

    def _count(self, now_ns: int) -> int:
        """Count the lateness of every deadline up to a tick at `now_ns`; returns the number of deadlines."""
        late_ns, period_ns = now_ns - self._waiting_ns, self._grid.period_ns
        deadlines = late_ns // period_ns + 1
        if deadlines == 1:
            self._lateness.add(late_ns)
        elif deadlines > 1:
            self._lateness.add_steps(late_ns, period_ns, deadlines)
            self._late_period += deadlines - 1
        self._waiting_ns += deadlines * period_ns
        self._ticks += 1
        return deadlines


def set_timer_slack(slack_ns: int = 1) -> bool:
    """Ask the kernel to wake the calling thread at most `slack_ns` late; False where that is not possible."""
    done = False
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        done = bool(libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(slack_ns), 0, 0, 0) == 0)
    return done


def request_realtime(priority: int = FIFO_PRIORITY) -> str | None:
    """Put the calling thread under SCHED_FIFO and lock the process's memory; one line on what was refused, or None."""
    refused = []
    if sys.platform == "linux":
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError as error:
            refused.append(f"SCHED_FIFO: {error.strerror} (needs CAP_SYS_NICE, or an rtprio limit of {priority})")
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
            reason = os.strerror(ctypes.get_errno())
            refused.append(f"locked memory: {reason} (needs CAP_IPC_LOCK, or a higher memlock limit)")
    else:
        refused.append(f"not available on {sys.platform}")
    return "no real-time scheduling: " + "; ".join(refused) if refused else None


def require_fine_clock(resolution_s: float = time.get_clock_info("monotonic").resolution) -> None:
    """Raise HapnetError if `time.monotonic_ns` is too coarse for a servo."""
    if resolution_s > COARSEST_S:
        advice = "on Windows take Python 3.13 or later"
        raise HapnetError(f"this Python's monotonic clock makes steps of {resolution_s * 1e3:.3g} ms: {advice}")


class _Tuning:
    """The interpreter's settings before the first servo; servos may start and end in any order."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._before = (0.0, True, 0)

    def enter(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._before = sys.getswitchinterval(), gc.isenabled(), gc.get_freeze_count()
                gc.collect()  # not beside another servo, which would wait for it
                gc.disable()
                sys.setswitchinterval(SWITCH_INTERVAL_S)
            gc.freeze()

    def leave(self) -> None:
        with self._lock:
            self._users -= 1
            if self._users:
                return
            interval, automatic, frozen = self._before
            sys.setswitchinterval(interval)
            if not frozen:  # unfreezing would also thaw objects that the program itself froze
                gc.unfreeze()
            if automatic:
                gc.enable()


_tuning = _Tuning()


@contextlib.contextmanager
def tuned_interpreter() -> Iterator[Callable[[], int]]:
    """Tune the interpreter for a servo inside this context; leaving the last such context restores the settings.

    Threads switch every `SWITCH_INTERVAL_S`. Objects that exist already are exempt from garbage collection; they stay
    exempt afterwards if the program had exempted some itself, as Python cannot distinguish the two.
    Automatic collection is off: it would run inside any thread that allocates, even the servo's, for any time.
    Reference counting still frees everything that is not in a cycle. For cycles, the context yields a function to call
    about once a second outside of ticks. It collects the young generations only, so its pause is bounded by the
    allocations since the last call, not by the size of the heap. It returns the number of objects it found.
    On Windows timers are as fine as `fine_timer` makes them.
    """
    _tuning.enter()
    try:
        with fine_timer():
            yield lambda: gc.collect(1)
    finally:
        _tuning.leave()


@contextlib.contextmanager
def fine_timer() -> Iterator[None]:
    """Ask Windows for timers of `WINDOWS_TIMER_MS` inside this context (winmm's ``timeBeginPeriod``).

    An emulated link's messages would else be up to 15.6 ms late. Other systems have fine timers.
    """
    if sys.platform == "win32":
        winmm = ctypes.WinDLL("winmm")
        granted = winmm.timeBeginPeriod(WINDOWS_TIMER_MS) == 0
        try:
            yield
        finally:
            if granted:
                winmm.timeEndPeriod(WINDOWS_TIMER_MS)
    else:
        yield


_MAX_SLEEP_S = 0.1
"""`stop` takes effect within this time [s], however long a step is."""


class StepLoop(Protocol):
    """The steps of a world in real time."""

    def start(self) -> None:
        """Begin to step."""

    def stop(self) -> None:
        """Make no more steps; returns when the last one has ended."""


MakeStepLoop = Callable[[Callable[[int], int], Callable[[BaseException], None], Callable[[], int]], StepLoop]
"""Makes the steps of a world from the arguments of `Stepper`."""


class Stepper:
    """A thread that calls ``step(now_ns)`` again and again: each call returns the next step's length [ns].

    A late step becomes a longer step. The next step's time begins at its end, so there is never a burst.
    """

    def __init__(
        self, step: Callable[[int], int], on_error: Callable[[BaseException], None], clock: Callable[[], int]
    ) -> None:
        self._step, self._on_error, self._clock = step, on_error, clock
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="world", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _main(self) -> None:
        set_timer_slack()
        try:
            deadline_ns = self._clock()
            while not self._stopping.is_set():
                now_ns = self._clock()
                if now_ns < deadline_ns:
                    time.sleep(min((deadline_ns - now_ns) * 1e-9, _MAX_SLEEP_S))
                else:
                    deadline_ns = now_ns + self._step(now_ns)
        except BaseException as error:
            self._on_error(error)
