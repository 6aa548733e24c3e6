"""The definition of a metric, and its input: a simulated run, its scene, and its windows of time.

A case can miss a metric: then `value_of` is infinite, and `quantile` counts the case instead of leaving it out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import floor, inf, isfinite
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.control.two_port import TwoPort
from hapnet.couplings.registry import coupling, ideal_stiffness
from hapnet.ext.metrics.obstacles import WallOrSolid, environment_force, obstacles, standing_force
from hapnet.params import Params
from hapnet.plant.worlds.moving_wall import MovingWall
from hapnet.plant.worlds.protocol import World
from hapnet.recording.poses import of_point, of_turning
from hapnet.recording.samples import Columns, Recording
from hapnet.side.device import DeviceSide
from hapnet.side.world import WorldSide
from hapnet.summary.from_samples import touching
from hapnet.summary.structure import LinkPart, SidePart, Summary

Better = Literal["higher", "lower", "nearer 0", "nearer 100"]
Measures = dict[str, float | None]
"""Values by the names of their metrics; None if a run gives no value."""

Mask: TypeAlias = NDArray[np.bool_]
"""(N,) True for the samples that count."""

FIRST_S, LAST_S, LONG_S = 10.0, 60.0, 120.0
"""The lengths of the first and the last window, and the shortest run that has these windows [s]."""

TENTHS = 10

Found = TypeVar("Found")


@dataclass(frozen=True)
class Metric:
    """A figure of merit.

    name : its key in dictionaries and files; it ends in the unit, as in `margin_J` or `packets_per_s`.
    label : its name in tables, short enough for a column.
    unit : of its values; "" for a bare number. better : "lower", "higher" or "nearer" a value. meaning : its
        definition in a sentence or two.
    missed : the metric that counts how often a run missed this one; a missed value counts as infinite in medians and
        quartiles. "": it cannot be missed.
    over : the set over which its mean, quantile, share or extreme is taken. Means are over time, as each recorded
        sample counts until the next sample (`hapnet.recording.durations`).
    find : computes its value for a run; None if the run gives no value.
    """

    name: str
    label: str
    unit: str
    better: Better
    meaning: str
    missed: str
    over: str
    find: Find

    @property
    def heading(self) -> str:
        """Label and unit, for an axis or a column."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


DEFINED: dict[str, Metric] = {}
"""Every metric that a loaded module of this package defines; `hapnet.ext.metrics.METRICS` has all metrics."""


def metric(label: str, unit: str, better: Better, *, over: str, missed: str = "") -> Callable[[Find], Find]:
    """Make a function a `Metric`, with the function's name as its name and the docstring as its meaning."""

    def define(find: Find) -> Find:
        name, text = find.__name__, " ".join((find.__doc__ or "").split()).removesuffix(".")
        assert name not in DEFINED, f"{name} is defined twice"
        DEFINED[name] = Metric(name, label, unit, better, text[:1].lower() + text[1:], missed, over, find)
        return find

    return define


class Simulated(Protocol):
    """The result of a run in virtual time: a `hapnet.simulation.result.Result`."""

    @property
    def summary(self) -> Summary: ...
    @property
    def recording(self) -> Recording: ...
    @property
    def device(self) -> DeviceSide: ...
    @property
    def world(self) -> WorldSide: ...
    @property
    def hand(self) -> TwoPort: ...


