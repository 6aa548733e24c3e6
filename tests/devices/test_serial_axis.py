"""The serial axis: its frames, its driver on a pseudo-terminal that the test writes to, its emulator in real time."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapnet.devices import serial_frames as wire
from hapnet.devices.serial_axis import SerialAxis
from hapnet.devices.serial_port import SerialPort
from hapnet.devices.serial_timing import Untimely, period_us
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.transport.config import free_address
from tests.support.processes import Program, assert_passive, read_json, started, until
from tests.support.serial_board import Pty

ABOUT = wire.About(2, 1000, 0, 20, 3_000_000, 1_500_000, 1000, 1000, 80_000, 2, 1)
NUMBERS = st.integers(0, 2**16 - 1)
STATES = st.builds(
    wire.State, st.integers(0, 255), NUMBERS, st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1), NUMBERS,
    st.integers(0, 2**32 - 1),
)  # fmt: skip


# Frames


def test_the_frames_of_the_page() -> None:
    """Byte for byte as serial_axis.md lays them out; the CRC of the digits 1 to 9 as its catalogues give it, 29B1."""
    state = wire.State(0x31, 77, 123_000, 20_513_000, 250, 4021)
    assert wire.state(state)[:-2].hex() == "53314d0078e00100e8003901fa00b50f0000"
    assert wire.state(state)[-2:] == crc16(wire.state(state)[:-2]).to_bytes(2, "big")
    assert wire.command(wire.Command(b"F", 77, -1000))[:-2].hex() == "464d0018fc"
    assert crc16(b"123456789") == 0x29B1
    assert (len(wire.state(state)), len(wire.about(ABOUT)), wire.COMMAND_SIZE) == (20, 32, 7)


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE bit by bit, as its definition says: polynomial 0x1021, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_the_flags() -> None:
    state = wire.State(0b0101_0010, 0, 0, 0, 0, 0)
    assert (state.buttons, state.homed, state.counted) == (2, True, -1)
    assert wire.State(wire.flags(2, homed=True, counted=-1), 0, 0, 0, 0, 0) == state


@given(st.lists(STATES, max_size=5), st.data())
def test_frames_read_back_however_they_are_cut(states: list[wire.State], data: st.DataObject) -> None:
    stream = wire.about(ABOUT) + b"".join(map(wire.state, states))
    frames, found = wire.Frames(), []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        found += frames.feed(stream[:cut])
        stream = stream[cut:]
    assert found == [ABOUT, *states]
    assert frames.damaged == 0


@given(STATES, st.data())
def test_a_damaged_frame_is_dropped_and_the_next_is_found(state: wire.State, data: st.DataObject) -> None:
    """Any one byte lost or changed is damage that this checksum always finds."""
    whole = wire.state(state)
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.integers(0, 255).filter(lambda byte: byte != whole[at]))
    for spoiled in (whole[:at] + bytes([other]) + whole[at + 1 :], whole[:at] + whole[at + 1 :]):
        after = [wire.state(state._replace(command=k)) for k in range(4)]  # a letter before them may look like a frame
        found = wire.Frames().feed(spoiled + b"".join(after))
        assert found[-3:] == [state._replace(command=k) for k in (1, 2, 3)]
        assert len(found) <= 4 or spoiled == whole


@given(st.binary(max_size=300))
def test_rubbish_is_no_frame_and_nothing_raises(raw: bytes) -> None:
    """A frame among random bytes has a chance of 1 in 65,536 at each letter: here a frame is one with the right CRC."""
    for found in wire.Frames().feed(raw):
        assert isinstance(found, wire.State | wire.About)
    wire.commands(raw)


@given(st.lists(st.tuples(NUMBERS, st.integers(-wire.FULL, wire.FULL)), max_size=4), st.binary(max_size=6))
def test_commands_read_back_after_rubbish(sent: list[tuple[int, int]], before: bytes) -> None:
    commands = [wire.Command(b"F", number, force) for number, force in sent]
    found, left = wire.commands(before + b"".join(map(wire.command, commands)))
    assert found == commands
    assert len(left) < wire.COMMAND_SIZE


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1))
def test_what_wraps_has_the_right_difference(start: int, change: int) -> None:
    assert wire.signed((start + change) % wire.WRAP - start) == change


# Timing


def arrivals(period: int, together: int, clock: float = 1.0, count: int = 60) -> list[tuple[float, list[int]]]:
    """States each `period` [us] that arrive so many together; the board's clock wraps in the middle."""
    states = [(wire.WRAP - 10_000 + round(k * period * clock)) % wire.WRAP for k in range(count)]
    return [((k + together) * period * 1e-6, states[k : k + together]) for k in range(0, count, together)]


