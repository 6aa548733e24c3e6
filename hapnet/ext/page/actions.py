"""Runs the requests of the page's users one by one, on threads, as they may block viser's event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import viser

from hapnet.errors import HapnetError
from hapnet.loading import failure
from netem import NetemError


class Actions:
    """Runs one action at a time, in the order of the requests. All methods are for viser's event loop."""

    def __init__(self) -> None:
        self._one_at_a_time = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(
        self,
        act: Callable[[], object],
        client: viser.ClientHandle | None,
        *,
        refused: str = "This failed",
        done: Callable[[bool], object] = lambda worked: None,
    ) -> None:
        """Call `act` on a thread when its turn comes; if it raises, show `client` the error under the title `refused`.

        done : called on the loop afterwards, with True if `act` succeeded.
        """
        self._start(self._run(act, client, refused, done))

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)  # the loop keeps no reference
        task.add_done_callback(self._tasks.discard)

    async def _run(
        self,
        act: Callable[[], object],
        client: viser.ClientHandle | None,
        refused: str,
        done: Callable[[bool], object],
    ) -> None:
        async with self._one_at_a_time:
            try:
                await asyncio.to_thread(act)
            except Exception as error:  # a user's own scene or law may raise anything
                known = isinstance(error, HapnetError | NetemError)
                show_notification(client, refused, str(error) if known else failure(error))
                done(False)
            else:
                done(True)


def show_notification(client: viser.ClientHandle | None, title: str, text: str) -> None:
    """Show a notification on this client's page."""
    if client is not None:
        client.add_notification(title, text, color="red", auto_close_seconds=8.0)
