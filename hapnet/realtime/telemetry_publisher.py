"""A side's telemetry in real time: the newest sample at a set rate, on the event loop and never on a servo's thread."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from hapnet.mechanics.plane import Plane
from hapnet.recording.drawing import Drawing, SceneSample
from hapnet.recording.samples import Event, PostureSample, Sample
from hapnet.recording.telemetry import KnownPlanes, Status, encode
from netem import LinkStats

STATUS_EVERY_S = 0.5
DRAWING_EVERY_S = 2.0
"""The period with which the world's drawing is published again, for new viewers [s]."""

_MOST_EVENTS = 100


class TelemetryPublisher:
    """Publishes the newest sample and, at intervals, the status.

    All other work comes first: a turn that is late by more than a period, because the loop was busy, is skipped.

    rate_hz : turns per second. put : publishes; returns at once. status : returns the side's present status.
    planes : returns the planes of a device's contact model; they are published when they change, and with each status.

    Attributes
    ----------
    dropped : turns that were skipped.
    """

    def __init__(
        self,
        rate_hz: float,
        put: Callable[[bytes], object],
        status: Callable[[], Status],
        planes: Callable[[], tuple[Plane, ...] | None] | None = None,
    ) -> None:
        self.dropped: int = 0
        self._period_s = 1.0 / rate_hz
        self._put, self._status, self._planes = put, status, planes
        self._published: object = self  # the planes that were published last; itself: none yet
        self._newest: Sample | None = None
        self._scene: SceneSample | None = None
        self._posture: PostureSample | None = None
        self._drawing: bytes | None = None
        self._drawing_s = 0.0
        self._began = False  # whether a status was published: it precedes the first sample, which it describes
        self._events: deque[Event] = deque(maxlen=_MOST_EVENTS)

    def keep(self, sample: Sample) -> None:
        """Keep a sample or an event, from any thread; a newer sample replaces an older one."""
        if isinstance(sample, Event):
            self._events.append(sample)
        elif isinstance(sample, SceneSample):
            self._scene = sample
        elif isinstance(sample, PostureSample):
            self._posture = sample
        elif isinstance(sample, Drawing):
            self._drawing = encode(sample)
        else:
            self._newest = sample

    async def run(self) -> None:
        """Publish until cancelled."""
        loop, period_s = asyncio.get_running_loop(), self._period_s
        due_s = status_s = loop.time()
        while True:
            now_s = loop.time()
            if now_s - due_s > period_s:
                self.dropped += 1
            else:
                if now_s >= status_s or (self._newest is not None and not self._began):
                    status_s = now_s + STATUS_EVERY_S
                    self.report_status()
                if self._drawing is not None and now_s >= self._drawing_s:
                    self._drawing_s = now_s + DRAWING_EVERY_S
                    self._put(self._drawing)
                self.publish()
            due_s = max(due_s + period_s, loop.time())
            await asyncio.sleep(due_s - loop.time())

    def report_status(self) -> None:
        """Publish the status; the planes follow it, for new viewers."""
        self._put(encode(self._status()))
        self._published = self

    def publish(self) -> None:
        """Publish the data kept since the last call."""
        sample, self._newest = self._newest, None
        scene, self._scene = self._scene, None
        posture, self._posture = self._posture, None
        if sample is not None:
            self._began = True
            self._put(encode(sample))
        for seen in (scene, posture):
            if seen is not None:
                self._put(encode(seen))
        if self._planes is not None and (planes := self._planes()) != self._published:
            self._published = planes
            self._put(encode(KnownPlanes(planes)))
        while self._events:
            self._put(encode(self._events.popleft()))


class LinkMeter:
    """Measures a link's delay and loss since the last `read`."""

    def __init__(self) -> None:
        self._offered = self._lost = self._delivered = 0
        self._total_ms = 0.0

    def read(self, stats: LinkStats) -> dict[str, Any]:
        """The link's figures, with ``delay_now_ms`` and ``loss_now`` (see `Status`)."""
        lost = stats.lost + stats.lost_down + stats.dropped_limit
        total_ms = (stats.delay_mean_ms or 0.0) * stats.delivered
        offered, delivered = stats.offered - self._offered, stats.delivered - self._delivered
        now = {
            "delay_now_ms": (total_ms - self._total_ms) / delivered if delivered else None,
            "loss_now": (lost - self._lost) / offered if offered else None,
        }
        self._offered, self._lost, self._delivered, self._total_ms = stats.offered, lost, stats.delivered, total_ms
        return stats.as_dict() | now
