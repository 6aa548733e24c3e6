"""A pair that is not there: a simulated run played back as telemetry, and controls that keep what they received."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hapnet.checks import Vector
from hapnet.ext.page.controls import Direction
from hapnet.ext.page.history import History
from hapnet.params import Params
from hapnet.recording.samples import DeviceSample, Event, Sample, WorldSample
from hapnet.recording.telemetry import KnownPlanes, Status
from hapnet.simulation.simulation import Simulation
from hapnet.summary.reported import values_of
from hapnet.wire.messages import Role
from netem import NetemError

NANO = 1_000_000_000
ROLES: tuple[Role, Role] = ("device", "world")


class Feed:
    """Plays a simulated run back into `history` over and over, with a status twice a second.

    Nine tenths of the first time are sent at once, so that there is a past; the rest at its own pace.
    """

    def __init__(self, history: History, params: Params, seed: int = 1) -> None:
        run = Simulation(
            params.set({"record_hz": 60.0}), seed, kernel=False
        )  # it keeps the planes of the newest message
        result = run.run()
        recording = result.recording
        self.accounts = {role: values_of(result.summary, role) for role in ROLES}
        self.planes = run.device_endpoint.planes
        self.meta = recording.meta
        self.links = {"device": str(recording.meta["params"]["link"]["up"]), "world": ""}
        self.links["world"] = str(recording.meta["params"]["link"]["down"])
        self.incarnation, self.paused, self.recording, self.paired = 1, False, "", True
        self.coupling, self.rendering = params.coupling, "hapnet" if params.rendering == "auto" else params.rendering
        self.smoothing = params.device.smoothing_s
        self._samples = [s for s in recording.samples() if not isinstance(s, Event)]
        self._last = {type(s): s for s in self._samples}
        self._history = history
        self._one_pair = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)

    def begin_anew(self, changes: dict[str, Any]) -> None:
        """End the pair with the final accounts of both sides; another starts with these attributes changed."""
        with self._one_pair:
            for role in ROLES:
                self._history.take(replace(self.status(role, time.monotonic_ns()), final=True))
            self.incarnation += 1
            vars(self).update(changes)

    def status(self, role: Role, now_ns: int) -> Status:
        params = {
            **self.meta["params"],
            "rendering": self.rendering,
            "device": {**self.meta["params"]["device"], "smoothing_s": self.smoothing},
        }
        about = {**self.meta, "params": params, "role": role, "clock": "one", "name": "left", "session": "default"}
        about["coupling"] = self.coupling
        link = {"profile": self.links[role], "delay_now_ms": 41.7, "loss_now": 0.02}
        heard = {"up": {"loss": 0.03}, "down": None} if role == "world" else {"up": None, "down": {"loss": 0.03}}
        path = {"round_trip_p50_ms": 96.0, **heard}
        kept = self.accounts[role]
        return Status(role, now_ns, self.incarnation, self.paired, self.paused, self.recording, about, link, path, kept)

    def __enter__(self) -> Feed:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _play(self) -> None:
        first, last = self._samples[0].time_ns, self._samples[-1].time_ns
        status_due = time.monotonic_ns()
        began, number, round_ns = status_due - (last - first) * 9 // 10, 0, 0
        rounds = 0
        while True:
            now = time.monotonic_ns()
            if now >= status_due:
                status_due += NANO // 2
                with self._one_pair:
                    for role in ROLES:
                        self._history.take(self.status(role, now))
                self._history.take(KnownPlanes(self.planes if self.rendering == "hapnet" else None))
            if self.paused:
                began += 10_000_000
            else:
                while (at := began + round_ns + self._samples[number].time_ns - first) <= now:
                    self._history.take(self._moved(self._samples[number], at, rounds))
                    number += 1
                    if number == len(self._samples):
                        number, rounds, round_ns = 0, rounds + 1, round_ns + last - first + NANO // 60
            if self._stop.wait(0.01):
                return

    def _moved(self, sample: Sample, time_ns: int, rounds: int) -> Sample:
        """At another time; and what was sent and credited in the rounds before is not forgotten."""
        if not isinstance(sample, DeviceSample | WorldSample):  # what the world looks like
            return sample._replace(time_ns=time_ns)
        last = self._last[type(sample)]
        sent_J, credited_J = rounds * last.sent_J, rounds * last.credited_J
        return sample._replace(
            time_ns=time_ns, sent_J=sample.sent_J + sent_J, credited_J=sample.credited_J + credited_J
        )


class FakeControls:
    """Keeps every call; `link`, `pause` and `record` change what `feed` sends, as the real ones would."""

    fixed = ""

    def __init__(self, feed: Feed | None = None) -> None:
        self.let_go_for: str | None = None
        self.calls: list[tuple[Any, ...]] = []
        self._feed = feed
        self._news = threading.Condition()

    def lead(self, position: Vector) -> None:
        self._called("lead", position)

    def let_go(self, why: str) -> None:
        self.let_go_for = why

    def link(self, way: Direction, words: str) -> None:
        if "loss" in words and "66%" in words:
            raise NetemError("loss: 66% is more than this link is made for")
        if self._feed is not None:
            self._feed.links["device" if way == "up" else "world"] = words
        self._called("link", way, words)

    def coupling(self, name: str, rendering: str) -> None:
        self._begin_anew("coupling", name, rendering, changes={"coupling": name, "rendering": rendering})

    def scene(self, label: str) -> None:
        self._begin_anew("scene", label)

    def mesh(self, name: str, content: bytes) -> None:
        self._begin_anew("mesh", name, len(content))

    def smoothing(self, seconds: float) -> None:
        self._begin_anew("smoothing", seconds, changes={"smoothing": seconds})

    def pause(self, on: bool) -> None:
        if self._feed is not None:
            self._feed.paused = on
        self._called("pause", on)

    def reset(self) -> None:
        self._begin_anew("reset")

    def record(self, on: bool) -> None:
        if self._feed is not None:
            self._feed.recording = "/tmp/runs/play.mcap" if on else ""
        self._called("record", on)

    def named(self, name: str) -> list[tuple[Any, ...]]:
        return [call[1:] for call in list(self.calls) if call[0] == name]

    def wait(self, until: Callable[[], object], seconds: float = 60.0) -> bool:
        """Whether `until` becomes true by a call within `seconds`."""
        with self._news:
            return self._news.wait_for(lambda: bool(until()), seconds)

    def _begin_anew(self, *call: Any, changes: dict[str, Any] | None = None) -> None:
        if self._feed is not None:
            self._feed.begin_anew(changes or {})
        self._called(*call)

    def _called(self, *call: Any) -> None:
        with self._news:
            self.calls.append(call)
            self._news.notify_all()
