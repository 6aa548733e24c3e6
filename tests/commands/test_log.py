import json
import os
import time
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hapnet import cli
from hapnet.commands.log import Log, check_target
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.side.notices import Notice
from tests.support.processes import no_room

KEYS = {"time", "monotonic_ns", "level", "role", "kind", "text"}


def lines(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]


def words() -> Console:
    return Console(file=StringIO(), soft_wrap=True)


def said(console: Console) -> str:
    return console.file.getvalue()


def test_a_notice_is_a_json_object_and_a_line_of_words(tmp_path: Path) -> None:
    console, file = words(), tmp_path / "x.jsonl"
    log = Log("device", console, str(file))
    now_ns, wall = time.monotonic_ns(), time.time()
    log.notify(Notice("silent", "nothing for 1 s", now_ns, "warning", {"silence_s": 1.0}))
    log.notify(Notice("left", "[red]gone[/red] \u2014\nfor good", now_ns))
    log.close()
    first, second = lines(file)
    assert set(first) == KEYS | {"values"}
    assert set(second) == KEYS
    assert (first["level"], first["role"], first["kind"]) == ("warning", "device", "silent")
    assert (first["monotonic_ns"], first["values"]) == (now_ns, {"silence_s": 1.0})
    assert datetime.fromisoformat(first["time"]).timestamp() == pytest.approx(wall, abs=0.1)
    assert first["time"].endswith("+00:00")
    assert second["text"] == "[red]gone[/red] \u2014\nfor good"
    local = datetime.fromisoformat(first["time"]).astimezone()
    assert f"{local:%H:%M:%S}.{local.microsecond // 1000:03d} nothing for 1 s\n" in said(console)
    assert "[red]gone[/red]" in said(console)  # what a peer says is not markup


def test_a_step_of_the_wall_clock_does_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set back by an hour in the middle: the stamps go on as the monotonic clock does."""
    log = Log("world", None, str(tmp_path / "x.jsonl"))
    begin = time.monotonic_ns()
    log.notify(Notice("a", "before", begin))
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() - 3600 * 10**9)
    log.notify(Notice("a", "after", begin + 2_500_000_000))
    log.notify(Notice("a", "later", begin + 2_500_001_000))
    log.close()
    stamps = [datetime.fromisoformat(line["time"]) for line in lines(tmp_path / "x.jsonl")]
    assert (stamps[1] - stamps[0]).total_seconds() == pytest.approx(2.5, abs=2e-6)
    assert stamps == sorted(stamps)
    assert abs((datetime.now(UTC) - stamps[0]).total_seconds()) < 60.0


def test_how_far_the_run_is_is_written_on_request_and_never_said(tmp_path: Path) -> None:
    for progress in (False, True):
        console, file = words(), tmp_path / f"{progress}.jsonl"
        log = Log("world", console, str(file), progress=progress)
        log.notify(Notice("progress", "1.0", 5))
        log.close()
        assert [line["text"] for line in lines(file)] == (["1.0"] if progress else [])
        assert said(console) == ""


def test_a_log_goes_on_where_the_last_one_ended(tmp_path: Path) -> None:
    for text in ("one", "two"):
        log = Log("world", None, str(tmp_path / "x.jsonl"))
        log.notify(Notice("a", text, 5))
        log.close()
    assert [line["text"] for line in lines(tmp_path / "x.jsonl")] == ["one", "two"]


@pytest.mark.parametrize("target", [".", "/proc/x.jsonl", "no/such/x.jsonl"])
def test_a_log_that_cannot_be_written_is_refused(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(HapnetError, match=rf"cannot write the log {target}: "):
        Log("world", None, target)


def test_a_log_that_can_be_written_no_more_ends_no_run_and_is_told_once(tmp_path: Path) -> None:
    console, file = words(), tmp_path / "x.jsonl"
    log = Log("world", console, str(file))
    log.notify(Notice("a", "first", 5))
    with no_room(file.stat().st_size + 20):
        for _ in range(3):
            log.notify(Notice("a", "then", 5))
    log.close()
    assert log.failure == f"cannot write the log {file}: File too large"
    assert said(console).count("cannot write the log") == 1
    assert said(console).count("then") == 3
    assert json.loads(file.read_text("utf-8").splitlines()[0])["text"] == "first"


def test_a_reader_that_has_left_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    log = Log("world", None, f"/dev/fd/{write}")
    os.close(read)
    log.notify(Notice("a", "to nobody", 5))
    log.close()
    os.close(write)
    assert log.failure is None


def test_standard_output_is_for_one_of_the_two(capsys: pytest.CaptureFixture[str]) -> None:
    for log_to, json_to in ((None, "-"), ("-", None), ("x", "-"), ("-", "x"), (None, None)):
        check_target(log_to, json_to)
    with pytest.raises(InvalidParameter, match="--log"):
        check_target("-", "-")
    assert cli.main(["world", "-l", "tcp/127.0.0.1:1", "--log", "-", "--json", "-"]) == 2
    out, err = capsys.readouterr()
    assert (out, err) == ("", "hapnet: --log is '-'; allowed: a file, as --json has standard output\n")
