"""The serial axis's driver and port, on a pseudo-terminal that the test writes to."""

import binascii
import os
import re
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices import serial_frames as wire
from hapnet.ext.devices.serial_axis import SerialAxis
from hapnet.ext.devices.serial_port import SerialPort
from tests.support.processes import started, until
from tests.support.serial_board import Pty

ABOUT = wire.About(2, 1000, 0, 20, 3_000_000, 1_500_000, 1000, 1000, 80_000, 2, 1)


# The port


def adapter(folder: Path, path: str, held_ms: int) -> Path:
    timer = folder / Path(path).name / "latency_timer"
    timer.parent.mkdir()
    timer.write_text(f"{held_ms}\n", "ascii")
    return timer


def test_a_latency_timer_of_16_ms_is_named_with_what_to_do(tmp_path: Path) -> None:
    pty = Pty()
    timer = adapter(tmp_path, pty.path, 16)
    with pytest.raises(HapnetError, match=f"delays bytes by 16 ms: echo 1 | sudo tee {timer}"):
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


def test_a_port_that_another_program_uses() -> None:
    pty = Pty()
    first = SerialPort(pty.path, 1_000_000)
    with pytest.raises(InvalidParameter, match="another program uses it"):
        SerialPort(pty.path, 1_000_000)
    first.close()
    SerialPort(pty.path, 1_000_000).close()
    pty.close()


# The driver


class Board:
    """The other end of a pseudo-terminal: the test is the firmware, but threads answer, and send states until quiet."""

    def __init__(self, link: Path, about: wire.About = ABOUT, homed: bool = True) -> None:
        self._link, self.about, self.homed = link, about, homed
        self.heard: list[wire.BoardCommand] = []
        self.period_s = 1e-3
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

    def state(
        self, time_us: int, position_nm: int = 0, impulse: int = 0, buttons: int = 0, counted: int = 0, age_us: int = 0
    ) -> None:
        flags = wire.flags(buttons, homed=self.homed, counted=counted)
        state = wire.BoardState(flags, 0, time_us % wire.WRAP, position_nm, age_us, impulse % wire.WRAP)
        self.write(wire.state(state))

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
        while not self._quiet.wait(self.period_s):
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


def test_a_count_is_where_two_positions_meet(axis: SerialAxis, board: Board) -> None:
    """Up from 0 to 1, and down from 1 to 0, is the same place: no velocity."""
    board.state(LATER_US, position_nm=1000, counted=1)
    axis.read()
    board.state(LATER_US + 1000, position_nm=0, counted=-1)
    assert axis.read() == ((0.0,), (0.0,))


def test_a_position_of_unknown_age_makes_no_velocity(axis: SerialAxis, board: Board) -> None:
    board.state(LATER_US, age_us=wire.OLDEST_US)
    axis.read()
    board.state(LATER_US + 1000, position_nm=1000, counted=1)
    assert axis.read()[1] == (0.0,)


def test_a_gap_is_no_motion(axis: SerialAxis, board: Board) -> None:
    """10 mm in a second that nobody saw; then 20 mm/s."""
    found = []
    for time_us, position_nm in ((0, 0), (1_000_000, 10_000_000), (1_001_000, 10_020_000)):
        board.state(LATER_US + time_us, position_nm)
        found.append(axis.read()[1][0])
    assert found == pytest.approx([0.0, 0.0, 0.02])


def test_a_command_in_parts_of_the_maximum_force(axis: SerialAxis, board: Board) -> None:
    for force in (-1.5, 99.0):
        axis.apply((force,))
    sent = [wire.BoardCommand(b"F", 1, -16384), wire.BoardCommand(b"F", 2, 32767)]
    until(lambda: board.heard[-2:] == sent)


def test_the_newest_of_several_states_counts(axis: SerialAxis, board: Board) -> None:
    board.write(b"".join(wire.state(wire.BoardState(16, 0, LATER_US + 1000 * k, k, 0, 0)) for k in range(3)))
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
    board.write(wire.state(wire.BoardState(16, 0, 0, 0, 0, 0))[:-1] + b"?")
    with pytest.raises(DeviceSilent, match="no complete state for"):
        axis.read()


def test_one_that_started_anew_has_lost_its_zero(axis: SerialAxis, board: Board) -> None:
    board.state(1000)
    axis.home()
    board.homed = False
    board.state(2000)
    with pytest.raises(HapnetError, match="was reset and has lost its zero"):
        axis.read()


