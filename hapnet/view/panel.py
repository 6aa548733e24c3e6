"""The page's numbers and buttons: what was measured, and what a user may change."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable, Iterable
from pathlib import PurePath
from typing import Any

import viser

from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.recording.telemetry import Status
from hapnet.report.words import felt
from hapnet.summary.structure import Verdict
from hapnet.summary.verdict import judge
from hapnet.view.choices import CHOICES, label_of, words_of
from hapnet.view.controls import Controls, Direction
from hapnet.view.force import force_now
from hapnet.view.history import Episode, Snapshot, coupled
from hapnet.view.link_form import LinkForm, put, show_notification
from netem import NetemError

SMOOTHING_S = 0.02
"""Time constant of the smoothing filter that the page switches on [s]."""

ABOUT = """
A hand (blue) moves a haptic device here; a virtual mass, the *proxy* (orange), moves in a virtual world elsewhere. They
send each other their positions over a network, and a spring on each side pulls them together. The **arrow** is the
force that the hand feels. The proxy stops at the wall; the handle goes on, and is pushed back.

Late positions make such springs put energy into the hand: it shakes. **PSPM** watches the energy on both sides and
moves a spring's end (the small dark ball) only as far as its reservoir can pay. So the *margin*, what is left of the
energy that passivity allows, never falls below zero, whatever the link does. Choose the coupling `zoh` on a bad link to
see the spring alone, and `paper` to see PSPM alone.

With `hapnet`, the world also tells the device the planes that are near the proxy: its **local contact model** (faint
blue). So the handle feels the wall at once, and moves freely, whatever the delay; and since PSPM pays for it, a model
that is wrong creates no energy.
"""

_VERDICTS = {True: ("passive", "#15803d"), False: ("NOT passive", "#dc2626"), None: ("not known", "#b45309")}
_CELL = "padding:0 8px 0 0;border:0;line-height:18px"


class Numbers:
    """The measured numbers, in a few lines, in the container that is open when this is made."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._html = gui.add_html(_table(Snapshot(None, None, None, None, False, None, None, (), 0), "waiting", ()))

    def update(self, snapshot: Snapshot, state: str, troubles: Iterable[str] = ()) -> None:
        """Show the snapshot. `state` : in a word or two, what the pair does. `troubles` : what is wrong with it now."""
        content = _table(snapshot, state, troubles)
        if content != self._html.content:
            self._html.content = content


SWITCH_HINT = (
    "The force goes to zero, then another pair starts where the handle is, with fresh energy and a verdict of its own. "
    "In a wall, some couplings then stay softer: lead the hand home first to compare."
)


