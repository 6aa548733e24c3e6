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
"""The processes are killed if they have not ended this long after the request [s]."""


class Pair:
    """Two child processes: a world that listens, and a device that dials it.

    params, seed : of both. directory : for the parameters, and for the files of both.
    on_notice : called with each notice: role, the raw line, and its content.
    record : both record, to device.mcap and world.mcap in `directory`. console : both accept commands (`send`).
    realtime : of the device. session : of both; None: a random name. address : another address on which the world
        listens; the two sides are connected by a Unix socket.
    keyboard : the device's class may read standard input.
    place : where device and proxy begin [m], for a hand that is led; None: where the scene and the hand begin.
    orphaned : the directory for each side's summary if this process is killed; None: it is not written.

    Attributes
    ----------
    parts : by role, the summary that a side has written.
    errors : by role, the lines on standard error.
    failure : one line on the process that ended without a request, or that was stopped by a signal; None: no failure.
    failed : by role, the reason why a side ended early. refused : a side ended early by itself, with an error line.
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
        self._asked_to_end = False
        self._environment = {PARENT: str(os.getpid())} | ({CONSOLE: "1"} if console else {})
        if place is not None:
            self._environment[PLACE] = json.dumps(place)
        if orphaned is not None:
            self._environment[ORPHANED] = str(orphaned.absolute())

    async def start(self, ready: Mapping[str, Standby] = NONE_READY) -> None:
        """Start both sides, in the processes in `ready` (by role, only for a pair with `console`) or in new ones.

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
        """Wait until both have ended: normally, as one failed or was stopped by a signal, or as `stop` was set."""
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
        """Request both to end; a second call requests it without delay. Not by SIGINT, which the terminal sends too.

        A process that a signal has stopped is continued, so that it ends in order: force zero, complete recording.
        """
        self._asked_to_end = True
        self._signal(signal.SIGTERM)
        if sys.platform != "win32":
            self._signal(signal.SIGCONT)

    def _link(self) -> tuple[str, list[str]]:
        """The address at which the world listens for the device, and the flags with a secret word of the two sides."""
        try:
            sockets = tempfile.mkdtemp(prefix="hapnet-")  # only this user can read it
            word = Path(sockets) / "word"
            word.write_text(secrets.token_hex(16), encoding="ascii")
            word.chmod(0o600)
        except OSError:  # no temporary directory can be written
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
        report, theirs = os.pipe()  # for the summary, which then needs no space on a disk
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
        if code not in (0, INCOMPLETE) and not self._asked_to_end and self.failure is None:
            own = (self.errors[role] or lines) if 0 < code < 128 else []
            self.refused = bool(own) and not own[-1].startswith(NOT_STARTED)
            self.failed[role] = own[-1] if own else how_it_ended(code)
            self.failure = own[-1] if own else f"the {role} process {how_it_ended(code)}"

    async def _watch_still(self) -> None:
        """Show which process a signal has stopped, and set `failure` if it does not continue."""
        looks = dict.fromkeys(self._children, 0)
        while max(looks.values()) < LOOKS:
            await asyncio.sleep(LOOK_S)
            for role, child in self._children.items():
                still = child.returncode is None and stands_still(child.pid)
                looks[role] = looks[role] + 1 if still else 0
                if looks[role] == 1:
                    self._notify(role, standing_still(child.pid))
        role = max(looks, key=looks.__getitem__)
        self.failed.setdefault(role, NOT_ON)
        self.failure = self.failure or f"the {role} process {NOT_ON}"

    def _notify(self, role: str, text: str) -> None:
        """Create a notice in place of a stopped process."""
        at = datetime.now(UTC)
        notice = record(Notice("stopped", text, time.monotonic_ns(), "warning"), role, at)
        self._on_notice(role, json.dumps(notice).encode() + b"\n", notice)

    def _signal(self, number: signal.Signals) -> None:
        for child in self._children.values():
            if child.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    child.send_signal(number)


async def _read(pipe: int) -> bytes:
    """Read a pipe until it is closed."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(pipe, "rb", buffering=0)
    )
    return await reader.read()


async def _notices(child: ProgramOnLoop) -> AsyncIterator[tuple[bytes, dict[str, Any]]]:
    """The lines that a process logs: each as raw bytes and as its content."""
    assert child.stdout is not None
    async for line in child.stdout:
        with contextlib.suppress(json.JSONDecodeError):
            yield line, json.loads(line)
