"""Every wrong input is answered in one line, with exit code 2, and nothing is left behind: see bad_input.py."""

import re
import sys
from pathlib import Path

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.conftest import mostly_slow
from tests.support.bad_input import BY_HAND, EVERY, FILES, SLOW, Bad
from tests.support.commands import Capture, empty_directory as empty_directory
from tests.support.processes import without_progress
from tests.support.typed_input import TYPED


@pytest.fixture
def files(empty_directory: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with the files; the modules in it are imported anew."""
    for name, content in FILES.items():
        (empty_directory / name).write_text(content, "utf-8")
    for name in ("parts", "exits", "syntax"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(empty_directory))
    return empty_directory


@pytest.mark.parametrize(
    "wrong",
    [*EVERY, *TYPED, *mostly_slow([(one,) for one in (*SLOW, *BY_HAND)], 0, len(SLOW))],
    ids=lambda one: " ".join((one.program, *one.argv)),
)
def test_a_wrong_input_is_answered_in_one_line(wrong: Bad, files: Path, capsys: Capture) -> None:
    main = cli.main if wrong.program == "hapnet" else netem_cli.main
    assert main(list(wrong.argv)) == 2
    out, said = capsys.readouterr()
    line = without_progress(said)
    assert not re.search("^PASSIVE: ", out, re.MULTILINE)  # what has failed is not known to be
    assert line.startswith(f"{wrong.program}: ")
    assert line.count("\n") == 1
    assert line.endswith("\n")
    assert "Traceback" not in line
    for words in wrong.says:
        assert words in line
    left = {path.name for path in files.iterdir()} - {"__pycache__"} - set(FILES)
    begun = wrong.argv[0] == "run" and "failed" in line
    assert left <= ({"runs"} if begun else set())  # what the processes of a run have logged
    assert not [path for path in files.rglob("*") if path.is_dir() and not any(path.iterdir())]
