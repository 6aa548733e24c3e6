"""Which calls of a driver are named: on a clock of the test's own, with as much waiting for a processor as it says."""

from __future__ import annotations

import time

import pytest

from hapnet.processes.system import ThreadTime
from hapnet.recording.samples import Event
from hapnet.side.driver_times import DriverTimes
from hapnet.summary.run import device_summary
from tests.side.test_real_device import Arm, Rig

MS = 1_000_000


class Calls:
    """The calls of a driver, a tick each; the servo has 1 kHz and a watchdog of 20 ms."""

    def __init__(self, *, paced: bool = True) -> None:
        self.times = DriverTimes("arm", MS, 20 * MS, paced=paced)
        self.now_ns = self.waited_ns = 0
        self.events: list[Event] = []

    def tick(self, read_ms: float = 0.1, waited_ms: float = 0.0, between_ms: float = 0.9, call: str = "read") -> None:
        self.times.between(self.now_ns)
        begun_ns, before_ns = self.now_ns, self.waited_ns
        self.now_ns += round(read_ms * MS)
        self.waited_ns += round(waited_ms * MS)
        event = self.times.called(call, begun_ns, self.now_ns, lambda: self.waited_ns, before_ns)
        self.events += [] if event is None else [event]
        self.now_ns += round(between_ms * MS)

    @property
    def said(self) -> list[str]:
        return [event.text for event in self.events]


@pytest.mark.parametrize("call", ["read", "apply"])
@pytest.mark.parametrize("paced", [True, False])
def test_a_hang_is_named_at_once_with_its_time(call: str, paced: bool) -> None:
    calls = Calls(paced=paced)
    for _ in range(10):
        calls.tick()
    calls.tick(4000.0, call=call)
    assert calls.said == [f"{call}() of arm took 4.0 s"]
    assert calls.times.blocked == f"{call}() of arm took 4.0 s"
    assert calls.times.blocked_ns == 4000 * MS
    assert calls.events[0].level == "warning"


def test_the_time_for_which_the_thread_waits_for_a_processor_does_not_count() -> None:
    calls = Calls()
    for _ in range(100):
        calls.tick(4000.0, waited_ms=3990.0)
    assert calls.times.blocked == ""


def test_stalls_of_50_ms_are_named_when_there_were_five() -> None:
    calls = Calls()
    for k in range(250):
        calls.tick(50.0 if k % 50 == 49 else 0.1)
        assert bool(calls.said) == (k == 249)
    assert calls.said == ["read() of arm took 50.0 ms, and 4 calls before it stalled too"]


def test_as_many_stalls_outside_of_the_calls_are_the_machines() -> None:
    calls = Calls()
    for k in range(5000):
        calls.tick(50.0 if k % 50 == 0 else 0.1, between_ms=50.0 if k % 50 == 25 else 0.9)
    assert calls.said == []
    assert calls.times.blocked == ""


def test_a_read_that_waits_for_its_device_may_take_its_time_often() -> None:
    calls = Calls(paced=False)
    for _ in range(1000):
        calls.tick(25.0)
    assert calls.said == []


def test_a_device_that_makes_250_of_1000_readings_is_named_once_and_so_is_its_recovery() -> None:
    calls = Calls()
    for _ in range(2000):
        calls.tick(4.0, between_ms=0.0)
    assert calls.said == ["read() of arm takes 4.0 ms: 250 of 1000 readings a second"]
    assert calls.times.rate_hz == pytest.approx(250.0, rel=0.01)
    for _ in range(1000):
        calls.tick()
    assert calls.said[1:] == ["read() of arm is fast enough again"]
    assert calls.times.rate_hz == pytest.approx(250.0, rel=0.01), "the summary says it at the end too"


def test_some_slow_readings_among_quick_ones_are_none() -> None:
    calls = Calls()
    for k in range(2000):
        calls.tick(4.0 if k % 3 == 0 else 0.1)
    assert calls.said == []


def test_a_thread_that_works_spends_its_time_and_one_that_sleeps_does_not() -> None:
    """However busy the machine is: a sleep counts for nothing, the rest is work, or waiting for a processor."""
    spent = ThreadTime()
    if spent() == 0:
        pytest.skip("this system does not say it")
    before_ns, begun_ns = spent(), time.monotonic_ns()
    worked = 0
    while worked < 2_000_000:
        worked += 1
    assert spent() - before_ns > 0.5 * (time.monotonic_ns() - begun_ns)
    before_ns, begun_ns = spent(), time.monotonic_ns()
    time.sleep(0.3)
    assert time.monotonic_ns() - begun_ns - (spent() - before_ns) > 0.95 * 300 * MS
    spent.close()


def test_after_its_end_it_looks_no_more() -> None:
    spent = ThreadTime()
    spent()
    for _ in range(2):
        spent.close()
    assert spent() == 0


class Hanging(Arm):
    rig: Rig | None = None

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        if self.rig is not None:
            self.rig.now_ns += 4000 * MS
            self.rig = None
        return super().read()


def test_a_run_whose_driver_hangs_names_it_and_counts_the_time_without_force() -> None:
    rig = Rig(Hanging)
    rig.tick(0.0, times=10)
    assert isinstance(rig.arm, Hanging)
    rig.arm.rig = rig
    rig.tick(0.0, times=10)
    name = f"{__name__}:Hanging"
    assert f"device: read() of {name} took 4.0 s" in rig.events
    assert any("the servo stalled for" in event and "no force" in event for event in rig.events)
    summary = device_summary(rig.side, "pspm")
    assert summary["driver"] is not None
    assert summary["driver"]["blocked"] == f"read() of {name} took 4.0 s"
    assert rig.side.punctuality.without_force_ns == pytest.approx(4000 * MS, abs=10 * MS)
