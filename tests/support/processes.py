"""Real processes, as a user starts them: what the tests of whole runs share."""

import contextlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from tests.conftest import ENVIRONMENT

HAPNET = (sys.executable, "-m", "hapnet")
NETEM = (sys.executable, "-c", "import sys; from netem.cli import main; sys.exit(main())")
LIMIT_S = 60.0
_DOING = "starting|running|simulating|drawing|reading|writing|replaying|comparing|sweeping|tuning|checking|measuring"
_DOING += "|compiling"
PROGRESS = re.compile(rf"({_DOING})[a-z ,]*: (\d[\d.]* (of \S+ )?[a-z ]+|.*\d (s|min) (so far|left))$")
"""A line of progress, as a slow machine sees one now and then."""


def without_progress(said: str) -> str:
    """What was said, without lines of progress."""
    return "".join(line for line in said.splitlines(keepends=True) if not PROGRESS.match(line))


def children() -> set[str]:
    """The numbers of this process's children; another test's browser, perhaps, is one."""
    found = set[str]()
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            found |= set((thread / "children").read_text("ascii").split())
    return found


def until(
    condition: Callable[[], bool], limit_s: float = LIMIT_S, said: Callable[[], str] = lambda: "not in time"
) -> None:
    """Poll until it holds, for a bounded time; after that the failure is what `said` says."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, said()
        time.sleep(0.01)


class Program:
    """A started command, its output read as it comes; in a process group of its own, so that what it leaves shows.

    command : what is started. env : variables beside this process's own.
    """

    def __init__(self, *argv: object, command: Sequence[str] = HAPNET, env: Mapping[str, str] | None = None) -> None:
        self.began_ns = time.monotonic_ns()
        self.process = subprocess.Popen(
            [*command, *map(str, argv)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**ENVIRONMENT, **(env or {})},
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=lines.extend, args=(stream,), daemon=True)
            for lines, stream in ((self.out, self.process.stdout), (self.err, self.process.stderr))
        ]
        for reader in self._readers:
            reader.start()

    def until(self, what: str, condition: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
        """Poll until it holds, for a bounded time; the process must not end before."""

        def said(wrong: str) -> str:
            return f"{wrong}: {what}\n{''.join(self.out + self.err)}"

        def holds() -> bool:
            if condition():
                return True
            assert self.process.poll() is None, said("ended before")
            return False

        until(holds, limit_s, lambda: said("not in time"))

    def until_line(self, words: str) -> None:
        self.until(f"a line with {words!r}", lambda: any(words in line for line in [*self.out, *self.err]))

    def end(self, limit_s: float = LIMIT_S) -> tuple[int, str, str]:
        """Exit code, standard output and standard error without lines of progress, once it has ended."""
        code = self.process.wait(limit_s)
        for reader in self._readers:
            reader.join(LIMIT_S)
        return code, "".join(self.out), without_progress("".join(self.err))

    def summary(self, code: int = 0) -> dict[str, Any]:
        """What it has printed as JSON, once it has ended with this code."""
        ended, out, err = self.end()
        assert ended == code, err
        return json.loads(out)

    @property
    def alive(self) -> bool:
        """Does any process of its group live?"""
        try:
            os.killpg(self.process.pid, 0)
        except ProcessLookupError:
            return False
        return True

    def until_gone(self, limit_s: float = LIMIT_S) -> None:
        """Wait until no process of its group lives, whatever has become of itself."""
        until(lambda: not self.alive, limit_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.kill()

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.end()
        assert not any(reader.is_alive() for reader in self._readers), "what it had started has not ended"
        for stream in (self.process.stdout, self.process.stderr):
            stream.close()  # while it is read, this would wait for ever


def started(*argv: object, command: Sequence[str] = HAPNET, env: Mapping[str, str] | None = None) -> Program:
    """A command that is killed at the end of its `with`."""
    return Program(*argv, command=command, env=env)


class Emulator(Program):
    """`hapnet emulate`, ready to be opened as `device`; its account, of what forces really acted, is in `folder`."""

    def __init__(self, name: str, folder: Path, *options: str, at: str = "", more: Sequence[object] = ()) -> None:
        self.account, self.device = folder / "emulator.json", f"{name}:{folder / name}"
        words = ",".join([f"{name}:{at or f'link={folder / name}'}", *options])
        super().__init__("emulate", words, *more, "--json", self.account)
        self.until_line(f"emulates {name}")

    def ended(self) -> dict[str, Any]:
        """Its own account, once it has been told to end."""
        os.kill(self.process.pid, signal.SIGTERM)
        assert self.end()[0] == 0
        return read_json(self.account)


def size(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0


def read_json(file: Path) -> dict[str, Any]:
    return json.loads(file.read_text("utf-8"))


def assert_accounts_agree(summary: dict[str, Any]) -> None:
    """To the nanojoule, in both directions, from the two processes' own counts."""
    for way, sender, receiver in (("up", "device", "world"), ("down", "world", "device")):
        flow = summary["energy"][way]
        assert flow["sent_nJ"] == summary[sender]["sent_nJ"]
        assert flow["credited_nJ"] == summary[receiver]["credited_nJ"]
        assert flow["in_flight_nJ"] >= 0
        assert flow["sent_nJ"] == flow["credited_nJ"] + flow["in_flight_nJ"] + flow["abandoned_nJ"]


def assert_passive(summary: dict[str, Any]) -> None:
    assert summary["theorem"]["margin_J"] > 0.0
    for side in ("device", "world"):
        assert_side_passive(summary[side])


def assert_side_passive(side: dict[str, Any]) -> None:
    """Of a side's part of the summary: its own half of the theorem."""
    assert side["ledger"]["margin_J"] > 0.0
    assert side["ledger"]["slack_J"] >= -1e-9
    assert side["reservoir_min_J"] >= 0.0


def resident_kB(pid: int) -> int:
    """Memory of a process that is in use now."""
    for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    raise AssertionError(f"{pid} has no memory")


def child_of(parent: int, role: str) -> int:
    """The process that any thread of `parent` started with that word on its command line."""
    for thread in Path(f"/proc/{parent}/task").iterdir():
        for child in (thread / "children").read_text("ascii").split():
            if role in Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0"):
                return int(child)
    raise AssertionError(f"{parent} has no child {role}")


@contextlib.contextmanager
def no_room(size: int) -> Iterator[None]:
    """No file of this process may grow beyond `size` bytes: not even the one that the tests' own output goes to."""
    assert signal.getsignal(signal.SIGXFSZ) is signal.SIG_IGN  # Python's own doing: a write fails instead
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
