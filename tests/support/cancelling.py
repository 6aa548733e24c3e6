"""Cancels a program at one of the places where it waits, and looks at what it leaves behind."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import sys
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from typing import Any, ClassVar

import pytest
import zenoh

from hapnet.checks import Vector
from hapnet.transport import zenoh as transport
from tests.support.processes import LIMIT_S, children


class Stepped(Coroutine[Any, Any, Any]):
    """A coroutine that calls `suspended` each time it waits."""

    def __init__(self, inner: Coroutine[Any, Any, Any], suspended: Callable[[], None]) -> None:
        self._inner, self._suspended = inner, suspended
        self.__qualname__ = getattr(inner, "__qualname__", "")

    def send(self, value: Any) -> Any:
        return self._after(self._inner.send(value))

    def throw(self, *error: Any) -> Any:
        return self._after(self._inner.throw(*error))

    def _after(self, waited_for: Any) -> Any:
        self._suspended()
        return waited_for

    def close(self) -> None:
        self._inner.close()

    def __await__(self) -> Generator[Any, Any, Any]:
        return self._inner.__await__()


async def cancelled_at(
    number: int, program: Callable[[], Coroutine[Any, Any, Any]], victim: str
) -> tuple[bool, asyncio.Task[Any]]:
    """Run `program`, and cancel the task `victim` as all its tasks together come to wait for the `number`-th time.

    victim : part of the qualified name of the task's coroutine. Returns whether it was cancelled, and the program's
    task, which is done.
    """
    loop, count, hit = asyncio.get_running_loop(), -1, False
    tasks: list[asyncio.Task[Any]] = []

    def suspended() -> None:
        nonlocal count
        count += 1
        if count == number:
            loop.call_soon(cancel)

    def cancel() -> None:
        nonlocal hit
        for task in tasks:
            if victim in task.get_coro().__qualname__ and not task.done():
                hit = task.cancel() or hit

    def make(of: asyncio.AbstractEventLoop, inner: Any, **more: Any) -> asyncio.Task[Any]:
        tasks.append(asyncio.Task(Stepped(inner, suspended), loop=of, **more))
        return tasks[-1]

    loop.set_task_factory(make)
    try:
        task = asyncio.create_task(program())
        await asyncio.wait((task,), timeout=LIMIT_S)
    finally:
        loop.set_task_factory(None)
    assert task.done()
    return hit, task


class Handle:
    """A device that stands still in the wall and is pushed; it keeps all forces.

    Its class keeps all that were made.
    """

    dof, force_limit, resolution = 1, 3.0, 0.0
    made: ClassVar[list[Handle]] = []

    def __init__(self, dof: int = 1) -> None:
        self.forces: list[Vector] = []
        self.closed = False
        self.made.append(self)

    def read(self) -> tuple[Vector, Vector]:
        return (0.03,), (0.0,)

    def apply(self, force: Vector) -> Vector:
        assert not self.closed
        self.forces.append(force)
        return force

    def close(self) -> None:
        self.closed = True


class Noting(Handle):
    """It notes the newest force in a file, as it may be in another process."""

    FILE: ClassVar[str] = "HAPNET_TEST_NOTED_FORCE"

    def __init__(self, dof: int = 1) -> None:
        super().__init__(dof)
        self._file = os.open(os.environ[self.FILE], os.O_WRONLY | os.O_CREAT)

    def apply(self, force: Vector) -> Vector:
        os.pwrite(self._file, f"{force[0]:12.6f}".encode(), 0)
        return super().apply(force)

    def close(self) -> None:
        os.close(self._file)
        super().close()


class Leaks:
    """What there is of this process that a program may leave behind."""

    def __init__(self, sessions: list[zenoh.Session]) -> None:
        self._sessions = sessions
        self._before = self._now()
        self._children = children()
        self._interpreter = sys.getswitchinterval(), gc.isenabled()
        Handle.made = []

    def _now(self) -> tuple[set[int | None], set[asyncio.Task[Any] | None], list[str], int]:
        threads = {thread.ident for thread in threading.enumerate()}
        files = [each for each in map(_target, os.listdir("/proc/self/fd")) if each]
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        return threads, tasks, sorted(files), sum(not each.is_closed() for each in self._sessions)

    async def require_none(self) -> None:
        """All is as it was, and no device renders a force. What Zenoh closes on its own threads may take a moment."""
        threads, tasks, files, sessions = self._before
        now = self._now()
        assert now[0] <= threads, [thread for thread in threading.enumerate() if thread.ident not in threads]
        assert now[1] <= tasks
        assert now[3] <= sessions
        assert (sys.getswitchinterval(), gc.isenabled()) == self._interpreter
        async with asyncio.timeout(LIMIT_S):
            while len(self._now()[2]) > len(files) or not children() <= self._children:
                await asyncio.sleep(0.005)
        for handle in Handle.made:
            assert handle.closed
            assert handle.forces[-1] == (0.0,)


def _target(descriptor: str) -> str:
    """What a file descriptor leads to, by its kind; empty: it is closed."""
    with contextlib.suppress(OSError):
        return os.readlink(f"/proc/self/fd/{descriptor}").partition(":")[0]
    return ""


@contextlib.asynccontextmanager
async def watched(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[list[zenoh.Session]]:
    """The sessions of Zenoh that are opened from here on."""
    sessions: list[zenoh.Session] = []
    opened = zenoh.open

    def opens(*given: Any) -> zenoh.Session:
        sessions.append(opened(*given))
        return sessions[-1]

    monkeypatch.setattr(transport.zenoh, "open", opens)
    yield sessions
