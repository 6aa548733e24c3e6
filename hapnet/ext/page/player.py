"""The page's part for a recording: where it is, and whether it goes on."""

from __future__ import annotations

import time

import viser

from hapnet.ext.page.link_form import put
from hapnet.ext.page.playback import Playback

STEP_S = 0.05
"""The scrubber's steps [s]."""

HELD_S = 0.7
"""After a user's change the scrubber is not moved for this time [s]."""


class PlayerPanel:
    """A scrubber and a button, in the container that is open when this is made."""

    def __init__(self, gui: viser.GuiApi, player: Playback) -> None:
        self._player = player
        end_s = max(player.duration_s, STEP_S)
        self._time = gui.add_slider("time [s]", 0.0, end_s, STEP_S, 0.0, hint=f"of {end_s:.1f} s; drag to go there")
        self._pause = gui.add_button("pause", icon=viser.Icon.PLAYER_PAUSE)
        self._changed_s = -HELD_S

        @self._time.on_update
        async def _(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if event.client is not None:
                self._changed_s = time.monotonic()
                player.seek(self._time.value)

        @self._pause.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            player.pause(not player.paused)
            self._pause.label = "go on" if player.paused else "pause"
            self._pause.icon = viser.Icon.PLAYER_PLAY if player.paused else viser.Icon.PLAYER_PAUSE

    def update(self) -> None:
        """Show where it is."""
        if time.monotonic() - self._changed_s > HELD_S:
            put(self._time, round(self._player.at_s / STEP_S) * STEP_S)
