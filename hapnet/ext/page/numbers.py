"""The page's numbers: the verdict, measured values, the parts of the force, and present faults."""

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

_CELL = "padding:0 8px 0 0;border:0;line-height:18px"


class Numbers:
    """The measured numbers, in a few lines, in the container that is open when this object is created."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._html = gui.add_html(_table(Snapshot(None, None, None, None, False, (), 0), "waiting", (), False))
        self._turn = 0

    def update(self, snapshot: Snapshot, state: str, troubles: Iterable[str] = (), *, fresh: bool = True) -> None:
        """Show the snapshot; in the browser it turns grey if no other follows.

        state : of the pair, in a word or two. troubles : a line for each present fault. fresh : the snapshot is from
        the last second; otherwise all numbers are grey.
        """
        self._turn = 1 - self._turn
        self._html.content = _table(snapshot, state, troubles, fresh, self._turn)


def verdict(snapshot: Snapshot) -> VerdictSummary | None:
    """The verdict on the present pair so far; None: both sides have not reported their accounts yet."""
    return None if snapshot.summary is None else snapshot.summary["verdict"]


def _table(snapshot: Snapshot, state: str, troubles: Iterable[str], fresh: bool, turn: int = 0) -> str:
    device, world = snapshot.device_status, snapshot.world_status
    word, colour, why = "...", _GREY, ""
    if (kept := verdict(snapshot)) is not None:
        word, colour = _VERDICTS[kept["passive"]]
        why = "" if kept["passive"] else f'<div class="hapnet-why">{html.escape(kept["reason"])}</div>'
    summary = snapshot.summary
    recording = device.recording if device is not None else ""
    rows = [
        ("delay up, down", f"{_link(device, 'delay_now_ms', 1.0, 0)}, {_link(world, 'delay_now_ms', 1.0, 0)} ms"),
        ("loss up, down", f"{_link(device, 'loss_now', 100.0, 1)}, {_link(world, 'loss_now', 100.0, 1)} %"),
        ("path: round trip", f"{_number(_round_trip(device, world), 1)} ms"),
        ("path: lost up, down", f"{_number(_lost(world, 'up'), 1)}, {_number(_lost(device, 'down'), 1)} %"),
        ("margin now", f"{_number(_margin(summary, 'margin_end_J'), 1)} mJ"),
        ("lowest margin", f"{_number(_margin(summary, 'margin_J'), 1)} mJ"),
        ("lowest after 1 s", f"{_number(_margin(summary, 'margin_later_J'), 1)} mJ"),
    ]
    if without_s := _without_force(summary):
        rows.append(("without force so far", f"{without_s:.1f} s"))
    force = force_now(of_point(snapshot).device, within(units(snapshot), "N"))
    if units(snapshot) == POSE and snapshot.device is not None:
        force.append(("torque on the hand", torque_now(snapshot.device)))
        if snapshot.world is not None:
            angle = angle_between(snapshot.device.position_m[-1], snapshot.world.position_m[-1])
            rows.append(("angle between", f"{math.degrees(angle):.1f}°"))
    if recording:
        rows.append(("recording", PurePath(recording).name))
    about = device.about if device is not None else world.about if world is not None else {}
    if walls := felt(about.get("felt"), springs=False, units=units(snapshot)):
        rows.append(("wall", walls))
    what = " · ".join(scene_label(str(about[key])) for key in ("name", "scene") if about.get(key))
    label = label_of(*coupled(device or world))
    how = ": ".join(filter(None, (label, words_of(label))))
    shown = f"hapnet-drawn-{turn}" if fresh else "hapnet-old"  # see `STYLE` in page.py
    return (
        f'<div style="padding:2px 12px 4px;font-size:13px;font-variant-numeric:tabular-nums" class="{shown}">'
        f'<div style="font-size:20px;font-weight:700;color:{colour}" class="hapnet-passive">{word}</div>{why}'
        f'<div style="opacity:.8" class="hapnet-state">{html.escape(state)}</div>'
        f"{''.join(map(_trouble, troubles))}"
        f'<div style="opacity:.65">{html.escape(what)}</div><div class="hapnet-coupling">{html.escape(how)}</div>'
        f'{_past(snapshot.past)}<table style="width:100%">{_lines(rows)}</table>'
        f'<table class="hapnet-force" style="width:100%">{_lines(force)}</table></div>'
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


def _link(status: Status | None, key: str, factor: float, digits: int) -> str:
    value = None if status is None else status.link.get(key)
    return _number(None if value is None else factor * float(value), digits)


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


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


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
