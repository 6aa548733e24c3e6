"""The servo's process from the side of its parent; a wire half is not needed for it."""

import dataclasses
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hapnet.assembly.build import device_session, prepare
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from hapnet.realtime import servo_pipe
from hapnet.realtime.controllers import ControlCallbacks
from hapnet.realtime.servo_pipe import MAX_FRAME, Pipe, PipeClosed, available, socket_pair
from hapnet.realtime.servo_process import ServoProcess
from hapnet.recording.samples import DeviceSample, Event, Sample
from hapnet.wire.messages import Position, decode
from tests.support.processes import until

pytestmark = pytest.mark.skipif(not available(), reason="no SOCK_SEQPACKET here")

WAIT_S = 30.0


class Loose(SimulatedDevice):
    """A device without a hand; it writes to a file which force it got last."""

    def __init__(self, dof: int) -> None:
        super().__init__(Rest(dof, Impedance(0.1, 1.0, 10.0), (0.0,) * dof))
        self._diary = os.open(os.environ["HAPNET_TEST_DIARY"], os.O_WRONLY | os.O_CREAT)

    def apply(self, force: tuple[float, ...]) -> tuple[float, ...]:
        applied = super().apply(force)
        os.pwrite(self._diary, f"{max(map(abs, force)):12.6f}".encode(), 0)
        return applied


class Counting(Loose):
    """It writes to another file how often it got one."""

    count = 0

    def apply(self, force: tuple[float, ...]) -> tuple[float, ...]:
        self.count += 1
        Path(f"{os.environ['HAPNET_TEST_DIARY']}.count").write_text(f"{self.count} ", "ascii")
        return super().apply(force)


class Breaking(Loose):
    """Fails in its 50th reading, with something that is no error of hapnet's."""

    count = 0

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        self.count += 1
        if self.count == 50:
            raise ArithmeticError("a wire broke")
        return super().read()


class Unplugged:
    def __init__(self, dof: int) -> None:
        raise OSError("no such device")

    read = apply = print


class Running:
    """A servo's process and what came from it."""

    def __init__(self, hardware: str = "tests.realtime.test_servo_process:Loose", **words: object) -> None:
        params = Params().set({"scene": "free", "dof": 2, "hardware": hardware, **words})
        setup = prepare(params, "sampled")
        self.messages: list[bytes] = []
        self.samples: list[Sample] = []
        self.errors: list[BaseException] = []
        outlet = ControlCallbacks(self.messages.append, self.samples.append, self.errors.append, lambda: None)
        self.servo = ServoProcess(setup, device_session(setup, 7), outlet)

    @property
    def pid(self) -> int:
        process = self.servo._process
        return process.pid

    def paired(self) -> None:
        self.servo.start()
        self.servo.pair(False)
        until(lambda: self.servo.origin_ns is not None)


@pytest.fixture
def diary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "diary"
    monkeypatch.setenv("HAPNET_TEST_DIARY", str(path))
    return path


@pytest.fixture
def running(diary: Path) -> Iterator[Running]:
    made = Running()
    yield made
    made.servo.stop()


# -- the pipe ----------------------------------------------------------------------------------------------------------


def pair() -> tuple[Pipe, Pipe]:
    ours, theirs = socket_pair()
    return Pipe(ours), Pipe(theirs)


@pytest.fixture
def pipes() -> Iterator[tuple[Pipe, Pipe]]:
    ends = pair()
    yield ends
    for end in ends:
        end.close()


def test_frames_arrive_whole_and_in_order(pipes: tuple[Pipe, Pipe]) -> None:
    a, b = pipes
    assert b.look() is None
    assert a.offer("credit", 2**62)
    assert a.offer("arrive", (0.1, -0.0), 1e-9)
    assert b.look() == ("credit", 2**62)
    assert b.wait(WAIT_S) == ("arrive", (0.1, -0.0), 1e-9)
    assert b.wait(0.001) is None


def test_a_full_pipe_refuses_and_does_not_wait(pipes: tuple[Pipe, Pipe]) -> None:
    a, b = pipes
    taken = 0
    while a.offer("credit", taken):
        taken += 1
        assert taken < MAX_FRAME
    assert [b.look() for _ in range(taken)] == [("credit", k) for k in range(taken)]
    assert a.offer("credit", taken)


def test_a_gone_end_is_seen() -> None:
    a, b = pair()
    a.close()
    assert not b.offer("stop")
    for look in (b.look, lambda: b.wait(1.0)):
        with pytest.raises(PipeClosed):
            look()
    b.close()
    a, b = pair()
    b.offer("unread")
    a.close()  # with something unread the kernel says so differently
    with pytest.raises(PipeClosed):
        b.wait(1.0)
    b.close()


