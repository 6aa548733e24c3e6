"""Zenoh's entities as hapnet declares them: keys, publishers that never block, callbacks on Zenoh's own threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import zenoh

from hapnet.errors import InvalidParameter

POSITION = "position"
KINDS = (POSITION, "energy", "control")

SIGNALS = "signals"
"""The key of values beside the stream. It is silent where there are none, so nobody watches it as those of `KINDS`."""

TELEMETRY = "telemetry"
"""What a side publishes on a separate key, for others and not for its peer."""

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

    priority : another than that of the kind.
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
    """Call a method whose type zenoh's stubs leave out."""
    method()


def check_name(name: str, value: str) -> str:
    """The value, if it can be a part of a key expression; raises InvalidParameter otherwise."""
    if not value or not value.isprintable() or set(value) & set("/#?$* "):
        raise InvalidParameter(name, value, "a name without spaces or any of / # ? $ *")
    return value