@dataclass(frozen=True)
class Measured:
    """A simulated run with the motion of each tick of the servo recorded, and its scene.

    ideal : the recording of the same run over an ideal link without deadband; None: there is no such run.
    local : the recording of the same run over an ideal link with a fast world, for walls with friction; None: none.
    """

    params: Params
    result: Simulated
    scene: World
    ideal: Recording | None = None
    local: Recording | None = None
    _once: dict[Callable[[Measured], Any], Any] = field(default_factory=dict, repr=False)

    def once(self, find: Callable[[Measured], Found]) -> Found:
        """``find(self)``, computed once for all metrics that need it."""
        if find not in self._once:
            self._once[find] = find(self)
        found: Found = self._once[find]
        return found

    @cached_property
    def walls(self) -> tuple[WallOrSolid, ...] | None:
        """The walls and solids of the scene; None: they are not known, and metrics that need them have no value."""
        moves = isinstance(self.scene, MovingWall) and self.scene.schedule.changes
        return () if moves else obstacles(self.scene)

    @cached_property
    def recording(self) -> Recording:
        """The run's recording; for a tool that turns, the recording of its point."""
        return of_point(self.result.recording)

    @cached_property
    def turning(self) -> Recording | None:
        """The recording of the rotation; None: the tool does not turn."""
        return of_turning(self.result.recording)

    @property
    def summary(self) -> Summary:
        return self.result.summary

    @property
    def device(self) -> Columns:
        """The device's samples."""
        found = self.recording.device
        assert found is not None, "a simulated run has both sides"
        return found

    @property
    def world(self) -> Columns | None:
        """The world's samples; None if the run ended before its first step."""
        return self.recording.world

    @property
    def sides(self) -> tuple[SidePart, SidePart]:
        """The device's and the world's part of the summary."""
        device, world = self.summary["device"], self.summary["world"]
        assert device is not None, "a simulated run has both sides"
        assert world is not None, "a simulated run has both sides"
        return device, world

    @property
    def links(self) -> tuple[LinkPart, LinkPart]:
        """The uplink's and the downlink's part of the summary."""
        up, down = self.summary["links"]["up"], self.summary["links"]["down"]
        assert up is not None, "a simulated run has both links"
        assert down is not None, "a simulated run has both links"
        return up, down

    @property
    def delay_s(self) -> float | None:
        """The sum of the median delays of both links [s]; None: no message came through one of them."""
        up_ms, down_ms = (direction["delay_p50_ms"] for direction in self.links)
        return None if up_ms is None or down_ms is None else (up_ms + down_ms) / 1e3

    @property
    def windows(self) -> tuple[Span, Span] | tuple[None, None]:
        """The first 10 s and the last minute before the hand comes to rest; None: the run is too short."""
        return first_and_last(self.params.duration_s, self.params.operator_model.end_hold_s) or (None, None)

    @property
    def scalar(self) -> bool:
        """Whether both springs are scalars, so that their stiffness in series with a wall is one number."""
        return isinstance(self.params.device.stiffness, float) and isinstance(self.params.world.stiffness, float)

    @cached_property
    def wanted(self) -> Array | None:
        """The force of the true environment on the device (N, n) [N]; None: the walls are not known.

        With springs that are no scalars only the walls' own stiffness counts: then this only shows their places.
        """

        def stiffness(wall: WallOrSolid) -> float:
            return ideal_stiffness(self.params, wall.stiffness) if self.scalar else wall.stiffness

        return self._force_at(self.device["position_m"], self.device["time_s"], stiffness)

    @cached_property
    def inside(self) -> Mask | None:
        """(N,) True while the device is in a wall; for a tool, while the proxy touches. None: this is not known."""
        if self.turning is not None:
            return None if self.world is None else touching(self.device, self.world)
        return None if self.wanted is None else np.asarray((self.wanted != 0.0).any(axis=1))

    def proxy_force(self, positions: Array, times: Array) -> Array | None:
        """The walls' force on a resting proxy (N, n) [N] for the device at `positions` (N, n) [m]; None: not known.

        It is the force of the spring between device and proxy and the wall in series: the world's spring K', or the
        device's for a coupling with only one spring. `times` (N,) : since the recording's origin [s].
        """
        springs = self.params.world if coupling(self.params.coupling).scaled else self.params.device
        if not isinstance(spring := springs.stiffness, float):
            return None
        return self._force_at(positions, times, lambda wall: spring * wall.stiffness / (spring + wall.stiffness))

    def _force_at(self, positions: Array, times: Array, stiffness: Callable[[WallOrSolid], float]) -> Array | None:
        """The force of the walls present at each time, with this stiffness; zero outside all walls."""
        scene = self.scene
        if isinstance(scene, MovingWall) and scene.schedule.changes:
            moving = scene.schedule
            late_s = ((self.result.world.origin_ns or 0) - int(self.recording.meta["origin_ns"])) / 1e9
            return environment_force(
                positions,
                (times - late_s).tolist(),
                lambda t: () if (wall := moving.at(t)) is None else (wall,),
                stiffness,
            )
        return None if self.walls is None else standing_force(positions, self.walls, stiffness)


Find: TypeAlias = Callable[[Measured], float | None]


class Span(NamedTuple):
    """The times from `since_s` to before `until_s` [s]."""

    since_s: float
    until_s: float

    def holds(self, times: Array) -> Mask:
        """True for those of `times` (N,) [s] that lie in the span."""
        return np.asarray((times >= self.since_s) & (times < self.until_s))


def first_and_last(lasts_s: float, still_s: float = 0.0) -> tuple[Span, Span] | None:
    """The first 10 s and the last minute; None: the run is too short.

    lasts_s : the duration of the run [s], 120 or more. still_s : the time at the end in which the hand holds still [s];
        the last minute is the minute before it.
    """
    if lasts_s < LONG_S:
        return None
    end_s = lasts_s - still_s
    return Span(0.0, FIRST_S), Span(end_s - LAST_S, end_s)


def tenths(times: Array, lasts_s: float) -> list[Mask]:
    """True for `times` (N,) [s] in each tenth of a run of `lasts_s` [s]; later times count with the last tenth."""
    which = np.minimum((times * (TENTHS / lasts_s)).astype(int), TENTHS - 1)
    return [which == tenth for tenth in range(TENTHS)]


def scaled(value: float | None, factor: float) -> float | None:
    """`value` in another unit; None stays None."""
    return None if value is None else factor * value


def value_of(measures: Mapping[str, float | None], metric: str) -> float | None:
    """The value of a case; infinite if the case missed it (a contact that was not felt); None if there is no value."""
    value = measures.get(metric)
    known = DEFINED.get(metric)
    if value is None and known is not None and known.missed and measures.get(known.missed):
        return inf
    return value


def quantile(values: Sequence[float], share: float) -> float:
    """The quantile at `share` (0 to 1), linear between values; infinite if one of the two is infinite."""
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = floor(place)
    part = place - low
    below, above = ordered[low], ordered[min(low + 1, len(ordered) - 1)]
    if not part or below == above:
        return below
    return below + part * (above - below) if isfinite(above) else above
