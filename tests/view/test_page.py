"""The page in a real browser: it shows, it drags, and what is pressed reaches the controls.

Screenshots are kept in the directory that HAPNET_SCREENSHOTS names, else in pytest's temporary one.
"""

import math
import operator
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, expect, sync_playwright

from hapnet.ext.page.controls import Controls
from hapnet.ext.page.history import History
from hapnet.ext.page.server import PageServer, serve
from hapnet.params import Params
from tests.view.feed import FakeControls, Feed

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SMALL = (940, 560)  # what is not looked at need not cost much
SLOWER_S = 1.0 / 30.0  # a browser that draws without a graphics card falls behind at the page's own 60 Hz
FITS = "width => document.querySelector('canvas[data-engine]').clientWidth <= width"
"""Whether the scene has its size: beside a panel it is as wide as the whole window for up to some seconds."""
NARROW, PANEL = 600, 200  # a window up to NARROW has its panel below the scene, others at least PANEL beside it
LIMIT_MS = 180_000.0  # software rendering on a busy machine is slow

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)")


@dataclass
class Open:
    """A page that is open in the browser."""

    page: Page
    controls: FakeControls
    feed: Feed
    server: PageServer

    def button(self, name: str) -> Locator:
        return self.page.get_by_role("button", name=name, exact=True)

    def switch(self, label: str) -> Locator:
        return self.page.get_by_label(label, exact=True)

    def scene_point(self, x_m: float, y_m: float = 0.0) -> tuple[float, float]:
        """Where a point of the plane of motion is on the screen: 24 units of 10 mm away, seen at 30 degrees."""
        box = self.page.locator("canvas[data-engine]").bounding_box()
        per_m = box["height"] / 2.0 / (0.24 * math.tan(math.radians(15.0)))
        return box["x"] + box["width"] / 2.0 + x_m * per_m, box["y"] + box["height"] / 2.0 - y_m * per_m


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    expect.set_options(timeout=LIMIT_MS)
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield chromium
        chromium.close()


@contextmanager
def opened(
    browser: Browser, size: tuple[int, int] = SMALL, *, watching: bool = False, **changes: object
) -> Iterator[Open]:
    """The page of a pair that is played back; it must have logged no error by the end."""
    history, errors = History(), list[str]()
    params = Params().set({"duration_s": 4.0, "operator": "rest", "link.up": "4g", "link.down": "4g", **changes})
    with Feed(history, params) as feed:
        controls = FakeControls(feed)
        given: Controls | None = None if watching else controls
        with serve(history, given, port=0, frame_s=SLOWER_S) as server:
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            page.set_default_timeout(LIMIT_MS)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.on("console", lambda line: errors.append(line.text) if _is_error(line) else None)
            page.goto(server.url)
            expect(page.locator(".hapnet-state")).to_have_text("running")
            page.wait_for_function(FITS, arg=size[0] if size[0] <= NARROW else size[0] - PANEL)
            yield Open(page, controls, feed, server)
            page.close()
    assert errors == []


@pytest.fixture(scope="module")
def playing(browser: Browser) -> Iterator[Open]:
    """One page for what does not disturb the others."""
    with opened(browser) as page:
        yield page


def _led_near(controls: FakeControls, x_m: float) -> bool:
    return any(abs(place[0] - x_m) < 0.0015 for (place,) in controls.named("lead"))


def _is_error(line: ConsoleMessage) -> bool:
    """Errors but the browser's own remark about how viser listens to the wheel."""
    return line.type == "error" and "preventDefault inside passive event listener" not in line.text


def keep(page: Page, tmp_path: Path, name: str) -> Path:
    directory = Path(os.environ.get("HAPNET_SCREENSHOTS", tmp_path))
    directory.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=directory / f"{name}.png")
    return directory / f"{name}.png"


@pytest.mark.slow
def test_it_shows_scene_plots_and_numbers(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, (1280, 720), operator="press", duration_s=12.0) as shown:
        page = shown.page
        expect(page.locator(".hapnet-passive")).to_have_text("passive")
        expect(page.locator(".uplot")).to_have_count(4)
        expect(page.locator(".hapnet-front tr")).to_have_count(5)
        for words in ("PSPM", "force on the hand", "round trip", "96.0 ms", "lost up, down", "3.0, 3.0 %"):
            expect(page.get_by_text(words).locator("visible=true").first).to_be_visible()
        page.get_by_text("more numbers").click()
        for words in ("spring K (y − x)", "link delay up, down", "42, 42 ms", "2.0, 2.0 %"):
            expect(page.get_by_text(words).locator("visible=true").first).to_be_visible()
        assert shown.server.watched
        assert keep(page, tmp_path, "page").stat().st_size > 10_000


@pytest.mark.slow
def test_a_tool_that_turns_is_drawn_at_both_poses_and_led_by_three_axes(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, (1280, 720), operator="press", scene="tool:peg + hole?at=0,0,-20mm") as shown:
        shown.page.get_by_text("more numbers").click()
        for words in ("torque on the hand", "mNm", "angle between"):
            expect(shown.page.get_by_text(words).first).to_be_visible()
        shown.button("release to start").click()
        assert shown.controls.wait(lambda: shown.controls.named("lead") == [((0.0, 0.0, 0.0),)], 20.0)
        keep(shown.page, tmp_path, "tool")


@pytest.mark.slow
def test_a_run_that_is_not_passive_says_so(browser: Browser, tmp_path: Path) -> None:
    light = {"operator_model.mass": 0.1, "operator_model.damping": 1.0, "duration_s": 10.0, "rendering": "paper"}
    with opened(browser, (1280, 720), scene="free", operator="sine", coupling="zoh", watching=True, **light) as shown:
        expect(shown.page.locator(".hapnet-passive")).to_have_text("NOT passive")
        keep(shown.page, tmp_path, "not-passive")


