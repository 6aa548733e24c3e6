"""The command `hapnet`, and `python -m hapnet`: sets the signal handlers before anything slow is imported."""

import os
import signal
import sys
from types import FrameType

EVALUATED = ("<string>", "<module>")


def main() -> int:
    """Run the command; returns its exit code."""
    _open_streams()
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _leave)
    if sys.platform != "win32":
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup
            signal.signal(signal.SIGHUP, _leave)
        if signal.SIGINT in signal.sigpending():  # the parent had blocked it while this interpreter started
            os._exit(128 + signal.SIGINT)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    from hapnet.cli import main as command
    from hapnet.commands.output import unless_closed

    return unless_closed(command)


def _open_streams() -> None:
    """Replace closed standard streams (``>&-``), so that no other file gets their numbers.

    Writing to them is an error, as it would be without this.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.open(os.devnull, os.O_RDONLY)  # gets the lowest free number
            setattr(sys, name, open(number, "w" if number else "r", encoding="utf-8", closefd=False))  # noqa: SIM115


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C: raise KeyboardInterrupt or, where an exception could be lost, end the process at once.

    An import may swallow the exception, or print it. And if it passes through an evaluated string (an annotation, for
    example), Python ends by the signal itself, even if the exception was caught.
    """
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith("<frozen importlib") or (code.co_filename, code.co_name) == EVALUATED:
            _leave(number, frame)
        frame = frame.f_back
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    progress = sys.modules.get("hapnet.commands.progress")
    if progress is not None and hasattr(progress, "erase"):  # the signal may interrupt its import
        progress.erase()
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
