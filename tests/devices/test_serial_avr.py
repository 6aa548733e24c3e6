"""The Hapkit's sketch, compiled for an ATmega328P with Arduino's own core, in simavr: what the page says it costs.

By hand (`-m soak`): it needs `apt-get install gcc-avr avr-libc arduino-core-avr simavr libsimavr-dev`, and is skipped
without them. The figures are printed with `-s`.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.serial_board import SKETCH, STAND_IN

ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
CORE = ARDUINO / "cores" / "arduino"
CYCLES_US = 16
FUNCTIONS = {
    "_Z10send_statev": "state",
    "_Z11position_nmPmPa": "sensor",
    "_Z10on_commandPK7Command": "command",
    "_Z5crc16PKvh": "crc",
    "__vector_18": "received_byte",
    "__vector_19": "sent_byte",
}

pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(
        shutil.which("avr-g++") is None or not CORE.exists() or not Path("/usr/include/simavr").exists(),
        reason="there is no avr-gcc, Arduino core or simavr",
    ),
]


def firmware(folder: Path, sketch: Path = SKETCH) -> Path:
    """The sketch with Arduino's core."""
    flags = [
        "-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_UNO", "-DARDUINO_ARCH_AVR", "-Os",
        "-ffunction-sections", "-fdata-sections", f"-I{CORE}", f"-I{ARDUINO / 'variants' / 'standard'}",
    ]  # fmt: skip
    cpp = [*flags, "-std=gnu++11", "-fno-exceptions", "-fno-threadsafe-statics"]
    objects = []
    for source in [
        *CORE.glob("*.c"),
        *(CORE / f"{name}.cpp" for name in ("Print", "HardwareSerial", "HardwareSerial0")),
    ]:
        objects.append(folder / f"{source.name}.o")
        compiler = ["avr-gcc", *flags] if source.suffix == ".c" else ["avr-g++", *cpp]
        subprocess.run([*compiler, "-w", "-c", source, "-o", objects[-1]], check=True)
    for name, more in (("main.cpp", []), (str(sketch), ["-Wall", "-Wextra", '-DBOARD="hapkit.h"', "-x", "c++"])):
        objects.append(folder / f"{Path(name).name}.o")
        subprocess.run(["avr-g++", *cpp, *more, "-c", CORE / name, "-o", objects[-1]], check=True)
    elf = folder / "hapkit.elf"
    subprocess.run(["avr-gcc", "-mmcu=atmega328p", "-Wl,--gc-sections", "-o", elf, *objects, "-lm"], check=True)
    return elf


def run(folder: Path, elf: Path, seconds: float) -> dict[str, list[float]]:
    """What tests/sketch/avr_board.c prints."""
    program = folder / "avr_board"
    flags = ["-O2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["gcc", *flags, STAND_IN / "avr_board.c", "-o", program, "-lsimavr"], check=True)
    symbols = [line.split() for line in subprocess.check_output(["avr-nm", elf], text=True).splitlines()]
    watched = [f"{FUNCTIONS[name]}={address}" for address, *_, name in symbols if name in FUNCTIONS]
    printed = subprocess.check_output([program, elf, str(seconds), "1", *watched], text=True)
    lines = [line.split() for line in printed.splitlines() if not line.startswith("Loaded")]
    return {name: [float(number) for number in numbers] for name, *numbers in lines}


def test_a_hapkit_makes_500_states_a_second(tmp_path: Path) -> None:
    found = run(tmp_path, firmware(tmp_path), 4.0)
    for name in FUNCTIONS.values():
        calls, whole, own = found[name]
        print(f"{name:<14} {calls:8.0f} calls, {whole / CYCLES_US:7.1f} us, {own / CYCLES_US:7.1f} us of its own")
    print(found["rate_hz"], found["bytes_s"])
    assert found["rate_hz"] == pytest.approx([500.0], rel=1e-3)
    assert found["clock"] == pytest.approx([1.0], abs=1e-4)  # timer 0's prescaler does not touch it
    assert found["bytes_s"] == pytest.approx([20 * 500.0], rel=0.02)
    sent, answered = found["commands"]
    assert sent > 1850
    assert answered >= sent - 1  # the last state goes out before the last command is there
    assert found["state"][1] < 0.4 * 2000 * CYCLES_US
    held, after = found["pwm"]
    assert held > 0
    assert after == 0  # 25 ms after the last command


def test_what_it_could_make(tmp_path: Path) -> None:
    """Without a pause it makes more than twice as many, each with its command."""
    free = tmp_path / "serial_axis"
    shutil.copytree(SKETCH.parent, free)
    board = free / "hapkit.h"
    text = board.read_text("utf-8")
    assert "PERIOD_US = 2000;" in text
    board.write_text(text.replace("PERIOD_US = 2000;", "PERIOD_US = 100;"), "utf-8")
    found = run(tmp_path, firmware(tmp_path, free / SKETCH.name), 2.0)
    print(found["rate_hz"])
    assert found["rate_hz"][0] > 1000.0
    assert found["commands"][1] >= found["commands"][0] - 3
