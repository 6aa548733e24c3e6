"""The summary's `path`: figures of the path between the sides, measured by the streams, emulated links included."""

from __future__ import annotations

from typing import Any, Literal

from hapnet.side.notices import Notice
from hapnet.summary import structure
from hapnet.summary.structure import Direction, DirectionFigures
from hapnet.wire.messages import Role
from hapnet.wire.path import Path, PathFigures

Section = structure.PathSummary

RoundTrip = Literal["round_trip_min_ms", "round_trip_p50_ms", "round_trip_p99_ms"]
ROUND_TRIP: tuple[RoundTrip, ...] = ("round_trip_min_ms", "round_trip_p50_ms", "round_trip_p99_ms")
DIRECTIONS: dict[Role, Direction] = {"device": "down", "world": "up"}
"""The direction that each role receives."""

REPORT_EVERY_NS = 10_000_000_000


def unknown() -> Section:
    """The keys of `path` with value None."""
    return structure.unknown(Section)


def of_side(role: Role, figures: PathFigures) -> Section:
    """Return one side's figures: the round trip, and the direction towards it."""
    if not figures.sent:
        return unknown()
    flow: DirectionFigures = {
        "sent": figures.sent,
        "arrived": figures.arrived,
        "overtaken": figures.overtaken,
        "lost": figures.lost,
        "loss": figures.lost / figures.sent,
        "jitter_p50_ms": _ms(figures.jitter_p50_ns),
        "jitter_p99_ms": _ms(figures.jitter_p99_ns),
        "age_p50_ms": _ms(figures.age_p50_ns),
        "age_p99_ms": _ms(figures.age_p99_ns),
        "stalls": figures.stalls,
        "longest_stall_ms": _ms(figures.max_stall_ns),
    }
    median, late = _ms(figures.round_trip_p50_ns), _ms(figures.round_trip_p99_ns)
    whole = unknown() | {
        "round_trip_min_ms": _ms(figures.round_trip_min_ns), "round_trip_p50_ms": median, "round_trip_p99_ms": late
    }  # fmt: skip
    whole[DIRECTIONS[role]] = flow
    return whole


def of_both(device: Section | None, world: Section | None) -> Section:
    """Both sides' figures together. Each direction is measured by its receiver; a receiver's report to the other side
    counts only where its own figures are missing. The round trip is the device's, if it has one."""
    by_role: dict[Role, Section | None] = {"device": device, "world": world}
    sides = [side for side in (device, world) if side is not None]
    whole = unknown()
    for key in ROUND_TRIP:
        whole[key] = next((side[key] for side in sides if side.get(key) is not None), None)
    for role, flow in DIRECTIONS.items():
        receiver = by_role[role]
        measured = [side[flow] for side in (receiver, *sides) if side is not None and side.get(flow) is not None]
        whole[flow] = next(iter(measured), None)
    return whole


class PathMeter:
    """The path's figures of one side since the last reading."""

    def __init__(self, role: Role, path: Path) -> None:
        self.role = role
        self._path, self._before = path, path.counts()

    def read(self) -> Section:
        """The figures since the last reading; None where no message has arrived."""
        now = self._path.counts()
        figures, self._before = self._path.figures(self._before), now
        return of_side(self.role, figures)


class PathReporter:
    """Reports the state of the path at intervals."""

    def __init__(self, role: Role, path: Path) -> None:
        self._meter = PathMeter(role, path)
        self._next_ns: int | None = None

    def look(self, now_ns: int) -> Notice | None:
        """Return the notice to send, if it is due."""
        if self._next_ns is not None and now_ns < self._next_ns:
            return None
        first, self._next_ns = self._next_ns is None, now_ns + REPORT_EVERY_NS
        section = self._meter.read()
        if first or not (text := words(section, self._meter.role)):
            return None
        flow = section[DIRECTIONS[self._meter.role]]
        values: dict[str, Any] = {**{key: section[key] for key in ROUND_TRIP}, **(flow or {})}
        return Notice("path", text, now_ns, values={key: value for key, value in values.items() if value is not None})


def words(section: Section, role: Role) -> str:
    """Return the figures of this side in one line; "" while there are none."""
    flow = section[DIRECTIONS[role]]
    if flow is None or section["round_trip_p50_ms"] is None:
        return ""
    other = "world" if role == "device" else "device"
    trips = f"round trip {section['round_trip_p50_ms']:.1f} ms (99 %: {section['round_trip_p99_ms']:.1f})"
    inward = f"{100 * (flow['loss'] or 0.0):.1f} % lost from the {other}, jitter {flow['jitter_p99_ms']:.1f} ms (99 %)"
    if 100 * (flow["overtaken"] or 0) >= (flow["sent"] or 0):
        inward += f", {100 * (flow['overtaken'] or 0) / (flow['sent'] or 1):.1f} % overtaken"
    if flow["age_p99_ms"] is not None:
        inward += f", data in use at most {flow['age_p99_ms']:.0f} ms old (99 %)"
    stalls = f", {flow['stalls']} stall{'s' * (flow['stalls'] > 1)}" if flow["stalls"] else ""
    return f"path: {trips}; {inward}{stalls}"


def _ms(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns * 1e-6
