"""The sketch in examples/serial_axis, compiled for this machine, and driven by the driver over a pseudo-terminal."""

import random
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.devices.serial_axis import SerialAxis
from tests.conftest import mostly_slow
from tests.support.processes import started, until
from tests.support.serial_board import SKETCH, STAND_IN, SketchBoard, compiled

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")

MakeBoard = Callable[..., SketchBoard]
COUNT_M = 15e-6


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("sketch"))


@pytest.fixture
def make_board(program: Path) -> Iterator[MakeBoard]:
    made: list[SketchBoard] = []

    def make(*words: object, **more: object) -> SketchBoard:
        made.append(SketchBoard(program, *words, **more))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for board in made:
        board.close()


@pytest.fixture
def axis(make_board: MakeBoard) -> Iterator[SerialAxis]:
    for axis in opened(make_board(), home=True):
        axis.home()
        yield axis


def opened(board: SketchBoard, *, home: bool = False) -> Iterator[SerialAxis]:
    axis = SerialAxis(1, port=board.path, home=home)
    yield axis
    axis.close()


def read(axis: SerialAxis) -> tuple[float, float]:
    """The next reading; on a busy machine a state may come late."""
    while True:
        try:
            (x,), (v,) = axis.read()
        except DeviceSilent:
            continue
        return x, v


def test_the_sketch_speaks_the_protocol(axis: SerialAxis) -> None:
    assert (axis.rate_hz, axis.force_limit, axis.continuous_force) == (1000.0, 3.0, 1.0)
    assert (axis.dead_man, axis.resolution) == (0, COUNT_M)
    assert [axis.workspace, axis.watchdog_s] == pytest.approx([0.04, 0.02])
    positions: list[float] = []

    def swung() -> bool:
        positions.append(read(axis)[0])
        return max(positions) - min(positions) > 0.015

    until(swung)
    assert max(map(abs, positions)) < 0.021  # 10 mm either way, from wherever it was when it started
    assert axis.buttons() == (False,)


def test_a_board_that_is_not_homed_makes_no_force(make_board: MakeBoard) -> None:
    """So one that starts anew in mid-run has none, whatever commands are still on their way."""
    for axis in opened(make_board()):
        with pytest.raises(HapnetError, match="home=yes"):
            axis.home()
        for _ in range(100):
            read(axis)
            axis.apply((1.5,))
            assert axis.acted() in (None, (0.0,))


def test_home_makes_the_present_place_zero(make_board: MakeBoard) -> None:
    board = make_board(20)
    axis = SerialAxis(1, port=board.path, home=True)
    until(lambda: read(axis)[0] > 0.01)
    axis.home()
    assert abs(read(axis)[0]) < 0.005
    axis.close()


