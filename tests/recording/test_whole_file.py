from __future__ import annotations

import os
from pathlib import Path

import pytest

from hapnet.commands import output
from hapnet.errors import OutputError, RecordingError
from hapnet.recording import whole_file
from hapnet.recording.whole_file import complete_or_absent


def half_write(file: Path) -> None:
    with complete_or_absent(file) as part:
        part.write_text("half")
        raise OSError(28, os.strerror(28))


def test_a_file_that_cannot_be_written_whole_is_absent_and_an_older_one_stays(tmp_path: Path) -> None:
    file = tmp_path / "summary.json"
    for before in (None, "old"):
        if before is not None:
            file.write_text(before)
        with pytest.raises(RecordingError, match=r"cannot write recording .*summary\.json: No space left on device"):
            half_write(file)
        assert [path.name for path in tmp_path.iterdir()] == ([] if before is None else ["summary.json"])
    assert file.read_text() == "old"


def test_a_disk_that_is_full_only_when_it_is_asked_to_keep_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some systems give out space late: the write succeeds, and fsync fails."""

    def full(descriptor: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(whole_file.os, "fsync", full)
    monkeypatch.setattr(whole_file.os.path, "ismount", lambda place: Path(place) == tmp_path)
    (tmp_path / "runs").mkdir()
    file = tmp_path / "runs" / "summary.json"
    with pytest.raises(OutputError) as refused:
        output.write_json({"a": 1}, str(file))
    assert str(refused.value) == (f"cannot write {file}: No space left on device: the disk of {tmp_path} is full")
    assert not list((tmp_path / "runs").iterdir())


def test_a_link_stays_a_link_and_a_pipe_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "link.json").symlink_to("real.json")
    output.write_json({"a": 1}, str(tmp_path / "link.json"))
    assert (tmp_path / "link.json").is_symlink()
    assert '"a": 1' in (tmp_path / "real.json").read_text()
    ours, theirs = os.pipe()
    output.write_json({"b": 2}, f"/dev/fd/{theirs}")
    os.close(theirs)
    with os.fdopen(ours) as pipe:
        assert '"b": 2' in pipe.read()
