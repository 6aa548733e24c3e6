"""Recordings of a run: the samples, samples as columns, and one recording joined from two sides."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Vector
from hapnet.errors import RecordingError
from hapnet.recording.alignment import ClockDifference, clock_difference
from hapnet.recording.drawing import Drawing, SceneSample

if TYPE_CHECKING:
    from pandas import DataFrame

Columns: TypeAlias = dict[str, NDArray[Any]]


class DeviceSample(NamedTuple):
    """The device's side at one servo tick. Vectors have one element per axis.

    `set_position_m` is PSPM's modulated ybar, `target_m` its input y. `force_N` is the coupling's force on the
    device; with the continuous servo, the force of the last substep. `operator_force_N` is the simulated
    hand's force and `operator_target_m` its target x_d; both are None if a person holds a real device. Energies are
    those of the modulator and the ledger: `sent_J` and `credited_J` are running totals, `margin_J` and `slack_J` those
    of this side's half of the theorem at this instant.

    `spring_force_N` is K (ybar - x) and `damper_force_N` is -B v: they add up to the force, unless a limit reduced
    it. `model_force_N` and `added_damping_force_N` are the parts of the spring's force that come from the
    planes of the local contact model and from added damping. All four are None if a coupling does not report them.

    `work_J` is W, the energy put in since the start at the port of this side's account: the hand's with the continuous
    servo, else the actuator's, by the force really applied. `bound_J` is V(0) + E(0). With them the account can be
    repeated (hapnet/control/ledger.py): margin = W + bound + credited - sent, and slack = margin - V - E. `stored_J` is
    V, at the hand's port with the kinetic energy. `account_J` is E as the ledger counts it: the reservoir less the
    deficit, and what was harvested since PSPM last ran. `operator_work_J` is the energy that the simulated hand put in.
    Work is summed over every tick and substep, whichever are recorded. All are NaN in older recordings.

    More than twenty attributes: one for each series that a viewer plots.

    `velocity_mps` is the measured velocity of this tick. `age_s` and `transit_s` belong to the newest used message of
    the world, NaN before the first: the time since it was sent, estimated without a common clock (hapnet/wire/path.py),
    and its arrival on this side's clock less its stamp on the world's clock. The transit contains the
    difference of the clocks (the relative transit time of RFC 3550, section 6.4.1).
    """

    time_ns: int
    position_m: Vector
    set_position_m: Vector
    target_m: Vector
    force_N: Vector
    operator_force_N: Vector | None
    reservoir_J: float
    deficit_J: float
    potential_J: float
    sent_J: float
    credited_J: float
    margin_J: float
    slack_J: float
    operator_target_m: Vector | None = None
    spring_force_N: Vector | None = None
    damper_force_N: Vector | None = None
    model_force_N: Vector | None = None
    added_damping_force_N: Vector | None = None
    velocity_mps: Vector | None = None
    age_s: float = math.nan
    transit_s: float = math.nan
    bound_J: float = math.nan
    work_J: float = math.nan
    stored_J: float = math.nan
    account_J: float = math.nan
    operator_work_J: float = math.nan


class MetricSample(NamedTuple):
    """The part of a `DeviceSample` that the metrics need: a study of thousands of runs records no more."""

    time_ns: int
    position_m: Vector
    force_N: Vector
    operator_target_m: Vector | None


class WorldSample(NamedTuple):
    """The world's side at the start of one step of length `step_s`; `position_m` is the proxy's.

    `penetration_m` is the depth in the deepest wall (0 or less outside), `contact_force_N` the walls' force on the
    proxy, `coupling_force_N` the virtual coupling's. `work_J` is the energy that the environment put in at the world's
    port by the end of the last step, with every substep of an engine. The rest is as in `DeviceSample`.

    More than twenty attributes: one for each column of a recording.
    """

    time_ns: int
    step_s: float
    position_m: Vector
    velocity_mps: Vector
    set_position_m: Vector
    target_m: Vector
    coupling_force_N: Vector
    contact_force_N: Vector
    penetration_m: float
    reservoir_J: float
    potential_J: float
    sent_J: float
    credited_J: float
    margin_J: float
    slack_J: float
    age_s: float = math.nan
    transit_s: float = math.nan
    bound_J: float = math.nan
    work_J: float = math.nan
    stored_J: float = math.nan
    account_J: float = math.nan

    def moved(
        self,
        place: Callable[[Vector], Vector],
        velocity: Callable[[Vector], Vector],
        force: Callable[[Vector], Vector],
    ) -> WorldSample:
        """The sample in other coordinates. place, velocity, force : convert such vectors to them."""
        return self._replace(
            position_m=place(self.position_m),
            velocity_mps=velocity(self.velocity_mps),
            set_position_m=place(self.set_position_m),
            target_m=place(self.target_m),
            coupling_force_N=force(self.coupling_force_N),
            contact_force_N=force(self.contact_force_N),
        )


class PostureSample(NamedTuple):
    """The joints' angles q of an arm that is coupled at its tip [rad], whenever the device is recorded."""

    time_ns: int
    angles_rad: Vector


