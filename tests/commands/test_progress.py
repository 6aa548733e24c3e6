import contextlib
import io
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.ext.compiled import progress as compiler
from tests.conftest import ENVIRONMENT

HIDE, SHOW = b"\x1b[?25l", b"\x1b[?25h"


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def console(*, terminal: bool, width: int = 80) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=width, highlight=False, color_system=None)


def shown(words: Console) -> str:
    return words.file.getvalue()


def script(words: Console, *, total: float | None = 20.0, speed: float = 1.0) -> Progress:
    """A command that lasts 17 seconds, seen every five seconds as the thread would."""
    clock = Clock()
    progress = Progress(words, "simulating", total, clock=clock)
    for second in range(18):
        clock.now = 100.0 + second
        if total is not None:
            progress.update(speed * second)
        if second and second % 5 == 0:
            progress.show()
    return progress


@pytest.mark.parametrize("terminal", [True, False])
def test_what_is_over_within_a_second_shows_nothing(terminal: bool) -> None:
    words = console(terminal=terminal)
    with Progress(words, "simulating", 20.0) as progress:
        progress.update(1.0)
        time.sleep(0.3)
    assert shown(words) == ""


def test_in_a_pipe_there_is_a_line_now_and_then() -> None:
    words = console(terminal=False)
    script(words)
    assert shown(words).splitlines() == [
        "simulating: 5 of 20 s, 15 s left",
        "simulating: 10 of 20 s, 10 s left",
        "simulating: 15 of 20 s, 5 s left",
    ]


@pytest.mark.parametrize("terminal", [True, False])
def test_what_takes_longer_is_shown_while_nothing_else_happens(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapnet.commands.progress.BAR_AFTER_S", 0.05)
    monkeypatch.setattr("hapnet.commands.progress.LINE_EVERY_S", 0.05)
    words, end = console(terminal=terminal), time.monotonic() + 30.0
    with Progress(words, "simulating", 20.0) as progress:
        progress.update(1.0)
        while shown(words).count("1 of 20 s") < 3 and time.monotonic() < end:
            time.sleep(0.01)
        progress.update(2.0)
        while "2 of 20 s" not in shown(words) and time.monotonic() < end:
            time.sleep(0.01)
    assert time.monotonic() < end


def test_the_time_left_is_at_the_speed_until_now() -> None:
    words = console(terminal=False)
    script(words, total=10_000.0, speed=2.0)
    assert shown(words).splitlines()[0] == "simulating: 10 of 10000 s, 83 min left"


def test_a_stage_whose_end_nobody_knows() -> None:
    words = console(terminal=False)
    script(words, total=None)
    assert shown(words).splitlines()[0] == "simulating: 5 s so far"


def test_a_new_stage_counts_from_its_first_update() -> None:
    words, clock = console(terminal=False), Clock()
    progress = Progress(words, "starting", clock=clock)
    clock.now += 4.0
    progress.stage("running", 11.0)
    progress.update(1.0)
    clock.now += 5.0
    progress.update(6.0)
    progress.show()
    assert shown(words) == "running: 6 of 11 s, 5 s left\n"


def test_where_it_is_measured_every_update_is_shown_and_nothing_else() -> None:
    words = console(terminal=False)
    with Progress(words, "measuring", 2, "", background=False) as progress:
        progress.update(0, "1/2 servo")
        progress.update(1, "2/2 codec")
    assert shown(words).splitlines() == ["1/2 servo", "2/2 codec: 1 s left"]  # rounded up


@pytest.mark.parametrize("width", [20, 40, 80, 200])
def test_a_bar_is_one_line_and_is_gone_at_the_end(width: int) -> None:
    words, clock = console(terminal=True, width=width), Clock()
    with Progress(words, "simulating", 600.0, clock=clock) as progress:
        for second in (0, 2, 4):
            clock.now = 100.0 + second
            progress.update(second)
            progress.show()
    text = shown(words)
    assert text.count("\n") == text.count("\x1b[1A") == 1  # at the end: down, and up again
    drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text).split("\r")
    assert 10 < max(len(line.rstrip("\n")) for line in drawn) <= width
    assert width < 80 or "4 of 600 s" in text
    assert text.rindex(SHOW.decode()) > text.rindex(HIDE.decode())
    assert text.endswith("\x1b[2K")


