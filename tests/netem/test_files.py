"""Files that are read once while they do not change."""

from pathlib import Path

import pytest

from netem.errors import ProfileError
from netem.files import read_once
from netem.trace import CapacityTrace


def test_a_file_is_read_again_only_when_it_has_changed(tmp_path: Path) -> None:
    read = []

    @read_once
    def words(path: str, most: int) -> list[str]:
        read.append(path)
        return Path(path).read_text("utf-8").split()[:most]

    file = tmp_path / "words"
    file.write_text("one two three")
    assert words(str(file), 2) is words(str(file), 2)
    assert words(str(file), 1) == ["one"]
    assert len(read) == 2
    file.write_text("four five")
    assert words(str(file), 2) == ["four", "five"]
    file.unlink()
    with pytest.raises(FileNotFoundError):
        words(str(file), 2)


def test_an_error_is_not_kept(tmp_path: Path) -> None:
    file = tmp_path / "trace.up"
    with pytest.raises(ProfileError, match="readable"):
        CapacityTrace.load(str(file))
    file.write_text("later\n")
    with pytest.raises(ProfileError, match="line 1"):
        CapacityTrace.load(str(file))
    file.write_text("3\n9\n")
    assert CapacityTrace.load(str(file)) is CapacityTrace.load(str(file))
    assert CapacityTrace.load(str(file)).times_ns == (3_000_000, 9_000_000)
