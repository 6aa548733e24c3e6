from __future__ import annotations

import ctypes
import gc
import itertools
import math
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, strategies as st

from hapnet.errors import InvalidParameter
from hapnet.realtime import servo as servos
from hapnet.realtime.servo import DeadlineGrid, Servo, request_realtime, set_timer_slack, tuned_interpreter
from tests.support.elsewhere import Winmm

MS = 1_000_000
WAIT_S = 30.0


class VirtualTime:
    """A clock that only `sleep` and `spend` move, with a fixed oversleep."""

    def __init__(self, oversleep_ns: int = 0) -> None:
        self.now_ns = 123_456_789
        self.oversleep_ns = oversleep_ns

    def clock(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9) + self.oversleep_ns

    def spend(self, ns: int) -> None:
        self.now_ns += ns


def run_virtual(
    costs_ns: list[int], *, oversleep_ns: int = 0, period_ns: int = MS
) -> tuple[list[int], Servo, VirtualTime]:
    """Run one tick for each cost, which is the time that the tick takes; return when the ticks were called."""
    time = VirtualTime(oversleep_ns)
    called: list[int] = []

    def tick(now_ns: int) -> None:
        time.spend(costs_ns[len(called)])
        called.append(now_ns)
        if len(called) == len(costs_ns):
            servo.stop()
            done.set()

    done = threading.Event()
    servo = Servo(period_ns, tick, clock=time.clock, sleep=time.sleep)
    assert servo.start() is None
    assert done.wait(WAIT_S)
    servo.stop()
    assert not servo.running
    assert servo.error is None
    return called, servo, time


# The grid


@given(
    start=st.integers(-(10**18), 10**18),
    period=st.integers(1, 10**9),
    elapsed=st.lists(st.integers(0, 10**10), max_size=30),
)
def test_grid_takes_the_first_grid_point_not_passed_and_counts_the_others(
    start: int, period: int, elapsed: list[int]
) -> None:
    grid = DeadlineGrid(start, period)
    now = start
    for i, step in enumerate(elapsed, 1):
        now += step
        before = grid.deadline_ns
        missed = grid.advance(now)
        assert (grid.deadline_ns - start) % period == 0
        assert grid.deadline_ns >= now
        assert grid.deadline_ns > before
        assert grid.deadline_ns == before + period or grid.deadline_ns - period < now
        assert missed == (grid.deadline_ns - before) // period - 1
        assert grid.deadline_ns == start + (i + grid.skipped) * period


def test_grid_in_time_skips_nothing_even_when_a_tick_ends_exactly_on_the_next_deadline() -> None:
    grid = DeadlineGrid(0, 10)
    assert [grid.advance(now) for now in (9, 20, 31)] == [0, 0, 1]
    assert grid.deadline_ns == 40


@pytest.mark.parametrize("period", [0, -1])
def test_a_period_must_be_positive(period: int) -> None:
    with pytest.raises(InvalidParameter, match=f"period_ns is {period}; allowed: a positive"):
        DeadlineGrid(0, period)
    with pytest.raises(InvalidParameter, match="period_ns"):
        Servo(period, lambda now_ns: None)


