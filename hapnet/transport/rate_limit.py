"""Drops a flood of messages before anything reads them; the time is an argument."""

from __future__ import annotations

import threading


class RateLimiter:
    """Limits the messages per second: a flood must not keep the interpreter busy.

    rate_hz : messages per second in the long run. burst : messages at once.
    """

    def __init__(self, rate_hz: int, burst: int) -> None:
        self._cost_ns = 1_000_000_000 // rate_hz
        self._span_ns = self._cost_ns * burst
        self._paid_ns = 0  # at this time the allowed rate has caught up with the messages so far
        self._lock = threading.Lock()
        self.refused: int = 0
        """Messages that were not let through."""

    def admit(self, now_ns: int) -> bool:
        """Whether a message that came at `now_ns` may pass. From any thread."""
        with self._lock:
            paid_ns = max(self._paid_ns, now_ns - self._span_ns) + self._cost_ns
            if paid_ns > now_ns:
                self.refused += 1
                return False
            self._paid_ns = paid_ns
            return True
