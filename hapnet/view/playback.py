"""Plays a recording to the page as if it came now, at its own pace, again and again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hapnet.recording.samples import Recording
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.wire.messages import Role

STATUS_NS = 500_000_000
"""Time between two statuses of each side [ns]."""

REST_NS = 2_000_000_000
"""At its end a recording stands still for this time, and then begins again [ns]."""

_ROLES: tuple[Role, Role] = ("device", "world")


class Playback:
    """Gives what a recording holds to `take` when it is due: samples, events, and statuses made from its metadata.

    Parameters
    ----------
    take : `History.take`. recording : of a run, or of one side of it. name : what the page calls it.
    now_ns : when it begins, on the clock of `advance`.

    Every sample keeps its distance from the first. Each time it begins again both sides have a new incarnation, so the
    page's account begins anew too.
    """

    def __init__(self, take: Callable[[Telemetry], None], recording: Recording, name: str, now_ns: int) -> None:
        self._take, self._recording, self._name = take, recording, name
        self._samples = recording.samples()
        self._roles = [role for role in _ROLES if getattr(recording, role) is not None]
        self._first_ns = self._samples[0].time_ns if self._samples else 0
        self._last_ns = self._samples[-1].time_ns if self._samples else 0
        self._rounds = 0
        self._begin(now_ns)

    def _begin(self, now_ns: int) -> None:
        self._began_ns = self._status_ns = now_ns
        self._next = 0
        self._rounds += 1

    def advance(self, now_ns: int) -> None:
        """Give all that is due by now."""
        if self._began_ns + self._last_ns - self._first_ns + REST_NS <= now_ns:
            self._begin(now_ns)
        if self._status_ns <= now_ns:
            self._status_ns = now_ns + STATUS_NS
            for role in self._roles:
                self._take(self._status(role, now_ns))
        while self._next < len(self._samples):
            sample = self._samples[self._next]
            due_ns = self._began_ns + sample.time_ns - self._first_ns
            if due_ns > now_ns:
                return
            self._take(sample._replace(time_ns=due_ns))
            self._next += 1

    def _status(self, role: Role, now_ns: int) -> Status:
        meta, summary = self._recording.meta, self._recording.summary or {}
        own = (meta.get("sides") or {}).get(role, meta)
        about: dict[str, Any] = {**own, "role": role, "clock": "recording", "name": self._name}
        ended = self._next == len(self._samples)
        path = dict(summary.get("path") or {})
        return Status(role, now_ns, self._rounds, not ended, ended, "", about, {"profile": ""}, path)
