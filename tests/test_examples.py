"""Every example runs, and says what its docstring promises."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def run(code: str, tmp_path: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, timeout=60
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def test_modulator(tmp_path: Path) -> None:
    lines = run("from examples.modulator import main; main()", tmp_path).splitlines()
    assert len(lines) == 10
    assert "modulated [ 0.03 -0.02]" in lines[-1]


def test_link_study(tmp_path: Path) -> None:
    lines = run("from examples.link_study import main; main(3.0)", tmp_path).splitlines()
    assert [line.split()[:2] for line in lines[1:3]] == [["ideal", "pspm"], ["ideal", "zoh"]]
    margins = {tuple(line.split()[:2]): float(line.split()[-1]) for line in lines[1:]}
    assert all(margin >= 0.0 for (_, coupling), margin in margins.items() if coupling == "pspm")


def test_own_scene(tmp_path: Path) -> None:
    words = "['simulate','--scene','examples.own_scene:corridor','--duration','2','--no-files']"
    assert "passive" in run(f"from hapnet.cli import main; raise SystemExit(main({words}))", tmp_path)


def test_own_device(tmp_path: Path) -> None:
    words = "['run','--device','examples.own_device:Bench','--duration','1','--out','out']"
    said = run(f"from hapnet.cli import main; raise SystemExit(main({words}))", tmp_path)
    assert "passive" in said
    assert (tmp_path / "out" / "figure.png").exists()


@pytest.mark.parametrize("file", sorted((ROOT / "examples").glob("*.py")), ids=lambda file: file.stem)
def test_examples_stay_short(file: Path) -> None:
    assert len(file.read_text(encoding="utf-8").splitlines()) < 60
