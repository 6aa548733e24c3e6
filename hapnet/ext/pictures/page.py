"""A report as a single HTML file, for any browser and for print, which loads nothing from elsewhere.

Its only script is plotly.js, in the page itself, if the extra `zoom` is installed; without scripts it shows pictures.
"""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

from hapnet.couplings.registry import COUPLINGS, known
from hapnet.ext.pictures.html import Html, element, join, table
from hapnet.ext.pictures.pictures import PngPicture
from hapnet.ext.pictures.settings import Setting, commands, of_side, settings
from hapnet.ext.pictures.zoomed import library
from hapnet.recording import alignment
from hapnet.recording.samples import Recording
from hapnet.summary import tables
from hapnet.summary.structure import DIRECTIONS, Direction, Summary, read
from hapnet.summary.verdict import has_reservoirs
from hapnet.summary.words import felt, get, milli, millijoule, number, outcome, percent, tuning, verdict
from hapnet.units import within

FOLDED = 12
"""A longer list of events is folded."""

MOST_EVENTS = 500
"""The largest number of events in the page; the recording has all."""

_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'"
_ZOOM = """
for (const shown of document.querySelectorAll(".zoom")) {
  const {data, layout} = JSON.parse(shown.firstElementChild.textContent);
  layout.height = Math.max(400, Math.min(layout.height, innerHeight - shown.getBoundingClientRect().top - 40));
  Plotly.newPlot(shown, data, layout, {
    responsive: true, scrollZoom: true, displaylogo: false, modeBarButtonsToRemove: ["sendChartToCloud"],
  });
}
"""
_FIRST = 5
"""The number of values beside the picture."""

_HOW_TO_ZOOM = " Drag over a part to zoom into it, turn the wheel, or double-click to see all again."
_WHAT_IT_MEANS = {
    "good": "At no time did the hand and the world together take out more energy than the bound d² allows "
    "(Theorem 1). The line above has the most energy that came out; the summary has the margin at the end, and the "
    "smallest margin after the first second.",
    "bad": "More energy came out than the bound d² allows: Theorem 1 does not hold for this run.",
    "unknown": "The known data do not show whether Theorem 1 held throughout.",
}
_HALF = (
    "One side's recording contains only the energy that went in and out at its own port, its half of Theorem 1. "
    "Run hapnet report with the files of both sides for the whole theorem."
)
_MEASURED = {
    "good": "At no observed time had the hand and the world together taken out more energy than the bound d² allows.",
    "bad": "More energy came out of the two ports than was put in plus the bound d².",
    "unknown": "The known data do not allow a verdict.",
}
"""For couplings to which Theorem 1 does not apply."""
_NO_EVENTS = "A run in virtual time records no events; the summary counts its silences."


@dataclass(frozen=True)
class ReportSource:
    """A file from which a report is made.

    missing : what is missing in it, as a line; None: nothing. repaired : its repaired copy, if one was made.
    written : when the file was last written, in UTC.
    """

    path: Path
    role: str
    missing: str | None = None
    repaired: Path | None = None
    written: str = ""


def page(recording: Recording, drawn: Mapping[str, PngPicture], sources: Sequence[ReportSource]) -> str:
    """The report on `recording`, which must have a summary, with its pictures.

    All texts of a recording are escaped. Pass the recording through `legible` first.
    """
    summary = read(recording.summary)
    energy = tables.energy(summary)
    hand = _of_device(recording, "operator")
    title = f"Scene {get(recording.meta, 'scene') or 'unknown'}{f', hand {hand}' if hand else ''}"
    body = element(
        "main",
        _head(summary, title, sources),
        _first(summary, drawn.get("run")),
        _section("The run", _facts(recording, sources)),
        _section("The scene", _picture(drawn.get("scene"))),
        _section(
            "Summary",
            _table(tables.both_ports(summary)),
            _table(tables.sides(summary)),
            _table(tables.environment(summary)),
            _table(tables.motion(summary)),
        ),
        _folded("Path", _table(tables.path(summary))),
        _folded("Links", _table(tables.links(summary)), _picture(drawn.get("link"))),
        _folded("Energy account", _table(energy), element("p", _ENERGY) if energy.rows else Html()),
        _folded("Servo", _picture(drawn.get("servo"))),
        _section("Silences and events", _events(recording)),
        _section("Commands that repeat the run", _commands(recording, sources)),
        _folded("Settings", _settings(settings(recording))),
        _folded("Versions", _versions(recording)),
        _folded("Files", _files(sources)),
    )
    scripts = [library(), _ZOOM] if any(picture.zoomed for picture in drawn.values()) else []
    style = Html((files("hapnet.ext.pictures") / "style.css").read_text("utf-8"))
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_policy(scripts)),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"{title}: hapnet report"),
        element("style", style),
    )
    run = [element("script", Html(script)) for script in scripts]
    return f"<!doctype html>\n{element('html', head, element('body', body, *run), lang='en')}\n"


