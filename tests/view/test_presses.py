"""Presses beside the handle, in a real browser: they take hold of it or do nothing, and the view stays as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

from playwright.sync_api import Browser

from tests.view.test_page import CHROMIUM, Open, browser, opened

__all__ = ["browser"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
    pytest.mark.slow,
]

BESIDE_PX = 100.0
DRAG_PX = 60.0
SETTLED_MS = 400  # a browser sends its camera 20 times a second


def view(shown: Open) -> np.ndarray:
    """Place, direction and upward direction of the browser's camera."""
    shown.page.wait_for_timeout(SETTLED_MS)
    (client,) = shown.server._server.get_clients().values()
    camera = client.camera
    return np.concatenate([camera.position, camera.look_at, camera.wxyz, camera.up_direction])


def drag(shown: Open, distance: float, angle: float) -> None:
    """Press beside the handle, which rests at the origin, and drag outwards."""
    (x, y), along = shown.scene_point(0.0), (math.cos(angle), math.sin(angle))
    for travelled in np.linspace(0.0, DRAG_PX, 4):
        reach = distance + travelled
        shown.page.mouse.move(x + reach * along[0], y + reach * along[1])
        if not travelled:
            shown.page.mouse.down()
    shown.page.mouse.up()


@pytest.mark.parametrize("size", [(1440, 900), (700, 800), (390, 844)])
def test_twenty_presses_within_100_pixels_keep_the_view(browser: Browser, size: tuple[int, int]) -> None:
    """All around the handle, also on the wall's side; a press far away turns the view, so that it can fail."""
    with opened(browser, size) as shown:
        shown.page.locator(".mantine-Notification-closeButton").click()  # a warning about the browser's graphics
        before, turned, held = view(shown), list[float](), 0
        for number in range(20):
            distance, angle = BESIDE_PX * math.sqrt((number + 1) / 20.0), number * 2.4  # a sunflower's seeds
            led = len(shown.controls.named("lead"))
            drag(shown, distance, angle)
            held += shown.controls.wait(lambda led=led: len(shown.controls.named("lead")) > led, 5.0)
            if not np.allclose(view(shown), before, atol=1e-6):
                turned.append(round(distance))
                shown.button("reset view").click()
        assert turned == []
        assert held >= 15  # on a busy machine a browser may join a press, a move and a release
        drag(shown, 0.4 * min(size), math.radians(120.0))
        assert not np.allclose(view(shown), before, atol=1e-6)