@pytest.mark.parametrize(("period", "together"), [(1000, 1), (2000, 1), (1000, 2), (2000, 2)])
def test_the_period_is_what_the_board_made(period: int, together: int) -> None:
    assert period_us(arrivals(period, together)) == period


def test_one_late_arrival_is_no_burst() -> None:
    found = arrivals(1000, 1)
    together = [time_us for _, times in found[10:30] for time_us in times]
    assert period_us([*found[:10], (found[29][0], together), *found[30:]]) == 1000


@pytest.mark.parametrize(("period", "together"), [(1000, 3), (1000, 16), (2000, 3), (2000, 8)])
def test_bursts_are_named(period: int, together: int) -> None:
    apart = f"one each {period * 1e-3:g} ms, but arrive {period * together * 1e-3:g} ms apart"
    with pytest.raises(Untimely, match=apart) as found:
        period_us(arrivals(period, together))
    assert found.value.bursts


@pytest.mark.parametrize(("clock", "says"), [(64.0, "64 times as fast"), (0.5, "0.5 times as fast")])
def test_a_clock_that_is_wrong_is_named(clock: float, says: str) -> None:
    """A PWM at 62.5 kHz on timer 0 makes Arduino's micros() 64 times too fast."""
    with pytest.raises(Untimely, match=says):
        period_us(arrivals(1000, 1, clock))


def test_too_few_states() -> None:
    for count in (0, 1, 7):
        with pytest.raises(Untimely, match=f"only {count} states"):
            period_us(arrivals(1000, 1, count=count))


# The port


def adapter(folder: Path, path: str, held_ms: int) -> Path:
    timer = folder / Path(path).name / "latency_timer"
    timer.parent.mkdir()
    timer.write_text(f"{held_ms}\n", "ascii")
    return timer


def test_a_latency_timer_of_16_ms_is_named_with_what_to_do(tmp_path: Path) -> None:
    pty = Pty()
    timer = adapter(tmp_path, pty.path, 16)
    with pytest.raises(HapnetError, match=f"holds bytes for 16 ms: echo 1 | sudo tee {timer}"):
        SerialPort(pty.path, 1_000_000, tmp_path)
    timer.write_text("1\n", "ascii")
    SerialPort(pty.path, 1_000_000, tmp_path).close()
    pty.close()


