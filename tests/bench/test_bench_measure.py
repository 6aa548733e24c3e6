"""What measures, here shortly; at length under `slow`."""

import contextlib
import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.assembly.build import compiled_ends
from hapnet.errors import HapnetError
from hapnet.ext.bench import latency, page, plants, servo, sides, traffic, watched
from hapnet.ext.bench.plants import PairedDevice
from hapnet.ext.bench.registry import ROWS
from hapnet.ext.bench.row import Call, Options, Row, cost
from hapnet.ext.bench.wire import credit_times, link_release
from hapnet.ext.compiled import names, real_time
from hapnet.ext.compiled.real_time import CompiledTicks
from hapnet.ext.compiled.servo_end import CompiledServo
from hapnet.ext.tools.device import SimulatedHandle
from hapnet.processes.child import Child, WaitForStart, together
from hapnet.records.machine_code import no_compiler
from hapnet.transport.config import free_address
from hapnet.wire.messages import Position, encode
from hapnet.wire.session import Session
from netem import LinkProfile
from netem.errors import ProfileError
from tests.conftest import mostly_slow

SHORT = Options(seconds=0.1, rounds=1)
BY_HAND = ("batch_1000", "page_mesh", "servo_traffic_2khz", "servo_traffic_5khz", "one_way_latency",
           "one_way_latency_realtime")  # fmt: skip
"""Measures that take many seconds; but for the first one, others of these tests run the same code."""


def double(wait_for_start: WaitForStart, value: int) -> tuple[int, int]:
    wait_for_start()
    return 2 * value, os.getpid()


def fail(wait_for_start: WaitForStart) -> None:
    raise ValueError("no such luck")


def test_children_begin_together_and_answer() -> None:
    with Child(double, 3) as one, Child(double, 4) as other:
        (six, first), (eight, second) = together([one, other], 10.0)
    assert (six, eight) == (6, 8)
    assert len({first, second, os.getpid()}) == 3


def test_a_failure_in_a_child_is_told_and_none_outlives_its_context() -> None:
    with Child(fail) as child, pytest.raises(HapnetError, match="fail failed: ValueError: no such luck"):
        child.wait_ready()
    with Child(double, 1) as waiting:
        waiting.wait_ready()
        with pytest.raises(HapnetError, match="did not answer within 0 s"):
            waiting.result(0.01)
        process = waiting._process
    assert not process.is_alive()


def test_busy_processes_end_with_a_benchmark_that_is_killed() -> None:
    code = "import time; from hapnet.processes.child import busy\nwith busy(2): print(flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], start_new_session=True, stdout=subprocess.PIPE) as bench:
        try:
            bench.stdout.readline()
            assert len(processes_of(bench.pid)) == 3
            bench.kill()
            bench.wait()
            wait_until(lambda: not processes_of(bench.pid))
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(bench.pid, signal.SIGKILL)


# Costs