Level: TypeAlias = Literal["info", "warning", "error"]


class Event(NamedTuple):
    """An event: `kind` is one word for programs, `text` is for people (the first 2000 characters are kept)."""

    time_ns: int
    kind: str
    text: str
    level: Level = "info"


Sample: TypeAlias = DeviceSample | PostureSample | WorldSample | Event | SceneSample | Drawing
"""All kinds of samples that are written to a file, to a watcher and to memory."""

S = TypeVar("S", Event, SceneSample, Drawing)

_SCALARS = (
    "time_ns",
    "step_s",
    "penetration_m",
    "age_s",
    "transit_s",
)  # and the energies; all other fields are vectors
VECTORS = frozenset(
    name
    for kind in (DeviceSample, WorldSample)
    for name in kind._fields
    if name not in _SCALARS and not name.endswith("_J")
)
"""The fields that have one element per axis."""


class Lost(NamedTuple):
    """A damaged part of a recording: the times of the last sample before it and of the first after it [ns], if any."""

    begin_ns: int | None
    end_ns: int | None


@dataclass(frozen=True)
class Recording:
    """A whole run, or one side of it, as columns.

    `device` and `world` map field names to arrays: ``time_ns`` (N,) int64, ``time_s`` (N,) seconds since
    ``meta["origin_ns"]``, vectors (N, n), all else (N,); NaN where a value is unknown. A side that was not recorded is
    None; a device of which only the motion was recorded (`MetricSample`) has no other columns.
    `torn` : the file ended before its writer closed it. `scene`, `drawing` : the world's picture, if it was
    recorded. `posture` : of an arm, if it does not follow from the positions. `lost` : the damaged parts of the file,
    whose samples are missing.
    """

    meta: dict[str, Any]
    device: Columns | None
    world: Columns | None
    events: list[Event]
    summary: Mapping[str, Any] | None
    torn: bool = False
    scene: tuple[SceneSample, ...] = ()
    drawing: Drawing | None = None
    posture: tuple[PostureSample, ...] = ()
    lost: tuple[Lost, ...] = ()

    def __repr__(self) -> str:
        counts = [
            f"{side} {len(columns['time_ns'])} samples"
            for side, columns in (("device", self.device), ("world", self.world))
            if columns is not None
        ]
        state = ["torn"] * self.torn + ["damaged"] * bool(self.lost)
        return f"Recording({', '.join([*counts, f'{len(self.events)} events', *state])})"

    def to_pandas(self, side: str = "device") -> DataFrame:
        """The samples of the device or the world as a table of pandas; see `hapnet.recording.frames.to_pandas`."""
        from hapnet.recording.frames import to_pandas

        return to_pandas(self, side)

    def samples(self) -> list[Sample]:
        """All samples and events, in order of time."""
        drawing = () if self.drawing is None else (self.drawing,)
        sides = [*_rows(DeviceSample, self.device), *self.posture, *_rows(WorldSample, self.world)]
        rows = [*drawing, *sides, *self.scene, *self.events]
        return sorted(rows, key=attrgetter("time_ns"))


