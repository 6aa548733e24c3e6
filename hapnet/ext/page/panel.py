"""The page's buttons and switches, with which a user changes a pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.page.actions import Actions
from hapnet.ext.page.choices import CHOICES, LARGEST_FILE, MESHES, SCENES, label_of, needs, scene_label
from hapnet.ext.page.controls import Controls, Direction
from hapnet.ext.page.history import Snapshot, coupled
from hapnet.ext.page.link_form import LinkForm, put
from hapnet.recording.telemetry import Status

SMOOTHING_S = 0.02
"""Time constant of the smoothing filter that the page switches on [s]."""

HOW = """
Drag the blue ball into the wall. A press farther away turns the view; *reset view* turns it back.
"""

ABOUT = """
The blue ball is the handle of a haptic device: it is here, in your hand. The orange ball, the *proxy*, is its partner
in a virtual world elsewhere. The two sides send each other their positions over a network, and a spring on each side
pulls them together. The **arrow** is the force on your hand. When you push into the wall, the proxy stops at the
surface, and the spring pushes you back.

Over a slow network, such springs put energy into the hand, and it shakes. **PSPM** limits this energy on both sides:
it moves a spring's end (the small dark ball) only as far as the energy in its reservoir allows. The *margin* is the
energy that may still come out; it never falls below zero, whatever the link does. To see the spring without PSPM,
choose the coupling `zoh` and a bad link; to see PSPM alone, choose `paper`.

