"""A side that runs in a task of its own, beside the program that uses it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from hapnet.couplings.registry import jointly_passive
from hapnet.errors import Ended
from hapnet.realtime.feed import Feed
from hapnet.realtime.off_loop import off_loop, until_done
from hapnet.realtime.runner import RealtimeSide
from hapnet.realtime.side_events import SideEvent, event_of, own_event
from hapnet.recording.samples import DeviceSample, Sample, WorldSample
from hapnet.side.notices import Notice
from hapnet.summary.causes import found
from hapnet.summary.structure import Summary
from hapnet.summary.verdict import ROUNDING_J, has_reservoirs

MOST_SAMPLES, MOST_EVENTS = 1000, 200
"""A stream that is further behind misses the oldest items."""

REPORT_MISSED_S = 1.0
"""Missed items are reported at most this often [s]."""


MakeSide = Callable[[Callable[[Notice], None], Callable[[Sample], None]], tuple[RealtimeSide, tuple[str, ...]]]
"""Makes the side, which calls these functions with its notices and samples, and returns it with warnings for its user.
It runs on a thread, as opening a device may take long."""


class SideTask:
    """Runs a side in a task that is not cancelled with its user's task, since ending takes several steps.

    make : makes the side. duration_s : the run's length from pairing [s]; 0: no end.

    Attributes
    ----------
    samples, events : the feeds that its user reads.
    """

    def __init__(self, make: MakeSide, duration_s: float) -> None:
        self._make, self._duration_s = make, duration_s
        self._loop = asyncio.get_running_loop()
        self.samples: Feed[Any] = Feed(MOST_SAMPLES, missed=partial(self._missed, "samples"))
        self.events: Feed[SideEvent] = Feed(MOST_EVENTS, keep=MOST_EVENTS, missed=partial(self._missed, "events"))
        self._stop, self._opened, self._paired = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._made: RealtimeSide | None = None
        self._was_paired = self._lost = self._hurried = False
        self._missing: dict[str, int] = {}
        self._reported_s = 0.0
        self._task = self._loop.create_task(self._run())
        self._task.add_done_callback(self._end)

    @property
    def side(self) -> RealtimeSide:
        assert self._made is not None, "not before `open` has returned"
        return self._made

    @property
    def failure(self) -> BaseException | None:
        """The exception with which the side failed."""
        if not self._task.done():
            return None
        return Ended("this side's task was cancelled") if self._task.cancelled() else self._task.exception()

    def require_running(self) -> None:
        """Raise the error with which the side failed, or `Ended`, if it runs no more."""
        if self.failure is not None:
            raise self.failure
        if self._task.done() or self._stop.is_set():
            raise Ended("this side has ended")

    async def open(self) -> None:
        """Wait until the side runs and can be reached. Raises the error if it does not."""
        await self._opened.wait()
        self.require_running()

    async def paired(self) -> None:
        """Wait for the first peer. Raises the error if none will come."""
        await self._paired.wait()
        if not self._was_paired:
            self.require_running()

    def summary(self) -> Summary:
        """The summary so far, or of the whole run; a scene that was given as an object has no name after that."""
        ended = self._task.done() and self.failure is None
        return self._task.result() if ended else self.side.summary()

    async def result(self) -> Summary:
        """Return the side's summary, once it has ended. Raises the error with which it failed."""
        await asyncio.wait((self._task,))
        if self.failure is not None:
            raise self.failure
        return self._task.result()

    async def leave(self, *, leave_at_once: bool) -> None:
        """End the side completely. If it is cancelled meanwhile, it ends at once, and then raises the cancellation.

        leave_at_once : do not wait for the energy in flight.
        """
        self._stop.set()
        if leave_at_once:
            self._leave_sooner()
        await until_done(self._task, cancelled=self._leave_sooner)

    def _leave_sooner(self) -> None:
        """Do not wait for the energy in flight; the second time, do not notify the peer either."""
        if self._made is None:
            return
        if self._hurried:
            self._made.leave_at_once()
        self._made.skip_settling()
        self._hurried = True

    async def _run(self) -> Summary:
        try:
            for warning in await off_loop(self._make_side):
                self.events.give(own_event("notice", warning, "warning"))
            if self._stop.is_set():
                return self.side.summary()
            return await self.side.run(self._stop, self._duration_s, self._opened.set)
        finally:
            if self._made is not None:  # a device is open even if it never ran
                await off_loop(self._made.control.stop)

    def _make_side(self) -> tuple[str, ...]:
        self._made, warnings = self._make(self._notify, self._watch)
        return warnings

    def _notify(self, notice: Notice) -> None:
        """Pass a notice to the events; on the loop."""
        if notice.kind == "progress":
            return
        self.events.give(event_of(notice))
        if notice.kind == "paired":
            self._was_paired = True
            self._paired.set()

    def _watch(self, sample: Sample) -> None:
        """Pass a sample to its readers; on control's thread."""
        if not isinstance(sample, DeviceSample | WorldSample):
            return
        self.samples.give(sample)
        if min(sample.margin_J, sample.slack_J) < -ROUNDING_J and not self._lost and (why := self._broken(sample)):
            self._lost = True
            with suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._lose, why)

    def _broken(self, sample: DeviceSample | WorldSample) -> str:
        """Return why this side is not passive by its own account and the verdict's rules; empty: it is."""
        coupling, role = self.side.setup.params.coupling, self.side.role
        if not jointly_passive(coupling) and sample.margin_J < -ROUNDING_J:
            return found("half", side=role, margin=f"{1e3 * sample.margin_J:.4g}").text
        if has_reservoirs(coupling) and sample.slack_J < -ROUNDING_J:
            return found("slack", side=role, energy=f"{-1e3 * sample.slack_J:.4g}").text
        return ""

    def _lose(self, why: str) -> None:
        self.events.give(own_event("passivity lost", why, "error"))

    def _missed(self, what: str, count: int) -> None:
        """Count the items that a stream has missed, and report them at times; on the loop."""
        self._missing[what] = self._missing.get(what, 0) + count
        if (now_s := self._loop.time()) - self._reported_s >= REPORT_MISSED_S:
            self._reported_s = now_s
            self._report_missed()

    def _report_missed(self) -> None:
        for what in list(self._missing):
            count = self._missing.pop(what)
            text = f"{count} {what} were missed: they came faster than they were read"
            self.events.give(own_event("missed", text, "warning", {"count": count}))

    def _end(self, task: asyncio.Task[Summary]) -> None:
        """End the feeds after the side has ended; on the loop."""
        self._report_missed()
        failure = self.failure
        if failure is not None:
            self.events.give(own_event("ended", f"failed: {failure}", "error"))
        else:
            summary = task.result()
            if summary["verdict"]["passive"] is False and not self._lost:
                self._lose(summary["verdict"]["reason"])
            duration_s = summary["duration_s"]
            text = "no peer came" if duration_s is None else f"after {duration_s:.1f} s: {summary['verdict']['reason']}"
            self.events.give(own_event("ended", text, values={} if duration_s is None else {"duration_s": duration_s}))
        for feed in (self.events, self.samples):
            feed.end(failure)
        self._opened.set()
        self._paired.set()
