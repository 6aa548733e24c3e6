"""The parts of a drawing, each on its own: one that fails is tried again, and the others are drawn meanwhile."""

from __future__ import annotations

from collections.abc import Callable

from hapnet.loading import failure

RETRY_S = 0.25
"""A part that has failed is drawn again after this time [s]."""


class Steps:
    """Runs the parts, and keeps what the last attempt of each failed with. Times `now_s` are those of the page."""

    def __init__(self) -> None:
        self._failed: dict[str, tuple[str, float]] = {}

    def run(
        self, name: str, draw: Callable[[], object], now_s: float, again: Callable[[], object] = lambda: None
    ) -> None:
        """Draw this part, unless it has just failed. again : called when it fails, so that all of it is drawn next."""
        if name in self._failed and now_s < self._failed[name][1]:
            return
        try:
            draw()
        except Exception as error:  # of viser, or of a picture that somebody else made: the page must go on
            self._failed[name] = failure(error), now_s + RETRY_S
            again()
        else:
            self._failed.pop(name, None)

    def failures(self) -> list[str]:
        """A sentence for each part that is not drawn now."""
        return [f"the {name} cannot be drawn now: {why}" for name, (why, _) in self._failed.items()]
