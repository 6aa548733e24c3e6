"""The summary as tables: one source for the terminal and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from hapnet.couplings.registry import jointly_passive
from hapnet.summary.structure import (
    DIRECTIONS,
    SIDES,
    DirectionFigures,
    Environment,
    Flow,
    LinkPart,
    MotionFigures,
    PathSummary,
    SidePart,
    Summary,
    Theorem,
    known,
    read,
)
from hapnet.summary.verdict import has_reservoirs
from hapnet.summary.words import (
    degrees,
    felt,
    headline,
    milli,
    millijoule,
    number,
    outcome,
    percent,
    rounded,
    shuffled,
    text,
    tuning,
    verdict,
)
from hapnet.units import METRES, within

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

Part = TypeVar("Part")


class _Row(NamedTuple, Generic[Part]):
    """A row of a table: label, unit, the value from a part of the summary, and its conversion to text."""

    label: str
    unit: str
    value: Callable[[Part], object]
    words: Callable[[Any], str]


def cut_share(of: SidePart | None) -> float | None:
    """The share of a device's ticks in which the motors could not hold the whole force; None: unknown."""
    if of is None or "servo" not in of:
        return None
    cut, ticks = known(of["cut_ticks"]), known(of["servo"]["ticks"])
    return None if cut is None or not ticks else cut / ticks