def test_the_port_asks_for_low_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pseudo-terminal has no such mode, and that is no failure."""
    from serial import Serial

    asked: list[bool] = []
    pty = Pty()
    SerialPort(pty.path, 1_000_000).close()
    monkeypatch.setattr(Serial, "set_low_latency_mode", lambda _, on: asked.append(on))
    SerialPort(pty.path, 1_000_000).close()
    assert asked == [True]
    pty.close()


# The driver


class Board:
    """The other end of a pseudo-terminal: the test is the firmware, but threads answer, and send states until quiet."""

    def __init__(self, link: Path, about: wire.About = ABOUT, homed: bool = True) -> None:
        self._link, self.about, self.homed = link, about, homed
        self.heard: list[wire.Command] = []
        self.plug_in()

    def plug_in(self) -> None:
        self._pty = Pty()
        self._link.symlink_to(self._pty.path)
        self._quiet = threading.Event()
        self._answering = threading.Thread(target=self._answer, daemon=True)
        self._sending = threading.Thread(target=self._stream, daemon=True)
        self._answering.start()

    def pull_out(self) -> None:
        self._link.unlink()
        self._quiet.set()
        self._pty.type(b"!")  # ends the thread
        self._answering.join()
        if self._sending.is_alive():
            self._sending.join()
        self._pty.close()

    def quieten(self, axis: SerialAxis) -> None:
        """From now on the test sends the states."""
        self._quiet.set()
        self._sending.join()
        with suppress(DeviceSilent):
            while True:
                axis.read()

    def write(self, data: bytes) -> None:
        os.write(self._pty.board, data)

    def state(self, time_us: int, position_nm: int = 0, impulse: int = 0, buttons: int = 0, counted: int = 0) -> None:
        flags = wire.flags(buttons, homed=self.homed, counted=counted)
        self.write(wire.state(wire.State(flags, 0, time_us % wire.WRAP, position_nm, 0, impulse % wire.WRAP)))

    def _answer(self) -> None:
        unread = b""
        while b"!" not in (came := os.read(self._pty.board, 4096)):
            commands, unread = wire.commands(unread + came)
            for command in commands:
                if command.mark == b"Q":
                    self.write(wire.about(self.about))
                    if not self._sending.is_alive() and not self._quiet.is_set():
                        self._sending.start()
                self.homed |= command.mark == b"H"
                self.heard.append(command)

    def _stream(self) -> None:
        start_s = time.monotonic()
        while not self._quiet.wait(1e-3):
            self.state(round((time.monotonic() - start_s) * 1e6))


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    board = Board(tmp_path / "axis")
    yield board
    board.pull_out()


@pytest.fixture
def axis(board: Board, tmp_path: Path) -> Iterator[SerialAxis]:
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    board.quieten(axis)
    yield axis
    axis.close()


LATER_US = 3_000_000_000
"""By the board's clock, long after it was quiet."""


def acted_N(axis: SerialAxis) -> float:
    acted = axis.acted()
    assert acted is not None
    return acted[0]


def test_it_declares_what_the_board_says(axis: SerialAxis) -> None:
    assert (axis.force_limit, axis.continuous_force) == (3.0, 1.5)
    assert [axis.resolution, axis.workspace, axis.watchdog_s] == pytest.approx([1e-6, 0.08, 0.02])
    assert axis.dead_man == 1


def test_a_reading_in_si_units(axis: SerialAxis, board: Board) -> None:
    """20 mm/s: 20 um in 1 ms."""
    for k in range(3):
        board.state(LATER_US + 1000 * k, position_nm=12_345_000 + 20_000 * k, buttons=0b10)
        (x,), (v,) = axis.read()
    assert [x, v] == pytest.approx([0.012385, 0.02])
    assert axis.interval() == pytest.approx(1e-3)
    assert axis.buttons() == (False, True)


def test_a_command_in_parts_of_the_longest_force(axis: SerialAxis, board: Board) -> None:
    for force in (-1.5, 99.0):
        axis.apply((force,))
    sent = [wire.Command(b"F", 1, -16384), wire.Command(b"F", 2, 32767)]
    until(lambda: board.heard[-2:] == sent)


def test_the_newest_of_several_states_counts(axis: SerialAxis, board: Board) -> None:
    board.write(b"".join(wire.state(wire.State(16, 0, LATER_US + 1000 * k, k, 0, 0)) for k in range(3)))
    assert axis.read()[0][0] == pytest.approx(2e-9)


def test_the_force_that_acted_is_the_mean_over_what_was_lost(axis: SerialAxis, board: Board) -> None:
    """1 N for 1 ms, then 2 N for 3 ms, of which two states were damaged; both counters wrap meanwhile."""
    unit_uNs = 3e6 / 32767 * 256e-6  # of the impulse: 256 us of a 32767th of 3 N
    start_us, start = wire.WRAP - 500, wire.WRAP - 20
    board.state(start_us, impulse=start)
    axis.read()
    assert axis.acted() is None
    board.state(start_us + 1000, impulse=start + round(1000 / unit_uNs))
    axis.read()
    assert acted_N(axis) == pytest.approx(1.0, rel=0.02)  # 43 units
    board.write(b"S1230000SS5")
    board.state(start_us + 4000, impulse=start + round(7000 / unit_uNs))
    axis.read()
    assert acted_N(axis) == pytest.approx(2.0, rel=0.01)


