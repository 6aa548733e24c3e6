"""How hapnet declares what it uses of Zenoh: keys, publishers that never block, callbacks on Zenoh's own threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import zenoh

KINDS = ("position", "energy", "control")

TELEMETRY = "telemetry"
"""What a side publishes on a key of its own for others, not for its peer."""

_PRIORITY = {
    "position": zenoh.Priority.REAL_TIME,
    "energy": zenoh.Priority.INTERACTIVE_HIGH,
    "control": zenoh.Priority.INTERACTIVE_LOW,
    TELEMETRY: zenoh.Priority.BACKGROUND,
}

_T = TypeVar("_T")


def publisher(session: zenoh.Session, key: str, kind: str) -> zenoh.Publisher:
    """For messages of this kind: dropped on congestion, of a priority of their own."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=_PRIORITY[kind],
        express=kind != TELEMETRY,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )


def direct(f: Callable[[_T], None]) -> zenoh.handlers.Callback[_T]:
    """A callback on Zenoh's own thread: a default one costs a thread that keeps the interpreter from exiting."""
    return zenoh.handlers.Callback(f, indirect=False)


def call(method: Callable[[], None]) -> None:
    """Call one of the methods whose type zenoh's stubs leave out."""
    method()
