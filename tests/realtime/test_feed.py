"""From one thread to readers on the loop: in order, bounded, and every gap is counted."""

import asyncio
import gc
import threading

import pytest
from hypothesis import given, strategies as st

from hapnet.realtime.feed import Feed


@given(most=st.integers(1, 5), batches=st.lists(st.integers(0, 12), max_size=8))
def test_what_a_reader_gets_and_misses_is_all_there_was(most: int, batches: list[int]) -> None:
    """It gets the newest of each batch, at most `most`; the sum of both is what was given."""
    reported: list[int] = []

    async def main() -> None:
        feed: Feed[int] = Feed(most, missed=reported.append)
        stream, given, got = feed.stream(lambda item: item), 0, list[int]()
        for count in batches:
            for _ in range(count):
                feed.give(given)
                given += 1
            fresh = [await anext(stream) for _ in range(min(count, most))]
            assert fresh == list(range(given - len(fresh), given))
            got += fresh
        assert stream.missed == sum(reported) == given - len(got)
        feed.end(None)
        assert [item async for item in stream] == []

    asyncio.run(main())


async def test_a_new_stream_begins_with_what_is_kept_or_with_what_comes() -> None:
    for keep, expected in ((0, [3]), (2, [1, 2, 3]), (9, [0, 1, 2, 3])):
        feed: Feed[int] = Feed(9, keep=keep)
        for item in range(3):
            feed.give(item)
        stream = feed.stream(lambda item: item)
        feed.give(3)
        feed.end(None)
        assert [item async for item in stream] == expected
        assert stream.missed == 0
        assert feed.newest == 3


class Meanwhile(Feed[int]):
    """Another item is given just before, or just after, a stream is known to the giver."""

    when: str = ""

    def __setattr__(self, name: str, value: object) -> None:
        now = name == "_streams" and bool(value) and self.when
        if now:
            self.when = ""
        if now == "before":
            self.give(3)
        super().__setattr__(name, value)
        if now == "after":
            self.give(3)


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize(("keep", "minimum"), [(0, []), (9, [0, 1, 2])])
async def test_an_item_that_is_given_while_a_stream_begins_comes_once(when: str, keep: int, minimum: list[int]) -> None:
    feed = Meanwhile(9, keep=keep)
    for item in range(3):
        feed.give(item)
    feed.when = when
    stream = feed.stream(lambda item: item)
    feed.give(4)
    feed.end(None)
    got = [item async for item in stream]
    assert got in ([*minimum, 3, 4], [4] if not keep else [])
    assert stream.missed == 0


async def test_readers_wake_up_for_what_another_thread_gives() -> None:
    feed: Feed[int] = Feed(10_000)
    streams = [feed.stream(lambda item: item), feed.stream(lambda item: -item)]

    def main() -> None:
        for item in range(2000):
            feed.give(item)
        loop.call_soon_threadsafe(feed.end, None)

    loop, giver = asyncio.get_running_loop(), threading.Thread(target=main)

    async def read(number: int) -> list[int]:
        return [item async for item in streams[number]]

    tasks = [asyncio.create_task(read(number)) for number in range(2)]
    await asyncio.sleep(0)  # both wait
    giver.start()
    up, down = await asyncio.gather(*tasks)
    giver.join()
    assert up == list(range(2000))
    assert down == [-item for item in up]


async def test_a_reader_that_is_cancelled_loses_nothing_and_a_failure_reaches_it() -> None:
    feed: Feed[int] = Feed(3)
    stream = feed.stream(lambda item: item)
    waiting = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0)
    with pytest.raises(RuntimeError, match="another task waits"):
        await anext(stream)
    feed.give(7)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert await anext(stream) == 7
    feed.end(OSError("cable"))
    with pytest.raises(OSError, match="cable"):
        await anext(stream)


async def test_a_stream_that_nobody_has_any_more_is_not_filled() -> None:
    feed: Feed[int] = Feed(3)
    stream = feed.stream(lambda item: item)
    del stream
    gc.collect()
    feed.give(1)
    feed.stream(lambda item: item)
    assert len(feed._streams) == 1