def test_counting_anew_forgets_what_was_late() -> None:
    """Ten ticks of 3.5 periods, the count begun anew in the fifth: five ticks remain, and what six skipped."""
    called: list[int] = []
    time = VirtualTime()

    def tick(now_ns: int) -> None:
        called.append(now_ns)
        time.spend(3 * MS + MS // 2)
        if len(called) == 5:
            servo.count_anew()
        if len(called) == 10:
            servo.stop()
            done.set()

    done = threading.Event()
    servo = Servo(MS, tick, clock=time.clock, sleep=time.sleep)
    servo.start()
    assert done.wait(WAIT_S)
    servo.stop()
    assert (servo.stats().ticks, servo.stats().skipped) == (5, 6 * 3)


# The servo in virtual time


@given(st.lists(st.integers(0, 5 * MS), min_size=1, max_size=20))
def test_ticks_are_called_on_grid_points_only_and_never_in_a_burst(costs_ns: list[int]) -> None:
    called, servo, _ = run_virtual(costs_ns)
    gaps = [b - a for a, b in itertools.pairwise(called)]
    assert gaps == [max(1, math.ceil(cost / MS)) * MS for cost in costs_ns[:-1]]
    stats = servo.stats()
    assert stats.ticks == len(costs_ns)
    assert stats.skipped == sum(max(0, math.ceil(cost / MS) - 1) for cost in costs_ns)
    deadlines = range(called[0], called[-1] + 1, MS)
    late_ns = sorted(min(at for at in called if at >= deadline) - deadline for deadline in deadlines)
    assert len(late_ns) == stats.ticks + stats.skipped - max(0, math.ceil(costs_ns[-1] / MS) - 1)
    assert sum(count for _, count in stats.late_histogram_ns) == len(late_ns)
    assert stats.late_max_us == late_ns[-1] / 1e3
    assert stats.late_period == sum(late >= MS for late in late_ns)
    median = late_ns[math.ceil(len(late_ns) / 2) - 1] / 1e3
    assert stats.late_p50_us is not None
    assert median <= stats.late_p50_us <= median * 33 / 32


def test_a_stalled_servo_has_late_deadlines_not_late_ticks() -> None:
    """Half of the time in stalls of 100 ms: half of the deadlines were late by up to 100 ms, though each tick of theirs
    but one in a hundred was in time."""
    _, servo, _ = run_virtual([*[0] * 100, 100 * MS] * 10)
    stats = servo.stats()
    assert stats.late_p50_us is not None
    assert stats.late_p99_us is not None
    assert stats.late_p50_us < 1000.0
    assert stats.late_p99_us == pytest.approx(98_000.0, rel=0.04)
    assert stats.late_max_us == 99_000.0


def test_oversleep_is_lateness_and_does_not_accumulate() -> None:
    called, servo, _ = run_virtual([0] * 1000, oversleep_ns=50_000)
    assert called[-1] - called[0] == 999 * MS
    stats = servo.stats()
    assert (stats.ticks, stats.skipped) == (1000, 0)
    assert stats.late_max_us == 50.0
    assert stats.late_p50_us == stats.late_p99_us == 50.0


def test_before_the_first_tick_there_is_no_lateness() -> None:
    stats = Servo(MS, lambda now_ns: None).stats()
    assert (stats.ticks, stats.skipped, stats.late_p50_us, stats.late_max_us) == (0, 0, None, None)


# How it ends


def test_stop_calls_safe_once_after_the_last_tick_and_may_be_repeated() -> None:
    events: list[str] = []
    ticked = threading.Event()

    def tick(now_ns: int) -> None:
        events.append("tick")
        ticked.set()

    servo = Servo(MS, tick, safe=lambda: events.append("safe"))
    servo.start()
    assert ticked.wait(WAIT_S)
    servo.stop()
    servo.stop()
    assert events.count("safe") == 1
    assert events[-1] == "safe"
    assert not servo.running


def test_stop_before_start_ends_it_before_a_tick() -> None:
    events: list[str] = []
    servo = Servo(MS, lambda now_ns: events.append("tick"), safe=lambda: events.append("safe"))
    servo.stop()
    servo.start()
    servo.stop()
    assert events == ["safe"]


def test_an_exception_in_tick_makes_safe_first_then_tells_the_owner() -> None:
    events: list[object] = []
    said = threading.Event()
    error = ZeroDivisionError("in tick")

    def tick(now_ns: int) -> None:
        raise error

    def on_error(exc: BaseException) -> None:
        events.append(exc)
        said.set()

    servo = Servo(MS, tick, safe=lambda: events.append("safe"), on_error=on_error)
    servo.start()
    assert said.wait(WAIT_S)
    servo.stop()
    assert events == ["safe", error]
    assert servo.error is error
    assert servo.stats().ticks == 1


def test_a_failing_safe_is_reported_and_does_not_hide_the_first_error() -> None:
    def fail(error: Exception) -> Callable[..., None]:
        def call(*_: object) -> None:
            raise error

        return call

    first, second = ValueError("tick"), OSError("safe")
    reported: list[BaseException] = []
    servo = Servo(MS, fail(first), safe=fail(second), on_error=reported.append)
    servo.start()
    servo.join()
    assert reported == [first]
    assert servo.unsafe == "OSError: safe"

    servo = Servo(MS, lambda now_ns: servo.stop(), safe=fail(second), on_error=reported.append)
    servo.start()
    servo.stop()
    assert reported == [first, second]


def test_an_interpreter_that_exits_makes_safe_first() -> None:
    program = """
        import threading
        from hapnet.realtime.servo import Servo
        ticked = threading.Event()
        Servo(1_000_000, lambda now_ns: ticked.set(), safe=lambda: print("safe", flush=True)).start()
        assert ticked.wait(20)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=WAIT_S, check=True
    )
    assert (done.stdout, done.stderr) == ("safe\n", "")


# What is asked of the machine


def test_realtime_is_granted_or_refused_in_one_line() -> None:
    # in a process of its own: locked memory and SCHED_FIFO would stay with this one
    program = """
        import os, sys, threading
        from hapnet.realtime.servo import Servo
        policies, ticked = [], threading.Event()
        def tick(now_ns):
            policies.append(os.sched_getscheduler(0))
            ticked.set()
        servo = Servo(1_000_000, tick, realtime=True)
        refusal = servo.start()
        assert ticked.wait(20) and servo.error is None
        servo.stop()
        fifo = policies[0] == os.SCHED_FIFO
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
        assert fifo == ("SCHED_FIFO" not in (refusal or "")), refusal
        locked = [line.split()[1] for line in open("/proc/self/status") if line.startswith("VmLck")][0] != "0"
        assert locked == ("locked memory" not in (refusal or "")), refusal
        assert refusal is None or "\\n" not in refusal
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], timeout=WAIT_S, check=True)


