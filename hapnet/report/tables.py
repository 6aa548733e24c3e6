"""The summary as tables: one source for the terminal's and the page's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hapnet.couplings.registry import jointly_passive
from hapnet.report.words import (
    get,
    has_reservoirs,
    known,
    milli,
    millijoule,
    number,
    outcome,
    shuffled,
    text,
    tuning,
    verdict,
)

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

_WAYS = ("up", "down")
_Row = tuple[str, str, tuple[str, ...], Callable[[Any], str]]  # label, unit, where in the summary, into words

_SIDES: tuple[_Row, ...] = (
    ("given out, most", "mJ", ("ledger", "energy_out_J"), millijoule),
    ("margin at the end", "mJ", ("ledger", "margin_end_J"), millijoule),
    ("slack, least", "mJ", ("ledger", "slack_J"), millijoule),
    ("true slack, least", "mJ", ("true_slack_J",), millijoule),
    ("reservoir, least", "mJ", ("reservoir_min_J",), millijoule),
    ("deficit, largest", "mJ", ("deficit_max_J",), millijoule),
    ("reserve", "mJ", ("reserve_J",), millijoule),
    ("given out while the servo was away", "mJ", ("overrun_leak_J",), millijoule),
    ("greatest speed", "m/s", ("speed_max_mps",), number),
    ("force in the account", "", ("force",), text),
    ("sent", "mJ", ("sent_nJ",), shuffled),
    ("credited", "mJ", ("credited_nJ",), shuffled),
    ("discarded", "mJ", ("discarded_nJ",), shuffled),
    ("abandoned", "mJ", ("abandoned_nJ",), shuffled),
    ("quantisation", "mJ", ("quantisation_J",), millijoule),
    ("pairs", "", ("incarnations",), number),
    ("initial energy of its peers", "mJ", ("peers_J",), milli),
    ("silences", "", ("outages", "count"), number),
    ("longest silence", "s", ("outages", "longest_s"), number),
    ("slowest recovery", "ms", ("outages", "recovery_max_s"), milli),
    ("positions not used (late or lost)", "", ("missing",), number),
    ("servo ticks", "", ("servo", "ticks"), number),
    ("servo late p50", "µs", ("servo", "late_p50_us"), number),
    ("servo late p99", "µs", ("servo", "late_p99_us"), number),
    ("servo skipped", "", ("servo", "skipped"), number),
    ("steps", "", ("step", "count"), number),
    ("step mean", "ms", ("step", "mean_s"), milli),
    ("step longest", "ms", ("step", "max_s"), milli),
)
_OF_ONE_PORT = {"given out, most", "margin at the end"}  # they say nothing where both are passive together only
_BOTH: tuple[_Row, ...] = (
    ("bound d²", "mJ", ("bound_J",), millijoule),
    ("energy that came out, most", "mJ", ("energy_out_J",), millijoule),
    ("margin at the end", "mJ", ("margin_end_J",), millijoule),
    ("margin after 1 s, least", "mJ", ("margin_later_J",), millijoule),
)
_OF_RESERVOIRS = {"sent", "credited", "discarded", "abandoned"}
_ENERGY: tuple[_Row, ...] = (
    ("energy sent", "mJ", ("sent_nJ",), shuffled),
    ("energy credited", "mJ", ("credited_nJ",), shuffled),
    ("energy in flight", "mJ", ("in_flight_nJ",), shuffled),
    ("energy abandoned", "mJ", ("abandoned_nJ",), shuffled),
)
_LINKS: tuple[_Row, ...] = (
    ("asked", "", ("profile",), text),
    ("delay p50", "ms", ("delay_p50_ms",), number),
    ("delay p99", "ms", ("delay_p99_ms",), number),
    ("released late, most", "ms", ("late_max_ms",), number),
    ("packets offered", "", ("offered",), number),
    ("delivered", "", ("delivered",), number),
    ("resent", "", ("resent",), number),
    ("recovered by it", "", ("recovered",), number),
    ("lost while down", "", ("lost_down",), number),
    ("dropped, queue full", "", ("dropped_limit",), number),
    ("reordered", "", ("reordered",), number),
)
_PATH: tuple[_Row, ...] = (
    ("messages numbered", "", ("sent",), number),
    ("not come", "", ("lost",), number),
    ("jitter p50", "ms", ("jitter_p50_ms",), number),
    ("jitter p99", "ms", ("jitter_p99_ms",), number),
    ("age of what is used p50", "ms", ("age_p50_ms",), number),
    ("age of what is used p99", "ms", ("age_p99_ms",), number),
    ("stalls", "", ("stalls",), number),
    ("longest stall", "ms", ("longest_stall_ms",), number),
)
_MOTION: tuple[_Row, ...] = (
    ("position error, free (rms)", "mm", ("free_rms_m",), milli),
    ("position error, in contact (rms)", "mm", ("contact_rms_m",), milli),
    ("penetration, largest", "mm", ("peak_penetration_m",), milli),
    ("force, largest", "N", ("peak_force_N",), number),
    ("contacts", "", ("contacts",), number),
)


@dataclass(frozen=True)
class Table:
    """Rows of a label and a value a column, in words; a row of which nothing is known is left out."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)


def sides(summary: Mapping[str, Any]) -> Table:
    """What each side knows of itself."""
    columns, coupling = ("device", "world"), get(summary, "coupling")
    untold = set() if has_reservoirs(coupling) else set(_OF_RESERVOIRS)
    if jointly_passive(coupling):
        untold |= _OF_ONE_PORT
    rows = tuple(row for row in _SIDES if row[0] not in untold)
    return Table("sides", columns, [*_rows(rows, [get(summary, side) for side in columns])])