class MemoryRecorder:
    """Keeps samples in memory; `write` is one list append."""

    def __init__(self, meta: Mapping[str, Any]) -> None:
        self._meta = meta
        self._samples: list[Sample | MetricSample] = []
        self._later: tuple[list[Columns], list[Columns]] = ([], [])

    def write(self, sample: Sample | MetricSample) -> None:
        self._samples.append(sample)

    def extend(self, device: Columns, world: Columns) -> None:
        """Append later samples of both sides, as columns without ``time_s``."""
        for parts, columns in zip(self._later, (device, world), strict=True):
            if len(columns["time_ns"]):
                parts.append(columns)

    def recording(self, summary: Mapping[str, Any] | None = None) -> Recording:
        """Return the recording of the written samples, as if read from a file."""
        found = from_samples(plain(self._meta), self._samples, plain(summary), torn=False)
        device, world = self._later
        return replace(found, device=_joined(found.device, device, found), world=_joined(found.world, world, found))


def join(a: Recording, b: Recording) -> Recording:
    """Join a device's and a world's recording, given in either order.

    The world's times are put on the device's clock, and both are counted from the later origin. If both have the same
    ``meta["clock"]``, that is exact. Otherwise the clocks' difference is measured by the messages, and kept as
    ``meta["clock_difference"]`` (the fields of a `ClockDifference`). If that fails, each starts at its own origin,
    and ``meta["aligned"]`` is False: the order of events on the two sides is not known. The settings of both are kept
    under ``meta["sides"]``. The summary is None: `hapnet.summary.run.merge` joins the two summaries.

    Raises RecordingError: the two are not one device's and one world's, or are of different runs.
    """
    if a.device is None and b.device is not None:
        a, b = b, a
    if a.device is None or b.world is None or a.world is not None or b.device is not None:
        raise RecordingError(
            "cannot join these recordings: one must hold a device's samples and the other a world's; "
            f"the first holds {_sides(a)}, the second {_sides(b)}"
        )
    for key in ("session", "name"):
        ours, theirs = a.meta.get(key), b.meta.get(key)
        if None not in (ours, theirs) and ours != theirs:
            raise RecordingError(
                f"cannot join recordings of different runs: the device's {key} is {ours!r}, the world's {theirs!r}"
            )
    same = a.meta.get("clock") is not None and a.meta.get("clock") == b.meta.get("clock")
    difference = None if same else clock_difference(a.device, b.world)
    meta = {**b.meta, **a.meta, "role": "both", "aligned": same or difference is not None}
    meta["sides"] = {"device": a.meta, "world": b.meta}
    if difference is not None:
        meta["clock_difference"] = plain(vars(difference))
    [world_origin] = on_device_clock(meta, np.array([_origin(b)], dtype=np.int64)).tolist()
    origin = meta["origin_ns"] = max(_origin(a), world_origin) if meta["aligned"] else _origin(a)
    if a.meta.get("utc_origin_ns") is not None:
        meta["utc_origin_ns"] = origin + utc_less_clock_ns(a.meta)

    def moved(samples: Iterable[S]) -> Iterator[S]:
        listed = list(samples)
        times = on_device_clock(meta, np.array([one.time_ns for one in listed], dtype=np.int64)).tolist()
        return (one._replace(time_ns=at_ns) for one, at_ns in zip(listed, times, strict=True))

    return Recording(
        meta,
        _on_clock(a.device, a.device["time_ns"], origin),
        _on_clock(b.world, on_device_clock(meta, b.world["time_ns"]), origin),
        sorted([*a.events, *moved(b.events)], key=attrgetter("time_ns")),
        None,
        a.torn or b.torn,
        tuple(moved(b.scene)),
        next(moved([] if b.drawing is None else [b.drawing]), None),
        a.posture,
        a.lost + tuple(Lost(*_moved(meta, span)) for span in b.lost),
    )


def _moved(meta: Mapping[str, Any], times: Lost) -> Iterator[int | None]:
    for at in times:
        yield None if at is None else int(on_device_clock(meta, np.array([at], dtype=np.int64))[0])


