"""One direction of a relayed connection, over links that the test empties by hand: what is sent again, and when."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from netem.retransmission import MAX_TIMER_S
from netem.tcp_relay import _Stream

SECOND = 10**9


class Rig:
    """A stream, what is in its two links, and the clock."""

    def __init__(self) -> None:
        self.now_ns, self.sent_again, self.waits_s = 0, 0, 0.0
        self.there: list[Callable[[], None]] = []
        self.back: list[Callable[[], None]] = []
        links: list[Any] = [type("Link", (), {"send": lambda _, item, size, held=held: held.append(item)})()
                            for held in (self.there, self.back)]  # fmt: skip
        self.stream = _Stream(links[0], links[1], self.count)

    def count(self) -> None:
        self.sent_again += 1

    async def send(self, pieces: int) -> None:
        for k in range(pieces):
            await self.stream.send(bytes([k]))

    @property
    def unacknowledged(self) -> list[int]:
        return list(self.stream._in_transit)

    def call_later(self, delay_s: float, ring: Callable[[], None]) -> asyncio.TimerHandle:
        self.waits_s = delay_s
        return asyncio.TimerHandle(delay_s, ring, (), asyncio.get_running_loop())


@pytest.fixture
async def rig(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Rig]:
    rig = Rig()
    with monkeypatch.context() as patch:
        patch.setattr("netem.tcp_relay.time.monotonic_ns", lambda: rig.now_ns)
        patch.setattr(asyncio.get_running_loop(), "call_later", rig.call_later)
        yield rig
        rig.stream.close()
        assert rig.stream._timer is None


async def test_an_acknowledgement_is_of_one_and_of_all_below_what_is_whole(rig: Rig) -> None:
    await rig.send(3)
    first, second, third = rig.there
    third()
    rig.back.pop()()
    assert rig.unacknowledged == [0, 1]
    first()
    second()
    rig.back.pop()()  # that of the first is lost
    assert (rig.unacknowledged, rig.stream._timer, rig.sent_again) == ([], None, 0)
    assert [await rig.stream.receive() for _ in range(3)] == [b"\0", b"\1", b"\2"]


async def test_what_three_later_ones_overtook_is_sent_again_once(rig: Rig) -> None:
    await rig.send(5)
    for number, again in ((1, 0), (2, 0), (3, 1), (4, 1)):
        rig.there[number]()
        rig.back.pop()()
        assert rig.sent_again == again
    assert rig.unacknowledged == [0]
    for arrival in (rig.there[5], rig.there[0]):  # both copies come in the end
        arrival()
    assert [await rig.stream.receive() for _ in range(5)] == [bytes([k]) for k in range(5)]


@pytest.mark.parametrize(
    ("trips_s", "timer_s"),
    [
        ((), 1.0),
        ((0.4,), 0.4 + 4 * 0.2),
        ((0.4, 0.8), 0.45 + 4 * (0.2 + (0.4 - 0.2) / 4)),
        ((0.01,), 0.01 + 0.2),
        ((0.1,), 0.1 + 0.2),
    ],
)
async def test_the_timer_is_that_of_linux_and_doubles(rig: Rig, trips_s: tuple[float, ...], timer_s: float) -> None:
    """Mean and spread of the round trips, with gains of 1/8 and 1/4; four spreads above the mean, at least 200 ms."""
    for trip_s in trips_s:
        await rig.send(1)
        rig.now_ns += round(trip_s * SECOND)
        rig.there.pop()()
        rig.back.pop()()
    await rig.send(1)
    for tries in range(9):
        assert rig.waits_s == pytest.approx(min(timer_s * 2**tries, MAX_TIMER_S))
        assert rig.sent_again == tries
        rig.stream._ring()
    await rig.send(1)  # the timer is the first one's, which was sent 0.1 s ago
    rig.now_ns += SECOND // 10
    rig.stream._set_timer()
    assert rig.waits_s == pytest.approx(min(timer_s * 2**9, MAX_TIMER_S) - 0.1)
