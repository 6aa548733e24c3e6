"""A link on an asyncio loop that releases on time.

An asyncio sleep wakes up to 1 ms late, because epoll counts whole milliseconds. Here a timerfd on the loop, armed with
the absolute time of the next release, wakes the loop within tens of microseconds.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, Protocol, TypeVar

from netem.link import Link
from netem.profile import LinkProfile
from netem.timeline import Cut, Timeline, TimelinePlayer

T = TypeVar("T")

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1
TFD_NONBLOCK: int = getattr(os, "O_NONBLOCK", 0)
TFD_CLOEXEC: int = getattr(os, "O_CLOEXEC", 0)


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


class _Timer(Protocol):
    def arm(self, due_ns: int | None) -> None: ...
    def close(self) -> None: ...


class DeadlineTimer:
    """Calls `callback` on the loop at `due_ns`, a time of ``time.monotonic_ns`` (CLOCK_MONOTONIC).

    `kind` is ``"timerfd"``, or ``"loop"`` (``loop.call_at``, up to a millisecond late) if the system or the loop has no
    timerfd. Call all methods on the loop's thread.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: Callable[[], None]) -> None:
        self.due_ns: int | None = None
        self._callback = callback
        self._timer: _Timer
        try:
            self._timer, self.kind = _FdTimer(loop, self._fire), "timerfd"
        except (OSError, AttributeError, NotImplementedError, TypeError):  # the last: no such libc, on Windows
            self._timer, self.kind = _LoopTimer(loop, self._fire), "loop"

    def arm(self, due_ns: int | None) -> None:
        """Fire at `due_ns` in place of any earlier setting: at once if it is past, never if None."""
        if due_ns != self.due_ns:
            self.due_ns = due_ns
            self._timer.arm(due_ns)

    def close(self) -> None:
        """Disarm for good and close the descriptor. May be called again."""
        self.due_ns = None
        self._timer.close()

    def _fire(self) -> None:
        self.due_ns = None
        self._callback()


