"""Zenoh's entities as hapnet declares them: keys, publishers that never block, callbacks on Zenoh's own threads.

`RateLimiter` drops a flood of messages before they are read.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

import zenoh

from hapnet.errors import InvalidParameter

POSITION = "position"
KINDS = (POSITION, "energy", "control")

SIGNALS = "signals"
"""The key of values beside the stream. It is silent if there are none, so it is not monitored as those of `KINDS`."""

TELEMETRY = "telemetry"
"""The separate key of data that a side publishes for viewers, not for its peer."""

_PRIORITY = {
    POSITION: zenoh.Priority.REAL_TIME,
    "energy": zenoh.Priority.INTERACTIVE_HIGH,
    "control": zenoh.Priority.INTERACTIVE_LOW,
    SIGNALS: zenoh.Priority.DATA,
    TELEMETRY: zenoh.Priority.BACKGROUND,
}

_T = TypeVar("_T")


def publisher(
    session: zenoh.Session,
    key: str,
    kind: str,
    priority: zenoh.Priority | None = None,
    reliability: zenoh.Reliability = zenoh.Reliability.BEST_EFFORT,
) -> zenoh.Publisher:
    """A publisher for messages of this kind: they are dropped on congestion, and have their own priority.

    priority : replaces that of the kind.
    """
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=_PRIORITY[kind] if priority is None else priority,
        express=kind != TELEMETRY,
        reliability=reliability,
    )


def direct(f: Callable[[_T], None]) -> zenoh.handlers.Callback[_T]:
    """A callback on Zenoh's own thread: a default callback needs a thread that keeps the interpreter from exiting."""
    return zenoh.handlers.Callback(f, indirect=False)


def call(method: Callable[[], None]) -> None:
    """Call a method whose type is missing in zenoh's stubs."""
    method()


def check_name(name: str, value: str) -> str:
    """The value, if it can be a part of a key expression; raises InvalidParameter otherwise."""
    if not value or not value.isprintable() or set(value) & set("/#?$* "):
        raise InvalidParameter(name, value, "a name without spaces or any of / # ? $ *")
    return value


class RateLimiter:
    """Limits the messages per second, so that a flood does not keep the interpreter busy.

    rate_hz : messages per second in the long run. burst : messages at once.
    """

    def __init__(self, rate_hz: int, burst: int) -> None:
        self._cost_ns = 1_000_000_000 // rate_hz
        self._span_ns = self._cost_ns * burst
        self._paid_ns = 0  # at this time the allowed rate has caught up with the messages so far
        self._lock = threading.Lock()
        self.refused: int = 0
        """The number of messages that were dropped."""

    def admit(self, now_ns: int) -> bool:
        """Whether a message that came at `now_ns` may pass. From any thread."""
        with self._lock:
            paid_ns = max(self._paid_ns, now_ns - self._span_ns) + self._cost_ns
            if paid_ns > now_ns:
                self.refused += 1
                return False
            self._paid_ns = paid_ns
            return True
