"""The data that the page draws: the last seconds of a running pair, and the state of both sides."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import Part
from hapnet.recording.drawing import Drawing, SceneSample, unpack
from hapnet.recording.samples import DeviceSample, Event, PostureSample, WorldSample
from hapnet.recording.telemetry import KnownPlanes, Status, Telemetry
from hapnet.summary.joint import JointMargin
from hapnet.summary.reported import present
from hapnet.summary.structure import Summary, VerdictSummary
from hapnet.units import METRES, POSE, text_in
from hapnet.wire.messages import Role

CAPACITY = 4096
"""Samples kept per side: ten seconds at up to 400 Hz."""

MOST_EVENTS = 50
MOST_EPISODES = 6

PARTS = ("spring_force_N", "damper_force_N", "model_force_N", "added_damping_force_N")
"""The fields of a `DeviceSample` with the parts of its force, in the order of `Track.parts_N`."""


@dataclass(frozen=True)
class Track:
    """The last seconds of one side, oldest first; N samples of n axes.

    `time_s` (N,) ends at 0 or before: 0 is the newest sample of both sides if they share a clock, otherwise of this
    side. `force_N` (N, n) is the coupling's force on the device, or the walls' force on the proxy. `penetration_m` (N,)
    is the proxy's, and NaN on the device's side. `parts_N` (N, 4, n) are the parts of the device's force: spring,
    damper, and the spring's parts from the contact model and from added damping; NaN if it reports no parts.
    The world has no parts: (N, 0, n).
    """

    time_s: Array
    position_m: Array
    set_position_m: Array
    force_N: Array
    parts_N: Array
    penetration_m: Array
    reservoir_J: Array
    margin_J: Array


@dataclass(frozen=True)
class Episode:
    """A pair that has ended: its coupling and rendering, and its verdict."""

    coupling: str
    rendering: str
    verdict: VerdictSummary


@dataclass(frozen=True)
class Snapshot:
    """A consistent copy of the data of a pair. Fields whose data have not arrived yet are None.

    `taken` counts the samples from both sides, so that silence differs from rest. `summary` is the summary of the
    pair so far, with its verdict; None: a side has not reported its account, or the pair is being replaced.
    `planes` are the planes that the device has received; None: it receives none. `past` are the earlier pairs, the
    newest last. `parts` and `scene` are the surfaces of the world and their present places. `names` are those of the
    hands, by the names of their seats.
    """

    device: Track | None
    world: Track | None
    device_status: Status | None
    world_status: Status | None
    aligned: bool
    events: tuple[Event, ...]
    taken: int
    summary: Summary | None = None
    planes: tuple[Plane, ...] | None = None
    past: tuple[Episode, ...] = ()
    parts: tuple[Part, ...] | None = None
    scene: SceneSample | None = None
    posture: Vector = ()
    names: Mapping[str, str] = field(default_factory=dict)


_UNFINISHED: VerdictSummary = {
    "passive": None,
    "reason": "the pair ended without the final accounts of both sides",
}


class History:
    """Keeps the messages given to `take`; `snapshot` copies them for drawing.

    A `Status` with a new incarnation means that its side has restarted: that side's past is deleted. A sample is
    dropped if it is older than the newest sample of its side, or has another number of axes.

    The verdict is computed from the accounts in both sides' statuses, joined as at the end of a run. The code that
    runs the pair calls `leave` when the pair is about to end, and `end` with its final verdict; the code that plays a
    recording calls `judge_by` with the recording's summary.

    seconds : how much of the past a snapshot shows. follows : `end` is not called: a pair ends when its sides restart,
    and its verdict is computed from its last accounts. joins : on one clock, add the margins of both ports at the same
    time, for couplings that are passive only jointly; False if the pair's own verdict has no such sum.
    names : of hands, to be shown in place of those of their seats; it may change.
    """

    def __init__(
        self,
        seconds: float = 10.0,
        *,
        follows: bool = True,
        joins: bool = True,
        names: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self._names = names
        self._span_ns = round(seconds * 1e9)
        self._follows, self._joins = follows, joins
        self._lock = threading.Lock()
        self._rings: dict[Role, _Ring | None] = {"device": None, "world": None}
        self._status: dict[Role, Status | None] = {"device": None, "world": None}
        self._joint = JointMargin()
        self._left: set[int] = set()  # the incarnations of the pair that is being replaced
        self._summary: Summary | None = None
        self._outdated = False
        self._given: Summary | None = None
        self._planes: tuple[Plane, ...] | None = None
        self._past: list[Episode] = []
        self._events: list[Event] = []
        self._drawing: Drawing | None = None
        self._parts: tuple[Part, ...] | None = None
        self._scene: SceneSample | None = None
        self._posture: Vector = ()
        self._taken = 0

    def take(self, message: Telemetry) -> None:
        """Add a message, from any thread."""
        with self._lock:
            if isinstance(message, DeviceSample):
                unknown = (math.nan,) * len(message.position_m)
                parts = [getattr(message, name) or unknown for name in PARTS]
                row = (*message.position_m, *message.set_position_m, *message.force_N, *chain(*parts))
                self._sample("device", message, row, math.nan)
            elif isinstance(message, WorldSample):
                row = (*message.position_m, *message.set_position_m, *message.contact_force_N)
                self._sample("world", message, row, message.penetration_m)
            elif isinstance(message, Status):
                self._take_status(message)
            elif isinstance(message, KnownPlanes):
                self._planes = message.planes
            elif isinstance(message, SceneSample):
                self._scene = message
                self._taken += 1
            elif isinstance(message, PostureSample):
                self._posture = message.angles_rad
            elif isinstance(message, Drawing):
                self._draw(message)
            else:
                self._events = [*self._events, message][-MOST_EVENTS:]

    def snapshot(self) -> Snapshot:
        """A snapshot of the present state; the arrays are copies."""
        with self._lock:
            device, world = self._rings["device"], self._rings["world"]
            statuses = self._status["device"], self._status["world"]
            aligned = _same_clock(*statuses)
            newest = max((ring.newest_ns for ring in (device, world) if ring), default=0) if aligned else None
            return Snapshot(
                None if device is None else device.track(self._span_ns, newest),
                None if world is None else world.track(self._span_ns, newest),
                *statuses,
                aligned,
                tuple(self._events),
                self._taken,
                self._present(),
                self._planes,
                tuple(self._past),
                self._parts,
                self._scene,
                self._posture,
                dict(self._names),
            )

    def judge_by(self, summary: Summary) -> None:
        """Show this summary's verdict instead of one computed from the sides' accounts."""
        with self._lock:
            self._given = summary

    def leave(self) -> None:
        """Note that the present pair is about to end, so that its account is no longer shown."""
        with self._lock:
            self._leave()

    def margins(self) -> dict[str, float | None]:
        """The margin of both ports together of the present pair, as `merge` takes it; empty without one clock."""
        with self._lock:
            return self._margins()

    def end(self, episode: Episode) -> None:
        """Add a pair that has ended, with its final verdict, to the past pairs."""
        with self._lock:
            self._past = [*self._past, episode][-MOST_EPISODES:]

    def _leave(self) -> None:
        self._left = {status.incarnation for status in self._status.values() if status is not None}

    def _present(self) -> Summary | None:
        """The summary of the present pair so far, computed once for each status."""
        if self._given is not None:
            return self._given
        sides = [status for status in self._status.values() if status is not None and status.account]
        if len(sides) < 2 or any(side.incarnation in self._left for side in sides):
            return None
        if self._outdated:
            device, world = sides
            self._summary = present(device, world, self._margins())
            self._outdated = False
        return self._summary

    def _margins(self) -> dict[str, float | None]:
        return self._joint.margins() if self._joins and _same_clock(*self._status.values()) else {}

    def _draw(self, drawing: Drawing) -> None:
        """Unpack a drawing only if it has changed: the world sends it repeatedly, and a page compares by identity."""
        if self._drawing is None or self._drawing.data != drawing.data:
            self._parts = unpack(drawing.data)
        self._drawing = drawing

    def _sample(self, role: Role, sample: DeviceSample | WorldSample, vectors: Vector, penetration: float) -> None:
        dof = len(sample.position_m)
        count = len(PARTS) + 3 if role == "device" else 3
        ring = self._rings[role] or _Ring(dof, count)
        if ring.dof != dof or len(vectors) != count * dof or sample.time_ns <= ring.newest_ns:
            return
        self._rings[role] = ring
        ring.append(sample.time_ns, (*vectors, penetration, sample.reservoir_J, sample.margin_J))
        self._taken += 1
        self._joint.take(role, sample.time_ns, sample.margin_J)

    def _take_status(self, status: Status) -> None:
        before = self._status[status.role]
        if before is not None and before.incarnation != status.incarnation:
            self._part_from(before)
            self._rings[status.role] = None
            self._planes = None
            self._scene = None
            if _scene_of(before) != _scene_of(status):
                self._drawing = self._parts = None
            self._joint.begin(status.role)
        self._status[status.role] = status
        self._outdated = True

    def _part_from(self, before: Status) -> None:
        """End the present pair, as a side has restarted: without both final accounts only a broken bound is certain."""
        if before.incarnation in self._left:
            return
        ended = self._present() if self._follows and self._given is None else None
        self._leave()
        if ended is not None:
            final = all(status is not None and status.final for status in self._status.values())
            verdict = ended["verdict"] if final or ended["verdict"]["passive"] is False else _UNFINISHED
            self._past = [*self._past, Episode(*coupled(before), verdict)][-MOST_EPISODES:]


class _Ring:
    """The newest `CAPACITY` samples of one side."""

    def __init__(self, dof: int, vectors: int) -> None:
        self.dof = dof
        self._parts = vectors - 3
        self.newest_ns = -(2**62)
        self._time_ns: NDArray[np.int64] = np.empty(CAPACITY, dtype=np.int64)
        self._values: Array = np.empty((CAPACITY, vectors * dof + 3))
        self._count = 0

    def append(self, time_ns: int, values: Vector) -> None:
        at = self._count % CAPACITY
        self._time_ns[at] = time_ns
        self._values[at] = values
        self._count += 1
        self.newest_ns = time_ns

    def track(self, span_ns: int, zero_ns: int | None) -> Track:
        """The samples of the last `span_ns`, their times counted from `zero_ns`, by default from the newest."""
        zero_ns = self.newest_ns if zero_ns is None else zero_ns
        order = np.arange(max(0, self._count - CAPACITY), self._count) % CAPACITY
        times = self._time_ns[order]
        first = int(np.searchsorted(times, self.newest_ns - span_ns))
        values = self._values[order[first:]]
        n = self.dof
        return Track(
            (times[first:] - zero_ns) / 1e9,
            values[:, :n],
            values[:, n : 2 * n],
            values[:, 2 * n : 3 * n],
            values[:, 3 * n : -3].reshape(len(values), self._parts, n),
            values[:, -3],
            values[:, -2],
            values[:, -1],
        )


def coupled(status: Status | None) -> tuple[str, str]:
    """A side's coupling and rendering from its status; "" if the status has none."""
    about = {} if status is None else status.about
    params = about.get("params")
    rendering = params.get("rendering", params.get("feel", "")) if isinstance(params, Mapping) else ""
    return str(about.get("coupling", "")), str(rendering)


def units(snapshot: Snapshot) -> str:
    """The units of the axes, as defined in `hapnet.units`."""
    sides = [side for side in (snapshot.device_status, snapshot.world_status) if side is not None]
    track = snapshot.device or snapshot.world
    return text_in(sides[0].about, track.position_m.shape[1]) if sides and track is not None else METRES


def of_point(snapshot: Snapshot) -> Snapshot:
    """For a tool that turns: the snapshot of its point alone, with three axes. Any other snapshot is unchanged."""
    if units(snapshot) != POSE:
        return snapshot
    device, world = (None if track is None else _cut(track) for track in (snapshot.device, snapshot.world))
    return replace(snapshot, device=device, world=world, planes=None)


def _cut(track: Track) -> Track:
    vectors = {name: getattr(track, name)[..., :3] for name in ("position_m", "set_position_m", "force_N", "parts_N")}
    return replace(track, **vectors)


def _scene_of(status: Status) -> tuple[object, object]:
    params = status.about.get("params")
    return status.about.get("scene"), params.get("scene") if isinstance(params, Mapping) else None


def _same_clock(a: Status | None, b: Status | None) -> bool:
    clock = a and a.about.get("clock")
    return a is not None and b is not None and clock is not None and clock == b.about.get("clock")
