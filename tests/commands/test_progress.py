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
from hapnet.commands.progress import BAR_AFTER_S, LINE_EVERY_S, Progress
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


def script(words: Console, seconds: int, *, total: float | None = 20.0, speed: float = 1.0) -> Progress:
    """A command that lasts so many seconds, seen four times a second as the thread would."""
    clock = Clock()
    progress = Progress(words, "simulating", total, clock=clock)
    for quarter in range(4 * seconds):
        clock.now = 100.0 + quarter / 4.0
        if total is not None:
            progress.update(speed * quarter / 4.0)
        progress.tick()
    return progress


@pytest.mark.parametrize("terminal", [True, False])
def test_what_is_over_within_a_second_shows_nothing(terminal: bool) -> None:
    words = console(terminal=terminal)
    script(words, int(BAR_AFTER_S))
    assert shown(words) == ""


def test_in_a_pipe_there_is_a_line_now_and_then() -> None:
    words = console(terminal=False)
    script(words, 17)
    assert shown(words).splitlines() == [
        "simulating: 5 of 20 s, 15 s left",
        "simulating: 10 of 20 s, 10 s left",
        "simulating: 15 of 20 s, 5 s left",
    ]
    brief = console(terminal=False)
    script(brief, int(LINE_EVERY_S))
    assert shown(brief) == ""


def test_the_time_left_is_at_the_speed_until_now() -> None:
    words = console(terminal=False)
    script(words, 6, total=10_000.0, speed=2.0)
    assert shown(words) == "simulating: 10 of 10000 s, 83 min left\n"


def test_a_stage_whose_end_nobody_knows() -> None:
    words = console(terminal=False)
    script(words, 6, total=None)
    assert shown(words) == "simulating: 5 s so far\n"


def test_a_new_stage_counts_from_its_first_update() -> None:
    words, clock = console(terminal=False), Clock()
    progress = Progress(words, "starting", clock=clock)
    clock.now += 4.0
    progress.stage("running", 11.0)
    progress.update(1.0)
    clock.now += 5.0
    progress.update(6.0)
    progress.tick()
    assert shown(words) == "running: 6 of 11 s, 5 s left\n"


def test_where_it_is_measured_every_update_is_shown_and_nothing_else() -> None:
    words = console(terminal=False)
    with Progress(words, "measuring", 2, "", background=False) as progress:
        progress.update(0, "1/2 servo")
        progress.update(1, "2/2 codec")
    assert shown(words).splitlines() == ["1/2 servo", "2/2 codec: 0 s left"]


@pytest.mark.parametrize("width", [20, 40, 80, 200])
def test_a_bar_is_one_line_and_is_gone_at_the_end(width: int) -> None:
    words, clock = console(terminal=True, width=width), Clock()
    with Progress(words, "simulating", 600.0, clock=clock) as progress:
        for second in (0, 2, 4):
            clock.now = 100.0 + second
            progress.update(second)
            progress.tick()
    text = shown(words)
    assert text.count("\n") == text.count("\x1b[1A") == 1  # at the end: down, and up again
    drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text).split("\r")
    assert 10 < max(len(line.rstrip("\n")) for line in drawn) <= width
    assert width < 80 or "4 of 600 s" in text
    assert text.rindex(SHOW.decode()) > text.rindex(HIDE.decode())
    assert text.endswith("\x1b[2K")


def test_lines_that_are_said_meanwhile_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bar is on standard error and the words on standard output, both the same terminal: the bar makes room."""
    window, inside = pty.openpty()
    clock = Clock()
    with open(inside, "w", encoding="utf-8") as terminal:  # a descriptor
        for stream in ("stdout", "stderr"):
            monkeypatch.setattr(sys, stream, terminal)
        with Progress(output.progress_console(), "running", 60.0, background=False, clock=clock) as progress:
            progress.update(1.0)
            output.console(None).print("device: paired with the world")
            progress.update(2.0)
        terminal.flush()
        seen = os.read(window, 65536).decode()
    os.close(window)
    assert "\r\x1b[2Kdevice: paired with the world\r\n" in seen
    assert "2 of 60 s" in seen[seen.index("paired") :]


def test_progress_is_for_people_and_results_are_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(output.progress_console(), "measuring", 2, "", background=False) as progress:
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