def test_without_a_whole_state_it_is_silent(axis: SerialAxis, board: Board) -> None:
    board.write(wire.state(wire.State(16, 0, 0, 0, 0, 0))[:-1] + b"?")
    with pytest.raises(DeviceSilent, match="no whole state for"):
        axis.read()


def test_one_that_was_pulled_out_is_silent_until_it_is_back(axis: SerialAxis, board: Board) -> None:
    board.pull_out()
    with pytest.raises(DeviceSilent, match="has gone"):
        axis.read()
    with pytest.raises(DeviceSilent, match="has gone"):
        axis.apply((1.0,))
    with pytest.raises(DeviceSilent, match="has gone"):
        axis.read()
    board.plug_in()

    def back() -> bool:
        board.state(1000, position_nm=7)
        try:
            return axis.read()[0][0] == pytest.approx(7e-9)
        except DeviceSilent:
            return False

    until(back)
    assert axis.acted() is None  # the board may have started anew


def test_one_that_is_not_calibrated_says_how(board: Board, tmp_path: Path) -> None:
    board.homed = False
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    with pytest.raises(HapnetError, match=r"centre its handle, and use serial:.*,home=yes"):
        axis.home()
    axis.close()
    asked = SerialAxis(1, port=str(tmp_path / "axis"), home=True)
    asked.home()
    asked.close()
    assert wire.Command(b"H") in board.heard


def test_another_version_is_refused(board: Board, tmp_path: Path) -> None:
    board.about = ABOUT._replace(version=3)
    with pytest.raises(HapnetError, match="speaks version 3 of the protocol, not 2: flash the sketch"):
        SerialAxis(1, port=str(tmp_path / "axis"))


def test_a_sketch_of_version_1_is_refused(tmp_path: Path) -> None:
    """It sends lines of text, and does not know the question."""
    pty = Pty()
    line = b"S 123000 20513000 -1250 4021 77 1"
    os.set_blocking(pty.board, False)
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(1e-3):
            with suppress(BlockingIOError):
                os.write(pty.board, b"%b*%04X\n" % (line, crc16(line)))

    sending = threading.Thread(target=send)
    sending.start()
    try:
        with pytest.raises(HapnetError, match=r"speaks version 1 \(text\) of the protocol, not 2: flash the sketch"):
            SerialAxis(1, port=pty.path)
    finally:
        stop.set()
        sending.join()
        pty.close()


@pytest.mark.parametrize(
    ("dof", "port", "says"), [(3, "/dev/x", "dof"), (1, "", "serial:/dev/ttyACM0"), (1, "/dev/nil", "No such")]
)
def test_what_cannot_be_is_refused(dof: int, port: str, says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        SerialAxis(dof, port=port)


# The emulator, in a process of its own, as a user starts it


class Axis(Program):
    """`hapnet emulate serial`, ready to be opened at `link`."""

    def __init__(self, link: Path, *options: str, more: tuple[object, ...] = ()) -> None:
        super().__init__("emulate", ",".join([f"serial:link={link}", *options]), *more)
        self.until_line("emulates serial")


def test_a_run_with_the_axis(tmp_path: Path) -> None:
    """Paired, a contact felt, passive by both accounts: hapnet's, and that of the forces that really acted."""
    link, account = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, more=("--json", account)) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 3, "--json", "-", "--out", tmp_path) as program:
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        summary = json.loads(stdout)
        assert_passive(summary)
        device = summary["device"]
        assert device["force"] == "applied"
        assert device["driver"]["name"] == f"serial:{link}"
        assert device["ledger"]["slack_J"] >= -device["quantisation_J"]
        assert summary["motion"]["contacts"] >= 1
        assert summary["motion"]["peak_force_N"] > 0.3
        log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text("utf-8").splitlines()]
        reported = {(entry["role"], entry["text"]) for entry in log if entry["kind"] == "signal"}
        assert reported == {("device", "buttons = [true]"), ("world", "buttons = [true]")}
        os.kill(emulator.process.pid, signal.SIGTERM)
        assert emulator.end()[0] == 0
        bound = summary["theorem"]["bound_J"] + device["quantisation_J"]
        assert read_json(account)["most_given_J"] <= bound


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "says"),
    [("stall=2", "is silent, no force: no whole state"), ("noise=0.01", ""), ("rubbish=0.5", "")],
)
def test_a_faulty_axis_is_survived(fault: str, says: str, tmp_path: Path) -> None:
    link, reported = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, fault, more=("--json", reported)) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 5, "--json", "-", "--out", tmp_path) as program:
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        summary = json.loads(stdout)
        assert summary["verdict"]["passive"] is not False
        assert summary["motion"]["contacts"] >= 1
        driver = summary["device"]["driver"]
        assert driver["missed"] > 0
        lines = [line for line in stderr.splitlines() if "silent" in line]
        assert len(lines) == driver["silences"]
        if says:
            assert driver["silences"] >= 1  # a busy machine may add some
            assert any(says in line for line in lines)
            assert "is back after" in stderr
            assert driver["silent_s"] >= 0.4
        os.kill(emulator.process.pid, signal.SIGTERM)
        emulator.end()
        found = read_json(reported)
        assert found["most_given_J"] <= summary["theorem"]["bound_J"] + summary["device"]["quantisation_J"]
        assert found["released"] > 0 or not says  # its own watchdog took the force away