def test_realtime_refused_says_what_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Libc:
        @staticmethod
        def mlockall(flags: int) -> int:
            return -1

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.sched_setscheduler", refuse)
    monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: Libc)
    line = request_realtime()
    assert "SCHED_FIFO: Operation not permitted (needs CAP_SYS_NICE" in line
    assert "locked memory: " in line
    assert "\n" not in line


@pytest.mark.skipif(sys.platform != "linux", reason="timer slack is Linux's")
def test_timer_slack_is_set_for_the_calling_thread_only() -> None:
    libc = ctypes.CDLL(None)
    get_timerslack = 30
    before = libc.prctl(get_timerslack, 0, 0, 0, 0)
    seen: list[object] = []

    def thread() -> None:
        seen.append(set_timer_slack())
        seen.append(libc.prctl(get_timerslack, 0, 0, 0, 0))

    worker = threading.Thread(target=thread)
    worker.start()
    worker.join()
    assert seen == [True, 1]
    assert libc.prctl(get_timerslack, 0, 0, 0, 0) == before


@pytest.fixture(params=[False, True], ids=["", "with objects of its own frozen"])
def program(request: pytest.FixtureRequest) -> Iterator[bool]:
    """A program that has frozen its objects, as the tests' own does, or has not; returns which."""
    if not request.param:
        gc.unfreeze()
    yield request.param
    gc.freeze()


def test_tuned_interpreter_collects_only_when_asked_and_restores_everything(program: bool) -> None:
    class Node:
        itself: Node

    interval = sys.getswitchinterval()
    assert gc.isenabled()
    frozen = gc.get_freeze_count()
    with tuned_interpreter() as collect:
        assert sys.getswitchinterval() == pytest.approx(1e-4)
        assert not gc.isenabled()
        assert gc.get_freeze_count() > frozen
        collect()
        node = Node()
        node.itself = node
        del node
        assert collect() >= 1
    assert sys.getswitchinterval() == interval
    assert gc.isenabled()
    assert (gc.get_freeze_count() > 0) == program


def test_two_that_overlap_leave_the_interpreter_as_the_first_found_it(program: bool) -> None:
    """Two sides of one program, the first of which ends first."""
    interval = sys.getswitchinterval()
    first, second = tuned_interpreter(), tuned_interpreter()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert sys.getswitchinterval() == pytest.approx(1e-4)
    assert not gc.isenabled()
    second.__exit__(None, None, None)
    assert sys.getswitchinterval() == interval
    assert gc.isenabled()
    assert (gc.get_freeze_count() > 0) == program


def follow_virtual(costs_ns: list[int]) -> tuple[list[int], Servo]:
    """Run a servo whose ticks wait by themselves, each as long as its cost; return when the ticks began."""
    time = VirtualTime()
    called: list[int] = []
    done = threading.Event()

    def tick(now_ns: int) -> None:
        called.append(time.clock())
        time.spend(costs_ns[len(called) - 1])
        if len(called) == len(costs_ns):
            servo.stop()
            done.set()

    servo = Servo(MS, tick, paced=False, clock=time.clock, sleep=time.sleep)
    servo.start()
    assert done.wait(WAIT_S)
    servo.stop()
    return called, servo


def test_a_device_that_waits_sets_the_pace() -> None:
    """Ticks follow one another without a sleep; late is what is beyond a period."""
    called, servo = follow_virtual([MS, MS, 3 * MS, MS, MS])
    assert [b - a for a, b in itertools.pairwise(called)] == [MS, MS, 3 * MS, MS]
    assert servo.stats().late_period == 2  # by 2 ms and by 1 ms, of the three periods that one tick took
    assert servo.stats().skipped == 2


def test_one_that_does_not_wait_leaves_the_processor_to_others() -> None:
    called, _ = follow_virtual([0] * 5)
    assert [b - a for a, b in itertools.pairwise(called)] == [MS // 10] * 4


@pytest.mark.parametrize(("result", "asked"), [(0, [("begin", 1), ("end", 1)]), (97, [("begin", 1)])])
def test_windows_is_asked_for_timers_of_1_ms(
    result: int, asked: list[tuple[str, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each timeBeginPeriod that was granted needs its timeEndPeriod (learn.microsoft.com, timeapi.h); 97 refuses it."""
    monkeypatch.setattr(servos.sys, "platform", "win32")
    monkeypatch.setattr(servos.ctypes, "WinDLL", Winmm, raising=False)
    monkeypatch.setattr(Winmm, "asked", [])
    monkeypatch.setattr(Winmm, "result", result)
    with tuned_interpreter():
        assert Winmm.asked == asked[:1]
    assert Winmm.asked == asked
