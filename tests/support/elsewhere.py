"""This machine with what Windows or macOS lacks taken away: ``python -m tests.support.elsewhere win32 device ...``.

It shows what hapnet itself needs of Linux, not how another system behaves. Everything is imported once before, as the
standard library and other packages would look for what those systems have instead; then hapnet is imported anew.
What is missing where: Python's documentation ("Availability") of os, signal, socket, select, time, fcntl and asyncio.
"""

import asyncio
import contextlib
import ctypes
import errno
import importlib
import io
import os
import pkgutil
import select
import signal
import socket
import sys
import time
from types import ModuleType
from typing import Any, ClassVar

OURS = ("hapnet", "netem")

LINUX_ONLY = (
    "epoll", "eventfd", "memfd_create", "pipe2", "sched_getaffinity", "sched_param", "sched_setscheduler", "SCHED_FIFO",
    "setns", "timerfd_create", "unshare", "waitid", "P_PID", "WNOWAIT",
)  # fmt: skip
UNIX_ONLY = (
    "AF_UNIX", "CLOCK_MONOTONIC", "MSG_DONTWAIT", "O_CLOEXEC", "O_NONBLOCK", "SIGALRM", "SIGCHLD", "SIGCONT", "SIGHUP",
    "SIGKILL", "SIGSTOP", "SIGUSR1", "SIGUSR2", "SIG_BLOCK", "SIG_SETMASK", "SIG_UNBLOCK", "WNOHANG", "WSTOPPED",
    "clock_getres", "clock_gettime", "fchmod", "fchown", "fork", "forkpty", "getloadavg", "getuid", "killpg", "mkfifo",
    "nice", "openpty", "poll", "pread", "preadv", "pthread_sigmask", "pwrite", "pwritev", "set_blocking", "sigpending",
    "sigwait", "sysconf", "ttyname", "uname",
)  # fmt: skip
UNIX_MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")


def modules() -> list[str]:
    """Names of all of hapnet's and netem's modules."""
    found = []
    for name in OURS:
        package = importlib.import_module(name)
        found += [name, *(module.name for module in pkgutil.walk_packages(package.__path__, f"{name}."))]
    return [name for name in found if not name.endswith("__main__")]


def become(platform: str) -> None:
    """Take away what `platform` lacks, and forget hapnet's modules."""
    for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
        del sys.modules[name]
    _without_packets()
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # the compiler that is here is Linux's
    gone = LINUX_ONLY + (UNIX_ONLY if platform == "win32" else ())
    for module in (os, signal, socket, select, time):
        for name in gone:
            module.__dict__.pop(name, None)
    _without_proc()
    _without_symbols(platform)
    if platform == "win32":
        for name in UNIX_MODULES:
            sys.modules[name] = None  # type: ignore[assignment]  # importing it then fails
        for kind in (asyncio.BaseEventLoop, asyncio.SelectorEventLoop, *asyncio.SelectorEventLoop.__mro__[1:3]):
            for name in ("add_signal_handler", "add_reader", "remove_reader", "connect_read_pipe"):
                if name in vars(kind):
                    setattr(kind, name, _refuse)
    sys.platform = platform


def _refuse(*given: object, **more: object) -> Any:
    raise NotImplementedError


def _without_proc() -> None:
    def look(event: str, given: tuple[Any, ...]) -> None:
        if event == "open" and str(given[0]).startswith(("/proc", "/sys")):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(given[0]))

    sys.addaudithook(look)


def _without_symbols(platform: str) -> None:
    before = ctypes.CDLL

    class Library(before):  # type: ignore[misc, valid-type]
        def __init__(self, name: str | None, *given: Any, **more: Any) -> None:
            if name is None and platform == "win32":
                raise TypeError("expected str, bytes or os.PathLike object, not NoneType")
            super().__init__(name, *given, **more)
            self.__dict__["_is_libc"] = name is None

        def __getattr__(self, name: str) -> Any:
            if self.__dict__.get("_is_libc") and name.startswith(("timerfd", "prctl", "pthread_setname")):
                raise AttributeError(name)
            return super().__getattr__(name)

    ctypes.CDLL = Library  # type: ignore[misc]
    if platform == "win32":
        ctypes.WinDLL = Winmm  # type: ignore[attr-defined]


class Winmm:
    """Windows' library of timers, which other systems lack: it notes what it is asked for."""

    asked: ClassVar[list[tuple[str, int]]] = []
    result = 0  # TIMERR_NOERROR

    def __init__(self, name: str) -> None:
        assert name == "winmm"

    def timeBeginPeriod(self, period_ms: int) -> int:
        self.asked.append(("begin", period_ms))
        return self.result

    def timeEndPeriod(self, period_ms: int) -> int:
        self.asked.append(("end", period_ms))
        return self.result


def _without_packets() -> None:
    """Neither has packets on a Unix socket; Python makes a pair of others in their place."""
    before, ours = socket.socketpair, socket.AF_UNIX

    def pair(family: Any = None, kind: Any = socket.SOCK_STREAM, proto: int = 0) -> Any:
        if kind == socket.SOCK_SEQPACKET:
            raise OSError(errno.EPROTONOSUPPORT, os.strerror(errno.EPROTONOSUPPORT))
        return before(ours, kind, proto)

    socket.socketpair = pair  # type: ignore[assignment]


def failures(platform: str) -> list[str]:
    """The modules that cannot be imported there, each with why."""
    names = modules()
    for name in names:
        importlib.import_module(name)
    become(platform)
    found = []
    for name in names:
        try:
            importlib.import_module(name)
        except Exception as error:
            found.append(f"{name}: {type(error).__name__}: {error}")
    return found


def main(platform: str, words: list[str]) -> int:
    """Run a command of hapnet there, or list what cannot be imported; returns the exit code."""
    if words == ["imports"]:
        print("\n".join(failures(platform)))
        return 0
    for name in (
        "hapnet.commands.side",
        "hapnet.ext.doctor.commands",
        "hapnet.realtime.runner",
        "hapnet.cli",
        "netem.aio",
        "rich.console",  # it would look for the console of Windows
    ):
        importlib.import_module(name)
    with contextlib.redirect_stdout(io.StringIO()):  # what reads the command line is imported then
        importlib.import_module("hapnet.cli").main([words[0], "--help"])
        importlib.import_module("hapnet.cli").main([*words, "--show-params"])
    become(platform)
    sys.argv = ["hapnet", *words]
    command: ModuleType = importlib.import_module("hapnet.__main__")
    return command.main()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
