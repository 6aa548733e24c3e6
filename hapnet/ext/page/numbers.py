"""The page's numbers: the verdict, five values and present faults in front, all other values in a folder."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable
from itertools import groupby
from pathlib import PurePath
from typing import Literal

import numpy as np
import viser

from hapnet.ext.page.choices import label_of, scene_label, words_of
from hapnet.ext.page.force import force_now, torque_now
from hapnet.ext.page.hands import in_words
from hapnet.ext.page.history import Episode, Snapshot, coupled, of_point, units
from hapnet.mechanics.pose import angle_between
from hapnet.recording.samples import Event
from hapnet.recording.telemetry import Status
from hapnet.summary.structure import Summary, VerdictSummary
from hapnet.summary.verdict import has_reservoirs
from hapnet.summary.words import felt
from hapnet.units import POSE, within

_VERDICTS = {True: ("passive", "#15803d"), False: ("NOT passive", "#dc2626"), None: ("not known", "#b45309")}
_GREY = "#64748b"
_SHORT = 20
"""A value of fewer characters is not wrapped."""

FRONT = ("round trip", "lost", "margin now", "lowest margin")
"""The values in front, beside the force on the hand."""

_CELL = "padding:0 8px 0 0;border:0;line-height:18px"


class Numbers:
    """The verdict and the measured values, in the container that is open when this object is created.

    Nothing is shown before the first `update`, and a value is shown only while it is known.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._html = gui.add_html("")
        self._folder = gui.add_folder("more numbers", expand_by_default=False, visible=False)
        with self._folder:
            self._more = gui.add_html("")
        self._turn = 0

    def update(self, snapshot: Snapshot, state: str, troubles: Iterable[str] = (), *, fresh: bool = True) -> None:
        """Show the snapshot; in the browser it turns grey if no other follows.

        state : of the pair, in a word or two. troubles : a line for each present fault. fresh : the snapshot is from
        the last second; otherwise all numbers are grey.
        """
        self._turn = 1 - self._turn
        shown = f"hapnet-drawn-{self._turn}" if fresh else "hapnet-old"  # see `STYLE` in page.py
        values, force = _values(snapshot), _force(snapshot)
        front = [*force[:1], *(values.pop(name) for name in FRONT if name in values)]
        self._html.content = _box(_front(snapshot, state, troubles, front), shown)
        more = [*values.values(), *force[1:]]
        self._more.content = _box(f'<table class="hapnet-more" style="width:100%">{_lines(more)}</table>', shown)
        self._folder.visible = bool(more)


def verdict(snapshot: Snapshot) -> VerdictSummary | None:
    """The verdict on the present pair so far; None: both sides have not reported their accounts yet."""
    return None if snapshot.summary is None else snapshot.summary["verdict"]


def _front(snapshot: Snapshot, state: str, troubles: Iterable[str], rows: Iterable[tuple[str, str]]) -> str:
    """The verdict, the state, faults, the coupling, the verdicts on earlier pairs, and the values in front."""
    found = ""
    if (kept := verdict(snapshot)) is not None:
        word, colour = _VERDICTS[kept["passive"]]
        found = f'<div style="font-size:20px;font-weight:700;color:{colour}" class="hapnet-passive">{word}</div>'
        found += "" if kept["passive"] else f'<div class="hapnet-why">{html.escape(kept["reason"])}</div>'
    side = snapshot.device_status or snapshot.world_status
    label = "" if side is None else label_of(*coupled(side))
    how = ": ".join(filter(None, (label, words_of(label))))
    return (
        f'{found}<div style="opacity:.8" class="hapnet-state">{html.escape(state)}</div>'
        f'{_hands(snapshot)}{"".join(map(_trouble, troubles))}<div class="hapnet-coupling">{html.escape(how)}</div>'
        f'{_past(snapshot.past)}<table class="hapnet-front" style="width:100%">{_lines(rows)}</table>'
    )


def _values(snapshot: Snapshot) -> dict[str, tuple[str, str]]:
    """The known values, each with its label, by name."""
    device, world, summary = snapshot.device_status, snapshot.world_status, snapshot.summary
    side = device or world
    about = {} if side is None else side.about
    found = {
        "round trip": _one("round trip", _round_trip(device, world), 1, "ms"),
        "lost": _two("lost", _lost(world, "up"), _lost(device, "down"), 1, "%"),
        "margin now": _one("margin now", _margin(summary, "margin_end_J"), 1, "mJ"),
        "lowest margin": _one("lowest margin", _margin(summary, "margin_J"), 1, "mJ"),
        "later": _one("lowest margin after 1 s", _margin(summary, "margin_later_J"), 1, "mJ"),
        "delay": _two("link delay", _link(device, "delay_now_ms", 1.0), _link(world, "delay_now_ms", 1.0), 0, "ms"),
        "loss": _two("link loss", _link(device, "loss_now", 100.0), _link(world, "loss_now", 100.0), 1, "%"),
        "without force": _one("time without force", _without_force(summary) or None, 1, "s"),
        "angle": _angle(snapshot),
        "wall": ("wall", felt(about.get("felt"), springs=False, units=units(snapshot)) or ""),
        "recording": ("recording", PurePath(device.recording).name if device is not None else ""),
        "device": ("device", str(about.get("name") or "")),
        "scene": ("scene", scene_label(str(about.get("scene") or ""))),
    }
    return {name: row for name, row in found.items() if row is not None and row[1]}


