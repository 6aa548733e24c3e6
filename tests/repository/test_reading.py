"""The reading path: files of the core, in order, that one person reads in an afternoon."""

import re

from tests.conftest import ROOT

PAGE = ROOT / "hapnet" / "READING.md"
MOST_LINES = 8000


def test_the_reading_path_is_short_and_of_the_core() -> None:
    files = re.findall(r"(?m)^\| `(hapnet/[^`]+\.py)` \|", PAGE.read_text("utf-8"))
    assert len(files) == len(set(files))
    assert not [name for name in files if name.startswith("hapnet/ext/")]
    lines = {name: len((ROOT / name).read_text("utf-8").splitlines()) for name in files}
    assert 4000 < sum(lines.values()) < MOST_LINES, lines
    assert {name.split("/")[1] for name in files} >= {"control", "wire", "side", "simulation", "summary"}


def test_the_page_says_how_many_files_there_are() -> None:
    text = PAGE.read_text("utf-8")
    assert f"These {len(re.findall(r'(?m)^. `hapnet/', text))} files" in text