def test_one_that_was_pulled_out_is_silent_until_it_is_back(axis: SerialAxis, board: Board) -> None:
    board.state(500)  # shortly before what comes afterwards, by the board's clock
    axis.read()
    board.pull_out()
    with pytest.raises(DeviceSilent, match="was disconnected"):
        axis.read()
    with pytest.raises(DeviceSilent, match="was disconnected"):
        axis.apply((1.0,))
    with pytest.raises(DeviceSilent, match="was disconnected"):
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


def test_one_that_had_no_power_has_lost_its_zero(axis: SerialAxis, board: Board) -> None:
    board.pull_out()
    board.homed = True
    board.plug_in()
    with pytest.raises(DeviceSilent, match="was disconnected"):
        axis.read()

    def sent(homed: bool) -> bool:
        board.homed = homed
        board.state(1000)
        try:
            return bool(axis.read())
        except DeviceSilent:
            return False

    until(lambda: sent(True))  # one that knows its place goes on
    threading.Timer(0.01, board.state, (2000,)).start()
    axis.home()
    with pytest.raises(HapnetError, match="was reset and has lost its zero"):
        until(lambda: not sent(False))


def test_states_that_get_lost_on_the_way_are_named(board: Board, tmp_path: Path) -> None:
    """The board says that it makes one each 1 ms, and one each 4 ms arrives."""
    board.about, board.period_s = ABOUT._replace(made_us=1000), 4e-3
    with pytest.raises(
        HapnetError, match=r"a state each 1000 us, but one each .* us arrives: is its baud rate too low"
    ):
        SerialAxis(1, port=str(tmp_path / "axis"))


def test_one_that_is_slower_than_it_promises_says_its_rate(board: Board, tmp_path: Path) -> None:
    board.period_s = 4e-3
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    assert 20.0 < axis.rate_hz <= 250.0
    axis.close()


def test_one_that_is_not_calibrated_says_how(board: Board, tmp_path: Path) -> None:
    board.homed = False
    axis = SerialAxis(1, port=str(tmp_path / "axis"))
    with pytest.raises(HapnetError, match=r"centre its handle, and use serial:.*,home=yes"):
        axis.home()
    axis.close()
    asked = SerialAxis(1, port=str(tmp_path / "axis"), home=True)
    asked.home()
    asked.close()
    assert wire.BoardCommand(b"H") in board.heard


def test_another_version_is_refused(board: Board, tmp_path: Path) -> None:
    board.about = ABOUT._replace(version=3)
    with pytest.raises(HapnetError, match="speaks version 3 of the protocol, not 2: flash the sketch"):
        SerialAxis(1, port=str(tmp_path / "axis"))


@pytest.fixture
def version_1() -> Iterator[Pty]:
    """A board whose sketch sends lines of text, and does not know the question."""
    pty = Pty()
    line = b"S 123000 20513000 -1250 4021 77 1"
    os.set_blocking(pty.board, False)
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(1e-3):
            with suppress(BlockingIOError):
                os.write(pty.board, b"%b*%04X\n" % (line, binascii.crc_hqx(line, 0xFFFF)))

    sending = threading.Thread(target=send)
    sending.start()
    yield pty
    stop.set()
    sending.join()
    pty.close()


VERSION_1 = r"speaks version 1 \(text\) of the protocol, not 2: flash the sketch"


def test_a_sketch_of_version_1_is_refused(version_1: Pty) -> None:
    with pytest.raises(HapnetError, match=VERSION_1):
        SerialAxis(1, port=version_1.path)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "doctor"])
def test_a_command_with_a_sketch_of_version_1_is_one_line(version_1: Pty, command: str, tmp_path: Path) -> None:
    out = ("--out", tmp_path) if command == "run" else ()
    with started(command, "--device", f"serial:{version_1.path}", *out) as program:
        code, _, stderr = program.end()
    assert code == 2
    (line,) = stderr.splitlines()
    assert re.search(VERSION_1, line)


@pytest.mark.parametrize(
    ("dof", "port", "says"), [(3, "/dev/x", "dof"), (1, "", "serial:/dev/ttyACM0"), (1, "/dev/nil", "No such")]
)
def test_what_cannot_be_is_refused(dof: int, port: str, says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        SerialAxis(dof, port=port)
