"""The command `hapnet`, and `python -m hapnet`: what must be settled before anything slow is imported."""

import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Run the command; its exit code."""
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _leave)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup
        signal.signal(signal.SIGHUP, _leave)
    from hapnet.cli import main

    return main()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Ctrl-C. An import that it interrupts may swallow an exception, or print it: it ends the process instead."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            _leave(number, frame)
        frame = frame.f_back
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