@pytest.mark.slow
def test_the_worlds_side_stops_the_force(tmp_path: Path) -> None:
    """SIGUSR1 to the world's process: the device renders no force any more, and the run stays passive."""
    link = tmp_path / "axis"
    address = free_address()
    with Axis(link):
        with (
            started("world", "-l", address, "--duration", 6, "--json", tmp_path / "world.json") as world,
            started("device", "--device", f"serial:{link}", "-e", address, "--duration", 6, "--json", "-") as device,
        ):
            device.until_line("paired")
            os.kill(world.process.pid, signal.SIGUSR1)
            device.until_line("renders no force any more: SIGUSR1")
            world.until_line("the device is told to give no force: SIGUSR1")
            code, stdout, stderr = device.end()
        assert code == 3, stderr
        assert json.loads(stdout)["device"]["stopped"]["asked"] is True


@pytest.mark.slow
def test_an_axis_in_millimetres_is_stopped(tmp_path: Path) -> None:
    link = tmp_path / "axis"
    with Axis(link, "units=1000"):
        with started("run", "--device", f"serial:{link}", "--duration", 5, "--out", tmp_path) as program:
            code, _, stderr = program.end()
        assert code in (2, 3), stderr
        assert "millimetres" in stderr


@pytest.mark.slow
def test_an_axis_that_is_killed_may_come_back(tmp_path: Path) -> None:
    link = tmp_path / "axis"
    with Axis(link) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 8, "--json", "-", "--out", tmp_path) as program:
            program.until_line("running: ")
            emulator.kill()
            program.until_line("has gone")
            with Axis(link):
                program.until_line("is back after")
                code, stdout, stderr = program.end()
        assert code == 0, stderr
        assert json.loads(stdout)["device"]["driver"]["silences"] >= 1


@pytest.mark.soak
def test_ten_minutes(tmp_path: Path) -> None:
    link, account = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, more=("--json", account)) as emulator:
        words = ("--realtime", "--duration", 600, "--json", "-", "--out", tmp_path)
        with started("run", "--device", f"serial:{link}", *words) as program:
            program.process.wait(700)
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        summary = json.loads(stdout)
        assert_passive(summary)
        device = summary["device"]
        print({key: device["servo"][key] for key in ("late_p50_us", "late_p99_us", "late_max_us", "overruns")})
        os.kill(emulator.process.pid, signal.SIGTERM)
        emulator.end()
        print(device["driver"], summary["theorem"], read_json(account))
        assert device["driver"]["silent_s"] < 6.0  # a machine that others use too; the emulator has no priority
        assert summary["motion"]["contacts"] >= 100
