"""The serial axis: its lines, its driver on a pseudo-terminal that the test writes to, its emulator in real time."""

from __future__ import annotations

import json
import os
import signal
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapnet.devices import serial_line as wire
from hapnet.devices.serial_axis import SerialAxis
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.transport.config import free_address
from tests.support.processes import Program, assert_passive, read_json, started, until

ABOUT = wire.About(1, 1000, 3000, 1500, 1000, 80_000, 20, 1, 2, 1)
NUMBERS = st.lists(st.integers(-(2**33), 2**33), max_size=8)


# Lines


def test_the_checksum_is_the_published_one() -> None:
    """CRC-16/CCITT-FALSE of the digits 1 to 9, as its catalogues give it."""
    assert wire.crc16(b"123456789") == 0x29B1
    assert wire.line("F", 1, -250000) == b"F 1 -250000*%04X\n" % wire.crc16(b"F 1 -250000")


@given(NUMBERS)
def test_a_line_reads_back(numbers: list[int]) -> None:
    assert wire.parse(wire.line("S", *numbers)[:-1]) == ("S", tuple(numbers))
    assert wire.parse(wire.line("S", *numbers)[:-1] + b"\r") == ("S", tuple(numbers))


@given(NUMBERS, st.data())
def test_a_damaged_line_is_dropped(numbers: list[int], data: st.DataObject) -> None:
    """Any one byte lost or changed is damage that this checksum always finds."""
    whole = wire.line("S", *numbers)[:-1]
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.integers(0, 255).filter(lambda byte: byte != whole[at]))
    changed = whole[:at] + bytes([other]) + whole[at + 1 :]
    read = wire.parse(changed)
    assert read is None or (read == wire.parse(whole) and changed.upper() == whole.upper())  # an f for an F
    lost = whole[:at] + whole[at + 1 :]
    assert wire.parse(lost) is None or lost == whole


@given(st.binary(max_size=300))
def test_rubbish_is_no_line(raw: bytes) -> None:
    for read in (wire.state, wire.about, wire.command):
        assert read(raw) is None


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31), 2**31 - 1))
def test_what_wraps_has_the_right_difference(start: int, change: int) -> None:
    assert wire.signed((start + change) % wire.WRAP - start) == change


# The driver


class Board:
    """The other end of a pseudo-terminal: the test is the firmware, but a thread answers what it is asked."""

    def __init__(self, link: Path, about: wire.About = ABOUT) -> None:
        self._link, self.about = link, about
        self.heard: list[bytes] = []
        self.plug_in()

    def plug_in(self) -> None:
        self._end, self._theirs = os.openpty()
        for end in (self._end, self._theirs):
            tty.setraw(end)
        self._link.symlink_to(os.ttyname(self._theirs))
        self._answering = threading.Thread(target=self._answer, args=(self._end,), daemon=True)
        self._answering.start()

    def pull_out(self) -> None:
        self._link.unlink()
        os.write(self._theirs, b"!")  # ends the thread
        self._answering.join()
        os.close(self._end)
        os.close(self._theirs)

    def write(self, data: bytes) -> None:
        os.write(self._end, data)

    def state(self, time_us: int, position_nm: int = 0, impulse_nNs: int = 0, buttons: int = 0) -> None:
        self.write(wire.line("S", time_us, position_nm, 5000, impulse_nNs, 0, buttons))

    def _answer(self, end: int) -> None:
        while b"!" not in (came := os.read(end, 4096)):
            for line in came.splitlines(keepends=True):
                if line == wire.line("I"):
                    os.write(end, wire.line("I", *self.about))
                if line == wire.line("H"):
                    self.about = self.about._replace(homed=1)
                self.heard.append(line)


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    board = Board(tmp_path / "axis")
    yield board
    board.pull_out()


@pytest.fixture
def axis(board: Board, tmp_path: Path) -> Iterator[SerialAxis]:
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    yield axis
    axis.close()


def acted_N(axis: SerialAxis) -> float:
    acted = axis.acted()
    assert acted is not None
    return acted[0]


def test_it_declares_what_the_board_says(axis: SerialAxis) -> None:
    assert (axis.rate_hz, axis.force_limit, axis.continuous_force) == (1000.0, 3.0, 1.5)
    assert [axis.resolution, axis.workspace, axis.watchdog_s] == pytest.approx([1e-6, 0.08, 0.02])
    assert axis.dead_man == 1


def test_a_reading_in_si_units(axis: SerialAxis, board: Board) -> None:
    board.state(1000, position_nm=12_345_000, buttons=0b10)
    (x,), (v,) = axis.read()
    assert [x, v] == pytest.approx([0.012345, 0.005])
    assert axis.buttons() == (False, True)


def test_a_command_in_micronewtons(axis: SerialAxis, board: Board) -> None:
    axis.apply((-1.25,))
    until(lambda: wire.line("F", 1, -1_250_000) in board.heard)


def test_the_newest_of_several_states_counts(axis: SerialAxis, board: Board) -> None:
    for k in range(3):
        board.state(1000 * k, position_nm=k)
    assert axis.read()[0][0] == pytest.approx(2e-9)
    assert axis.damaged == 2


def test_the_force_that_acted_is_the_mean_over_what_was_lost(axis: SerialAxis, board: Board) -> None:
    """1 N for 1 ms, then 2 N for 3 ms, of which two states were damaged; both counters wrap meanwhile."""
    start_us, start_nNs = wire.WRAP - 500, wire.WRAP - 2_000_000
    board.state(start_us, impulse_nNs=start_nNs)
    axis.read()
    assert axis.acted() is None
    board.state((start_us + 1000) % wire.WRAP, impulse_nNs=(start_nNs + 1_000_000) % wire.WRAP)
    axis.read()
    assert acted_N(axis) == pytest.approx(1.0)
    board.write(b"S 1 2 3*0000\nS 5\n")
    board.state((start_us + 4000) % wire.WRAP, impulse_nNs=(start_nNs + 7_000_000) % wire.WRAP)
    axis.read()
    assert acted_N(axis) == pytest.approx(2.0)
    assert axis.interval() == pytest.approx(3e-3)  # by the board's clock, whenever the states came
    assert axis.damaged == 2


def test_a_pause_in_which_the_impulse_may_have_wrapped_leaves_the_force_unknown(axis: SerialAxis, board: Board) -> None:
    for time_us in (0, 600_000):
        board.state(time_us)
        axis.read()
    assert axis.acted() is None
    assert axis.interval() is None


def test_without_a_whole_state_it_is_silent(axis: SerialAxis, board: Board) -> None:
    board.write(b"S 1 2 3 4 5 6*0000\n")
    with pytest.raises(DeviceSilent, match="no whole state for 2 ms"):
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
    board.about = ABOUT._replace(homed=0)
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    with pytest.raises(HapnetError, match=r"centre its handle, and use serial:.*,home=yes"):
        axis.home()
    axis.close()
    asked = SerialAxis(1, port=str(tmp_path / "axis"), home=True)
    asked.home()
    asked.close()
    assert wire.line("H") in board.heard


def test_another_version_is_refused(board: Board, tmp_path: Path) -> None:
    board.about = ABOUT._replace(version=2)
    with pytest.raises(HapnetError, match="speaks version 2 of the protocol, not 1"):
        SerialAxis(1, port=str(tmp_path / "axis"))


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
