"""The link on a loop: released on time and in order, with a timerfd and without."""

import asyncio
import time

import pytest

from netem import Link, LinkProfile
from netem.aio import AsyncLink, DeadlineTimer
from netem.timeline import Timeline

MS = 1_000_000
KINDS = ["timerfd", "loop"]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each kind of timer, on the loop that the test runs on."""
    if request.param == "loop":

        def refuse(*_: object) -> None:
            raise NotImplementedError

        monkeypatch.setattr("netem.aio._FdTimer", refuse)
    return str(request.param)


async def fired(timer_done: asyncio.Event) -> None:
    await asyncio.wait_for(timer_done.wait(), timeout=60)


async def test_fires_once_and_never_early(kind: str) -> None:
    done, fires = asyncio.Event(), []

    def fire() -> None:
        fires.append(time.monotonic_ns())
        done.set()

    timer = DeadlineTimer(asyncio.get_running_loop(), fire)
    assert timer.kind == kind
    due = time.monotonic_ns() + 5 * MS
    timer.arm(due)
    await fired(done)
    assert len(fires) == 1
    assert fires[0] >= due
    assert timer.due_ns is None
    timer.close()


async def test_arming_again_replaces_and_the_past_fires_at_once(kind: str) -> None:
    done = asyncio.Event()
    timer = DeadlineTimer(asyncio.get_running_loop(), done.set)
    assert timer.kind == kind
    timer.arm(time.monotonic_ns() + 3600 * 10**9)
    timer.arm(0)
    await fired(done)
    timer.close()


async def test_disarmed_and_closed_timers_stay_silent(kind: str) -> None:
    done = asyncio.Event()
    loop = asyncio.get_running_loop()
    disarmed, closed, later = (DeadlineTimer(loop, fire) for fire in (pytest.fail, pytest.fail, done.set))
    assert later.kind == kind
    now = time.monotonic_ns()
    disarmed.arm(now + MS)
    disarmed.arm(None)
    closed.arm(now + MS)
    closed.close()
    closed.close()
    closed.arm(now)
    later.arm(now + 5 * MS)
    await fired(done)
    disarmed.close()
    later.close()


async def test_items_arrive_on_time_in_order_of_release(kind: str) -> None:
    done, arrived = asyncio.Event(), []

    def deliver(item: tuple[int, int]) -> None:
        arrived.append((time.monotonic_ns(), item))
        if len(arrived) == 50:
            done.set()

    link: AsyncLink[tuple[int, int]] = AsyncLink(Link(LinkProfile.parse("delay 5ms 4ms"), seed=4), deliver)
    assert link.timer.kind == kind
    reference: Link[int] = Link(LinkProfile.parse("delay 5ms 4ms"), seed=4)
    for number in range(50):
        reference.send(0, number)
        link.send((number, time.monotonic_ns()))
    delays = {number: due for due, number in reference.poll(10**9)}
    await fired(done)
    link.close()
    for at, (number, sent) in arrived:
        assert at - sent >= delays[number]
    assert sorted(number for _, (number, _) in arrived) == list(range(50))
    assert link.link.stats.delivered == 50


@pytest.mark.parametrize("order", ["", " unordered", " unordered rate 100mbit"])
async def test_what_is_resent_arrives_when_it_would_in_virtual_time(kind: str, order: str) -> None:
    profile = LinkProfile.parse(f"delay 1ms loss 50% resend 5 3ms{order}")
    done, arrived = asyncio.Event(), {}
    reference: Link[int] = Link(profile, seed=4)
    now = time.monotonic_ns()
    for number in range(50):
        reference.send(now, number, 100)
    expected = [(due, number) for due, number in reference.poll(now + 10**9)]

    def deliver(number: int) -> None:
        assert number not in arrived
        arrived[number] = time.monotonic_ns()
        if len(arrived) == len(expected):
            done.set()

    link: AsyncLink[int] = AsyncLink(Link(profile, seed=4), deliver)
    assert link.timer.kind == kind
    for number in range(50):
        link.link.send(now, number, 100)
    link.release()
    await fired(done)
    link.close()
    assert list(arrived) == [number for _, number in expected]
    assert all(arrived[number] >= due for due, number in expected)
    assert link.link.stats.recovered == reference.stats.recovered > 10


async def test_what_is_not_delayed_is_delivered_before_send_returns() -> None:
    arrived: list[str] = []
    link: AsyncLink[str] = AsyncLink(Link(LinkProfile()), arrived.append)
    link.send("now")
    assert arrived == ["now"]
    link.close()


async def test_deliver_may_send_and_may_raise(kind: str) -> None:
    done, arrived, problems = asyncio.Event(), [], []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: problems.append(context["exception"]))

    def deliver(item: int) -> None:
        arrived.append(item)
        if item < 3:
            link.send(item + 1)
        else:
            done.set()
        if item == 1:
            raise RuntimeError("one of deliver's own")

    link: AsyncLink[int] = AsyncLink(Link(LinkProfile()), deliver)
    assert link.timer.kind == kind
    link.send(0)
    await fired(done)
    assert arrived == [0, 1, 2, 3]
    assert [str(problem) for problem in problems] == ["one of deliver's own"]
    link.close()


async def test_another_clock_and_a_live_change() -> None:
    done, arrived = asyncio.Event(), []

    def clock() -> int:
        return time.monotonic_ns() - 10**15

    def deliver(item: int) -> None:
        arrived.append(clock())
        done.set()

    link: AsyncLink[int] = AsyncLink(Link(LinkProfile.parse("delay 3ms")), deliver, clock=clock)
    before = clock()
    link.send(1)
    link.change(LinkProfile.parse("delay 1h".replace("1h", "3600s")))
    await fired(done)
    assert arrived[0] >= before + 3 * MS
    link.send(2)
    assert link.timer.due_ns > time.monotonic_ns() + 3000 * 10**9
    link.close()


async def test_a_timeline_changes_the_link_when_it_is_due(kind: str) -> None:
    done, arrived = asyncio.Event(), []

    def deliver(item: int) -> None:
        arrived.append((time.monotonic_ns(), item))
        done.set()

    start = time.monotonic_ns()
    held = True  # the clock stands until the first item is sent, so that no pause of the machine brings it up too early

    def clock() -> int:
        return start if held else time.monotonic_ns()

    link: AsyncLink[int] = AsyncLink(Link(LinkProfile.parse("delay 3600s")), deliver, clock=clock)
    assert link.timer.kind == kind
    link.play(Timeline.parse("at 0s: down; at 3ms: up; at 3ms: delay 2ms"))
    link.send(1)
    assert link.link.stats.lost_down == 1
    held = False
    async with asyncio.timeout(5):
        while not link.link.is_up:
            await asyncio.sleep(0)
    link.send(2)
    await fired(done)
    assert [item for _, item in arrived] == [2]
    assert arrived[0][0] >= start + 5 * MS
    link.play(Timeline.parse("at 0s: down; at 3600s: up"))  # in place of the first
    link.send(3)
    assert link.link.stats.lost_down == 2
    link.close()
