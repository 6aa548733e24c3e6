"""A process that has loaded all that a side needs, and waits for its command: so another pair begins at once.

Its standard input has one line of JSON, ``{"argv": [...], "environment": {...}}``; what follows is the side's own
(`hapnet.commands.console`). If that ends before the line has come, the process ends too.
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
"""After a pair has been started, its processes have the machine for so long before the next ones are loaded [s]."""


class Standby(NamedTuple):
    """A process that waits to be a side. report : the pipe of its summary, which it calls `file`."""

    child: ProgramOnLoop
    report: int
    file: int

    @classmethod
    async def started(cls) -> Standby:
        """Start one."""
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
        """End it, as it is not needed."""
        os.close(self.report)
        with suppress(ProcessLookupError):
            self.child.kill()
        await self.child.communicate()


class Reserve:
    """A world and a device that wait, once there was time to load them.

    Attributes
    ----------
    processes : by role, those that wait.
    """

    def __init__(self) -> None:
        self.processes: dict[str, Standby] = {}
        self._preparing: asyncio.Task[None] | None = None

    async def take(self) -> dict[str, Standby]:
        """Those that wait and live; they are the caller's now."""
        taken, self.processes = self.processes, {}
        for role, standby in list(taken.items()):
            if standby.child.returncode is not None:
                await taken.pop(role).end()
        return taken

    def prepare(self) -> None:
        """Load those that are missing, in a while; returns at once."""
        if self._preparing is None or self._preparing.done():
            self._preparing = asyncio.create_task(self._load())

    async def _load(self) -> None:
        await asyncio.sleep(PREPARE_AFTER_S)
        for role in ("world", "device"):
            if role not in self.processes:
                self.processes[role] = await Standby.started()

    async def close(self) -> None:
        """End those that wait."""
        if self._preparing is not None:
            self._preparing.cancel()
            await asyncio.wait([self._preparing])
        for standby in self.processes.values():
            await standby.end()


def load() -> None:
    """Do once what a side does first, so that all of it is loaded."""
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
        if not (byte := os.read(0, 1)):  # not more than the line: what follows is not ours
            return 0
        line += byte
    command = json.loads(line)
    os.environ.update(command["environment"])
    return cli.main(command["argv"])


if __name__ == "__main__":
    sys.exit(main())
