"""The command `hapnet`, and `python -m hapnet`: what must be settled before anything slow is imported."""

import os
import signal
import sys
from types import FrameType

EVALUATED = ("<string>", "<module>")


def main() -> int:
    """Run the command; its exit code."""
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _leave)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup
        signal.signal(signal.SIGHUP, _leave)
    if signal.SIGINT in signal.sigpending():  # held back by who started this, as the interpreter was starting
        os._exit(128 + signal.SIGINT)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    from hapnet.cli import main

    return main()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Ctrl-C. Where an exception would not do, it ends the process at once.

    An import may swallow it, or print it; and once it has passed through an evaluated string (an annotation, say),
    Python ends by the signal itself, whoever has caught it.
    """
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith("<frozen importlib") or (code.co_filename, code.co_name) == EVALUATED:
            _leave(number, frame)
        frame = frame.f_back
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    progress = sys.modules.get("hapnet.commands.progress")
    if progress is not None and hasattr(progress, "erase"):  # an import of it may be what is interrupted
        progress.erase()
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
