"""What the page on recordings says to type, typed."""

import re
import shlex
from pathlib import Path

import pytest

from hapnet import cli, simulate
from hapnet.params import Params
from hapnet.recording import alignment
from hapnet.recording.mcap import save
from hapnet.recording.samples import DeviceSample, WorldSample
from tests.recording.test_mcap import FOR_VIEWERS
from tests.recording.test_samples import halves
from tests.support.commands import Capture, empty_directory as empty_directory

PAGE = (Path(__file__).resolve().parents[2] / "hapnet" / "recording" / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_the_lines_of_python_run_as_they_stand(empty_directory: Path, capsys: Capture) -> None:
    pytest.importorskip("pandas", reason="the extra pandas is not installed")
    save(simulate(Params().set({"duration_s": 0.3, "operator": "sine"}), seed=1).recording, "run.mcap")
    plot, numbers = blocks("python")
    exec(plot, {})
    assert Path("run.png").stat().st_size > 10_000
    exec(numbers, {})
    assert re.fullmatch(r"\(\d+, 1\)\n0\.\d+\n", capsys.readouterr().out)


def test_the_commands_run_as_they_stand(empty_directory: Path) -> None:
    save(simulate(Params().set({"duration_s": 0.2})).recording, "run.mcap")
    for part, name in zip(halves({"clock": "boot-2"}, 6_000), ("device.mcap", "world.mcap"), strict=True):
        save(part, name)
    lines, _ = blocks("sh")  # of the second: the tests of all pages
    for line in lines.splitlines():
        program, *words = shlex.split(line, comments=True)
        assert program == "hapnet"
        assert cli.main(words) == 0
    for said in re.findall(r"[\w-]+\.csv", lines):
        assert Path(said).exists() or said == "run-events.csv"  # a simulation has no events


def test_topics_and_fields_on_the_page_are_those_of_the_files() -> None:
    topics = {"/device/state", "/world/state", "/events", "/world/scene", "/device/posture"}
    topics |= {"/world/shapes", "/device/shapes"}
    topics |= FOR_VIEWERS
    assert set(re.findall(r"`(/(?:device|world|events)[a-z_/]*)`", PAGE)) == topics
    for name in ("velocity_mps", "age_s", "transit_s"):
        assert f"`{name}`" in PAGE
        assert name in DeviceSample._fields
        assert name in WorldSample._fields
    assert "minute by minute" in PAGE
    assert alignment.WINDOW_S == 60.0