@pytest.mark.soak
def test_who_watches_only_can_press_and_drag_nothing(browser: Browser) -> None:
    with opened(browser, watching=True) as shown:
        page = shown.page
        expect(page.get_by_role("slider")).to_have_count(0)
        for name in ("pause", "record", "reset", "release to start"):
            expect(shown.button(name)).to_have_count(0)
        page.mouse.move(*shown.scene_point(0.0))
        page.mouse.down()
        page.mouse.move(*shown.scene_point(0.02), steps=2)
        page.mouse.up()
        expect(page.locator(".hapnet-state")).to_have_text("running")
        assert shown.controls.calls == []


@pytest.mark.soak
def test_the_scene_has_more_than_half_of_a_telephones_height(browser: Browser) -> None:
    with opened(browser, (390, 844)) as shown:
        box = shown.page.locator("canvas[data-engine]").bounding_box()
        sheet = shown.page.locator('[style*="max-height: 60%"]').bounding_box()
        assert box["height"] > 844 / 2
        assert sheet["y"] >= box["y"] + box["height"] - 8.0


@pytest.mark.slow
def test_a_drag_leads_the_hand_where_the_mouse_is(playing: Open) -> None:
    page, controls = playing.page, playing.controls
    page.mouse.move(*playing.scene_point(0.0))
    page.mouse.down()
    steps = [0.010, 0.020, 0.030]
    for number, x in enumerate(steps):
        page.mouse.move(*playing.scene_point(x, 0.004), steps=2)  # the first move of a drag only begins it
        assert controls.wait(partial(_led_near, controls, x)), number
    page.mouse.up()
    led = [place[0] for (place,) in controls.named("lead")]
    assert led == sorted(led)
    assert all(len(place) == 1 for (place,) in controls.named("lead"))
    before = len(led)
    page.mouse.move(*playing.scene_point(-0.02))
    playing.button("release to start").click()
    assert controls.wait(lambda: controls.named("lead")[-1] == ((0.0,),))
    assert len(controls.named("lead")) == before + 1  # a mouse that let go leads nobody


@pytest.mark.soak
def test_a_slider_changes_both_links(playing: Open) -> None:
    page, controls = playing.page, playing.controls
    before = len(controls.named("link"))
    page.get_by_role("slider").first.press("ArrowRight")
    assert controls.wait(lambda: len(controls.named("link")) >= before + 2)
    changed = controls.named("link")[before : before + 2]
    words = "delay 36ms 3ms 25% distribution normal loss 10% 20% resend 3 8ms rate 6mbit"
    assert changed == [("up", words), ("down", words)]
    expect(page.locator("form input").first).to_have_value(words)


@pytest.mark.soak
def test_each_direction_may_have_a_link_of_its_own(playing: Open) -> None:
    page, controls = playing.page, playing.controls
    alike = playing.switch("both directions alike")
    alike.click()
    expect(page.get_by_role("slider")).to_have_count(6)
    before = len(controls.named("link"))
    page.get_by_role("slider").last.press("ArrowRight")
    assert controls.wait(lambda: len(controls.named("link")) > before)
    assert [way for way, _ in controls.named("link")[before:]] == ["down"]
    alike.click()
    assert controls.wait(lambda: {way for way, _ in controls.named("link")[before + 1 :]} == {"up", "down"})
    assert len({words for _, words in controls.named("link")[before + 1 :]}) == 1
    expect(page.get_by_role("slider")).to_have_count(3)


@pytest.mark.soak
def test_words_are_put_in_force_by_enter_and_bad_ones_are_told(playing: Open) -> None:
    controls = playing.controls
    words = playing.page.locator("form input").first
    words.fill("delay 120ms loss 3%")
    words.press("Enter")
    assert controls.wait(lambda: ("up", "delay 120ms loss 3%") in controls.named("link"))
    before = len(controls.named("link"))
    words.fill("delay soon")
    words.press("Enter")
    expect(playing.page.get_by_text("The link stays as it was")).to_be_visible()
    assert len(controls.named("link")) == before
    words.fill("geo")
    words.press("Enter")
    assert controls.wait(lambda: len(controls.named("link")) == before + 2)
    assert controls.named("link")[-1][1].startswith("delay 270ms")


@pytest.mark.slow
def test_buttons_and_switches_call_theirs(playing: Open) -> None:
    page, controls = playing.page, playing.controls
    state = page.locator(".hapnet-state")
    for pressed, call, after in (
        ("pause", ("pause", True), "paused"),
        ("resume", ("pause", False), "running"),
        ("record", ("record", True), "recording"),
        ("stop recording", ("record", False), "running"),
    ):
        playing.button(pressed).click()
        assert controls.wait(partial(operator.contains, controls.calls, call)), pressed
        expect(state).to_have_text(after)
    playing.button("record").dblclick()  # faster than the status that shows the first click
    assert controls.wait(lambda: controls.named("record") == [(True,), (False,)] * 2)
    playing.button("reset").click()
    assert controls.wait(lambda: ("reset",) in controls.calls)
    playing.switch("smoothing filter").click()
    assert controls.wait(lambda: ("smoothing", 0.02) in controls.calls)
    for label, coupling, rendering in (("zoh", "zoh", "paper"), ("hapnet", "pspm", "hapnet")):
        playing.switch("coupling").click()
        page.get_by_role("option", name=label, exact=True).click()
        assert controls.wait(partial(operator.contains, controls.calls, ("coupling", coupling, rendering)))
        expect(page.locator(".hapnet-coupling")).to_contain_text(f"{label}: ")
    expect(page.locator(".hapnet-past")).to_contain_text("hapnet passive")