_SIDES: tuple[_Row[SidePart], ...] = (
    _Row("given out, most", "mJ", lambda of: of["ledger"]["energy_out_J"], millijoule),
    _Row("margin at the end", "mJ", lambda of: of["ledger"]["margin_end_J"], millijoule),
    _Row("slack, min", "mJ", lambda of: of["ledger"]["slack_J"], millijoule),
    _Row("true slack, min", "mJ", lambda of: of["true_slack_J"], millijoule),
    _Row("reservoir, min", "mJ", lambda of: of["reservoir_min_J"], millijoule),
    _Row("set-positions modulated", "%", lambda of: of["modulated_share"], percent),
    _Row("deficit, largest", "mJ", lambda of: of["deficit_max_J"], millijoule),
    _Row("reserve", "mJ", lambda of: of["reserve_J"], millijoule),
    _Row("given out while the servo stalled", "mJ", lambda of: of["overrun_leak_J"], millijoule),
    _Row("max speed", "m/s", lambda of: of["speed_max_mps"], number),
    _Row("force in the account", "", lambda of: of["force"], text),
    _Row("ticks in which the motors held less", "%", cut_share, percent),
    _Row("sent", "mJ", lambda of: of["sent_nJ"], shuffled),
    _Row("credited", "mJ", lambda of: of["credited_nJ"], shuffled),
    _Row("discarded", "mJ", lambda of: of["discarded_nJ"], shuffled),
    _Row("abandoned", "mJ", lambda of: of["abandoned_nJ"], shuffled),
    _Row("quantisation", "mJ", lambda of: of["quantisation_J"], millijoule),
    _Row("pairs", "", lambda of: of["incarnations"], number),
    _Row("initial energy of its peers", "mJ", lambda of: of["peers_J"], milli),
    _Row("silences", "", lambda of: of["outages"]["count"], number),
    _Row("longest silence", "s", lambda of: of["outages"]["longest_s"], number),
    _Row("slowest recovery", "ms", lambda of: of["outages"]["recovery_max_s"], milli),
    _Row("positions not used (late or lost)", "", lambda of: of["missing"], number),
    _Row("servo ticks", "", lambda of: of["servo"]["ticks"], number),
    _Row("servo late p50", "µs", lambda of: of["servo"]["late_p50_us"], number),
    _Row("servo late p99", "µs", lambda of: of["servo"]["late_p99_us"], number),
    _Row("servo skipped", "", lambda of: of["servo"]["skipped"], number),
    _Row("servo stalled", "", lambda of: of["servo"]["overruns"], number),
    _Row("without force", "s", lambda of: of["servo"]["without_force_s"], number),
    _Row("steps", "", lambda of: of["step"]["count"], number),
    _Row("step mean", "ms", lambda of: of["step"]["mean_s"], milli),
    _Row("step longest", "ms", lambda of: of["step"]["max_s"], milli),
)
_OF_ONE_PORT = {"given out, most", "margin at the end"}  # meaningless if only both ports together are passive
_BOTH: tuple[_Row[Theorem], ...] = (
    _Row("bound d²", "mJ", lambda of: of["bound_J"], millijoule),
    _Row("energy that came out, most", "mJ", lambda of: of["energy_out_J"], millijoule),
    _Row("margin at the end", "mJ", lambda of: of["margin_end_J"], millijoule),
    _Row("margin after 1 s, min", "mJ", lambda of: of["margin_later_J"], millijoule),
)
_ENVIRONMENT: tuple[_Row[Environment], ...] = (
    _Row("stiffness of the wall", "N/m", lambda of: of["stiffness_N_m"], number),
    _Row("felt stiffness of the wall", "N/m", lambda of: of["felt_stiffness_N_m"], number),
    _Row("stiffest wall of the device alone", "N/m", lambda of: of["local_limit_N_m"], number),
    _Row("work on the proxy", "mJ", lambda of: of["work_J"], millijoule),
    _Row("balance of its own account, min", "mJ", lambda of: of["env_slack_J"], millijoule),
    _Row("put in by its motors", "mJ", lambda of: of["env_supplied_J"], millijoule),
    _Row("stored at the end", "mJ", lambda of: of["env_stored_J"], millijoule),
    _Row("excess that it would have given out", "mJ", lambda of: of["env_given_J"], millijoule),
    _Row("paid back by damping", "mJ", lambda of: of["env_paid_J"], millijoule),
    _Row("substeps repeated", "", lambda of: of["env_undone"], number),
    _Row("lost as bodies were stopped", "mJ", lambda of: of["env_undone_J"], millijoule),
    _Row("pairs that overlapped at the start", "", lambda of: of["env_overlaps"], number),
)
_OF_RESERVOIRS = {"sent", "credited", "discarded", "abandoned"}
_ENERGY: tuple[_Row[Flow], ...] = (
    _Row("energy sent", "mJ", lambda of: of["sent_nJ"], shuffled),
    _Row("energy credited", "mJ", lambda of: of["credited_nJ"], shuffled),
    _Row("energy in flight", "mJ", lambda of: of["in_flight_nJ"], shuffled),
    _Row("energy abandoned", "mJ", lambda of: of["abandoned_nJ"], shuffled),
)
_LINKS: tuple[_Row[LinkPart], ...] = (
    _Row("asked", "", lambda of: of["profile"], text),
    _Row("delay p50", "ms", lambda of: of["delay_p50_ms"], number),
    _Row("delay p99", "ms", lambda of: of["delay_p99_ms"], number),
    _Row("released late, most", "ms", lambda of: of["late_max_ms"], number),
    _Row("packets offered", "", lambda of: of["offered"], number),
    _Row("delivered", "", lambda of: of["delivered"], number),
    _Row("resent", "", lambda of: of["resent"], number),
    _Row("recovered by resending", "", lambda of: of["recovered"], number),
    _Row("lost while down", "", lambda of: of["lost_down"], number),
    _Row("dropped, queue full", "", lambda of: of["dropped_limit"], number),
    _Row("reordered", "", lambda of: of["reordered"], number),
)
_PATH: tuple[_Row[DirectionFigures], ...] = (
    _Row("messages numbered", "", lambda of: of["sent"], number),
    _Row("arrived", "", lambda of: of["arrived"], number),
    _Row("overtaken", "", lambda of: of["overtaken"], number),
    _Row("lost", "", lambda of: of["lost"], number),
    _Row("jitter p50", "ms", lambda of: of["jitter_p50_ms"], number),
    _Row("jitter p99", "ms", lambda of: of["jitter_p99_ms"], number),
    _Row("age of used messages p50", "ms", lambda of: of["age_p50_ms"], number),
    _Row("age of used messages p99", "ms", lambda of: of["age_p99_ms"], number),
    _Row("stalls", "", lambda of: of["stalls"], number),
    _Row("longest stall", "ms", lambda of: of["longest_stall_ms"], number),
)
_MOTION: tuple[_Row[MotionFigures], ...] = (
    _Row("position error, free (rms)", "mm", lambda of: of["free_rms_m"], milli),
    _Row("position error, in contact (rms)", "mm", lambda of: of["contact_rms_m"], milli),
    _Row("angle between, free (rms)", "°", lambda of: of["free_rms_rad"], degrees),
    _Row("angle between, in contact (rms)", "°", lambda of: of["contact_rms_rad"], degrees),
    _Row("penetration, largest", "mm", lambda of: of["peak_penetration_m"], milli),
    _Row("force, largest", "N", lambda of: of["peak_force_N"], number),
    _Row("torque, largest", "Nm", lambda of: of["peak_torque_Nm"], number),
    _Row("contacts", "", lambda of: of["contacts"], number),
)


@dataclass(frozen=True)
class Table:
    """Rows of a label and one value per column, as text; rows without any value are left out."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)


def sides(summary: Summary) -> Table:
    """A table of each side's own figures."""
    hidden = set() if has_reservoirs(summary["coupling"]) else set(_OF_RESERVOIRS)
    if jointly_passive(str(summary["coupling"])):
        hidden |= _OF_ONE_PORT
    rows = tuple(row for row in _SIDES if row.label not in hidden)
    return Table("sides", SIDES, [*_rows(rows, [summary[side] for side in SIDES], summary["units"])])


