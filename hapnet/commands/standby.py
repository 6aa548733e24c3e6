"""A process that has loaded everything that a side needs, and waits for its command, so that the next pair starts fast.

Its standard input has one line of JSON, ``{"argv": [...], "environment": {...}}``; the rest is for the side
(`hapnet.commands.console`). If standard input ends before that line, the process ends too.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import redirect_stdout, suppress
from io import StringIO
from typing import NamedTuple

from hapnet.processes.start import PIPE, ProgramOnLoop, module, started_on_loop

PREPARE_AFTER_S = 2.0
"""The next processes are loaded this long after a pair was started, so that the pair's own start is not slowed [s]."""


class Standby(NamedTuple):
    """A process that waits to run a side. report : this end of the pipe of its summary. file : the process's end."""

    child: ProgramOnLoop
    report: int
    file: int

    @classmethod
    async def started(cls) -> Standby:
        """Start such a process."""
        report, theirs = os.pipe()
        try:
            command = module("hapnet.commands.standby")
            child = await started_on_loop(command, stdin=PIPE, keeps=(theirs,), own_group=True)
        except BaseException:
            os.close(report)
            raise
        finally:
            os.close(theirs)
        return cls(child, report, theirs)

    async def end(self) -> None:
        """End the process, which is not needed any more."""
        os.close(self.report)
        with suppress(ProcessLookupError):
            self.child.kill()
        await self.child.communicate()


class Reserve:
    """A waiting process for the world and one for the device, loaded in the background.

    Attributes
    ----------
    processes : by role, the waiting processes.
    """

    def __init__(self) -> None:
        self.processes: dict[str, Standby] = {}
        self._preparing: asyncio.Task[None] | None = None

    async def take(self) -> dict[str, Standby]:
        """Return the waiting processes that are alive; the caller then owns them."""
        taken, self.processes = self.processes, {}
        for role, standby in list(taken.items()):
            if standby.child.returncode is not None:
                await taken.pop(role).end()
        return taken

    def prepare(self) -> None:
        """Load the missing processes after `PREPARE_AFTER_S`; returns at once."""
        if self._preparing is None or self._preparing.done():
            self._preparing = asyncio.create_task(self._load())

    async def _load(self) -> None:
        await asyncio.sleep(PREPARE_AFTER_S)
        for role in ("world", "device"):
            if role not in self.processes:
                self.processes[role] = await Standby.started()

    async def close(self) -> None:
        """End the waiting processes."""
        if self._preparing is not None:
            self._preparing.cancel()
            await asyncio.wait([self._preparing])
        for standby in self.processes.values():
            await standby.end()


def load() -> None:
    """Do the first steps of a side once, so that their modules are loaded."""
    import rich.console

    from hapnet import cli
    from hapnet.assembly.build import prepare
    from hapnet.commands.options import ZenohOptions
    from hapnet.commands.side import zenoh_settings
    from hapnet.installing import versions
    from hapnet.laws import COUPLING_NAMES, built_in
    from hapnet.params import Params
    from hapnet.wire.secret import Secret

    for name in COUPLING_NAMES:
        built_in(name)
    rich.console.Console(file=StringIO())
    prepare(Params())
    zenoh_settings(ZenohOptions())
    Secret(bytes(32))
    versions()
    with redirect_stdout(StringIO()):
        cli.main(["world", "--show-params"])


def main() -> int:
    """Load, wait, and run the command; returns its exit code."""
    from hapnet import cli

    load()
    line = bytearray()
    while not line.endswith(b"\n"):
        if not (byte := os.read(0, 1)):  # byte by byte, as the input after the line is for the side
            return 0
        line += byte
    command = json.loads(line)
    os.environ.update(command["environment"])
    return cli.main(command["argv"])


if __name__ == "__main__":
    sys.exit(main())
