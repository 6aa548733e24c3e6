import io
import threading

import pytest

from netem import progress as module
from netem.progress import Progress


class Screen(io.StringIO):
    """Where people read; says when `enough` lines or redrawn lines have come."""

    def __init__(self, *, terminal: bool, enough: int) -> None:
        super().__init__()
        self._terminal, self._enough = terminal, enough
        self.full = threading.Event()

    def isatty(self) -> bool:
        return self._terminal

    def flush(self) -> None:
        if self.getvalue().count("\r" if self._terminal else "\n") >= self._enough:
            self.full.set()


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SHOW_AFTER_S", "LINE_EVERY_S", "_REDRAW_S"):
        monkeypatch.setattr(module, name, 0.001)


def test_lines_in_a_pipe() -> None:
    out = Screen(terminal=False, enough=3)
    progress = Progress(out, "sending")
    progress.at(0.25)
    with progress:
        assert out.full.wait(10)
    assert out.getvalue().startswith("sending: 25 %, 0 s left\nsending: 25 %, 0 s left\n")


def test_one_line_on_a_terminal_that_is_gone_at_the_end() -> None:
    out = Screen(terminal=True, enough=3)
    with Progress(out, "measuring"):
        assert out.full.wait(10)
    assert "\rmeasuring: 0 s so far\x1b[K" in out.getvalue()
    assert "\n" not in out.getvalue()
    assert out.getvalue().endswith("\r\x1b[K")


def test_nothing_before_it_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SHOW_AFTER_S", 1000.0)
    out = Screen(terminal=True, enough=1)
    with Progress(out, "measuring"):
        pass
    assert out.getvalue() == ""


def test_the_time_left() -> None:
    out = Screen(terminal=False, enough=1)
    assert Progress(out, "a", expected_s=40.0).line(10.0) == "a: 25 %, 30 s left"
    assert Progress(out, "a", expected_s=40.0).line(50.0) == "a: 100 %, 0 s left"
    known = Progress(out, "a")
    known.at(0.2)
    assert known.line(10.0) == "a: 20 %, 40 s left"
    assert Progress(out, "a").line(10.0) == "a: 10 s so far"


def test_a_reader_that_has_gone_ends_nothing() -> None:
    class Gone(Screen):
        def write(self, text: str) -> int:
            self.full.set()
            raise BrokenPipeError

    out = Gone(terminal=False, enough=1)
    with Progress(out, "sending"):
        assert out.full.wait(10)