def _force(snapshot: Snapshot) -> list[tuple[str, str]]:
    """The force on the hand, its parts, and the torque of a tool; empty: there is no sample yet."""
    if snapshot.device is None:
        return []
    force = force_now(of_point(snapshot).device, within(units(snapshot), "N"))
    return [*force, ("torque on the hand", torque_now(snapshot.device))] if units(snapshot) == POSE else force


def _angle(snapshot: Snapshot) -> tuple[str, str] | None:
    """The angle between a handle that turns and its proxy."""
    device, world = snapshot.device, snapshot.world
    if device is None or world is None or units(snapshot) != POSE:
        return None
    return "angle between", f"{math.degrees(angle_between(device.position_m[-1], world.position_m[-1])):.1f}°"


def _box(content: str, shown: str) -> str:
    return (
        f'<div style="padding:2px 12px 4px;font-size:13px;font-variant-numeric:tabular-nums" class="{shown}">'
        f"{content}</div>"
    )


def _hands(snapshot: Snapshot) -> str:
    """The hands of the world, a line each; empty: it has one."""
    return "".join(
        f'<div class="hapnet-hand"><span style="color:rgb{color}">&#9679;</span> {html.escape(words)}</div>'
        for words, color in in_words(snapshot)
    )


def _trouble(line: str) -> str:
    return f'<div style="color:#b45309;line-height:16px" class="hapnet-trouble">{html.escape(line)}</div>'


def _lines(rows: Iterable[tuple[str, str]]) -> str:
    return "".join(
        f'<tr><td style="{_CELL};opacity:.65;white-space:nowrap">{html.escape(name)}</td>'
        f'<td style="{_CELL};font-weight:600;white-space:{"nowrap" if len(value) < _SHORT else "normal"}">'
        f"{html.escape(value)}</td></tr>"
        for name, value in rows
    )


def _past(episodes: Iterable[Episode]) -> str:
    """The pairs before this one, each with its own verdict."""
    parts = []
    for (label, passive), alike in groupby(episodes, _outcome):
        word, colour = _VERDICTS[passive]
        count = len(list(alike))
        times = f" ({count} times)" if count > 1 else ""
        parts.append(f'{html.escape(label)} <span style="color:{colour}">{word}</span>{times}')
    return f'<div style="opacity:.8" class="hapnet-past">before: {" · ".join(parts)}</div>' if parts else ""


def _outcome(episode: Episode) -> tuple[str, bool | None]:
    return label_of(episode.coupling, episode.rendering), episode.verdict["passive"]


def _link(status: Status | None, key: str, factor: float) -> float | None:
    value = None if status is None else status.link.get(key)
    return None if value is None else factor * float(value)


def _round_trip(*sides: Status | None) -> float | None:
    """The measured round trip, over the network and the emulated links together [ms]."""
    known = (side.path.get("round_trip_p50_ms") for side in sides if side is not None)
    return next((value for value in known if value is not None), None)


def _lost(status: Status | None, direction: str) -> float | None:
    """The share of the other side's messages that did not arrive [%]."""
    heard = None if status is None else status.path.get(direction)
    return None if heard is None else 100.0 * float(heard["loss"])


def _without_force(summary: Summary | None) -> float | None:
    """The total time in which the device's servo rendered no force [s]."""
    part = None if summary is None else summary["device"]
    return None if part is None else part["servo"]["without_force_s"]


def _margin(summary: Summary | None, name: Literal["margin_J", "margin_end_J", "margin_later_J"]) -> float | None:
    """The margin of both ports [mJ]."""
    value = None if summary is None else summary["theorem"][name]
    return None if value is None else 1e3 * value


def _one(label: str, value: float | None, digits: int, unit: str) -> tuple[str, str] | None:
    return None if value is None else (label, f"{value:.{digits}f} {unit}")


def _two(label: str, up: float | None, down: float | None, digits: int, unit: str) -> tuple[str, str] | None:
    """A value of each direction; of one direction if only that one is known."""
    known = {name: value for name, value in (("up", up), ("down", down)) if value is not None}
    values = ", ".join(f"{value:.{digits}f}" for value in known.values())
    return (f"{label} {', '.join(known)}", f"{values} {unit}") if known else None


SHOWN_S = 5.0
"""How long a stall of the servo is shown [s]."""

EMPTY_J = 1e-6
EMPTY_S = 0.3
"""A reservoir counts as empty after `EMPTY_S` [s] with at most `EMPTY_J` [J]: a moment without energy is normal."""

_EMPTY = {
    "device": "the device's reservoir is empty: the handle's spring cannot follow the world",
    "world": "the world's reservoir is empty: the proxy cannot follow the hand",
}


class Troubles:
    """Finds the faults to show beside the verdict. Times `now_s` are those of the page."""

    def __init__(self) -> None:
        self._last: Event | None = None
        self._seen_s = -SHOWN_S

    def now(self, snapshot: Snapshot, now_s: float) -> list[str]:
        """A sentence for each present fault."""
        stall = next((event for event in reversed(snapshot.events) if event.kind == "overrun"), None)
        if stall is not None and stall != self._last:
            self._last, self._seen_s = stall, now_s
        found = []
        if self._last is not None and now_s - self._seen_s < SHOWN_S:
            found.append(self._last.text)
        coupling, _ = coupled(snapshot.device_status or snapshot.world_status)
        if has_reservoirs(coupling):
            for role, track in (("device", snapshot.device), ("world", snapshot.world)):
                if track is None or track.time_s[-1] - track.time_s[0] < EMPTY_S:
                    continue
                newest = track.reservoir_J[track.time_s >= track.time_s[-1] - EMPTY_S]
                if float(np.max(newest)) <= EMPTY_J:
                    found.append(_EMPTY[role])
        return found
