"""Every command that reads a damaged or cut recording says in one line what is missing, and ends with code 3."""

from dataclasses import replace
from pathlib import Path

import pytest

from hapnet import Params, simulate
from hapnet.cli import main
from hapnet.recording.mcap import read_recording, save
from hapnet.recording.missing import missing
from hapnet.recording.samples import Lost
from tests.conftest import mostly_slow
from tests.recording.test_samples import ORIGIN, memory, run


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("whole") / "run.mcap"
    result = simulate(Params().set({"duration_s": 6.0}), seed=1)
    save(replace(result.recording, summary=result.summary), file)
    return file


def damaged(whole: Path, directory: Path) -> Path:
    data = bytearray(whole.read_bytes())
    data[data.index(b"lz4", len(data) // 3) + 1000] ^= 1  # in a chunk
    (directory / "bad.mcap").write_bytes(data)
    return directory / "bad.mcap"


COMMANDS = {
    "export": ["export", "FILE", "--out", "OUT", "--format", "csv"],
    "simulate": ["simulate", "--operator", "FILE", "--duration", "1", "--no-files"],
    "report": ["report", "FILE", "--out", "OUT"],
    "replay": ["replay", "FILE", "--out", "OUT"],
    "seeds": ["simulate", "--operator", "FILE", "--duration", "1", "--seeds", "0:2"],
    "run": ["run", "--operator", "FILE", "--duration", "1", "--no-files"],
}


@pytest.mark.parametrize(
    ("command", "how"),
    mostly_slow([(command, how) for how in ("damaged", "cut") for command in COMMANDS], 1, 10),
)
def test_a_command_says_what_is_missing(
    whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], command: str, how: str
) -> None:
    file = damaged(whole, tmp_path)
    if how == "cut":
        file.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    words = [{"FILE": str(file), "OUT": str(tmp_path / "out")}.get(word, word) for word in COMMANDS[command]]
    assert main(words) == 3
    [line] = [line for line in capfd.readouterr().err.splitlines() if line.startswith("hapnet: ")]
    assert "bad.mcap" in line
    if how == "damaged":
        found = read_recording(file)
        [begin_s, end_s] = [(at_ns - found.meta["origin_ns"]) / 1e9 for at_ns in found.lost[0]]
        assert f"({begin_s:.3f} s to {end_s:.3f} s), the rest was read" in line
        assert "is damaged: up to " in line
        assert "killed" not in line
    else:
        assert "is incomplete: it ends at " in line
        assert "damaged" not in line


@pytest.mark.parametrize("command", mostly_slow(COMMANDS, 2, 4))
def test_nothing_is_said_of_a_whole_recording(
    whole: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    words = [{"FILE": str(whole), "OUT": str(tmp_path / "out")}.get(word, word) for word in COMMANDS[command]]
    assert main(words) == 0
    assert "hapnet: " not in capfd.readouterr().err


def test_the_line_lists_three_parts_and_counts_the_others() -> None:
    s = 1_000_000_000
    spans = [Lost(None, ORIGIN + s), *(Lost(ORIGIN + i * 10 * s, ORIGIN + i * 10 * s + s) for i in range(1, 4))]
    found = replace(memory(run()), lost=tuple(spans))
    assert missing("a.mcap", found) == (
        "a.mcap is damaged: up to 4.000 s of 4.000 s are missing (0.000 s to 1.000 s, 10.000 s to 11.000 s, "
        "20.000 s to 21.000 s and 1 more parts), the rest was read"
    )


def test_damage_at_the_end_is_not_called_a_killed_process() -> None:
    """The summary is there, so the writer closed the file."""
    found = replace(memory(run()), summary={"seed": 1}, torn=True)
    assert missing("a.mcap", found) == "a.mcap is damaged at its end, after all samples"
    line = missing("a.mcap", replace(found, summary=None)) or ""
    assert "because the process that wrote it was killed or the file was cut off" in line
    assert missing("a.mcap", replace(found, torn=False)) is None