def test_prepare_runs_before_each_call_and_all_calls_count() -> None:
    done: list[str] = []
    subject = Call(lambda: done.append("call"), lambda: done.append("prepare"))
    (ours,), (theirs,) = cost(subject, Call(lambda: None), SHORT)
    assert done == ["prepare", "call"] * (len(done) // 2)
    assert ours.counts.sum() == theirs.counts.sum() == len(done) // 2 - 50  # the first turn warms
    assert ours.values[0] >= 0.0


@pytest.mark.parametrize(
    "name",
    ["device_tick", "pspm_update_3dof", "world_step_wall", "world_step_kilohertz", "codec_position", "codec_energy",
     "side_tick_pose", "side_tick_joints"],
)  # fmt: skip
def test_cost_rows(name: str) -> None:
    row = ROWS[name](SHORT)
    assert row.name == name
    assert row.unit == "us"
    assert 0.0 < row.figures.minimum <= row.figures.median <= row.figures.p99
    assert row.ratio == row.figures.median / row.reference.median
    assert row.against


@pytest.mark.slow
@pytest.mark.skipif(no_compiler() is not None, reason="nothing can be compiled")
def test_a_side_whose_ticks_are_timed_is_paired_and_compiled() -> None:
    real_time.make_ready(names.named(names.SERVO, 12))
    paired = PairedDevice({"scene": "tool:stick"}, compiled_ends())
    for _ in range(200):
        paired.prepare()
        paired.tick()
    servo = paired.side.servo
    assert isinstance(servo, CompiledServo)
    assert isinstance(paired.side.device, SimulatedHandle)
    assert isinstance(paired.side.device.compiled, CompiledTicks)
    assert paired.side.ticks > 150
    assert servo.model.has_earlier  # the world has answered
    assert any(servo.model.earlier)  # and moves


# Lateness


class Clock:
    """Stands still but for sleeps, of which some last longer than asked for: in place of the module `time`."""

    def __init__(self, late_ns: dict[int, int]) -> None:
        self.now_ns, self.sleeps = 7_000_000_000, 0
        self._late_ns = late_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.sleeps += 1
        self.now_ns += round(seconds * 1e9) + self._late_ns.get(self.sleeps, 0)


def test_the_bare_loop_counts_the_lateness_of_every_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 deadlines; the 10th tick comes 0.3 ms late, the 20th 5.3 ms: that one skips five, late by 4.3 to 0.3 ms."""
    monkeypatch.setattr(servo, "time", Clock({10: 300_000, 20: 5_300_000}))
    try:
        found = servo.bare_loop(lambda: None, 0.1, False)
    finally:
        gc.enable()
    assert (found.deadlines, found.skipped, found.refusal) == (100, 5, None)
    on_time, late, *later = found.bins
    assert on_time == (0, 93)
    assert late[1] == 2
    assert 300_000 <= late[0] < 330_000
    assert [count for _, count in later] == [1] * 5
    assert [edge / 1e6 for edge, _ in later] == pytest.approx([1.3, 2.3, 3.3, 4.3, 5.3], rel=0.04)


@pytest.mark.parametrize("busy_thread", [False, True])
def test_a_servo_and_a_bare_loop_run_beside_each_other(busy_thread: bool) -> None:
    with Child(servo.bare_loop, 0.1, False) as bare, Child(servo.servo_loop, 0.1, False, busy_thread) as subject:
        reference, ours = together([bare, subject], 10.0)
    assert reference.deadlines >= 100
    for found in (reference, ours):
        assert found.deadlines > found.skipped
        assert [edge for edge, _ in found.bins] == sorted(edge for edge, _ in found.bins)
        assert found.refusal is None


def test_a_tick_is_late_by_a_period_of_its_own_rate() -> None:
    """At 5 kHz by 0.2 ms; the deadlines of 0.1 s are then 500."""
    assert servo.Lateness(((199_999, 90), (200_000, 10)), 0, period_ns=200_000).late == 10
    with Child(servo.bare_loop, 0.1, False, 200_000) as bare:
        (found,) = together([bare], 10.0)
    assert found.deadlines >= 500
    assert found.period_ns == 200_000


def test_shares_of_late_deadlines() -> None:
    """Over two rounds of 50 and 150 deadlines: 1 + 5 late of 200, 14 skipped; of the bare loop's 100, 1 and 2."""
    ours = [servo.Lateness(((5, 49), (1_000_000, 1)), 4), servo.Lateness(((5, 145), (3_000_000, 5)), 10)]
    found = servo.late_share(ours, [servo.Lateness(((999_999, 99), (1_000_001, 1)), 2)])
    shares = {"late_period": 0.03, "late_period_bare": 0.01, "late_period_excess": 0.02}
    assert found == pytest.approx({**shares, "skipped": 0.07, "skipped_bare": 0.02, "skipped_excess": 0.05})


def test_link_release_is_netems_own_benchmark() -> None:
    row = link_release(SHORT)
    assert row.rounds[0].counts.sum() == row.bare_rounds[0].counts.sum() == 200


# Latency


def test_latency_joins_by_number_and_drops_the_start() -> None:
    """Position 3 is lost, and nobody of this run sent number 9."""
    sent_ns = [0, 400_000_000, 600_000_000, 700_000_000, 800_000_000]
    sent = [(at_ns, encode(Position(1, number, at_ns, (0.1,)))) for number, at_ns in enumerate(sent_ns)]
    arrived = [(90_000, 0), (600_100_000, 2), (800_070_000, 4), (800_080_000, 9)]
    found = latency.join(sent, arrived)
    assert found.values == pytest.approx([70.0, 100.0])
    with pytest.raises(HapnetError, match="no message arrived"):
        latency.join(sent, [])
    with pytest.raises(HapnetError, match="the servo sent no message"):
        latency.join([], arrived)


def test_a_message_says_when_its_tick_began() -> None:
    """Sent at 5 ns and 2 ms later; what is no position is left out."""
    first, second = (encode(Position(1, number, 5 + 2_000_000 * number, (0.1,))) for number in range(2))
    greeting = Session(role="device", dof=1, name="device", incarnation=1).poll(0)[0][0].data
    found = latency.tick_starts([(60_000, first), (70_000, greeting), (2_060_000, second)])
    assert found == [(5, first), (2_000_005, second)]


# Traffic


def test_a_side_may_say_much_on_standard_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three times what a pipe holds: unread, it would stop the side."""
    driver = tmp_path / "chatty.py"
    driver.write_text("import sys\nsys.stderr.write('x' * 200_000)\nraise ValueError('\\nno motor')\n", "utf-8")
    (tmp_path / "params.toml").write_text('hardware = "chatty:Motor"\n', "utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    side = sides.Side("device", tmp_path, "--connect", free_address())
    with side, pytest.raises(HapnetError, match=r"the device process: .*no motor"):
        side.expect("paired")


# Recovery and simulation


def test_energy_without_loss_takes_the_one_way_delay() -> None:
    assert credit_times(LinkProfile.parse("delay 40ms"), 50, 1) == [40_000_000] * 50


def test_lost_energy_is_credited_a_timeout_later_or_more() -> None:
    """RFC 6298: the timeout is never shorter than the smoothed round trip, 80 ms here."""
    times = credit_times(LinkProfile.parse("delay 40ms loss 20%"), 300, 1)
    late = [t for t in times if t != 40_000_000]
    assert 0.1 < len(late) / len(times) < 0.3  # 20 % of the first copies are lost
    assert min(late) >= 40_000_000 + 80_000_000
    assert min(times) == 40_000_000


def test_batch_counts_scenario_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(plants, "simulate_batch", lambda params, seeds, workers: asked.append(len(seeds)))
    monkeypatch.setattr(plants, "_elapsed", lambda call, *args: call(*args) or 0.5)
    monkeypatch.setattr(plants, "simulate", lambda params, seed: None)
    row = plants.batch_1000(SHORT)
    assert asked == [1000]
    assert row.figures.median == 1000 * 30.0 / 0.5
    assert row.ratio == 1000.0


# The command


@pytest.mark.slow
def test_the_command_writes_what_it_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = [
        "bench",
        "--only",
        "device_tick,codec_p*",
        "--seconds",
        "0.1",
        "--rounds",
        "2",
        "--out",
        str(tmp_path / "o"),
    ]
    with restored_signals():
        assert cli.main([*argv, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    rows = json.loads(out)
    assert [row["name"] for row in rows] == ["device_tick", "codec_position"]
    assert rows == json.loads((tmp_path / "o" / "bench.json").read_text("utf-8"))
    assert (tmp_path / "o" / "bench.png").stat().st_size > 10_000
    assert "1/2 device_tick" in err
    assert "median ≤ 5 " in err


def test_a_row_that_fails_costs_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(options: Options) -> Row:
        raise HapnetError("the cable is out")

    def unlinked(options: Options) -> Row:
        raise ProfileError("delay", "x", "a time")

    rows = {"broken": broken, "unlinked": unlinked, "sound": lambda options: Row("sound", "us", "sound")}
    monkeypatch.setattr("hapnet.ext.bench.registry.select", lambda only: rows)
    with restored_signals():
        assert cli.main(["bench", "--out", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    assert "broken: not measured: the cable is out" in out
    found = json.loads((tmp_path / "bench.json").read_text("utf-8"))
    assert [(row["name"], row["median"]) for row in found] == [("broken", None), ("unlinked", None), ("sound", None)]
    assert "delay" in found[1]["note"]


def test_interrupted_it_shows_what_it_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str] = []

    def interrupted(options: Options) -> Row:
        written.extend(row["name"] for row in json.loads((tmp_path / "bench.json").read_text("utf-8")))
        raise KeyboardInterrupt

    rows = {"first": lambda options: Row("first", "us", "something"), "second": interrupted}
    monkeypatch.setattr("hapnet.ext.bench.registry.select", lambda only: rows)
    with restored_signals():
        assert cli.main(["bench", "--out", str(tmp_path)]) == 130
    assert written == ["first"]
    assert "first: something" in capsys.readouterr().out


def test_interrupted_it_leaves_no_process(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hapnet", "bench", "--only", "servo_idle", "--seconds", "60"]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, cwd=Path(__file__).parents[2],
    ) as bench:  # fmt: skip
        try:
            wait_until(lambda: len(processes_of(bench.pid)) >= 3)
            os.killpg(bench.pid, signal.SIGINT)
            _, err = bench.communicate(timeout=60)
            wait_until(lambda: not processes_of(bench.pid))
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(bench.pid, signal.SIGKILL)
    assert bench.returncode == 130
    assert "Traceback" not in err


@pytest.mark.slow
def test_traffic_runs_at_a_kilohertz_each_way_beside_a_busy_process() -> None:
    row = traffic.servo_traffic(Options(seconds=3.0, rounds=1, beside=1))
    assert row.more["messages_per_s"] > 300  # a thousand on a machine that does nothing else
    assert f"{row.more['messages_per_s']:.0f} messages/s in the slower direction" in row.note
    assert row.rounds[0].counts.sum() > 900
    assert {limit.figure for limit in row.limits} == {"ratio", "ratio_p99", "late_period_excess", "skipped_excess"}


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_slow(["one_way_latency_realtime", "one_way_latency"], 0, 1))
def test_latency_beside_raw_zenoh(name: str) -> None:
    row = ROWS[name](Options(seconds=1.0, rounds=1))
    for found in (*row.rounds, *row.bare_rounds):
        assert found.counts.sum() > 300
        assert 5.0 < found.quantile(0.5) < 5000.0


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.soak if name in BY_HAND else pytest.mark.slow) for name in ROWS]
)
def test_every_row_is_measured(name: str) -> None:
    assert ROWS[name](SHORT).name == name


@contextlib.contextmanager
def restored_signals() -> Iterator[None]:
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def processes_of(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for directory in Path("/proc").iterdir():
        if directory.name.isdigit():
            with contextlib.suppress(OSError):
                state, *rest = (directory / "stat").read_text().rpartition(")")[2].split()
                if int(rest[2]) == session and state != "Z":
                    found.append(int(directory.name))
    return found


def wait_until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.slow
def test_a_watched_servo_is_measured_beside_one_that_nobody_watches() -> None:
    row = watched.servo_watched(Options(seconds=2.0, rounds=1))
    assert row.unit == "us"
    assert "reads all telemetry" in row.what
    assert {"late_period", "late_period_bare"} <= set(row.more)
    assert row.ratio_p99 is not None


@pytest.mark.slow
def test_a_client_of_a_page_with_a_mesh_gets_the_mesh_once_and_then_updates() -> None:
    row = page.page_mesh(Options(seconds=3.0, rounds=1))
    assert row.more["surfaces_sent"] == 1.0
    assert row.more["updates_hz"] > 0.0
    judged = {limit.figure for limit, _ in row.verdicts()}
    assert judged == {"updates_hz", "surfaces_sent", "ratio_p99", "skipped_excess"}


@pytest.mark.parametrize("hz", [60.0, 30.0])
def test_updates_a_second_are_counted_between_the_first_and_the_last(hz: float) -> None:
    assert page.Received(tuple(5.0 + k / hz for k in range(100)), 0.0, 1).updates_hz == pytest.approx(hz)
    assert page.Received((), 0.0, 0).updates_hz == 0.0
