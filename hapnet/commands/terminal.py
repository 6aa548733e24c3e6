"""The terminal that a command was started in: a device's class may read its keyboard, and it is left as it was."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def is_ours() -> bool:
    """Whether a child process may read standard input. A terminal stops whoever reads in the background."""
    ours = True
    if sys.platform != "win32":
        ours = not sys.stdin.isatty() or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    return ours


@contextmanager
def left_as_it_was() -> Iterator[None]:
    """At the end the terminal is in the mode that it had, even if whoever changed it was killed."""
    if sys.platform == "win32" or not sys.stdin.isatty() or not is_ours():
        yield
    else:
        import termios

        before = termios.tcgetattr(sys.stdin.fileno())
        try:
            yield
        finally:
            with suppress(termios.error):  # it was closed meanwhile
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, before)