# -- the process -------------------------------------------------------------------------------------------------------


def test_it_ticks_renders_and_gives_its_account(running: Running, diary: Path) -> None:
    running.paired()
    servo = running.servo
    until(lambda: len(running.messages) >= 5)
    servo.on_sample((0.01, 0.0), 0, 0, 0)
    until(lambda: diary.exists() and float(diary.read_text() or 0.0) > 0.3)  # 100 N/m at 10 mm, on its way there
    servo.credit(1_000_000)
    until(lambda: any(isinstance(s, DeviceSample) and s.credited_J == 0.001 for s in running.samples))
    servo.stop()
    assert float(diary.read_text()) == 0.0
    positions = [decode(message) for message in running.messages]
    assert all(isinstance(message, Position) and message.incarnation == 7 for message in positions)
    numbers = [message.sequence for message in positions if isinstance(message, Position)]
    assert numbers == list(range(len(numbers)))
    summary = servo.part()
    assert summary["servo"]["ticks"] > 5
    assert sum(count for _, count in summary["servo"]["late_histogram_us"]) >= summary["servo"]["ticks"]
    assert summary["ledger"]["slack_J"] >= -1e-12
    assert not running.errors


def test_what_is_credited_arrives_once_though_the_pipe_was_full(running: Running) -> None:
    """Stopped, the servo reads nothing: the pipe fills with set-positions, and credits wait for it to go on."""
    running.paired()
    servo = running.servo
    os.kill(running.pid, signal.SIGSTOP)
    until(lambda: Path(f"/proc/{running.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
    stopped = time.monotonic()
    while servo._pipe.offer("arrive", 0, (0.001, 0.0), 0.0):
        pass
    for _ in range(200):
        servo.credit(1_000)
    assert servo._owed
    until(lambda: time.monotonic() > stopped + 0.05)  # more than the watchdog's 20 ms
    os.kill(running.pid, signal.SIGCONT)

    def credited() -> float:
        servo.on_sample((0.0, 0.0), 0, 0, 0)
        return max((s.credited_J for s in running.samples if isinstance(s, DeviceSample)), default=0.0)

    until(lambda: round(credited() * 1e9) == 200_000)
    servo.stop()
    last = running.samples[-1]
    assert isinstance(last, DeviceSample)
    assert round(last.credited_J * 1e9) == 200_000
    away = [s for s in running.samples if isinstance(s, Event)]
    assert servo.part()["servo"]["overruns"] >= 1
    assert away
    assert away[0].kind == "overrun"


def test_what_is_told_before_it_runs_reaches_the_servo() -> None:
    """As a page sends the side of a new episode where the hand is, while it still starts."""
    made = Running("simulated", operator="mouse")
    servo = made.servo
    servo.place((0.02, 0.03))
    servo.pause(True)
    servo.pause(False)
    servo.lead((0.02, -0.01))
    try:
        made.paired()

        def target() -> tuple[float, ...]:
            last = made.samples[-1] if made.samples else None
            return (last.operator_target_m or ()) if isinstance(last, DeviceSample) else ()

        until(lambda: target() == pytest.approx((0.02, -0.01), abs=1e-6))
        first = next(sample for sample in made.samples if isinstance(sample, DeviceSample))
        assert first.position_m == pytest.approx((0.02, 0.03), abs=2e-3)
    finally:
        servo.stop()
    assert not made.errors


def test_a_device_that_cannot_be_made_is_named(diary: Path) -> None:
    with pytest.raises(HapnetError, match=r"Unplugged.*no such device"):
        Running(f"{__name__}:Unplugged").servo.start()


def test_a_device_that_fails_is_told_in_one_line(diary: Path) -> None:
    running = Running(f"{__name__}:Breaking")
    running.paired()
    until(lambda: bool(running.errors))
    running.servo.stop()
    assert "a wire broke" in str(running.errors[0])
    assert float(diary.read_text()) == 0.0


def test_a_killed_servo_is_seen(running: Running) -> None:
    running.paired()
    os.kill(running.pid, signal.SIGKILL)
    until(lambda: bool(running.errors))
    assert str(running.errors[0]) == "the servo's process was killed by SIGKILL"


@pytest.mark.slow
def test_one_that_is_killed_as_it_is_asked_to_end_has_failed_too(running: Running) -> None:
    """Then it has not reported its account: a run of such a verdict must not end as if all were well."""
    running.paired()
    process = running.servo._process
    os.kill(process.pid, signal.SIGSTOP)  # so that it cannot have answered
    process.send_signal = lambda number: os.kill(process.pid, signal.SIGKILL)  # type: ignore[method-assign]
    running.servo.stop()
    assert str(running.errors[0]) == "the servo's process was killed by SIGKILL"
    assert running.servo.part()["servo"]["ticks"] is None


def test_a_stop_finds_its_way_though_the_pipe_is_full(running: Running, diary: Path) -> None:
    """The servo hangs for a moment while set-positions pour in; then it is told to stop."""
    running.paired()
    servo = running.servo
    os.kill(running.pid, signal.SIGSTOP)
    while servo._pipe.offer("arrive", (0.02, 0.0), 0.0):
        pass
    pid = running.pid
    threading.Timer(0.2, os.kill, (pid, signal.SIGCONT)).start()
    servo.stop()
    assert servo.part()["servo"]["ticks"] > 0  # it ended in order, and left its account
    assert float(diary.read_text()) == 0.0


def test_every_stop_returns_when_it_is_done(running: Running) -> None:
    running.paired()
    process = running.servo._process
    assert process is not None
    seen: list[int | None] = []

    def stop() -> None:
        running.servo.stop()
        seen.append(process.poll())

    threads = [threading.Thread(target=stop) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [0, 0, 0]


@pytest.mark.slow
def test_a_stop_while_it_starts_leaves_no_process(running: Running) -> None:
    starting = threading.Thread(target=running.servo.start)
    starting.start()
    until(lambda: running.servo._process is not None)
    process = running.servo._process
    running.servo.stop()
    starting.join()
    assert process.poll() == 0
    assert running.servo.start() is None  # and after a stop there is no start
    assert running.servo._process is None


@pytest.mark.slow
def test_what_fails_outside_is_told_and_ends_nothing_else(running: Running) -> None:
    """The link or the recording raises in this process: that is an error of the run, and the servo is still heard."""
    broken = ArithmeticError("the link broke")

    def send(message: bytes) -> None:
        raise broken

    servo = running.servo
    servo._callbacks = dataclasses.replace(servo._callbacks, send=send)
    running.paired()
    until(lambda: bool(running.errors))
    assert running.errors[0] is broken
    servo.stop()
    assert servo.part()["servo"]["ticks"] > 0


@pytest.mark.slow
def test_no_surplus_is_lost_to_a_parent_that_does_not_read(diary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parent stops reading for 500 ticks: positions are dropped and counted, energy is not."""
    running, reported = Running(f"{__name__}:Counting"), Path(f"{diary}.count")
    monkeypatch.setattr(servo_pipe, "_FROM_SERVO", 1 << 13)  # full after a few ticks
    resume = threading.Event()
    read = running.servo._pass_on
    given: list[float] = []

    def slow(frame: Any) -> None:
        if frame[0] == "position" and frame[1] > 0.0 and not resume.is_set():
            resume.wait(WAIT_S)
        read(frame)

    running.servo._pass_on = slow  # type: ignore[method-assign]
    running.paired()
    servo = running.servo
    servo.credit(200_000_000)  # more than the ceiling: with shuffle all the surplus goes back

    def ticks() -> int:
        servo.credit(1_000)
        return int(reported.read_text("ascii").partition(" ")[0] or 0) if reported.exists() else 0

    try:
        before = ticks()
        until(lambda: ticks() > before + 500)
    finally:
        resume.set()
        servo.stop()
    while servo.has_shuffled:
        given.append(servo.shuffled())
    summary = servo.part()
    last = [s for s in running.samples if isinstance(s, DeviceSample)][-1]
    assert summary["servo"]["unsent"] > 0
    assert sum(given) == pytest.approx(last.sent_J, abs=1e-12)


def test_ctrl_c_is_its_parents_affair_and_sigterm_ends_it_with_zero_force(running: Running, diary: Path) -> None:
    running.paired()
    running.servo.on_sample((0.02, 0.0), 0, 0, 0)
    until(lambda: diary.exists() and float(diary.read_text() or 0.0) > 0.3)
    os.kill(running.pid, signal.SIGINT)
    before = len(running.messages)
    until(lambda: len(running.messages) > before + 20)
    os.kill(running.pid, signal.SIGTERM)
    until(lambda: bool(running.errors))
    assert float(diary.read_text()) == 0.0


def test_a_class_of_the_script_itself_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["__main__"], "Mine", Unplugged, raising=False)
    setup = prepare(Params().set({"hardware": "__main__:Mine", "scene": "free"}), "sampled")
    with pytest.raises(InvalidParameter, match="in a module of its own"):
        ServoProcess(setup, device_session(setup, 7), ControlCallbacks(print, print, print, print))


def test_where_there_are_no_such_sockets_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    assert available()
    monkeypatch.delattr(socket, "SOCK_SEQPACKET")
    assert not available()
