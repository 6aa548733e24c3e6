"""One side of a hapnet pair for a program without asyncio; the side runs in its own thread."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Any

_LEVELS = {"warning": logging.WARNING, "error": logging.ERROR}


class Side:
    """Runs the asynchronous context manager that `connect` returns, such as `hapnet.connect_device`, until `close`."""

    def __init__(self, connect: Callable[[], AbstractAsyncContextManager[Any]]) -> None:
        self._connect = connect
        self._changed = threading.Event()
        self._failure: BaseException | None = None
        self._side: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._leave: asyncio.Event | None = None
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main()), name="hapnet", daemon=True)
        self.summary: Any = None

    def open(self) -> None:
        """Start the side; return when the other side can connect. Raises ConnectionError: the side failed."""
        self._thread.start()
        self._changed.wait()
        self.check()

    def wait_for_peer(self) -> None:
        """Return when a peer has connected and there is a sample. Raises ConnectionError: the side failed or ended."""
        while self.sample is None:
            self.require_open()
            time.sleep(0.01)

    def require_open(self) -> None:
        """Raises ConnectionError: the side failed or ended."""
        self.check()
        if not self.is_open:
            raise ConnectionError("hapnet: the run ended before it began")

    def check(self) -> None:
        """Raises ConnectionError: the side failed."""
        if self._failure is not None:
            raise ConnectionError(f"hapnet: {self._failure}") from self._failure

    @property
    def sample(self) -> Any:
        """The newest sample; None before a peer has connected. Raises ConnectionError: the side failed."""
        self.check()
        return self._side.sample

    @property
    def is_open(self) -> bool:
        return self._side is not None and self._thread.is_alive()

    def close(self) -> None:
        """Set the force to zero, notify the other side and wait for the end; then `summary` is the run's summary."""
        if self._loop is not None and self._leave is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._leave.set)
            self._thread.join()

    async def _tell(self) -> None:
        """Write the side's events, but no signals, to LeRobot's log."""
        async for event in self._side.events():
            if event.notice.kind != "signal":
                logging.log(_LEVELS.get(event.level, logging.INFO), "hapnet: %s", event.text)

    async def _main(self) -> None:
        self._loop, self._leave = asyncio.get_running_loop(), asyncio.Event()
        try:
            async with self._connect() as self._side:
                self._changed.set()
                told = asyncio.ensure_future(self._tell())
                left, ended = (asyncio.ensure_future(wait) for wait in (self._leave.wait(), self._side.wait_ended()))
                await asyncio.wait((left, ended), return_when=asyncio.FIRST_COMPLETED)
                for task in (left, ended, told):
                    task.cancel()
            self.summary = await self._side.wait_ended()
            logging.info("hapnet: %s", self.summary["verdict"]["reason"])
        except Exception as error:
            self._failure = error
        finally:
            self._changed.set()
