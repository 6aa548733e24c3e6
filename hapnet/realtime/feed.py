"""Pass items from a thread that must not wait to reading tasks, each at its own pace; missed items are counted."""

from __future__ import annotations

import asyncio
import weakref
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Any, Generic, TypeVar

T = TypeVar("T")
U = TypeVar("U")


class Feed(Generic[T]):
    """Items that one thread gives, and any number of streams read.

    most : a stream that is further behind misses the oldest items.
    keep : the number of last items with which a new stream begins.
    missed : called on the event loop with the number of items that a stream has just missed.

    Attributes
    ----------
    newest : the last item given; None: there is none yet.
    """

    def __init__(self, most: int, keep: int = 0, missed: Callable[[int], None] = lambda count: None) -> None:
        self.newest: T | None = None
        self.most: int = most
        self.missed: Callable[[int], None] = missed
        self.ended: bool = False
        self.failure: BaseException | None = None
        self._given = 0
        self._kept: deque[tuple[int, T]] = deque(maxlen=keep)
        self._streams: tuple[weakref.ref[Stream[Any]], ...] = ()  # replaced as a whole: another thread reads it

    def give(self, item: T) -> None:
        """Give an item; from any one thread at a time. Returns at once."""
        self.newest = item
        numbered = self._given, item
        self._given += 1
        self._kept.append(numbered)
        for reference in self._streams:
            if (stream := reference()) is not None:
                stream.put(numbered)

    def stream(self, pick: Callable[[T], U]) -> Stream[U]:
        """Return a new stream of the results of `pick` for each item; on the event loop."""
        stream = Stream(self, pick)
        alive = [reference for reference in self._streams if reference() is not None]
        self._streams = (*alive, weakref.ref(stream))
        kept = list(self._kept)  # after the stream is added: an item given meanwhile comes twice rather than not at all
        stream.begin(kept, kept[0][0] if kept else 0 if self._kept.maxlen else self._given)
        return stream

    def end(self, failure: BaseException | None) -> None:
        """End all streams after the last item, or let them raise `failure`; on the event loop."""
        self.ended, self.failure = True, failure
        for reference in self._streams:
            if (stream := reference()) is not None:
                stream.wake()


class Stream(AsyncIterator[U]):
    """Items as an async iterator, for one task at a time. It ends with the side, and raises the error of a failed side.

    A reader that is cancelled while it waits loses no item.

    Attributes
    ----------
    missed : the number of items that were dropped before they were read.
    """

    def __init__(self, feed: Feed[Any], pick: Callable[[Any], U]) -> None:
        self.missed: int = 0
        self._feed, self._pick = feed, pick
        self._items: deque[tuple[int, Any]] = deque(maxlen=feed.most)
        self._next = 0  # the number of the next item
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Future[None] | None = None
        self._called = False  # `wake` is scheduled on the loop and has not run yet

    def begin(self, kept: list[tuple[int, Any]], number: int) -> None:
        """Put earlier items in front; some may already have been put. number : that of the first item."""
        self._items.extendleft(reversed(kept))
        self._next = number

    def put(self, numbered: tuple[int, Any]) -> None:
        """Add an item, from the giver's thread: two appends at most, and the loop is woken only if a task waits."""
        self._items.append(numbered)
        if self._waiting is not None and not self._called:
            self._called = True
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self.wake)

    def wake(self) -> None:
        """Let the reader look again; on the event loop."""
        self._called = False
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    def __aiter__(self) -> Stream[U]:
        return self

    async def __anext__(self) -> U:
        while True:
            await self._until_there_is_one()
            number, item = self._items.popleft()
            if number >= self._next:  # an older item was given before the stream began, or is a copy
                break
        missed, self._next = number - self._next, number + 1
        if missed:
            self.missed += missed
            self._feed.missed(missed)
        return self._pick(item)

    async def _until_there_is_one(self) -> None:
        while not self._items:
            if self._feed.ended:
                if self._feed.failure is not None:
                    raise self._feed.failure
                raise StopAsyncIteration
            if self._waiting is not None:
                raise RuntimeError("another task waits for this stream already: make one for each")
            self._waiting = self._loop.create_future()
            try:
                if not self._items:  # an item may have come before `_waiting` was set
                    await self._waiting
            finally:
                self._waiting = None
