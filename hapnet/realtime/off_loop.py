"""Blocking work beside the event loop, and waits that a cancellation does not cut short."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


async def off_loop(call: Callable[[], T]) -> T:
    """Return the result of `call`, run on a thread of its own that ends afterwards.

    The caller always waits for it, since otherwise parts could remain half started or half stopped. A cancellation
    meanwhile is raised afterwards. (`asyncio.to_thread` leaves at once, keeps its threads, and queues behind the
    program's other work.)
    """
    outcome: concurrent.futures.Future[T] = concurrent.futures.Future()

    def main() -> None:
        try:
            result = call()
        except BaseException as error:
            outcome.set_exception(error)
        else:
            outcome.set_result(result)

    waiting = asyncio.wrap_future(outcome)
    thread = threading.Thread(target=main, name="hapnet-call", daemon=True)
    thread.start()
    try:
        await until_done(waiting)
    finally:
        thread.join()  # its work is done
    return waiting.result()


async def until_done(future: asyncio.Future[Any], cancelled: Callable[[], object] = lambda: None) -> None:
    """Wait until `future` is done, with a result or an error. A cancellation meanwhile is raised afterwards.

    cancelled : called at each cancellation.
    """
    cancellation: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait((future,))
        except asyncio.CancelledError as error:
            cancellation = error
            cancelled()
    if cancellation is not None:
        if not future.cancelled():
            future.exception()  # so that asyncio does not log it
        raise cancellation