def both_ports(summary: Summary) -> Table:
    """A table of both ports together: energy given out, and the margin to d^2."""
    return Table("both ports", ("",), [*_rows(_BOTH, [summary["theorem"]])])


def environment(summary: Summary) -> Table:
    """A table of the environment: felt stiffness, and its own account; slack below 0: it gave out energy of its own."""
    return Table("environment", ("",), [*_rows(_ENVIRONMENT, [summary["environment"]], summary["units"])])


def energy(summary: Summary) -> Table:
    """The account of the shuffled energy; no rows if the coupling shuffles none."""
    directions = [summary["energy"][direction] for direction in DIRECTIONS]
    rows = [*_rows(_ENERGY, directions)] if has_reservoirs(summary["coupling"]) else []
    return Table("shuffled energy (up: from the device)", DIRECTIONS, rows)


def links(summary: Summary) -> Table:
    """A table of the emulated links; `path` includes the network."""
    directions = [summary["links"][direction] for direction in DIRECTIONS]
    rows = [*_rows(_LINKS, directions)]
    lost = [None if direction is None else _share(direction["lost"], direction["offered"]) for direction in directions]
    if any(lost):
        rows.append(("lost [%]", *map(text, lost)))
    return Table("emulated links (up: from the device)", DIRECTIONS, rows)


def path(summary: Summary) -> Table:
    """A table of the path between the sides, measured by the streams: network and emulated links together."""
    found = summary["path"]
    rows = [*_rows(_PATH, [found[direction] for direction in DIRECTIONS])]
    lost = _lost(found)
    if any(lost):
        rows.insert(4, ("lost [%]", *map(text, lost)))
    trips = {"min": found["round_trip_min_ms"], "p50": found["round_trip_p50_ms"], "p99": found["round_trip_p99_ms"]}
    rows += [(f"round trip {name} [ms]", "", number(trip)) for name, trip in trips.items() if trip is not None]
    return Table("path, measured end to end (up: from the device)", DIRECTIONS, rows)


def motion(summary: Summary) -> Table:
    """A table of the motion: tracking errors, force and contacts."""
    return Table("motion", ("",), [*_rows(_MOTION, [summary["motion"]], summary["units"])])


def brief(summary: Summary) -> list[str]:
    """The most important figures, one line each: tracking error, largest force, felt stiffness of a wall, path."""
    moved, length = summary["motion"], within(summary["units"], "mm")
    force, depth, contacts = moved["peak_force_N"], moved["peak_penetration_m"], moved["contacts"]
    errors = {
        "free": (moved["free_rms_m"], moved["free_rms_rad"]),
        "in contact": (moved["contact_rms_m"], moved["contact_rms_rad"]),
    }
    tracking = ", ".join(
        f"{milli(value)} {length}{'' if angle is None else f' and {degrees(angle)}°'} {where}"
        for where, (value, angle) in errors.items()
        if value is not None
    )
    torque = "" if moved["peak_torque_Nm"] is None else f" and {number(moved['peak_torque_Nm'])} Nm"
    pushed = [] if force is None else [f"{number(force)} {within(summary['units'], 'N')}{torque}"]
    pushed += [f"{number(contacts)} contact{'s' * (contacts != 1)}"] if contacts else []
    pushed += [f"{milli(depth)} {length} deep at most"] if contacts and depth is not None else []
    walls = felt(summary["environment"], units=summary["units"])
    return [
        f"tracking error (rms): {tracking or 'not known'}",
        f"largest force: {', '.join(pushed) or 'not known'}",
        *([] if walls is None else [f"wall: {walls}"]),
        f"path: {_path_words(summary['path'])}",
    ]


def felt_line(summary: Summary) -> str:
    """How stiff a wall was felt, in one sentence; without a wall the largest force; "": neither is known.

    A second sentence says in which share of the ticks the motors could not hold the whole force, from 0.5 % on; a third
    how much energy the world was kept from giving, from 1 mJ on.
    """
    cut = known(cut_share(summary["device"]))
    motors = f"The motors could not hold the whole force in {cut:.0%} of the ticks." if cut and cut >= 0.005 else ""
    given = known(summary["environment"]["env_given_J"])
    active = given is not None and given >= 1e-3
    held = (
        f"The world's forces would have put in {millijoule(given)} mJ of their own, and were held back."
        if active
        else ""
    )
    return " ".join(filter(None, (_felt(summary), motors, held)))