def _policy(scripts: Sequence[str]) -> str:
    """The page's security policy, by which only these scripts run, checked by their digests."""
    digests = [f"'sha256-{b64encode(sha256(script.encode()).digest()).decode('ascii')}'" for script in scripts]
    return f"{_POLICY}; script-src {' '.join(digests)}" if scripts else _POLICY


_ENERGY = (
    "Shuffled energy is counted in whole nanojoules: energy sent is exactly the sum of energy credited, in flight "
    "and abandoned. “Discarded” in the summary is the surplus that a side did not send."
)


def _head(summary: Summary, title: str, sources: Sequence[ReportSource]) -> Html:
    line, coupling = verdict(summary), str(summary["coupling"])
    found = outcome(summary)
    alone = found == "unknown" and None in (summary["device"], summary["world"])
    if has_reservoirs(coupling):
        meaning = _HALF if alone else _WHAT_IT_MEANS[found]
    else:
        judged, spec = "" if alone else f"{_MEASURED[found]} ", known(coupling)
        claim = "This coupling is the user's own and makes no claim."
        if spec is not None:
            claim = f"The claim of this coupling ({spec.title}; {spec.source}): {spec.claim}."
        meaning = judged + claim
    return element(
        "header",
        element("h1", title),
        element("p", line[0].upper() + line[1:], class_=f"verdict {found}"),
        element("details", element("summary", "What this verdict means"), element("p", meaning)),
        *(element("p", _missing(source), class_="note") for source in sources if source.missing),
    )


def _first(summary: Summary, picture: PngPicture | None) -> Html:
    """The picture of the run and the most important values, which fit on one screen together with the verdict."""
    items = [element("div", element("dt", name), element("dd", value)) for name, value in _values(summary)[:_FIRST]]
    values = element("dl", *items) if items else Html()
    if picture is None:
        return element("section", values, class_="first")
    reading = element("details", element("summary", "How to read the picture"), element("p", _caption(picture)))
    return element("section", element("figure", _shown(picture)), element("div", values, reading), class_="first")


def _values(summary: Summary) -> list[tuple[str, str]]:
    """The known values of a run, the most important one first."""
    moved, path, theorem, units = summary["motion"], summary["path"], summary["theorem"], summary["units"]
    lost = {way: part["loss"] for way in DIRECTIONS if (part := path[way]) is not None and part["loss"] is not None}
    found: list[tuple[str, object, str, str]] = [
        ("largest force on the hand", moved["peak_force_N"], number(moved["peak_force_N"]), within(units, "N")),
        ("ticks in which the motors held less", cut := tables.cut_share(summary["device"]) or None, percent(cut), "%"),
        ("wall", wall := felt(summary["environment"], springs=False, units=units), str(wall), ""),
        ("lowest margin", theorem["margin_J"], millijoule(theorem["margin_J"]), "mJ"),
        ("round trip", path["round_trip_p50_ms"], number(path["round_trip_p50_ms"]), "ms"),
        (f"lost {', '.join(lost)}", lost or None, ", ".join(map(percent, lost.values())), "%"),
        ("margin at the end", theorem["margin_end_J"], millijoule(theorem["margin_end_J"]), "mJ"),
        ("position error, free (rms)", moved["free_rms_m"], milli(moved["free_rms_m"]), within(units, "mm")),
        ("contacts", moved["contacts"], number(moved["contacts"]), ""),
        ("duration", summary["duration_s"], number(summary["duration_s"]), "s"),
    ]
    return [(name, f"{shown} {unit}".rstrip()) for name, value, shown, unit in found if value is not None]


def _missing(source: ReportSource) -> str:
    words = f"{source.missing}. The report covers the samples that can be read"
    return f"{words}; a repaired copy is {source.repaired.name}." if source.repaired else f"{words}."


def _facts(recording: Recording, sources: Sequence[ReportSource]) -> Html:
    summary, meta = read(recording.summary), recording.meta
    coupling = str(summary["coupling"])
    duration = summary["duration_s"]
    facts = {
        "scene": get(meta, "scene"),
        "hand": _of_device(recording, "operator"),
        "device": _of_device(recording, "hardware"),
        "coupling": f"{COUPLINGS[coupling].title} ({coupling})" if coupling in COUPLINGS else coupling,
        "tuned to": tuning(summary),
        **{f"{direction}link": _link(recording, direction) for direction in DIRECTIONS},
        "duration": None if duration is None else f"{number(duration)} s",
        "seed": summary["seed"],
        "clock": "virtual time" if get(meta, "clock") == "virtual" else "real time",
        "clocks": alignment.words(meta),
        "file written": ", ".join(dict.fromkeys(source.written for source in sources if source.written)),
    }
    known_ones = {name: str(value) for name, value in facts.items() if value not in (None, "")}
    items = [element("div", element("dt", name), element("dd", value)) for name, value in known_ones.items()]
    return element("dl", *items)


