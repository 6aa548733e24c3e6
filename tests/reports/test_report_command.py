"""`hapnet report` of what may lie on a disk: one side, torn, empty, a single sample, unknown values."""

import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from matplotlib.image import imread

from hapnet import cli
from hapnet.recording.mcap import RecordingWriter
from hapnet.recording.samples import DeviceSample, Recording, Sample, WorldSample
from tests.conftest import mostly_slow
from tests.plots.test_run import run
from tests.reports.conftest import plain as plain
from tests.reports.test_report_page import stands_alone

SUMMARY = {
    "theorem": {"margin_J": None, "bound_J": None},
    "device": {
        "ledger": {"margin_J": 0.05, "bound_J": 0.05},
        "servo": {"late_p50_us": 30.0, "late_histogram_us": [[20.0, 3], [30.0, 90], [2000.0, 1]]},
    },
    "world": None,
    "links": {
        "up": {"profile": "delay 3ms", "delay_p50_ms": 3.0, "delay_histogram_ms": [[2.9, 0], [3.1, 7]]},
        "down": None,
    },
}


def write(file: Path, samples: list[Sample], summary: dict[str, Any] | None = None) -> Path:
    """As a process does that ends in order or, without a summary, that was killed at that instant."""
    writer = RecordingWriter(file, {**run(seconds=1).meta, "origin_ns": 0})
    for sample in samples:
        writer.write(sample)
    writer.flush(0)
    written = file.read_bytes()
    writer.close(summary)
    if summary is None:
        file.write_bytes(written)
    return file


def unknown(sample: Sample) -> Sample:
    """All that is a number is none."""
    if not isinstance(sample, DeviceSample | WorldSample):
        return sample
    nothing = {
        name: tuple(math.nan for _ in value) if isinstance(value, tuple) else math.nan
        for name, value in sample._asdict().items()
        if name != "time_ns" and value is not None
    }
    return sample._replace(**nothing)


def one_of_each(recording: Recording) -> list[Sample]:
    samples = recording.samples()
    return [next(s for s in samples if isinstance(s, kind)) for kind in (DeviceSample, WorldSample)]


def half_unknown(recording: Recording) -> list[Sample]:
    return [unknown(sample) if i % 2 else sample for i, sample in enumerate(recording.samples())]


CASES: dict[str, Callable[[], list[Sample]]] = {
    "both sides": lambda: run(seconds=1).samples(),
    "the device's side": lambda: run(sides="device", seconds=1).samples(),
    "the world's side": lambda: run(sides="world", seconds=1).samples(),
    "no samples": list,
    "one of the device's": lambda: one_of_each(run(seconds=1))[:1],
    "one of each": lambda: one_of_each(run(seconds=1)),
    "three axes": lambda: run(3, seconds=1).samples(),
    "nothing known": lambda: [unknown(sample) for sample in run(seconds=1).samples()],
    "every other one known": lambda: half_unknown(run(2, seconds=1)),
    "one, unknown": lambda: [unknown(sample) for sample in one_of_each(run(3, seconds=1))],
}
FIRST = ("no samples", "one of each", "every other one known")
"""Of these a torn recording is reported first."""
ORDER = [*FIRST, *sorted(set(CASES) - set(FIRST))]


@pytest.mark.parametrize(
    ("case", "torn"),
    mostly_slow(
        [
            ("both sides", False),
            ("one, unknown", False),
            *((case, True) for case in (*FIRST, *sorted(set(CASES) - set(FIRST)))),
        ],
        2,
        7,
    ),
)
def test_reports_whatever_was_recorded(
    case: str, torn: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "r.mcap", CASES[case](), None if torn else SUMMARY)
    before = file.read_bytes()
    assert cli.main(["report", str(file), "--json", "-"]) == (3 if torn else 0)
    out, err = capsys.readouterr()
    summary = json.loads(out)
    found = stands_alone((tmp_path / "r.html").read_text("utf-8"))
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"r.mcap", "r.html", "r.png"} | ({"r.repaired.mcap"} if torn else {"r-link.png", "r-servo.png"})
    for name in names:
        assert not name.endswith(".png") or imread(io.BytesIO((tmp_path / name).read_bytes())).shape[1] > 1000
    assert ("r.mcap is incomplete" in found.sections[""]) == torn
    assert ("is incomplete" in err) == torn
    assert file.read_bytes() == before
    if not torn:
        assert summary["device"] == SUMMARY["device"]
        assert len(found.attributes("img")) == 3


def test_two_sides_one_torn(tmp_path: Path) -> None:
    device = write(tmp_path / "d.mcap", run(sides="device", seconds=1).samples())
    world = write(tmp_path / "w.mcap", run(sides="world", seconds=1).samples(), {
        "device": None, "world": {"ledger": {"margin_J": 0.03, "slack_J": 0.0, "bound_J": 0.05}, "sent_nJ": 0,
                                  "credited_nJ": 0, "in_flight_nJ": 0, "abandoned_nJ": 0},
        "links": {"up": None, "down": None}, "seed": 3, "duration_s": 1.0, "coupling": "pspm", "wall_clock": {},
    })  # fmt: skip
    assert cli.main(["report", str(world), str(device), "--out", str(tmp_path / "o")]) == 3
    found = stands_alone((tmp_path / "o" / "w-d.html").read_text("utf-8"))
    assert "d.mcap is incomplete" in found.sections[""]
    assert "w.mcap is incomplete" not in found.sections[""]
    assert "whole" in found.sections["Files"]


def test_a_summary_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strange: Any = ["no", "object"]
    file = write(tmp_path / "r.mcap", run(seconds=1).samples(), strange)
    assert cli.main(["report", str(file)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    world = write(tmp_path / "w.mcap", run(sides="world", seconds=1).samples(), {"x": 1})
    device = write(tmp_path / "d.mcap", run(sides="device", seconds=1).samples(), {"y": 1})
    assert cli.main(["report", str(device), str(world)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_what_cannot_be_written_is_one_line_and_the_summary_is_told_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "r.mcap", run(seconds=1).samples(), SUMMARY)
    (tmp_path / "r.html").mkdir()
    assert cli.main(["report", str(file), "--json", "-"]) == 3
    out, err = capsys.readouterr()
    assert json.loads(out)["device"] == SUMMARY["device"]
    assert err.splitlines()[-1].startswith(f"hapnet: cannot write report {tmp_path / 'r.html'}: ")
    assert (tmp_path / "r-servo.png").exists()


@pytest.mark.slow
def test_a_torn_file_that_cannot_be_repaired_is_reported_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write(tmp_path / "r.mcap", run(seconds=1).samples())
    (tmp_path / "r.repaired.mcap").mkdir()
    assert cli.main(["report", str(file)]) == 3
    assert "cannot write recording" in capsys.readouterr().err
    assert "r.mcap is incomplete" in stands_alone((tmp_path / "r.html").read_text("utf-8")).sections[""]
