"""Processes that wait to be the next pair: a switch would take as long as Python takes to load two sides."""

from __future__ import annotations

import asyncio

from hapnet.commands.pair import Standby

PREPARE_AFTER_S = 2.0
"""After a pair has been started, its processes have the machine for so long before the next ones are loaded [s]."""


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