def _felt(summary: Summary) -> str:
    surroundings, moved, units = summary["environment"], summary["motion"], summary["units"]
    wall, hand = known(surroundings["stiffness_N_m"]), known(surroundings["felt_stiffness_N_m"])
    force, torque = known(moved["peak_force_N"]), known(moved["peak_torque_Nm"])
    if wall is not None and hand is not None:
        unit = within(units, "N/m")
        limit = known(surroundings["local_limit_N_m"])
        share = "" if limit is None or limit < hand else f" of the {rounded(limit)} {unit} that this device can render"
        stiff = f"The wall of {rounded(wall)} {unit}"
        soft = f"like {rounded(hand)}{share}" if share else f"like {rounded(hand)} {unit}"
        return f"{stiff} was not touched; it would feel {soft}." if moved["contacts"] == 0 else f"{stiff} felt {soft}."
    if force is None:
        return ""
    turned = "" if torque is None else f" and the largest torque {rounded(torque)} Nm"
    return f"The largest force was {rounded(force)} {within(units, 'N')}{turned}."


def verdict_text(tree: object) -> RenderableType:
    """The verdict in one line. `tree` : a summary, perhaps with parts missing."""
    return _styled(headline(tree)[0], tree)


def margin_words(summary: Summary) -> str:
    """Explains the margins in the tables, in one line."""
    bound = known(summary["theorem"]["bound_J"])
    allowed, more = (
        ("d²", "it") if bound is None else (f"the {millijoule(bound)} mJ allowed", f"{millijoule(bound)} mJ")
    )
    return (
        f"margin: {allowed}, plus the energy that hand and world have put in, minus the energy that came out; "
        f"so it may exceed {more}"
    )


def summary_text(tree: object) -> RenderableType:
    """The verdict, `brief` and all tables; ``-`` where a value is unknown. `tree` : as for `verdict_text`."""
    from rich import box
    from rich.console import Group
    from rich.table import Table as RichTable
    from rich.text import Text

    def drawn(table: Table) -> RichTable:
        out = RichTable(
            title=table.title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, show_header=any(table.columns)
        )
        out.add_column("")
        for column in table.columns:
            out.add_column(column, justify="right")
        for row in table.rows:
            out.add_row(*map(Text, row))  # as plain text, never as markup
        return out

    summary = read(tree)
    ports = both_ports(summary)
    tables = (
        sides(summary),
        environment(summary),
        energy(summary),
        path(summary),
        links(summary),
        motion(summary),
    )
    parts: list[RenderableType] = [drawn(ports), Text(margin_words(summary)), Text("")] if ports.rows else []
    parts += [drawn(table) for table in tables if table.rows]
    known_figures = [line for line in (*brief(summary), _about(summary)) if line and not line.endswith(": not known")]
    return Group(_styled(verdict(tree), tree), *map(Text, known_figures), *parts)


def _styled(line: str, tree: object) -> Text:
    """A line with the colour of the verdict."""
    from rich.text import Text

    styles = {"bad": "bold red", "unknown": "bold yellow", "good": "bold green"}
    return Text(line, style=styles[outcome(tree)])


def _path_words(found: PathSummary) -> str:
    """The round trip, and the loss in each direction, emulated links included."""
    median, late = found["round_trip_p50_ms"], found["round_trip_p99_ms"]
    parts = [] if median is None else [f"round trip {number(median)} ms"]
    if parts and late is not None:
        parts[0] += f" (99 %: {number(late)})"
    parts += [
        f"{lost} % lost {direction}"
        for direction, lost in zip(DIRECTIONS, _lost(found), strict=True)
        if lost is not None
    ]
    return ", ".join(parts) or "not known"


def _lost(found: PathSummary) -> list[str | None]:
    """The losses on the path in each direction, in %."""
    return [
        None if direction is None else _share(direction["lost"], direction["sent"])
        for direction in (found["up"], found["down"])
    ]


def _rows(
    rows: tuple[_Row[Part], ...], columns: Sequence[Part | None], units: str | None = METRES
) -> Iterator[tuple[str, ...]]:
    for label, of_metres, value_of, words in rows:
        unit = within(units, of_metres)
        values = [None if column is None else value_of(column) for column in columns]
        if any(value is not None for value in values):
            yield (f"{label} [{unit}]" if unit else label, *map(words, values))


def _share(part: int | None, whole: int | None) -> str | None:
    return None if part is None or not whole else f"{100 * part / whole:.2f}"


def _about(summary: Summary) -> str:
    duration = summary["duration_s"]
    values = {
        "coupling": summary["coupling"],
        "tuned to": tuning(summary),
        "seed": summary["seed"],
        "duration": None if duration is None else f"{number(duration)} s",
    }
    return ", ".join(f"{name} {value}" for name, value in values.items() if value is not None)