def all_of(window: int) -> str:
    """All that a terminal shows; one read may return a part of it."""
    seen = b""
    while select.select([window], [], [], 0.5)[0]:
        seen += os.read(window, 65536)
    return seen.decode()


def test_lines_that_are_said_meanwhile_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both streams are one terminal: each line is above the bar, also those that a user's own coupling prints."""
    window, inside = pty.openpty()
    clock = Clock()
    with open(inside, "w", encoding="utf-8") as terminal:  # a descriptor
        for stream in ("stdout", "stderr"):
            monkeypatch.setattr(sys, stream, terminal)
        words = output.console(None)
        with Progress(output.progress_console(words), "running", 60.0, background=False, clock=clock) as progress:
            progress.update(1.0)
            words.print("device: paired with the world")
            print("a user's figure")
            sys.stderr.write("a user's warning\n")
            progress.update(2.0)
        assert sys.stdout is sys.stderr is terminal
        terminal.flush()
        seen = all_of(window)
    os.close(window)
    for line in ("device: paired with the world", "a user's figure", "a user's warning"):
        assert f"\r\x1b[2K{line}\r\n" in seen
        assert "1 of 60 s" in seen[seen.index(line) :]
    assert "2 of 60 s" in seen[seen.index("a user's warning") :]


def test_what_goes_to_a_file_does_not_pass_through_the_bar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    window, inside = pty.openpty()
    with open(inside, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        words = output.console(None)
        with Progress(output.progress_console(words), "running", 60.0, background=False) as progress:
            progress.update(1.0)
            words.print("a line")
            print("a user's figure")
        terminal.flush()
        seen = all_of(window)
    os.close(window)
    assert capsys.readouterr().out == "a line\na user's figure\n"
    assert "1 of 60 s" in seen
    assert "line" not in seen
    assert "figure" not in seen


def test_progress_is_for_people_and_results_are_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(output.progress_console(output.console(None)), "measuring", 2, "", background=False) as progress:
        progress.update(0, "1/2 servo")
        output.console(None).print("0.3 us")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("0.3 us\n", "1/2 servo\n")


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_whoever_ends_it_finds_the_terminal_as_it_was(number: signal.Signals, code: int) -> None:
    """The bar drawn, a signal: the line is erased, the cursor is back, and nothing is said."""
    window, inside = pty.openpty()
    argv = [sys.executable, "-m", "hapnet", "simulate", "--duration", "10000", "--no-files"]
    environment = {**ENVIRONMENT, "TERM": "xterm", "COLUMNS": "80"}
    with subprocess.Popen(argv, stdin=inside, stdout=inside, stderr=inside, env=environment) as process:
        try:
            os.close(inside)
            seen = until(window, b"of 10000 s")
            process.send_signal(number)
            seen += until(window, None)
            assert process.wait(30) == code
        finally:
            process.kill()
            os.close(window)
    assert seen.rindex(SHOW) > seen.rindex(HIDE)
    assert b"simulating" not in seen[seen.rindex(b"\x1b[2K") :]
    assert b"Traceback" not in seen


def until(window: int, words: bytes | None) -> bytes:
    """What is shown until `words` are, or until the other end is closed."""
    seen, deadline = b"", time.monotonic() + 60.0
    with contextlib.suppress(OSError):
        while words is None or words not in seen:
            assert select.select([window], [], [], deadline - time.monotonic())[0], seen
            seen += os.read(window, 4096)
    return seen


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_shows_how_far_the_compiler_is(terminal: bool) -> None:
    words, clock = console(terminal=terminal), Clock()
    with Progress(words, "simulating", 20.0, background=False, clock=clock) as progress:
        progress.update(1.0)
        before = shown(words)
        compiler.reported.get()(0.4)
        compiled = shown(words)[len(before) :]
        compiler.reported.get()(1.0)
        progress.update(2.0)
    assert ("simulating (compiling: 40%)" in compiled and "1 of 20 s" in compiled) == terminal
    assert "compiling" not in shown(words).splitlines()[-1].rpartition("\r")[2]
    if not terminal:
        assert "compil" not in shown(words)
    compiler.reported.get()(0.5)  # nobody hears of it any more
    assert "50%" not in shown(words)