class ControlPanel:
    """Buttons, switches and links, in the container that is open when this is made.

    Parameters
    ----------
    lead : leads the hand, as a drag does.
    starting : called with True when a new episode is about to start, and with False if it does not start.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        controls: Controls,
        lead: Callable[[Vector | None], None],
        starting: Callable[[bool], None],
    ) -> None:
        self._controls = controls
        self._starting = starting
        self._busy = threading.Lock()
        self._seen: dict[str, Any] = {}
        self._pause = gui.add_button("pause", icon=viser.Icon.PLAYER_PAUSE)
        self._record = gui.add_button("record", icon=viser.Icon.PLAYER_RECORD, color="red")
        reset = gui.add_button("reset", icon=viser.Icon.RELOAD, color="gray")
        home = gui.add_button("hand home", icon=viser.Icon.HOME, color="gray", hint="lead the hand back to the middle")
        self._choice: viser.GuiDropdownHandle[str] = gui.add_dropdown("coupling", tuple(CHOICES), hint=SWITCH_HINT)
        self._smoothing = gui.add_checkbox("smoothing filter", False, hint=f"{1e3 * SMOOTHING_S:.0f} ms, before PSPM")
        self._alike = gui.add_checkbox("alike both ways", True)
        self._up = LinkForm(gui, "link, both ways", controls, self._directions_of_first)
        self._down = LinkForm(gui, "link, world to device", controls, lambda: ("down",))
        self._down.folder.visible = False
        self._paused = self._recording = False

        self._on_click(self._pause, self._switch_pause)
        self._on_click(self._record, self._switch_recording)
        self._on_click(reset, controls.reset, anew=True)
        self._on_click(home, lambda: lead(None))
        self._on_change(self._choice, self._couple)
        self._on_change(self._smoothing, lambda on: controls.smoothing(SMOOTHING_S if on else 0.0))

        @self._alike.on_update
        def _(event: viser.GuiEvent[viser.GuiCheckboxHandle]) -> None:
            self._arrange()
            if event.client is not None and self._alike.value:
                self._up.send(event.client)

    def update(self, snapshot: Snapshot) -> None:
        """Show what the sides report; an older report does not undo what a user has just changed."""
        device, world = snapshot.device_status, snapshot.world_status
        if device is not None:
            if self._is_new("paused", (device.incarnation, device.paused)):
                self._paused = device.paused
                self._pause.label = "go on" if device.paused else "pause"
                self._pause.icon = viser.Icon.PLAYER_PLAY if device.paused else viser.Icon.PLAYER_PAUSE
            if self._is_new("recording", (device.incarnation, device.recording)):
                self._recording = bool(device.recording)
                self._record.label = "stop recording" if device.recording else "record"
                self._record.icon = viser.Icon.PLAYER_STOP if device.recording else viser.Icon.PLAYER_RECORD
            label = label_of(*coupled(device))
            if label and self._is_new("coupling", (device.incarnation, label)):
                if label not in self._choice.options:  # a user's own
                    self._choice.options = (*self._choice.options, label)
                put(self._choice, label)
            smoothing = float(device.about.get("params", {}).get("device", {}).get("smoothing_s", 0.0))
            if self._is_new("smoothing", (device.incarnation, smoothing)):
                put(self._smoothing, smoothing > 0.0)
        up, down = _words(device), _words(world)
        if up is not None and down is not None:
            if "links" not in self._seen:
                self._seen["links"] = up, down
                put(self._alike, up == down)
            self._up.follow(up)
            self._down.follow(down)

    def _is_new(self, name: str, value: object) -> bool:
        known = self._seen.get(name, self)
        self._seen[name] = value
        return bool(known != value)

    def _directions_of_first(self) -> tuple[Direction, ...]:
        return ("up", "down") if self._alike.value else ("up",)

    def _arrange(self) -> None:
        self._up.folder.label = "link, both ways" if self._alike.value else "link, device to world"
        self._down.folder.visible = not self._alike.value

    def _switch_pause(self) -> None:
        self._controls.pause(not self._paused)
        self._paused = not self._paused  # a second click may come before the next status

    def _switch_recording(self) -> None:
        self._controls.record(not self._recording)
        self._recording = not self._recording

    def _couple(self, label: str) -> None:
        self._controls.coupling(*CHOICES.get(label, (label, "auto")))

    def _on_click(self, button: viser.GuiButtonHandle, act: Callable[[], None], anew: bool = False) -> None:
        @button.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._do(act, anew, event.client)

    def _on_change(self, chosen: viser.GuiInputHandle[Any], act: Callable[[Any], None]) -> None:
        """Call `act` with the value that a user chooses; if that fails, the one before stands again."""
        before = chosen.value

        @chosen.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            nonlocal before
            if event.client is not None and not self._do(lambda: act(chosen.value), True, event.client):
                put(chosen, before)
            before = chosen.value

    def _do(self, act: Callable[[], None], anew: bool, client: viser.ClientHandle | None) -> bool:
        """Run one action at a time; False: it failed, and the page says so."""
        with self._busy:
            try:
                if anew:
                    self._starting(True)
                act()
            except (HapnetError, NetemError) as error:
                self._starting(False)
                show_notification(client, "This did not work", str(error))
                return False
            return True


def verdict(snapshot: Snapshot) -> Verdict | None:
    """The verdict on this episode so far; None: no samples of both sides yet."""
    return None if snapshot.account is None else judge(snapshot.account)


def _words(status: Status | None) -> str | None:
    return None if status is None else str(status.link.get("profile", ""))


def _table(snapshot: Snapshot, state: str, troubles: Iterable[str]) -> str:
    device, world = snapshot.device_status, snapshot.world_status
    word, colour, why = "...", "#64748b", ""
    if (kept := verdict(snapshot)) is not None:
        word, colour = _VERDICTS[kept["passive"]]
        why = "" if kept["passive"] else f'<div class="hapnet-why">{html.escape(kept["reason"])}</div>'
    recording = device.recording if device is not None else ""
    rows = [
        ("delay up, down", f"{_link(device, 'delay_now_ms', 1.0, 0)}, {_link(world, 'delay_now_ms', 1.0, 0)} ms"),
        ("loss up, down", f"{_link(device, 'loss_now', 100.0, 1)}, {_link(world, 'loss_now', 100.0, 1)} %"),
        ("path: round trip", f"{_number(_round_trip(device, world), 1)} ms"),
        ("path: lost up, down", f"{_number(_lost(world, 'up'), 1)}, {_number(_lost(device, 'down'), 1)} %"),
        ("margin now", f"{_number(_milli(snapshot.margin_J), 1)} mJ"),
        ("least so far", f"{_number(_milli(snapshot.min_margin_J), 1)} mJ"),
        ("least after 1 s", f"{_number(_milli(snapshot.later_margin_J), 1)} mJ"),
    ]
    if recording:
        rows.append(("recording", PurePath(recording).name))
    about = device.about if device is not None else world.about if world is not None else {}
    if walls := felt(about.get("felt"), springs=False):
        rows.append(("wall", walls))
    what = " · ".join(str(about[key]) for key in ("name", "scene") if about.get(key))
    label = label_of(*coupled(device or world))
    how = ": ".join(filter(None, (label, words_of(label))))
    return (
        '<div style="padding:2px 12px 4px;font-size:13px;font-variant-numeric:tabular-nums">'
        f'<div style="font-size:20px;font-weight:700;color:{colour}" class="hapnet-passive">{word}</div>{why}'
        f'<div style="opacity:.8" class="hapnet-state">{html.escape(state)}</div>'
        f"{''.join(map(_trouble, troubles))}"
        f'<div style="opacity:.65">{html.escape(what)}</div><div class="hapnet-coupling">{html.escape(how)}</div>'
        f"{_past(snapshot.past)}<table>{_lines(rows)}</table>"
        f'<table class="hapnet-force">{_lines(force_now(snapshot.device))}</table></div>'
    )


def _trouble(line: str) -> str:
    return f'<div style="color:#b45309;line-height:16px" class="hapnet-trouble">{html.escape(line)}</div>'


def _lines(rows: Iterable[tuple[str, str]]) -> str:
    return "".join(
        f'<tr><td style="{_CELL};opacity:.65">{html.escape(name)}</td>'
        f'<td style="{_CELL};font-weight:600;white-space:nowrap">{html.escape(value)}</td></tr>'
        for name, value in rows
    )


def _past(episodes: Iterable[Episode]) -> str:
    """The pairs before this one, each with its own verdict."""
    said = []
    for episode in episodes:
        word, colour = _VERDICTS[judge(episode.account)["passive"]]
        label = html.escape(label_of(episode.coupling, episode.rendering))
        said.append(f'{label} <span style="color:{colour}">{word}</span>')
    return f'<div style="opacity:.8" class="hapnet-past">before: {" · ".join(said)}</div>' if said else ""


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


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
