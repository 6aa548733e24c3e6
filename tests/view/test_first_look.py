"""The first look at a page in a real browser: the verdict, the hint at the handle, and no placeholder."""

from __future__ import annotations

import io
import re

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

import numpy as np
from PIL import Image
from playwright.sync_api import Browser

from tests.view.test_page import CHROMIUM, Open, browser, opened
from tests.view.test_presses import drag

__all__ = ["browser"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
    pytest.mark.slow,
]

PLACEHOLDER = re.compile(r"connecting|waiting|(?<!load a mesh )\.\.\.|^\W*-\W*(mJ|ms|%|N)?$", re.MULTILINE)


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
