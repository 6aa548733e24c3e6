"""Plays a recording to the page like live telemetry, at its own pace, repeatedly, from any point.

`PlayerPanel` is the page's scrubber and its button.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from hapnet.ext.page.link_form import put
from hapnet.recording.samples import Recording
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.summary.structure import SIDES
from hapnet.wire.messages import Role

STATUS_NS = 500_000_000
"""Time between two statuses of each side [ns]."""

REST_NS = 2_000_000_000
"""At its end a recording pauses for this time, and then begins again [ns]."""


class Playback:
    """Passes a recording's data to `take` when they are due: samples, events, and statuses made from its metadata.

    take : `History.take`. recording : of a run, or of one side of it. name : the name that the page shows.
    now_ns : the time of the start, on the clock of `advance`.

    Every sample keeps its time since the first sample. At each new beginning or jump both sides get a new incarnation,
    and all samples up to that time are passed on at once: so the page's account covers all of the time before it.
    """

    def __init__(self, take: Callable[[Telemetry], None], recording: Recording, name: str, now_ns: int) -> None:
        self._take, self._recording, self._name = take, recording, name
        self._samples = recording.samples()
        self._roles = [role for role in SIDES if getattr(recording, role) is not None]
        self._first_ns = self._samples[0].time_ns if self._samples else 0
        self._length_ns = self._samples[-1].time_ns - self._first_ns if self._samples else 0
        self._rounds = 0
        self._paused = False
        self._asked_ns: int | None = None
        self._advanced_ns = now_ns
        self._begin(0, now_ns)

    @property
    def duration_s(self) -> float:
        """The time from the first sample to the last [s]."""
        return self._length_ns * 1e-9

    @property
    def at_s(self) -> float:
        """The time that is shown now, from the first sample on [s]."""
        return min(self._at_ns, self._length_ns) * 1e-9

    @property
    def paused(self) -> bool:
        return self._paused

    def pause(self, on: bool) -> None:
        """Pause or resume, from any thread."""
        self._paused = on

    def seek(self, seconds: float) -> None:
        """Jump, at the next `advance`, to this time after the first sample; from any thread."""
        self._asked_ns = min(max(round(seconds * 1e9), 0), self._length_ns)

    def _begin(self, at_ns: int, now_ns: int) -> None:
        self._at_ns, self._status_ns = at_ns, now_ns
        self._next = 0
        self._rounds += 1

    def advance(self, now_ns: int) -> None:
        """Pass on everything that is due by now."""
        asked_ns, self._asked_ns = self._asked_ns, None
        if asked_ns is not None:
            self._begin(asked_ns, now_ns)
        elif not self._paused:
            self._at_ns += now_ns - self._advanced_ns
        self._advanced_ns = now_ns
        if self._length_ns + REST_NS <= self._at_ns:
            self._begin(0, now_ns)
        if self._status_ns <= now_ns:
            self._status_ns = now_ns + STATUS_NS
            for role in self._roles:
                self._take(self._status(role, now_ns))
        began_ns = now_ns - self._at_ns
        while self._next < len(self._samples):
            sample = self._samples[self._next]
            due_ns = began_ns + sample.time_ns - self._first_ns
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
        still = ended or self._paused
        return Status(role, now_ns, self._rounds, not ended, still, "", about, {"profile": ""}, path)


STEP_S = 0.05
"""The scrubber's steps [s]."""

HELD_S = 0.7
"""After a user's change the scrubber is not moved for this time [s]."""


class PlayerPanel:
    """A scrubber and a button, in the container that is open when this object is created."""

    def __init__(self, gui: viser.GuiApi, player: Playback) -> None:
        self._player = player
        end_s = max(player.duration_s, STEP_S)
        self._time = gui.add_slider("time [s]", 0.0, end_s, STEP_S, 0.0, hint=f"of {end_s:.1f} s; drag to go there")
        self._pause = gui.add_button("pause", icon=viser.Icon.PLAYER_PAUSE)
        self._changed_s = -HELD_S

        @self._time.on_update
        async def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if event.client is not None:
                self._changed_s = time.monotonic()
                player.seek(self._time.value)

        @self._pause.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            player.pause(not player.paused)
            self._pause.label = "resume" if player.paused else "pause"
            self._pause.icon = viser.Icon.PLAYER_PLAY if player.paused else viser.Icon.PLAYER_PAUSE

    def update(self) -> None:
        """Move the scrubber to the time that is shown now."""
        if time.monotonic() - self._changed_s > HELD_S:
            put(self._time, round(self._player.at_s / STEP_S) * STEP_S)
