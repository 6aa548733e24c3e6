"""Publishes a running pair's telemetry on ROS 2 topics: the messages of an exported bag (hapnet/recording/rosbag.py),
live and below the node's namespace.
"""

from __future__ import annotations

import queue
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from hapnet.recording.rosbag import ACCOUNT_EVERY_NS, BagMessage, Messages
from hapnet.recording.samples import DeviceSample, Event, PostureSample, Sample, WorldSample, from_samples
from hapnet.recording.telemetry import Status, Telemetry

DIAGNOSTICS = "/diagnostics"
"""ROS has one topic for all diagnostics, in no namespace."""

_MOST = 1000


class RosBridge:
    """Receives telemetry on any thread, and publishes it as messages on the thread that calls `publish_next`.

    types : the classes of messages by their names. publish : called with topic, type and message. namespace : of the
    topics. wall_ns : UTC [ns], for the stamps of events: the time of their arrival.

    Attributes
    ----------
    published : number of messages by topic. dropped : number of messages that arrived faster than they were published.
    """

    def __init__(
        self,
        types: Any,
        publish: Callable[[str, str, Any], object],
        namespace: str,
        wall_ns: Callable[[], int],
    ) -> None:
        self.published: dict[str, int] = defaultdict(int)
        self.dropped: int = 0
        self._make, self._publish, self._wall_ns = Messages(types), publish, wall_ns
        self._prefix = namespace.rstrip("/")
        self._queue: queue.Queue[Telemetry] = queue.Queue(_MOST)
        self._about: dict[str, dict[str, Any]] = {}
        self._account_ns: dict[str, int] = {}

    def take(self, message: Telemetry) -> None:
        """Add a message to the queue; returns at once."""
        try:
            self._queue.put_nowait(message)
        except queue.Full:
            self.dropped += 1

    def publish_next(self, wait_s: float) -> None:
        """Publish the messages in the queue, waiting at most `wait_s` for the first."""
        try:
            found = [self._queue.get(timeout=wait_s)]
        except queue.Empty:
            return
        with suppress(queue.Empty):
            while True:
                found.append(self._queue.get_nowait())
        self._publish_all(found)

    def _publish_all(self, found: list[Telemetry]) -> None:
        sides: dict[str, list[Sample]] = {"device": [], "world": []}
        events: list[Sample] = []
        for message in found:
            if isinstance(message, Status):
                self._about[message.role] = message.about
            elif isinstance(message, DeviceSample | PostureSample):
                sides["device"].append(message)
            elif isinstance(message, WorldSample):
                sides["world"].append(message)
            elif isinstance(message, Event):  # it does not state on which side's clock its time is
                events.append(message._replace(time_ns=self._wall_ns()))
        for side, samples in sides.items():
            if side not in self._about or not samples:  # samples are published only after the first status
                continue
            recording = from_samples(self._about[side], samples, None, torn=False)
            if getattr(recording, side) is None:
                continue
            self._send(*self._make.of_side(recording, side))
            newest_ns = samples[-1].time_ns
            if newest_ns - self._account_ns.get(side, -ACCOUNT_EVERY_NS) >= ACCOUNT_EVERY_NS:
                self._account_ns[side] = newest_ns
                self._send(next(self._make.account(recording, side)))
        if events:
            self._send(*self._make.events(from_samples({}, events, None, torn=False)))

    def _send(self, *messages: BagMessage) -> None:
        for topic, kind, _, content in messages:
            whole = topic if topic == DIAGNOSTICS else self._prefix + topic
            self._publish(whole, kind, content)
            self.published[whole] += 1
