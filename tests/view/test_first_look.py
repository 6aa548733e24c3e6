"""The first look at a page in a real browser: verdict, hint, no placeholder; and the first presses beside the handle,
which take hold of it or do nothing, and keep the view."""

from __future__ import annotations

import io
import math
import re

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

import numpy as np
from PIL import Image
from playwright.sync_api import Browser

from tests.conftest import mostly_slow
from tests.view.test_page import CHROMIUM, Open, browser, opened

__all__ = ["browser"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
    pytest.mark.slow,
]

PLACEHOLDER = re.compile(r"connecting|waiting|(?<!load a mesh )\.\.\.|^\W*-\W*(mJ|ms|%|N)?$", re.MULTILINE)


BESIDE_PX = 100.0
DRAG_PX = 60.0
SETTLED_MS = 400  # a browser sends its camera 20 times a second


def view(shown: Open) -> np.ndarray:
    """Place, direction and upward direction of the browser's camera."""
    shown.page.wait_for_timeout(SETTLED_MS)
    (client,) = shown.server._page._server.get_clients().values()
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


def dark(shown: Open) -> int:
    """How many dark pixels are above the handle, where its hint is."""
    x, y = shown.scene_point(0.0)
    picture = shown.page.screenshot(clip={"x": x - 40.0, "y": y - 48.0, "width": 80.0, "height": 30.0})
    return int((np.asarray(Image.open(io.BytesIO(picture)).convert("L")) < 90).sum())


def test_on_a_telephone_verdict_and_hint_are_seen_without_scrolling(browser: Browser) -> None:
    with opened(browser, (390, 844)) as shown:
        page = shown.page
        page.locator(".mantine-Notification-closeButton").click()  # a warning about the browser's graphics
        page.wait_for_timeout(1000)
        about = page.get_by_text("what am I looking at?").bounding_box()
        verdict = page.locator(".hapnet-passive").bounding_box()
        values = page.locator(".hapnet-front").bounding_box()
        assert 844 / 2 < about["y"] < verdict["y"] < values["y"]
        assert values["y"] + values["height"] < 844
        assert page.locator(".hapnet-front tr").count() == 5
        assert dark(shown) > 20
        drag(shown, 0.0, 0.0)
        assert shown.controls.wait(lambda: shown.controls.named("lead"))
        page.wait_for_timeout(1000)
        assert dark(shown) == 0


def test_in_the_first_second_no_placeholder_is_seen(browser: Browser) -> None:
    """Of a pair that runs, from the first time that the panel has text on."""
    with opened(browser) as shown:
        page = shown.page
        page.add_init_script(
            "window.seen = []; setInterval(() => {"
            " if (document.querySelector('.hapnet-state')) window.seen.push(document.body.innerText); }, 20);"
        )
        page.reload()
        page.locator(".hapnet-state").wait_for()
        page.wait_for_timeout(1000)
        seen = page.evaluate("window.seen")
    assert seen
    assert [found[0] for text in seen if (found := PLACEHOLDER.search(text))] == []
    assert all("reset view" in text and "pause" in text for text in seen)


@pytest.mark.parametrize(
    ("size", "every"),
    mostly_slow([((390, 844), 4), ((1440, 900), 1), ((700, 800), 1), ((390, 844), 1)], 0, 1),
)
def test_twenty_presses_within_100_pixels_keep_the_view(browser: Browser, size: tuple[int, int], every: int) -> None:
    """All around the handle, also on the wall's side; a press far away turns the view, so that it can fail."""
    with opened(browser, size) as shown:
        shown.page.locator(".mantine-Notification-closeButton").click()  # a warning about the browser's graphics
        before, turned, held = view(shown), list[float](), 0
        for number in range(0, 20, every):
            distance, angle = BESIDE_PX * math.sqrt((number + 1) / 20.0), number * 2.4  # a sunflower's seeds
            led = len(shown.controls.named("lead"))
            drag(shown, distance, angle)
            held += shown.controls.wait(lambda led=led: len(shown.controls.named("lead")) > led, 5.0)
            if not np.allclose(view(shown), before, atol=1e-6):
                turned.append(round(distance))
                shown.button("reset view").click()
        assert turned == []
        assert held >= 15 // every  # on a busy machine a browser may join a press, a move and a release
        drag(shown, 0.4 * min(size), math.radians(120.0))
        assert not np.allclose(view(shown), before, atol=1e-6)