@pytest.mark.slow
def test_the_sketch_counts_the_force_that_acted_while_its_clock_wraps(axis: SerialAxis) -> None:
    """Its clock wraps 1.5 s after its start; the force that is reported is the PWM's, 128/255 of 3 N."""
    reported = []
    start_s = time.monotonic()
    while time.monotonic() < start_s + 2.0:
        read(axis)
        axis.apply((1.5,))
        if (acted := axis.acted()) is not None:
            reported.append(acted[0])
    assert sorted(reported)[len(reported) // 2] == pytest.approx(3.0 * 128 / 255, rel=1e-4)
    assert min(reported) >= -1e-3
    assert max(reported) <= 1.51 * 1.01


def test_the_sketch_limits_the_force_and_takes_it_away_by_itself(axis: SerialAxis) -> None:
    def acted() -> float:
        read(axis)
        found = axis.acted()
        return 0.0 if found is None else found[0]

    def pushed() -> bool:
        axis.apply((-10.0,))
        return acted() == pytest.approx(-3.0, rel=0.01)

    until(pushed)
    until(lambda: acted() == 0.0)  # nothing is sent any more


@pytest.mark.parametrize("speed_mm_s", mostly_slow([0.5, -20.0, 200.0], 1))
def test_the_velocity_of_a_steady_motion(make_board: MakeBoard, speed_mm_s: float) -> None:
    """At 0.5 mm/s there is a count each 30 ms. Two counts are enough to know the speed, and it stays known between."""
    for axis in opened(make_board(speed_mm_s)):
        start_s, found = time.monotonic(), []
        while time.monotonic() < start_s + 0.5:
            found.append(read(axis)[1] * 1e3)
        steady = found[len(found) // 2 :]
        assert statistics.median(steady) == pytest.approx(speed_mm_s, rel=0.01)
        assert min(abs(v) for v in steady) > 0.5 * abs(speed_mm_s)


def test_a_board_that_is_slower_than_it_promises(make_board: MakeBoard) -> None:
    """It needs 2 ms for a loop of 1 ms: it makes at most 500 states a second, and the velocity is right."""
    for axis in opened(make_board(20, 2000)):
        assert 200.0 < axis.rate_hz <= 500.0
        intervals, found = [], []
        for _ in range(100):
            found.append(read(axis)[1] * 1e3)
            intervals.append(axis.interval() or 0.0)
        assert statistics.median(found) == pytest.approx(20.0, rel=0.01)
        assert statistics.median(intervals) >= 2e-3


def changed(chance: random.Random) -> Callable[[bytes], bytes]:
    return lambda data: bytes(byte ^ 1 << chance.randrange(8) if chance.random() < 0.01 else byte for byte in data)


def lost(chance: random.Random) -> Callable[[bytes], bytes]:
    return lambda data: bytes(byte for byte in data if chance.random() >= 0.01)


def halved(chance: random.Random) -> Callable[[bytes], bytes]:
    return lambda data: data[: len(data) // 2] if chance.random() < 0.1 else data


@pytest.mark.parametrize("spoil", mostly_slow([(one,) for one in [changed, lost, halved]], 1))
def test_what_is_damaged_on_the_way_is_no_reading(
    make_board: MakeBoard, spoil: Callable[[random.Random], object]
) -> None:
    """Every position lies on the handle's motion, 20 mm/s, within a count and the time of a few states."""
    for axis in opened(make_board(20, spoil=spoil(random.Random(1)))):
        at_s, before = 0.0, read(axis)[0]
        for _ in range(500):
            x, _ = read(axis)
            at_s = axis.interval() or 0.0
            assert x - before == pytest.approx(0.02 * at_s, abs=2 * COUNT_M)
            before = x


def test_a_board_that_is_reset_has_lost_its_zero(make_board: MakeBoard) -> None:
    board = make_board()
    axis = SerialAxis(1, port=board.path, home=True)
    axis.home()
    read(axis)
    board.reset()

    def read_on() -> bool:
        read(axis)
        return False

    with pytest.raises(HapnetError, match="was reset and has lost its zero: centre the handle"):
        until(read_on)
    axis.close()


def test_an_adapter_that_holds_bytes_for_16_ms_is_named(make_board: MakeBoard) -> None:
    board = make_board(20, held=True)
    with pytest.raises(
        HapnetError, match=r"one each .* ms, but arrive .* ms apart, several together.*set the adapter's latency timer"
    ):
        SerialAxis(1, port=board.path)


def test_an_adapter_with_a_slow_board(make_board: MakeBoard) -> None:
    """The same with a state each 6 ms, of which three fill the adapter's 62 bytes only after 16 ms."""
    board = make_board(20, 6000, held=True)
    with pytest.raises(HapnetError, match=r"ms apart, several together: set the adapter's latency timer"):
        SerialAxis(1, port=board.path)


@pytest.mark.parametrize(
    ("board", "core"),
    [
        ("encoder.h", "ARDUINO"),
        ("encoder.h", "ARDUINO_ARCH_RP2040"),
        ("encoder.h", "ARDUINO_ARCH_ESP32"),
        ("encoder.h", "TEENSYDUINO"),
        ("simplefoc.h", "ARDUINO"),
    ],
)
def test_each_boards_file_compiles(board: str, core: str, tmp_path: Path) -> None:
    """For this machine, and for a Cortex-M0+ (RP2040) where there is a compiler."""
    flags = [
        "-std=gnu++17",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{STAND_IN}",
        f'-DBOARD="{board}"',
        f"-D{core}",
        "-x",
        "c++",
    ]
    for compiler, more in (("g++", []), ("arm-none-eabi-g++", ["-mcpu=cortex-m0plus", "-mthumb"])):
        if shutil.which(compiler):
            subprocess.run([compiler, *flags, *more, "-c", SKETCH, "-o", tmp_path / "sketch.o"], check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "more", "code", "says"),
    [
        ((20,), {"held": True}, 2, "several together: set the adapter's latency timer to 1 ms"),
        ((0, 2000), {}, 2, "as this device: --servo-hz 4"),
    ],
)
def test_a_run_that_cannot_be(
    make_board: MakeBoard, tmp_path: Path, words: tuple[int, ...], more: dict[str, bool], code: int, says: str
) -> None:
    board = make_board(*words, **more)
    with started("run", "--device", f"serial:{board.path},home=yes", "--duration", 3, "--out", tmp_path) as program:
        found, _, stderr = program.end()
    assert found == code, stderr
    assert [line for line in stderr.splitlines() if says in line], stderr


@pytest.mark.slow
def test_a_run_ends_when_the_board_is_reset(make_board: MakeBoard, tmp_path: Path) -> None:
    board = make_board()
    words = ("run", "--device", f"serial:{board.path},home=yes", "--duration", 20, "--out", tmp_path)
    with started(*words, "--set", "device.self_test_N=0") as program:
        program.until_line("running: ")
        board.reset()
        code, _, stderr = program.end()
    assert code == 2, stderr
    assert [line for line in stderr.splitlines() if "lost its zero: centre the handle" in line], stderr
