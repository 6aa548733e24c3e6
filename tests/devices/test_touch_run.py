"""Whole runs with the Touch's driver and a stand-in of OpenHaptics' library, whose thread ticks by itself."""

import json
import shutil
from pathlib import Path

import pytest

from tests.support.hd_stand_in import built
from tests.support.processes import assert_passive, started, without_progress

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    return built(tmp_path_factory.mktemp("hd"))


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        ("", 0, ""),
        pytest.param("STUB_FAULT=2:0.3:0x0302", 0, "HD_COMM_ERROR: is it connected?", marks=pytest.mark.soak),
        pytest.param("STUB_FAULT=2:0.01:0x0200", 0, "its motors are warm", marks=pytest.mark.soak),
        ("STUB_FAULT=3:60:0x0302", 3, "the device is silent at the end"),
        ("STUB_CALIBRATION=0x5002", 2, "put its stylus into the inkwell, then start again"),
    ],
)
def test_a_run_with_the_stand_in(library: str, fault: str, code: int, said: str, tmp_path: Path) -> None:
    argv = ("run", "--device", f"touch:library={library}", "--duration", 5, "--json", "-", "--out", tmp_path / "run")
    with started(*argv, env=dict([fault.split("=")]) if fault else {}) as program:
        found, stdout, stderr = program.end()
    assert found == code, stderr
    assert said in stderr
    if code:
        return
    summary = json.loads(stdout)
    assert_passive(summary)
    assert summary["device"]["force"] == "commanded"
    assert summary["motion"]["peak_force_N"] > 0.3


def test_its_stylus_turns_a_tool_and_gives_no_torque(library: str, tmp_path: Path) -> None:
    argv = ("run", "--device", f"touch:library={library}", "--scene", "tool:stick", "--duration", 3)
    with started(*argv, "--json", "-", "--out", tmp_path / "run") as program:
        summary = program.summary()
    assert_passive(summary)
    assert summary["device"]["force"] == "commanded"


def test_a_run_without_the_library_is_one_line(tmp_path: Path) -> None:
    with started("run", "--device", "touch", "--out", tmp_path / "run", env={"PATH": ""}) as program:
        code, _, stderr = program.end()
    assert code == 2
    said = without_progress(stderr)
    assert said.startswith("hapnet: the device touch cannot be made: the device needs OpenHaptics (libHD) and")
    assert said.count("\n") == 1
