"""The form that changes an emulated link: a preset, sliders, and text in tc-netem's syntax."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from typing import Any

import viser

from hapnet.ext.page.actions import Actions
from hapnet.ext.page.controls import Controls, Direction, require_no_file
from netem import PRESETS, LinkProfile, NetemError
from netem.effects import RandomLoss

CUSTOM = "custom"

TYPED_S = 0.15
"""How long to wait for the last typed letters, which arrive up to 50 ms after the Enter key [s]."""

SETTLED_S = 1.5
"""Within this time after a change both sides report the new link [s]."""


class LinkForm:
    """Preset, sliders and text of one link, or of both, in the container that is open when this object is created.

    actions : run the changes. directions : returns the directions that this form changes; called for each change.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        label: str,
        controls: Controls,
        actions: Actions,
        directions: Callable[[], Iterable[Direction]],
    ) -> None:
        self._controls = controls
        self._directions = directions
        self._actions = actions
        self._running = 0
        self._profile = LinkProfile()
        self._whole = True  # whether all of the profile was shown
        self._followed, self._changed_s = "", -SETTLED_S
        self.folder: viser.GuiFolderHandle = gui.add_folder(label)
        with self.folder:
            self._preset = gui.add_dropdown(
                "preset", (*PRESETS, CUSTOM), initial_value="ideal", hint="typical links; figures are for one direction"
            )
            self._delay = gui.add_slider("delay [ms]", 0.0, 500.0, 1.0, 0.0)
            self._jitter = gui.add_slider("jitter [ms]", 0.0, 100.0, 1.0, 0.0)
            self._loss = gui.add_slider("loss [%]", 0.0, 50.0, 0.5, 0.0)
            typed = gui.add_form(None)
            with typed:
                self._words = gui.add_text(
                    "netem string", "ideal", hint="the present link in tc-netem's syntax; Enter applies your change"
                )
        self._react(self._preset, self._by_preset)
        self._react(self._delay, lambda: _delayed(self._profile, self._delay.value))
        self._react(self._jitter, lambda: _jittered(self._profile, self._jitter.value))
        self._react(self._loss, lambda: _lossy(self._profile, self._loss.value))

        @typed.on_submit
        async def _(event: viser.GuiEvent[viser.GuiFormHandle]) -> None:
            asyncio.get_running_loop().call_later(
                TYPED_S, lambda: self._change(lambda: _typed(self._words.value), event.client)
            )

    def follow(self, text: str) -> None:
        """Show the present link; text that this version of netem cannot parse is shown unchanged.

        An older report does not undo a change that was made here, and no report overwrites text that a user types.
        """
        if self._running or text == self._followed or time.monotonic() - self._changed_s < SETTLED_S:
            return
        self._followed = text
        try:
            profile = LinkProfile.named(text)
        except NetemError:
            put(self._words, text)
        else:
            if not self._whole or str(profile) != str(self._profile):
                self._show(profile)

    def forget(self) -> None:
        """Show the present link again at the next `follow`."""
        self._followed = ""

    def send(self, client: viser.ClientHandle | None) -> None:
        """Apply the link that is shown."""
        self._change(lambda: self._profile, client)

    def _react(self, element: viser.GuiInputHandle[Any], wanted: Callable[[], LinkProfile]) -> None:
        @element.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # otherwise this program set it
                self._change(wanted, event.client)

    def _change(self, wanted: Callable[[], LinkProfile], client: viser.ClientHandle | None) -> None:
        """Begin a change. It applies the values that are shown when its turn comes."""
        profile = self._profile

        def apply() -> None:
            nonlocal profile
            profile = wanted()
            for direction in self._directions():
                self._controls.link(direction, str(profile))

        def done(worked: bool) -> None:
            self._running -= 1
            if worked:
                self._changed_s = time.monotonic()
                if str(profile) != str(self._profile):
                    self._show(profile)

        self._running += 1
        self._actions.begin(apply, client, refused="The link stays as it was", done=done)

    def _show(self, profile: LinkProfile) -> None:
        self._profile, self._whole = profile, False
        words = str(profile)
        put(self._preset, next((name for name in PRESETS if str(LinkProfile.preset(name)) == words), CUSTOM))
        put(self._delay, min(profile.delay_ns / 1e6, 500.0))
        put(self._jitter, min(profile.jitter_ns / 1e6, 100.0))
        put(self._loss, min(100.0 * profile.loss.probability, 50.0) if isinstance(profile.loss, RandomLoss) else 0.0)
        put(self._words, words or "ideal")
        self._whole = True

    def _by_preset(self) -> LinkProfile:
        return self._profile if self._preset.value == CUSTOM else LinkProfile.preset(self._preset.value)


def put(element: Any, value: object) -> None:
    """Set the value of an input; viser's declaration of it is read-only to mypy."""
    element.value = value


def _typed(text: str) -> LinkProfile:
    require_no_file(text)
    return LinkProfile.named(text)


def _delayed(profile: LinkProfile, ms: float) -> LinkProfile:
    return profile.replace(delay_ns=round(ms * 1e6), **({} if ms else {"reorder": 0.0, "reorder_correlation": 0.0}))


def _jittered(profile: LinkProfile, ms: float) -> LinkProfile:
    still: dict[str, Any] = {} if ms else {"distribution": "uniform", "delay_correlation": 0.0}
    return profile.replace(jitter_ns=round(ms * 1e6), **still)


def _lossy(profile: LinkProfile, percent: float) -> LinkProfile:
    return profile.replace(loss=RandomLoss(percent / 100.0) if percent else None)
