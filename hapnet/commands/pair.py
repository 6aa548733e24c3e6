"""Starts, reads and ends the two processes of a run on this machine."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hapnet.checks import Vector
from hapnet.commands.log import record
from hapnet.commands.side import CONSOLE, ORPHANED, PARENT, PLACE
from hapnet.commands.standby import Standby
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.processes.start import (
    LOOK_S,
    LOOKS,
    NOT_ON,
    NOTHING,
    PIPE,
    ProgramOnLoop,
    how_it_ended,
    module,
    side_command,
    standing_still,
    stands_still,
    started_on_loop,
)
from hapnet.realtime.servo_process import NOT_STARTED
from hapnet.side.notices import Notice
from hapnet.summary.causes import INCOMPLETE
from hapnet.transport.config import free_address, local_address

NONE_READY: Mapping[str, Standby] = MappingProxyType({})

STOP_LIMIT_S = 30.0
"""How long the processes may take to end after the request [s]; then they are killed."""


class Pair:
    """Two child processes: a world that listens, and a device that dials it.

    params, seed : of both. directory : for the parameters, and for what both write.
    on_notice : called with each notice: role, the raw line, and its content.
    record : both record, to device.mcap and world.mcap in `directory`. console : both take commands (`send`).
    realtime : of the device. session : of both; None: a random one. address : where the world listens for others
        too; the two are connected by a Unix socket.
    keyboard : the device's class may read standard input.
    place : where device and proxy begin [m], for a hand that is led; None: where the scene and the hand begin.
    orphaned : where each side leaves its summary if this process is killed; None: nowhere.

    Attributes
    ----------
    parts : the summary of each side that has left one.
    errors : by role, the lines on standard error.
    failure : one line on the process that ended although nobody had asked it to, or that stood still; None: none.
    failed : by role, why a side ended before its time. refused : one did so by itself, and said why.
    """

    def __init__(
        self,
        params: Params,
        seed: int,
        directory: Path,
        on_notice: Callable[[str, bytes, dict[str, Any]], None],
        *,
        record: bool = True,
        console: bool = False,
        realtime: bool = False,
        session: str | None = None,
        address: str | None = None,
        keyboard: bool = False,
        place: Vector | None = None,
        orphaned: Path | None = None,
    ) -> None:
        self._address = address
        self._at_end = contextlib.ExitStack()
        self._session = session or f"run-{secrets.token_hex(4)}"
        self.parts: dict[str, dict[str, Any]] = {}
        self.errors: dict[str, list[str]] = {}
        self.failure: str | None = None
        self.failed: dict[str, str] = {}
        self.refused = False
        self._params, self._seed, self._directory, self._on_notice = params, seed, directory, on_notice
        self._keyboard = None if keyboard else NOTHING
        self._record, self._console, self._realtime = record, console, realtime
        self._children: dict[str, ProgramOnLoop] = {}
        self._reports: dict[str, asyncio.Task[bytes]] = {}
        self._reported = False
        self._environment = {PARENT: str(os.getpid())} | ({CONSOLE: "1"} if console else {})
        if place is not None:
            self._environment[PLACE] = json.dumps(place)
        if orphaned is not None:
            self._environment[ORPHANED] = str(orphaned.absolute())

    async def start(self, ready: Mapping[str, Standby] = NONE_READY) -> None:
        """Start both, by role as one of the processes that are `ready`, if any is; these are for a pair with `console`.

        Raises HapnetError if the parameters cannot be written.
        """
        try:
            (self._directory / "params.toml").write_text(self._params.toml(sources=True), encoding="utf-8")
        except OSError as error:
            raise HapnetError(f"cannot write to {self._directory}: {error.strerror or error}") from None
        link, secret = self._link()
        listens = ["--listen", link] if self._address is None else ["--listen", link, "--listen", self._address]
        for role, endpoints in (("world", listens), ("device", ["--connect", link])):
            self._children[role] = await self._start(role, [*endpoints, *secret], ready.get(role))

    async def run(self, stop: asyncio.Event) -> None:
        """Wait until both have ended: normally, because one failed or stood still, or because `stop` was set."""
        watchers = [asyncio.create_task(self._watch(role)) for role in self._children]
        stopping = asyncio.create_task(stop.wait())
        stopping.add_done_callback(lambda task: None if task.cancelled() else self.stop())
        still = asyncio.create_task(self._watch_still())
        while self.failure is None and not stopping.done() and not all(task.done() for task in watchers):
            pending = [task for task in (*watchers, stopping, still) if not task.done()]
            limit_s = STOP_LIMIT_S if any(task.done() for task in watchers) else None  # both end at the same time
            done, _ = await asyncio.wait(pending, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            if not done:
                break
        if self.failure is not None or not stopping.done():
            self.stop()
        _, late = await asyncio.wait(watchers, timeout=STOP_LIMIT_S)
        if late:
            self.failure = self.failure or "a process did not end, and was killed"
            for child in self._children.values():
                with contextlib.suppress(ProcessLookupError):
                    child.kill()
            await asyncio.wait(watchers)
        for task in (stopping, still):
            task.cancel()
        for task in watchers:
            task.result()
        self._at_end.close()

    def recording(self, role: str) -> Path:
        """The path of this side's recording."""
        return self._directory / f"{role}.mcap"

    def send(self, role: str, **command: Any) -> None:
        """Send a command to one side's console; nothing happens if that side has ended."""
        child = self._children.get(role)
        if child is not None and child.stdin is not None and child.returncode is None:
            with contextlib.suppress(ConnectionError):
                child.stdin.write(json.dumps(command).encode() + b"\n")

    def stop(self) -> None:
        """Ask both to end; called again: without delay. SIGINT would count twice, as the terminal sends it too.

        One that stands still goes on, so that it can end in order: without force, and with a whole recording.
        """
        self._reported = True
        self._signal(signal.SIGTERM)
        if sys.platform != "win32":
            self._signal(signal.SIGCONT)

    def _link(self) -> tuple[str, list[str]]:
        """Where the world listens for the device, and the flags of a word that nobody else knows."""
        try:
            sockets = tempfile.mkdtemp(prefix="hapnet-")  # nobody but this user may look into it
            word = Path(sockets) / "word"
            word.write_text(secrets.token_hex(16), encoding="ascii")
            word.chmod(0o600)
        except OSError:  # nothing can be written there
            return free_address(), []
        self._at_end.callback(shutil.rmtree, sockets, ignore_errors=True)
        return local_address(sockets), ["--secret-file", str(word)]

    async def _start(self, role: str, endpoints: list[str], standby: Standby | None) -> ProgramOnLoop:
        if standby is not None:
            argv = self._command(role, endpoints, standby.file)[len(module("hapnet")) :]
            assert standby.child.stdin is not None
            standby.child.stdin.write(json.dumps({"argv": argv, "environment": self._environment}).encode() + b"\n")
            self._reports[role] = asyncio.create_task(_read(standby.report))
            return standby.child
        report, theirs = os.pipe()  # for the summary, which then needs no room on a disk
        try:
            child = await started_on_loop(
                self._command(role, endpoints, theirs),
                stdin=PIPE if self._console else self._keyboard if role == "device" else NOTHING,
                keeps=(theirs,),
                environment=self._environment,
                own_group=self._console,
            )
        finally:
            os.close(theirs)
        self._reports[role] = asyncio.create_task(_read(report))
        return child

    def _command(self, role: str, endpoints: list[str], report: int) -> list[str]:
        flags = [*endpoints, "--progress", "--no-files"]
        flags += ["--realtime"] * (self._realtime and role == "device")
        record = self.recording(role) if self._record else None
        return side_command(
            role, *flags, session=self._session, params=self._directory / "params.toml", seed=self._seed,
            record=record, summary=f"/dev/fd/{report}",
        )  # fmt: skip

    async def _watch(self, role: str) -> None:
        child = self._children[role]
        assert child.stderr is not None
        errors = asyncio.create_task(child.stderr.read())
        async for line, notice in _notices(child):
            self._on_notice(role, line, notice)
        lines = (await errors).decode(errors="replace").strip().splitlines()
        code = await child.wait()
        self.errors[role] = [line.removeprefix("hapnet: ") for line in lines if line.startswith("hapnet: ")]
        with contextlib.suppress(json.JSONDecodeError):
            self.parts[role] = json.loads(await self._reports[role])
        if code not in (0, INCOMPLETE) and not self._reported and self.failure is None:
            own = (self.errors[role] or lines) if 0 < code < 128 else []
            self.refused = bool(own) and not own[-1].startswith(NOT_STARTED)
            self.failed[role] = own[-1] if own else how_it_ended(code)
            self.failure = own[-1] if own else f"the {role} process {how_it_ended(code)}"

    async def _watch_still(self) -> None:
        """Say which process stands still, and set `failure` if it does not go on."""
        looks = dict.fromkeys(self._children, 0)
        while max(looks.values()) < LOOKS:
            await asyncio.sleep(LOOK_S)
            for role, child in self._children.items():
                still = child.returncode is None and stands_still(child.pid)
                looks[role] = looks[role] + 1 if still else 0
                if looks[role] == 1:
                    self._say(role, standing_still(child.pid))
        role = max(looks, key=looks.__getitem__)
        self.failed.setdefault(role, NOT_ON)
        self.failure = self.failure or f"the {role} process {NOT_ON}"

    def _say(self, role: str, text: str) -> None:
        """A notice about a process that cannot speak for itself."""
        at = datetime.now(UTC)
        notice = record(Notice("stopped", text, time.monotonic_ns(), "warning"), role, at)
        self._on_notice(role, json.dumps(notice).encode() + b"\n", notice)

    def _signal(self, number: signal.Signals) -> None:
        for child in self._children.values():
            if child.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(number)


async def _read(pipe: int) -> bytes:
    """Read everything from a pipe until it is closed."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(pipe, "rb", buffering=0)
    )
    return await reader.read()


async def _notices(child: ProgramOnLoop) -> AsyncIterator[tuple[bytes, dict[str, Any]]]:
    """The lines that a process logs: each as raw bytes, and its content."""
    assert child.stdout is not None
    async for line in child.stdout:
        with contextlib.suppress(json.JSONDecodeError):
            yield line, json.loads(line)