def _link(recording: Recording, direction: Direction) -> str | None:
    side = of_side(recording, "device" if direction == "up" else "world")
    profile = get(side, "links", direction)
    if profile is None:
        link = read(recording.summary)["links"][direction]
        profile = None if link is None else link["profile"]
    timeline = get(side, "params", "link", f"{direction}_timeline")
    return None if profile is None else f"{profile or 'nothing emulated'}{f'; {timeline}' if timeline else ''}"


def _events(recording: Recording) -> Html:
    if not (events := recording.events):
        virtual = get(recording.meta, "clock") == "virtual"
        return element("p", _NO_EVENTS if virtual else "No events were recorded.")
    origin_ns = int(recording.meta.get("origin_ns", 0))
    rows = [
        (f"{round((event.time_ns - origin_ns) / 1e9, 3) + 0.0:.3f}", event.kind, event.text)
        for event in events[:MOST_EVENTS]
    ]
    shown = table(("time [s]", "kind", "what"), rows, class_="events")
    if len(events) > len(rows):
        shown = join(shown, element("p", f"The other {len(events) - len(rows)} events are only in the recording."))
    if len(events) <= FOLDED:
        return shown
    counts = ", ".join(f"{count} {kind}" for kind, count in Counter(e.kind for e in events).most_common(FOLDED))
    return element("details", element("summary", f"{len(events)} events: {counts}"), shown)


def _settings(rows: list[Setting]) -> Html:
    if not rows:
        return element("p", "The recording does not contain the settings.")
    changed = sum(bool(row.default) for row in rows)
    words = f"{changed} of {len(rows)} differ from the defaults (marked)." if changed else "All have their defaults."
    cells = [
        (
            join(element("mark", one.name), " ") if one.default else one.name,
            one.value,
            one.default,
            one.source,
            one.meaning,
        )
        for one in rows
    ]
    names = ("parameter", "value", "default", "set by", "meaning")
    return join(element("p", words), table(names, cells, class_="settings"))


def _commands(recording: Recording, sources: Sequence[ReportSource]) -> Html:
    found = commands(recording, [s.repaired or s.path for s in sources if s.role != "no samples"])
    if not found:
        return element("p", "This version of hapnet cannot use the recording's settings.")
    return join(*(join(element("p", f"{c.purpose}:"), element("pre", element("code", c.line))) for c in found))


def _versions(recording: Recording) -> Html:
    by_side = {
        side: get(of_side(recording, side), "versions") or read(recording.summary)["versions"]
        for side in ("device", "world")
    }
    same = by_side["device"] == by_side["world"]
    columns = {"": by_side["device"]} if same else by_side
    names = dict.fromkeys(name for versions in columns.values() if isinstance(versions, Mapping) for name in versions)
    rows = [(name, *(str(get(versions, name) or "-") for versions in columns.values())) for name in names]
    return table(("" if same else "package", *columns), rows) if rows else element("p", "Unknown.")


def _files(sources: Sequence[ReportSource]) -> Html:
    rows = [
        (
            str(source.path),
            source.role,
            f"damaged or torn, repaired copy: {source.repaired or 'none'}" if source.missing else "whole",
            source.written or "-",
        )
        for source in sources
    ]
    return table(("file", "side", "state", "written"), rows, class_="files")


def _section(title: str, *parts: Html) -> Html:
    """A section of the page; empty if it has no content."""
    return element("section", element("h2", title), *parts) if any(parts) else Html()


def _folded(title: str, *parts: Html) -> Html:
    """A section whose content is folded; empty if it has no content."""
    if not any(parts):
        return Html()
    return element("section", element("details", element("summary", element("h2", title)), *parts))


def _table(content: tables.Table) -> Html:
    if not content.rows:
        return Html()
    head = ("", *content.columns) if any(content.columns) else ()
    return table(head, content.rows, caption=content.title, class_="numbers")


def _picture(picture: PngPicture | None) -> Html:
    if picture is None:
        return Html()
    return element("figure", _shown(picture), element("figcaption", _caption(picture)))


def _shown(picture: PngPicture) -> Html:
    source = f"data:image/png;base64,{b64encode(picture.png).decode('ascii')}"
    image = element("img", src=source, alt=picture.alternative)
    shown = element("div", image, class_="wide", tabindex="0")
    if not picture.zoomed:
        return shown
    content = element("script", Html(picture.zoomed), type="application/json")
    return join(element("div", content, class_="wide zoom"), element("noscript", shown))


def _caption(picture: PngPicture) -> str:
    return picture.caption + (_HOW_TO_ZOOM if picture.zoomed else "")


def _of_device(recording: Recording, name: str) -> Any:
    """A parameter that only the device's process uses; None without the device's recording."""
    return None if recording.device is None else get(of_side(recording, "device"), "params", name)
