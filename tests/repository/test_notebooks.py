"""The notebooks run from top to bottom, and are kept without what they showed."""

from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.support.notebooks import NOTEBOOKS, cells, run


def test_the_page_lists_every_notebook() -> None:
    page = (ROOT / "examples" / "README.md").read_text("utf-8")
    assert {file.name for file in NOTEBOOKS if f"`{file.name}`" not in page} == set()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_is_kept_without_outputs(notebook: Path) -> None:
    code = [cell for cell in cells(notebook) if cell["cell_type"] == "code"]
    assert code
    assert all((cell["outputs"], cell["execution_count"], cell["metadata"]) == ([], None, {}) for cell in code)
    assert all(len(line.rstrip("\n")) <= 140 for cell in cells(notebook) for line in cell["source"])


@pytest.mark.slow
def test_first_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    shown = [repr(value).partition("(")[0] for value in run(NOTEBOOKS[0]) if value is not None]
    assert shown == ["Result", "Comparison"]
    said = capsys.readouterr().out.splitlines()
    assert "passive: True" in said[0]
    passive = {line.split()[0]: line for line in said if "intercontinental" in line}
    assert "passive True" in passive["pspm:rendering=paper"]  # Theorem 1
    assert "passive False" in passive["zoh:rendering=paper"]  # a late set-position gives out what nobody put in
    assert (tmp_path / "runs" / "first_steps" / "report.html").exists()
    assert (tmp_path / "runs" / "first_steps" / "run-device.csv").exists()


@pytest.mark.slow
def test_own_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """15 % of the time 20 % are lost, else 0.5 %; the delay's mean is 20 + 3 + 0.15 * 30 ms."""
    monkeypatch.chdir(tmp_path)
    run(NOTEBOOKS[1])
    said = capsys.readouterr().out
    mean_ms, lost = (float(words.split()[0]) for words in said.splitlines()[1].split(", "))
    assert mean_ms == pytest.approx(27.5, abs=0.4)
    assert lost == pytest.approx(100 * (0.15 * 0.2 + 0.85 * 0.005), abs=0.3)
