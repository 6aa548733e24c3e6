"""Boards for the serial axis: its sketch compiled for this machine, behind an adapter that may spoil bytes."""

import os
import signal
import subprocess
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from tests.conftest import ROOT

SKETCH = ROOT / "examples" / "serial_axis" / "serial_axis.ino"
STAND_IN = ROOT / "tests" / "sketch"


def compiled(folder: Path) -> Path:
    """The sketch as a program of this machine."""
    program = folder / "board"
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{STAND_IN}", f'-DSKETCH="{SKETCH}"']
    subprocess.run(["g++", *flags, STAND_IN / "board.cpp", "-o", program], check=True)
    return program


class Pty:
    """A pseudo-terminal: the board's end, and the driver's end at `path`."""

    def __init__(self) -> None:
        self.board, self._driver = os.openpty()
        for end in (self.board, self._driver):
            tty.setraw(end)
        self.path = os.ttyname(self._driver)

    def type(self, data: bytes) -> None:
        """Send bytes to the board."""
        os.write(self._driver, data)

    def close(self) -> None:
        os.close(self.board)
        os.close(self._driver)


class SketchBoard:
    """The compiled sketch `program` on a pseudo-terminal; `words` : its arguments.

    spoil : what becomes of the bytes on their way to the host. held : an adapter with a latency timer of 16 ms, as
    FTDI's application note AN232B-04 describes it: bytes go on when 62 have come, or 16 ms after the first.
    """

    def __init__(
        self,
        program: Path,
        *words: object,
        spoil: Callable[[bytes], bytes] | None = None,
        held: bool = False,
    ) -> None:
        self._pty = Pty()
        self.path = self._pty.path
        self._spoil, self._held = spoil, held
        between = spoil is not None or held
        self._process = subprocess.Popen(
            [program, *map(str, words)],
            stdin=self._pty.board,
            stdout=subprocess.PIPE if between else self._pty.board,
            bufsize=0,
        )
        self._copying = threading.Thread(target=self._copy, daemon=True)
        if between:
            self._copying.start()

    def reset(self) -> None:
        """As the button on the board does."""
        self._process.send_signal(signal.SIGUSR1)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        if self._copying.is_alive():
            self._copying.join()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._pty.close()

    def _copy(self) -> None:
        waiting, since_s = b"", 0.0
        os.set_blocking(self._pty.board, False)
        while came := self._process.stdout.read(20):
            if not waiting:
                since_s = time.monotonic()
            waiting += came
            if self._held and len(waiting) < 62 and time.monotonic() - since_s < 0.016:
                continue
            out, waiting = (waiting[:62], waiting[62:]) if self._held else (waiting, b"")
            since_s = time.monotonic()
            out = out if self._spoil is None else self._spoil(out)
            try:
                os.write(self._pty.board, out)
            except BlockingIOError:  # nobody reads
                continue