def both_ports(summary: Mapping[str, Any]) -> Table:
    """How far both ports together were from giving out more than d^2."""
    return Table("both ports", ("",), [*_rows(_BOTH, [get(summary, "theorem")])])


def energy(summary: Mapping[str, Any]) -> Table:
    """The account of the shuffled energy; no rows if the coupling shuffles none."""
    rows = [*_rows(_ENERGY, _ways(summary, "energy"))] if has_reservoirs(get(summary, "coupling")) else []
    return Table("shuffled energy (up: from the device)", _WAYS, rows)


def links(summary: Mapping[str, Any]) -> Table:
    """What the emulated links did; the network's part is in `path`."""
    ways = _ways(summary, "links")
    rows = [*_rows(_LINKS, ways)]
    lost = [_share(way, "lost", "offered") for way in ways]
    if any(lost):
        rows.append(("lost [%]", *map(text, lost)))
    return Table("emulated links (up: from the device)", _WAYS, rows)


def path(summary: Mapping[str, Any]) -> Table:
    """What the streams showed of the way between the sides, the network and the emulated links together."""
    ways = _ways(summary, "path")
    rows = [*_rows(_PATH, ways)]
    lost = [_share(way, "lost", "sent") for way in ways]
    if any(lost):
        rows.insert(2, ("lost [%]", *map(text, lost)))
    for quantile in ("min", "p50", "p99"):
        trip = known(get(summary, "path", f"round_trip_{quantile}_ms"))
        if trip is not None:
            rows.append((f"round trip {quantile} [ms]", "", number(trip)))
    return Table("path, measured end to end (up: from the device)", _WAYS, rows)


def motion(summary: Mapping[str, Any]) -> Table:
    """How the proxy followed the hand."""
    return Table("motion", ("",), [*_rows(_MOTION, [get(summary, "motion")])])


def brief(summary: Mapping[str, Any]) -> list[str]:
    """What matters most, in a line each: how well the proxy followed the hand, how hard it pushed, over which path."""
    free, touched, force, depth, contacts = (
        known(get(summary, "motion", name))
        for name in ("free_rms_m", "contact_rms_m", "peak_force_N", "peak_penetration_m", "contacts")
    )
    errors = {"free": free, "in contact": touched}
    told = ", ".join(f"{milli(value)} mm {where}" for where, value in errors.items() if value is not None)
    pushed = [] if force is None else [f"{number(force)} N"]
    pushed += [f"{number(contacts)} contact{'s' * (contacts != 1)}"] if contacts else []
    pushed += [f"{milli(depth)} mm deep at most"] if contacts and depth is not None else []
    return [
        f"tracking error (rms): {told or 'not known'}",
        f"largest force: {', '.join(pushed) or 'not known'}",
        f"path: {_path_words(summary)}",
    ]


def brief_text(summary: Mapping[str, Any]) -> RenderableType:
    """The verdict, and `brief`: for people who have just run it."""
    from rich.console import Group
    from rich.text import Text

    return Group(_verdict_text(summary), *map(Text, brief(summary)))


def summary_text(summary: Mapping[str, Any]) -> RenderableType:
    """The summary object for people: its verdict and all tables; ``-`` where a value is unknown."""
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
            out.add_row(*map(Text, row))  # not markup, whatever it says
        return out

    tables = (both_ports(summary), sides(summary), energy(summary), path(summary), links(summary), motion(summary))
    return Group(
        _verdict_text(summary),
        Text(_about(summary)),
        *(drawn(table) for table in tables if table.rows),
    )


def _verdict_text(summary: Mapping[str, Any]) -> Text:
    from rich.text import Text

    styles = {"bad": "bold red", "unknown": "bold yellow", "good": "bold green"}
    return Text(verdict(summary), style=styles[outcome(summary)])


def _path_words(summary: Mapping[str, Any]) -> str:
    """The round trip, and what each direction lost; the emulated links included."""
    median, late = (known(get(summary, "path", f"round_trip_{quantile}_ms")) for quantile in ("p50", "p99"))
    said = [] if median is None else [f"round trip {number(median)} ms"]
    if said and late is not None:
        said[0] += f" (99 %: {number(late)})"
    for way in _WAYS:
        lost = _share(get(summary, "path", way), "lost", "sent")
        said += [] if lost is None else [f"{lost} % lost {way}"]
    return ", ".join(said) or "not known"


def _ways(summary: Mapping[str, Any], what: str) -> list[Any]:
    return [get(summary, what, way) for way in _WAYS]


def _rows(rows: tuple[_Row, ...], columns: list[Any]) -> Iterator[tuple[str, ...]]:
    for label, unit, path, convert in rows:
        values = [get(column, *path) for column in columns]
        if any(value is not None for value in values):
            yield (f"{label} [{unit}]" if unit else label, *map(convert, values))


def _share(way: Any, part: str, whole: str) -> str | None:
    some, all_of_it = known(get(way, part)), known(get(way, whole))
    return None if some is None or not all_of_it else f"{100 * some / all_of_it:.2f}"


def _about(summary: Mapping[str, Any]) -> str:
    duration = get(summary, "duration_s")
    values = {
        "coupling": get(summary, "coupling"),
        "tuned to": tuning(summary),
        "seed": get(summary, "seed"),
        "duration": None if duration is None else f"{number(duration)} s",
    }
    return ", ".join(f"{name} {value}" for name, value in values.items() if value is not None)
