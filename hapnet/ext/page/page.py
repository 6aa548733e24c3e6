"""The page: scene, plots, numbers and controls on one viser server, drawn from a `History`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import viser

from hapnet.checks import Vector
from hapnet.ext.arms.picture import ArmPicture
from hapnet.ext.page.controls import Controls
from hapnet.ext.page.history import History, Snapshot, units
from hapnet.ext.page.numbers import Numbers, Troubles
from hapnet.ext.page.panel import ABOUT, HOW, ControlPanel
from hapnet.ext.page.playback import Playback, PlayerPanel
from hapnet.ext.page.plots import Plots
from hapnet.ext.page.scene import PageScene
from hapnet.ext.solids.rigid import parts_of_words
from hapnet.loading import failure
from hapnet.plant.worlds.picture import Part
from hapnet.recording.telemetry import Status
from hapnet.units import POSE

SILENT_S = 0.7
"""The page reports a silence after this time without a sample [s]."""

OLD_S = 1.0
"""The numbers turn grey if no sample has arrived for longer than this time [s]."""

PLOTTED_S = 10.0

_WIDTHS, _NARROW = (290, 370), (250, 240)  # of the two panels [pixels]
_NARROW_BELOW = 1100  # in a narrower window the panels are narrow, to leave space for the scene [pixels]


@dataclass(slots=True)
class _Last:
    """The newest data of a pair that the page has shown, and when they arrived [s].

    taken : the number of samples that are drawn; -1: draw the last sample again. heard : the number that have arrived.
    heard_s, status_s : when the last sample and the last change of a status arrived. statuses : of both sides.
    """

    taken: int = 0
    heard: int = 0
    heard_s: float = -1e9
    statuses: tuple[Status | None, Status | None] = (None, None)
    status_s: float = -1e9


class Page:
    """The page's content. Times `now_s` are from one monotonic clock.

    controls : receives the user's changes. None: the page only watches; it has no buttons, and no handle to drag.
    player : plays a recording; None: the page shows a running pair.
    """

    def __init__(
        self, server: viser.ViserServer, history: History, controls: Controls | None, player: Playback | None = None
    ) -> None:
        self._server = server
        self._history = history
        self._controls = controls
        self._scene: PageScene | None = None
        self._drawn: tuple[int, Any, str, object, object] | None = None  # axes, walls, label, words, arm of the scene
        self._parts: tuple[Part, ...] | None = None
        self._last = _Last()
        self._troubles = Troubles()
        self._steps = PagePainter()
        self._starting_from: tuple[int | None, int | None] | None = None
        self._origin: Vector = ()
        gui = server.gui
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.set_panel_label("hapnet")
        gui.add_html(STYLE)
        with gui.add_folder("what am I looking at?", expand_by_default=False):
            gui.add_markdown(ABOUT if controls is None else HOW + ABOUT)
        self._numbers = Numbers(gui)
        self._player = None if player is None else PlayerPanel(gui, player)
        self._settings = gui.add_folder(None, visible=False)  # until the pair reports them
        with self._settings:
            self._panel = None if controls is None else ControlPanel(gui, controls, self._lead, self._start_anew)
        front = gui.add_button("reset view", icon=viser.Icon.EYE, color="gray", hint="look from the front again")
        gui.main_panel.dock_left()
        gui.main_panel.set_width(_WIDTHS[0])
        self._plots_panel = panel = gui.add_panel()
        with panel.add_tab("last 10 s", viser.Icon.CHART_LINE):
            self._plots = Plots(gui, PLOTTED_S)
        panel.dock_right()
        panel.set_width(_WIDTHS[1])
        server.on_client_connect(self._fit)
        self._clients: set[int] = set()

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            if not self._clients and controls is not None:
                controls.let_go("")
            self._clients.add(client.client_id)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self._clients.discard(client.client_id)
            if not self._clients and controls is not None:
                controls.let_go("the page is closed")

        @front.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None and self._scene is not None:
                self._scene.cameras.look(event.client.camera)

    async def _fit(self, client: viser.ClientHandle) -> None:
        """Fit the panels to this client's window. In a narrow window the plots are folded, and a click opens them."""
        self._plots.fit(client.camera.image_height)
        narrow = client.camera.image_width < _NARROW_BELOW
        main, plots = _NARROW if narrow else _WIDTHS
        client.gui.main_panel.set_width(main)
        self._plots_panel.set_width(plots)
        if narrow:
            self._plots_panel.minimize()
        else:
            self._plots_panel.expand()

    def draw(self, now_s: float, *, rest: bool) -> None:
        """Draw the 3-D part and, if `rest`, the other parts, and send them; to be called some 60 times a second."""

        def drawn() -> None:
            self.draw_scene(now_s)
            if rest:
                self.draw_rest(now_s)
            self._server.flush()  # otherwise viser collects for as long as a frame lasts before it sends

        self._steps.run("page", drawn, now_s)

    def draw_scene(self, now_s: float) -> None:
        """Draw the 3-D part; to be called some 60 times a second."""
        self._steps.run("scene", partial(self._draw_scene, now_s), now_s, again=self._drop_scene)

    def draw_rest(self, now_s: float) -> None:
        """Draw plots, numbers and controls; to be called some 4 times a second."""
        snapshot, steps = self._history.snapshot(), self._steps
        with self._server.atomic():
            steps.run("plots", lambda: self._draw_plots(snapshot), now_s)
            if (panel := self._panel) is not None:
                steps.run("controls", lambda: self._draw_controls(panel, snapshot), now_s, again=panel.forget)
            if (player := self._player) is not None:
                steps.run("player", player.update, now_s)
            if (scene := self._scene) is not None:
                steps.run("handle", scene.fit, now_s, again=self._drop_scene)
            steps.run("numbers", lambda: self._draw_numbers(snapshot, now_s), now_s)

    def _draw_controls(self, panel: ControlPanel, snapshot: Snapshot) -> None:
        panel.update(snapshot)
        if snapshot.device_status is not None:
            self._settings.visible = True

    def _draw_numbers(self, snapshot: Snapshot, now_s: float) -> None:
        troubles = [*self._steps.failures(), *self._troubles.now(snapshot, now_s)]
        if (statuses := (snapshot.device_status, snapshot.world_status)) != self._last.statuses:
            self._last.statuses, self._last.status_s = statuses, now_s
        paused = any(status.paused for status in statuses if status is not None)
        fresh = now_s - (self._last.status_s if paused else self._last.heard_s) <= OLD_S
        self._numbers.update(snapshot, self._state(snapshot, now_s), troubles, fresh=fresh)

    def _draw_plots(self, snapshot: Snapshot) -> None:
        self._plots.update(snapshot, [] if _moves(snapshot) else self._surfaces(snapshot))

    def _drop_scene(self) -> None:
        """Create the scene again at the next drawing, as it may have been drawn in part."""
        self._drawn, self._last.taken = None, -1

    def _draw_scene(self, now_s: float) -> None:
        snapshot = self._history.snapshot()
        last = self._last
        if snapshot.taken == last.taken:
            return
        last.taken = snapshot.taken
        if snapshot.taken != last.heard:  # otherwise the same sample is drawn again
            last.heard, last.heard_s = snapshot.taken, now_s
        if (track := snapshot.device or snapshot.world) is None:
            return
        words = None if snapshot.parts or _drawing_comes(snapshot) else _scene_name(snapshot)
        wall_name = "wall at the start" if _moves(snapshot) else "wall"  # a moving wall is drawn at its start
        described = {} if snapshot.device_status is None else snapshot.device_status.about
        wanted = track.position_m.shape[1], self._surfaces(snapshot), wall_name, words, described.get("arm")
        if self._scene is None or self._drawn != wanted or self._parts is not snapshot.parts:
            lead = None if self._controls is None else self._lead
            dof, surfaces, *_ = wanted
            parts, turns = snapshot.parts or parts_of_words(words), units(snapshot) == POSE
            dof, arm = 3 if turns else dof, ArmPicture.of(described)
            hints = self._scene is None or self._scene.hints
            self._scene = PageScene(self._server, dof, surfaces, lead, wall_name, parts, arm, turns=turns, hints=hints)
            self._drawn, self._parts = wanted, snapshot.parts
            self._origin = (0.0,) * dof
        self._scene.update(snapshot)

    def _state(self, snapshot: Snapshot, now_s: float) -> str:
        silent = now_s - self._last.heard_s > SILENT_S
        if self._starting_from is not None:
            began = all(a != b for a, b in zip(self._starting_from, _incarnations(snapshot), strict=True))
            if not began or silent:
                return "starting ..."
            self._starting_from = None
        statuses = [s for s in (snapshot.device_status, snapshot.world_status) if s is not None]
        if any(status.paused for status in statuses):
            return "paused"
        if silent:
            return "no telemetry" if snapshot.taken else "connecting ..."
        if not all(status.paired for status in statuses):
            return "not paired"
        return "recording" if any(status.recording for status in statuses) else "running"

    def _start_anew(self, begins: bool) -> None:
        self._starting_from = _incarnations(self._history.snapshot()) if begins else None

    def _lead(self, position: Vector | None) -> None:
        """Lead the hand to `position`; None: to the start."""
        target = self._origin if position is None else (*position, *self._origin[len(position) :])  # a jaw stays open
        if self._controls is not None and self._scene is not None and target:
            self._controls.lead(target)
            self._scene.show_target(target)

    def _surfaces(self, snapshot: Snapshot) -> Any:
        status: Status | None = snapshot.world_status or snapshot.device_status
        return [] if status is None else status.about.get("surfaces", [])