With `hapnet`, the device also keeps a **local contact model**: the planes near the proxy, which the world sends
(faint blue). So you feel the wall at once, and the handle moves freely, whatever the delay. A wrong model creates no
energy, because PSPM still limits it.
"""

SWITCH_HINT = (
    "The force goes to zero, then another pair starts at the handle's place, with new energy and its own verdict. "
    "Some couplings feel softer if they start inside a wall: press 'release to start' before you compare."
)

SCENE_HINT = "Another pair starts in this world, with the handle at its starting place."

FILE_HINT = "STL, OBJ or PLY, in millimetres; the handle begins at the file's origin" + needs("mesh")


class ControlPanel:
    """Coupling, scene and link, then buttons, in the container that is open when this object is created.

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
        self._actions = Actions()
        self._seen: dict[str, Any] = {}
        fixed = controls.fixed
        self._choice: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "coupling", tuple(CHOICES), disabled=bool(fixed), hint=fixed or SWITCH_HINT
        )
        self._scene: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "scene", tuple(SCENES), disabled=bool(fixed), hint=fixed or SCENE_HINT
        )
        if fixed:
            gui.add_html(f'<div class="hapnet-fixed" style="padding:0 12px;font-size:12px;opacity:.8">{fixed}</div>')
        else:
            self._offer_upload(gui)
        self._up = LinkForm(
            gui, "link, device to world" if fixed else "link, both directions", controls, self._actions,
            self._directions_of_first,
        )  # fmt: skip
        self._down = LinkForm(gui, "link, world to device", controls, self._actions, lambda: ("down",))
        self._down.folder.visible = False
        with self._up.folder:
            self._alike = gui.add_checkbox("both directions alike", not fixed, visible=not fixed)
        self._pause = gui.add_button("pause", icon=viser.Icon.PLAYER_PAUSE)
        home = gui.add_button("release to start", icon=viser.Icon.HOME, color="gray", hint="lead the hand to its start")
        with gui.add_folder("more"):
            reset = gui.add_button("reset", icon=viser.Icon.RELOAD, color="gray", visible=not fixed)
            self._record = gui.add_button("record", icon=viser.Icon.PLAYER_RECORD, color="red", visible=not fixed)
            self._smoothing = gui.add_checkbox(
                "smoothing filter", False, hint=f"{1e3 * SMOOTHING_S:.0f} ms, before PSPM", visible=not fixed
            )
        self._paused = self._recording = False

        self._on_click(self._pause, self._switch_pause)
        self._on_click(self._record, self._switch_recording)
        self._on_click(reset, controls.reset, anew=True)
        self._on_click(home, lambda: lead(None))
        self._on_change(self._choice, self._couple)
        self._on_change(self._scene, controls.scene)
        self._on_change(self._smoothing, lambda on: controls.smoothing(SMOOTHING_S if on else 0.0))

        @self._alike.on_update
        async def _(event: viser.GuiEvent[viser.GuiCheckboxHandle]) -> None:
            self._arrange()
            if event.client is not None and self._alike.value:
                self._up.send(event.client)

    def _offer_upload(self, gui: viser.GuiApi) -> None:
        file = gui.add_upload_button("load a mesh ...", color="gray", icon=viser.Icon.FILE_UPLOAD, hint=FILE_HINT)

        @file.on_upload
        async def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
            given = file.value
            self._do(lambda: self._take_file(given.name, given.content), True, event.client)

    def update(self, snapshot: Snapshot) -> None:
        """Show the settings that the sides report; an older report does not undo a change that a user has just made."""
        device, world = snapshot.device_status, snapshot.world_status
        if device is not None:
            if self._is_new("paused", (device.incarnation, device.paused)):
                self._paused = device.paused
                self._pause.label = "resume" if device.paused else "pause"
                self._pause.icon = viser.Icon.PLAYER_PLAY if device.paused else viser.Icon.PLAYER_PAUSE
            if self._is_new("recording", (device.incarnation, device.recording)):
                self._recording = bool(device.recording)
                self._record.label = "stop recording" if device.recording else "record"
                self._record.icon = viser.Icon.PLAYER_STOP if device.recording else viser.Icon.PLAYER_RECORD
            label = label_of(*coupled(device))
            self._show_choice("coupling", self._choice, device, label)
            self._show_scene(device if world is None else world)
            smoothing = float(device.about.get("params", {}).get("device", {}).get("smoothing_s", 0.0))
            if self._is_new("smoothing", (device.incarnation, smoothing)):
                put(self._smoothing, smoothing > 0.0)
        up, down = _words(device), _words(world)
        if up is not None and down is not None:
            if "links" not in self._seen and not self._controls.fixed:
                self._seen["links"] = up, down
                put(self._alike, up == down)
            self._up.follow(up)
            self._down.follow(down)

    def forget(self) -> None:
        """Show all reported settings again at the next `update`, as the last `update` failed in part."""
        self._seen.clear()
        self._up.forget()
        self._down.forget()

    def _show_scene(self, side: Status) -> None:
        params = side.about.get("params")
        words = params.get("scene") if isinstance(params, dict) else None
        label = scene_label(str(words or side.about.get("scene") or ""))
        self._show_choice("scene", self._scene, side, label)

    def _show_choice(self, name: str, offered: viser.GuiDropdownHandle[str], side: Status, label: str) -> None:
        if label and self._is_new(name, (side.incarnation, label)):
            if label not in offered.options:  # a user's own scene or coupling
                offered.options = (*offered.options, label)
            put(offered, label)

    def _take_file(self, name: str, content: bytes) -> None:
        if not name.lower().endswith(MESHES):
            raise InvalidParameter("file", name, f"a mesh: {', '.join(MESHES)}")
        if len(content) > LARGEST_FILE:
            raise InvalidParameter("file", name, f"at most {LARGEST_FILE >> 20} MB")
        self._controls.mesh(name, content)

    def _is_new(self, name: str, value: object) -> bool:
        known = self._seen.get(name, self)
        self._seen[name] = value
        return bool(known != value)

    def _directions_of_first(self) -> tuple[Direction, ...]:
        return ("up", "down") if self._alike.value else ("up",)

    def _arrange(self) -> None:
        self._up.folder.label = "link, both directions" if self._alike.value else "link, device to world"
        self._down.folder.visible = not self._alike.value

    def _switch_pause(self) -> None:
        wanted = not self._paused
        self._controls.pause(wanted)
        self._paused = wanted  # a second click may come before the next status

    def _switch_recording(self) -> None:
        wanted = not self._recording
        self._controls.record(wanted)
        self._recording = wanted

    def _couple(self, label: str) -> None:
        if label not in self._choice.options:
            raise InvalidParameter("coupling", label, ", ".join(CHOICES), CHOICES)
        self._controls.coupling(*CHOICES.get(label, (label, "auto")))

    def _on_click(self, button: viser.GuiButtonHandle, act: Callable[[], None], anew: bool = False) -> None:
        @button.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            self._do(act, anew, event.client)

    def _on_change(self, chosen: viser.GuiInputHandle[Any], act: Callable[[Any], None]) -> None:
        """Call `act` with the value that a user chooses; if that fails, show the previous value again."""
        before = chosen.value

        @chosen.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            nonlocal before
            value, kept = chosen.value, before
            before = value

            def undo() -> None:
                nonlocal before
                before = kept
                put(chosen, kept)

            if event.client is not None:
                self._do(lambda: act(value), True, event.client, failed=undo)

    def _do(
        self,
        act: Callable[[], None],
        anew: bool,
        client: viser.ClientHandle | None,
        failed: Callable[[], None] = lambda: None,
    ) -> None:
        """Begin an action; if it fails, the page shows the error, and `failed` is called."""

        def done(worked: bool) -> None:
            if not worked:
                self._starting(False)
                failed()

        if anew:
            self._starting(True)
        self._actions.begin(act, client, done=done)


def _words(status: Status | None) -> str | None:
    return None if status is None else str(status.link.get("profile", ""))
