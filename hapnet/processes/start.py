"""Start programs, and end them."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

Program = subprocess.Popen[bytes]
ProgramOnLoop = asyncio.subprocess.Process
TimeoutExpired = subprocess.TimeoutExpired
NOTHING, PIPE = subprocess.DEVNULL, subprocess.PIPE

LOOKS, LOOK_S = 20, 0.5
"""A process that is stopped (SIGSTOP) at this many looks in a row, this far apart [s], is ended. Looks are counted, not
time, as the parent may have been stopped too, and just been continued."""

NOT_ON = "was stopped by a signal, and not continued"
"""The reason for ending such a process."""

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def module(name: str, *arguments: str) -> list[str]:
    """The command that runs a module of this interpreter."""
    return [sys.executable, "-m", name, *arguments]


def started(
    command: Sequence[str],
    *,
    stdin: int | None = None,
    stdout: int | None = None,
    stderr: int | None = None,
    keeps: Collection[int] = (),
    environment: Mapping[str, str] | None = None,
    own_group: bool = False,
) -> Program:
    """Start a program; it leaves Ctrl-C to this process until it has a handler for it.

    stdin, stdout, stderr : `NOTHING`, `PIPE`, or a file's number; None: this process's. keeps : open files to inherit.
    environment : additional variables. own_group : the terminal's Ctrl-C does not reach it.

    Raises OSError: it cannot be started.
    """
    with for_children():
        return subprocess.Popen(
            command, stdin=stdin, stdout=stdout, stderr=stderr, pass_fds=tuple(keeps),
            env={**os.environ, **(environment or {})}, process_group=0 if own_group else None,
        )  # fmt: skip


def side_command(
    role: str, *flags: str, session: str, params: Path, seed: int, record: Path | None, summary: str
) -> list[str]:
    """The command that runs one side of a pair, and prints its notices.

    params : the parameters' file. record : where its recording goes. summary : where its summary goes.
    """
    command = module("hapnet", role, *flags, "--no-multicast-scouting", "--session", session, "--params", str(params))
    command += ["--seed", str(seed), "--json", summary, "--log", "-"]
    return command if record is None else [*command, "--record", str(record)]


async def started_on_loop(
    command: Sequence[str],
    *,
    stdin: int | None = None,
    keeps: Collection[int] = (),
    environment: Mapping[str, str] | None = None,
    own_group: bool = False,
) -> ProgramOnLoop:
    """Start a program as `started` does, with its output and errors as pipes for the event loop."""
    with for_children():
        return await asyncio.create_subprocess_exec(
            *command, stdin=stdin, stdout=PIPE, stderr=PIPE, pass_fds=tuple(keeps),
            env={**os.environ, **(environment or {})}, process_group=0 if own_group else None,
        )  # fmt: skip


def end(program: Program, limit_s: float) -> str:
    """End a program that was requested to end: after `limit_s` by SIGTERM, after as long again by SIGKILL.

    Returns in words how it ended.
    """
    for more in (program.terminate, program.kill, None):
        with suppress(TimeoutExpired):
            program.wait(limit_s)
            break
        if more is not None:
            more()
    return how_it_ended(program.returncode)


def kill(program: Program) -> None:
    """End it now."""
    program.kill()
    program.communicate()


def how_it_ended(code: int | None) -> str:
    """Describe how a process ended: by its exit code, or by a signal, which it may have handled. None: it runs."""
    if code is None:
        return "does not answer"
    with suppress(ValueError):
        return f"was {'killed' if code < 0 else 'ended'} by {signal.Signals(-code if code < 0 else code - 128).name}"
    return f"ended with exit code {code}"


def stands_still(pid: int) -> bool:
    """Whether a signal has stopped this child. The check does not consume its exit status."""
    still = False
    if sys.platform == "linux":  # Windows has no stopped processes, and macOS does not report them
        with suppress(ChildProcessError):
            still = os.waitid(os.P_PID, pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
    return still


def standing_still(pid: int) -> str:
    """Describe a child that a signal has stopped."""
    limit_s = LOOKS * LOOK_S
    return f"was stopped by a signal; it is ended after {limit_s:.0f} s unless it is continued (kill -CONT {pid})"


class _Held(threading.local):
    """Holds Ctrl-C back from this thread while children start: from the first start's begin until the last one's end,
    as starts of an event loop overlap, and end in any order."""

    starts = 0

    def begin(self) -> None:
        """Hold Ctrl-C back, if it is not held yet."""
        self.starts += 1
        if self.starts > 1:
            return
        came: list[int] = []
        main = threading.current_thread() is threading.main_thread()
        self.came, self.handler = came, signal.getsignal(signal.SIGINT) if main else None
        if callable(self.handler):
            signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
        if sys.platform != "win32":
            self.masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})

    def end(self) -> None:
        """Raise Ctrl-C, if it came, once no child is starting any more."""
        self.starts -= 1
        if self.starts:
            return
        if sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, self.masked)
        if callable(self.handler):
            signal.signal(signal.SIGINT, self.handler)
        if self.came:
            signal.raise_signal(signal.SIGINT)


_HELD = _Held()


@contextmanager
def for_children(*, one_thread: bool = False) -> Iterator[None]:
    """Processes started in this context leave Ctrl-C to their parent; with `one_thread` each computes with one.

    A Ctrl-C that comes meanwhile is raised at the end: a process whose start is interrupted ends in a traceback. The
    children inherit the mask. It does not protect this thread, as Python raises here what any other thread receives.
    """
    before = {name: os.environ.get(name) for name in _THREADS if one_thread}
    os.environ.update(dict.fromkeys(before, "1"))
    _HELD.begin()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        _HELD.end()
