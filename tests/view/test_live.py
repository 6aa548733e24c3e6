"""The whole of `hapnet play` in a real browser: two processes, a link, a page, and a mouse that is the hand."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

from playwright.sync_api import Browser, Page, expect

from hapnet.ext.page.history import History, Snapshot
from hapnet.ext.page.watcher import Watcher
from hapnet.transport.config import ZenohSettings
from tests.support.processes import Program, started
from tests.view.test_page import CHROMIUM, LIMIT_MS, browser, keep

__all__ = ["browser"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
    pytest.mark.soak,  # a pair, and a browser that renders in software, are too much for two cores
]

WAIT_S = 90.0
WALL_M = 0.02


@dataclass
class Playing:
    """The page, and what the pair behind it publishes."""

    program: Program
    page: Page
    history: History

    def until(
        self, what: str, condition: Callable[[Snapshot], bool], meanwhile: Callable[[], None] | None = None
    ) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition(self.history.snapshot()):
            assert time.monotonic() < deadline, what
            if meanwhile is not None:
                meanwhile()
            self.page.wait_for_timeout(50)

    def spot(self, x_m: float) -> tuple[float, float]:
        """Where a point of the first axis is on the screen: 24 units of 10 mm away, seen at 30 degrees."""
        box = self.page.locator("canvas[data-engine]").bounding_box()
        per_m = box["height"] / 2.0 / (0.24 * math.tan(math.radians(15.0)))
        return box["x"] + box["width"] / 2.0 + x_m * per_m, box["y"] + box["height"] / 2.0

    def choose(self, label: str) -> None:
        self.page.get_by_label("coupling", exact=True).click()
        self.page.get_by_role("option", name=label, exact=True).click()

    def coupled(self, name: str) -> None:
        def met(now: Snapshot) -> bool:
            sides = (now.device_status, now.world_status)
            return all(s is not None and s.paired and s.about["coupling"] == name for s in sides) and now.taken > 0

        self.until(name, met)


@pytest.fixture
def playing(browser: Browser) -> Iterator[Playing]:
    history = History()
    with started("play", "--no-browser", "--port", 0, "--link", "delay 40ms 10ms loss 2%") as program:
        program.until_line("hapnet view -e ")
        url = next(word for line in program.out for word in line.split() if word.startswith("http://"))
        address = next(line for line in program.out if "hapnet view" in line).split("view -e ")[1].split("`")[0]
        watcher = Watcher(ZenohSettings(connect=(address,)), history.take)
        watcher.open()
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(LIMIT_MS)
        page.goto(url)
        expect(page.locator(".hapnet-state")).to_have_text("running")
        yield Playing(program, page, history)
        page.close()
        watcher.close()
        program.process.send_signal(signal.SIGINT)
        assert program.end()[0] == 130


def least_margin_J(now: Snapshot) -> float:
    return 0.0 if now.summary is None else now.summary["theorem"]["margin_J"] or 0.0


def handle_m(now: Snapshot) -> float:
    return math.nan if now.device is None else float(now.device.position_m[-1, 0])


def proxy_m(now: Snapshot) -> float:
    return math.nan if now.world is None else float(now.world.position_m[-1, 0])


def test_the_mouse_feels_the_wall(playing: Playing, tmp_path: Path) -> None:
    """The page loads, a drag moves the handle, the proxy stops at the wall, and a slider changes the measured delay."""
    page = playing.page
    playing.until("both sides", lambda now: now.device is not None and now.world is not None)
    page.wait_for_timeout(1000)
    page.mouse.move(*playing.spot(handle_m(playing.history.snapshot())))
    page.mouse.down()
    reach = iter(range(10**6))

    def drag_on() -> None:
        page.mouse.move(*playing.spot(min(0.06, 0.002 * next(reach))))

    playing.until("in the wall", lambda now: handle_m(now) > WALL_M + 0.006 and proxy_m(now) > WALL_M, drag_on)
    page.mouse.up()
    playing.until("held", lambda now: handle_m(now) > WALL_M + 0.006)
    now = playing.history.snapshot()
    assert proxy_m(now) < WALL_M + 0.004
    assert now.device.force_N[-1, 0] < -0.3  # pushed back
    keep(page, tmp_path, "play-in-the-wall")
    page.get_by_role("slider").first.press("End")  # of the delay, in both directions

    def slow(now: Snapshot) -> bool:
        sides = (now.device_status, now.world_status)
        return all(s is not None and 480.0 < (s.link["delay_now_ms"] or 0.0) < 520.0 for s in sides)

    playing.until("a delay of 500 ms", slow)
    page.get_by_text("more numbers").click()
    numbers = page.locator("table").filter(has_text="delay up, down")
    playing.until("the page says so", lambda now: "5" in numbers.inner_text().split("delay up, down")[1][:3])
    keep(page, tmp_path, "play-slow")


def test_without_pspm_the_margin_falls_below_zero(playing: Playing, tmp_path: Path) -> None:
    """On the same bad link, with the same hand that moves to and fro, with PSPM it does not."""
    page = playing.page
    playing.coupled("pspm")
    page.wait_for_timeout(1000)

    def shake(what: str, enough: Callable[[Snapshot], bool]) -> None:
        page.mouse.move(*playing.spot(handle_m(playing.history.snapshot())))
        page.mouse.down()
        playing.until(what, enough, lambda: page.mouse.move(*playing.spot(0.012 * math.sin(8.0 * time.monotonic()))))
        page.mouse.up()

    begun = time.monotonic()
    shake("8 s with PSPM", lambda now: time.monotonic() > begun + 8.0)
    assert least_margin_J(playing.history.snapshot()) >= 0.0
    expect(page.locator(".hapnet-passive")).to_have_text("passive")
    playing.choose("zoh")
    playing.coupled("zoh")
    shake("a margin below zero", lambda now: least_margin_J(now) < -0.05)
    expect(page.locator(".hapnet-passive")).to_have_text("NOT passive")
    keep(page, tmp_path, "play-without-pspm")
    expect(page.locator(".hapnet-past")).to_contain_text("hapnet passive")
    playing.choose("hapnet")
    playing.coupled("pspm")
    expect(page.locator(".hapnet-passive")).to_have_text("passive")