def _scene_name(snapshot: Snapshot) -> object:
    status = snapshot.world_status or snapshot.device_status
    return None if status is None else status.about.get("scene")


def _drawing_comes(snapshot: Snapshot) -> bool:
    """Whether the world will send its parts. Older versions of hapnet do not send them."""
    begins = snapshot.world_status is not None and snapshot.world is None
    return snapshot.parts is None and (begins or snapshot.scene is not None)


def _moves(snapshot: Snapshot) -> bool:
    """Whether the scene's wall moves. The page does not receive its present place."""
    return _scene_name(snapshot) == "moving"


def _incarnations(snapshot: Snapshot) -> tuple[int | None, int | None]:
    device, world = snapshot.device_status, snapshot.world_status
    return None if device is None else device.incarnation, None if world is None else world.incarnation


RETRY_S = 0.25
"""A part that has failed is drawn again after this time [s]."""


class PagePainter:
    """Draws each part of a page by itself: a part that fails is tried again, and the others are drawn meanwhile.

    Times `now_s` are those of the page.
    """

    def __init__(self) -> None:
        self._failed: dict[str, tuple[str, float]] = {}

    def run(
        self, name: str, draw: Callable[[], object], now_s: float, again: Callable[[], object] = lambda: None
    ) -> None:
        """Draw this part, unless it has just failed. again : called at a failure; prepares a full drawing."""
        if name in self._failed and now_s < self._failed[name][1]:
            return
        try:
            draw()
        except Exception as error:  # of viser, or of a user's own scene: the page must continue
            self._failed[name] = failure(error), now_s + RETRY_S
            again()
        else:
            self._failed.pop(name, None)

    def failures(self) -> list[str]:
        """A sentence for each part that is not drawn now."""
        return [f"the {name} cannot be drawn now: {why}" for name, (why, _) in self._failed.items()]


STYLE = """<style>
/* viser shows the scene at 5 % until the image that lights it has arrived */
canvas { opacity: 1 !important; }
/* grey after a second without a drawing: two names alternate, as a change of the name restarts the animation */
@keyframes hapnet-old-0 { to { filter: grayscale(1) opacity(0.5); } }
@keyframes hapnet-old-1 { to { filter: grayscale(1) opacity(0.5); } }
.hapnet-drawn-0 { animation: hapnet-old-0 1ms linear 1s forwards; }
.hapnet-drawn-1 { animation: hapnet-old-1 1ms linear 1s forwards; }
.hapnet-old { filter: grayscale(1) opacity(0.5); }
/* on a telephone: the sheet at the bottom takes less than half, and the scene is drawn above it */
@media (max-width: 36em) {
  [style*="max-height: 60%"] { max-height: 44% !important; }
  [style*="width: 20em"] { width: 100% !important; }
  div[style*="z-index: 0; width: 100%; height: 100%"] { height: 56% !important; }
}
</style>"""
"""The selectors match inline styles of viser 1.1; with another version only the layout on telephones may be lost."""