class _FdTimer:
    def __init__(self, loop: asyncio.AbstractEventLoop, fire: Callable[[], None]) -> None:
        self._loop, self._fire = loop, fire
        libc = ctypes.CDLL(None, use_errno=True)
        self._settime = libc.timerfd_settime
        self._settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Itimerspec), ctypes.c_void_p)
        self._fd: int = libc.timerfd_create(_CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        try:
            loop.add_reader(self._fd, self._on_readable)
        except BaseException:
            os.close(self._fd)
            raise

    def arm(self, due_ns: int | None) -> None:
        if self._fd < 0:
            return
        # all zeros would disarm, so a time before 1 ns becomes 1 ns
        seconds, rest = divmod(0 if due_ns is None else max(due_ns, 1), 10**9)
        value = _Itimerspec(_Timespec(0, 0), _Timespec(seconds, rest))
        if self._settime(self._fd, _TFD_TIMER_ABSTIME, ctypes.byref(value), None) != 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")

    def close(self) -> None:
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            self._loop.remove_reader(fd)
            os.close(fd)

    def _on_readable(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:  # armed again between the wake-up and here
            return
        self._fire()


class _LoopTimer:
    def __init__(self, loop: asyncio.AbstractEventLoop, fire: Callable[[], None]) -> None:
        self._loop, self._fire = loop, fire
        self._handle: asyncio.TimerHandle | None = None
        self._due_ns = 0
        self._closed = False

    def arm(self, due_ns: int | None) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        if due_ns is not None and not self._closed:
            self._due_ns = due_ns
            wait_s = (due_ns - time.monotonic_ns()) * 1e-9
            self._handle = self._loop.call_at(self._loop.time() + wait_s, self._on_time)

    def close(self) -> None:
        self.arm(None)
        self._closed = True

    def _on_time(self) -> None:
        self._handle = None
        if time.monotonic_ns() < self._due_ns:  # the loop may call early, by its clock's resolution
            self.arm(self._due_ns)
        else:
            self._fire()


class AsyncLink(Generic[T]):
    """A `Link` on an asyncio loop: it passes each item to `deliver` when it is due, in the order of release.

    link : the link to run; no other code may poll it.
    deliver : called on the loop with each item. It may send. Its exceptions go to the loop's exception handler.
    clock : returns ns and advances as ``time.monotonic_ns`` does.
    loop : None: the running loop.
    cut : cuts the connections that the link carries, if it carries any, when a timeline says so.

    Call all methods on the loop's thread. ``async with AsyncLink(...)`` closes it at the end.
    """

    def __init__(
        self,
        link: Link[T],
        deliver: Callable[[T], object],
        clock: Callable[[], int] = time.monotonic_ns,
        loop: asyncio.AbstractEventLoop | None = None,
        cut: Callable[[Cut], None] | None = None,
    ) -> None:
        self.link, self._cut = link, cut
        self._deliver, self._clock = deliver, clock
        self._loop = loop or asyncio.get_running_loop()
        self._releasing = False
        self.timer = DeadlineTimer(self._loop, self.release)
        self._player: TimelinePlayer | None = None
        self._player_timer: DeadlineTimer | None = None

    def send(self, item: T, size: int | None = None) -> None:
        """Offer an item now. An item without delay is delivered before this returns, unless `deliver` calls this."""
        now_ns = self._clock()
        self.link.send(now_ns, item, size)
        self.release(now_ns)

    def change(self, profile: LinkProfile) -> None:
        """Use another profile from now on, without losing items in flight."""
        now_ns = self._clock()
        self.link.change(profile, now_ns)
        self.release(now_ns)

    def play(self, timeline: Timeline) -> None:
        """Change the link by a timeline that starts now and replaces any earlier one.

        Raises ProfileError: it cuts connections, and this link carries none.
        """
        self._player = TimelinePlayer(self.link, timeline, self._clock(), self._cut)
        if self._player_timer is None:
            self._player_timer = DeadlineTimer(self._loop, self._advance)
        self._advance()

    @contextmanager
    def faults(self, timeline: Timeline | str) -> Iterator[None]:
        """Change the link by a timeline that starts now; the end of the block restores its profile.

        Raises ProfileError: the timeline's text is malformed.
        """
        before, was_up = self.link.profile, self.link.is_up
        if isinstance(timeline, str):
            timeline = Timeline.parse(timeline, connections=self._cut is not None)
        self.play(timeline)
        try:
            yield
        finally:
            self._player = None
            if self._player_timer is not None:
                self._player_timer.arm(None)
            (self.link.up if was_up else self.link.down)()
            self.change(before)

    async def __aenter__(self) -> AsyncLink[T]:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop; items in flight are never delivered."""
        self.timer.close()
        if self._player_timer is not None:
            self._player_timer.close()

    def release(self, now_ns: int | None = None) -> None:
        """Deliver the items due by now, and arm the timer. To send many items, use `link.send` and call this once."""
        if self._releasing:
            return  # called by deliver(): the outer call, or the timer that it arms, delivers the rest in order
        self._releasing = True
        try:
            for _, item in self.link.poll(self._clock() if now_ns is None else now_ns):
                try:
                    self._deliver(item)
                except Exception as error:
                    self._loop.call_exception_handler({"message": "netem: deliver() raised", "exception": error})
        finally:
            self._releasing = False
        self.timer.arm(self._on_timer_clock(self.link.next_due_ns))

    def _advance(self) -> None:
        assert self._player is not None
        assert self._player_timer is not None
        now_ns = self._clock()
        self._player.advance(now_ns)
        self.release(now_ns)
        self._player_timer.arm(self._on_timer_clock(self._player.next_due_ns))

    def _on_timer_clock(self, due_ns: int | None) -> int | None:
        if due_ns is None or self._clock is time.monotonic_ns:
            return due_ns
        return due_ns + time.monotonic_ns() - self._clock()