def on_device_clock(meta: Mapping[str, Any], world_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert times of the world's clock to the device's [ns], by the settings of a joined recording."""
    if "clock_difference" in meta:
        return ClockDifference.of(meta["clock_difference"]).on_device(world_ns)
    sides = meta["sides"]
    apart = 0 if meta["aligned"] else int(sides["device"]["origin_ns"]) - int(sides["world"]["origin_ns"])
    return world_ns + apart


def from_samples(
    meta: dict[str, Any], samples: Iterable[Sample | MetricSample], summary: Mapping[str, Any] | None, torn: bool
) -> Recording:
    """`samples` as columns; a missing ``meta["origin_ns"]`` becomes the time of the first sample."""
    device, world, events = list[DeviceSample | MetricSample](), list[WorldSample](), list[Event]()
    scene, posture, drawing = list[SceneSample](), list[PostureSample](), None
    for sample in samples:
        if isinstance(sample, DeviceSample | MetricSample):
            device.append(sample)
        elif isinstance(sample, WorldSample):
            world.append(sample)
        elif isinstance(sample, Event):
            events.append(sample)
        elif isinstance(sample, SceneSample):
            scene.append(sample)
        elif isinstance(sample, PostureSample):
            posture.append(sample)
        else:
            drawing = sample
    first = min((rows[0].time_ns for rows in (device, world, events) if rows), default=0)
    origin = int(meta.setdefault("origin_ns", first))
    device_columns, world_columns = _columns(device, origin), _columns(world, origin)
    seen = tuple(scene), drawing, tuple(posture)
    return Recording(meta, device_columns, world_columns, events, summary, torn, *seen)


def _columns(samples: list[DeviceSample | MetricSample] | list[WorldSample], origin_ns: int) -> Columns | None:
    if not samples:
        return None
    kind = type(samples[0])
    unknown = (math.nan,) * len(samples[0].position_m)
    columns: Columns = {}
    for name, values in zip(kind._fields, zip(*samples, strict=True), strict=True):
        if name in VECTORS:
            vectors = [unknown if v is None else v for v in values]
            if set(map(len, vectors)) != {len(unknown)}:
                raise RecordingError(
                    f"{name} does not fit: it must have {len(unknown)} axes, as the first position_m has"
                )
            columns[name] = np.array(list(chain.from_iterable(vectors)), dtype=float).reshape(len(samples), -1)
        elif name == "time_ns":
            columns[name] = np.array(values, dtype=np.int64)
        else:
            columns[name] = np.array(values, dtype=float)
    return _on_clock(columns, columns["time_ns"], origin_ns)


def _joined(first: Columns | None, later: list[Columns], recording: Recording) -> Columns | None:
    """The columns, followed by the later columns."""
    if not later:
        return first
    parts = later if first is None else [first, *later]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in later[0]}
    return _on_clock(columns, columns["time_ns"], _origin(recording))


def _on_clock(columns: Columns, time_ns: NDArray[np.int64], origin_ns: int) -> Columns:
    return {**columns, "time_ns": time_ns, "time_s": (time_ns - origin_ns) / 1e9}


def utc_less_clock_ns(meta: Mapping[str, Any]) -> int:
    """The difference to add to a time on a recording's clock to get UTC [ns]; 0 if it is not in the settings."""
    origin_ns, utc_origin_ns = meta.get("origin_ns"), meta.get("utc_origin_ns")
    return 0 if origin_ns is None or utc_origin_ns is None else int(utc_origin_ns) - int(origin_ns)


def plain(value: Any) -> Any:
    """`value` as strict JSON allows it: numbers that are not finite become None, numpy's types become Python's."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return str(value) if isinstance(value, os.PathLike) else value


def _rows(kind: type[DeviceSample] | type[WorldSample], columns: Columns | None) -> Iterator[Sample]:
    """The samples from which `_columns` made `columns`."""
    if columns is None:
        return
    lists = [columns[name].tolist() for name in kind._fields]
    for values in zip(*lists, strict=True):
        yield kind._make((None if all(map(math.isnan, v)) else tuple(v)) if isinstance(v, list) else v for v in values)


def _origin(recording: Recording) -> int:
    return int(recording.meta["origin_ns"])


def _sides(recording: Recording) -> str:
    sides = [name for name in ("device", "world") if getattr(recording, name) is not None]
    return " and ".join(sides) or "no samples"
