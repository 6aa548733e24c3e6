"""Two people at two browsers, each with a hand of their own in the same world: each feels the other's push."""

import re
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

from playwright.sync_api import Browser, Page, sync_playwright

from tests.support.processes import Program, started, until
from tests.view.test_page import CHROMIUM, FITS, LIMIT_MS, PANEL, SMALL, Open

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
]
FORCE = re.compile(r"force on the hand\s*([\d.]+) N")
UNDRAWN = """
for (const gl of [WebGLRenderingContext, WebGL2RenderingContext])
  for (const draw of ["clear", "drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
    if (gl.prototype[draw]) gl.prototype[draw] = () => {};
const soon = draw => setTimeout(() => draw(performance.now()), 100);
window.requestAnimationFrame = soon;
"""
"""The scene is there, can be dragged, and has ten frames a second, but its pixels are not computed: without a graphics
card a picture takes a processor for some 0.3 s, and the hands need theirs."""
SPRING_N_M, MOST_M = 5.0, 0.02  # of the block to its place, which it leaves by less than this


class Player:
    """A person with a browser, whose hand is at (x, z) [m] in the plane of the page."""

    def __init__(self, browser: Browser, url: str, name: str) -> None:
        self.name, self.at = name, (0.0, 0.0)
        self.page: Page = browser.new_page(viewport={"width": SMALL[0], "height": SMALL[1]})
        self.page.add_init_script(UNDRAWN)
        self.page.set_default_timeout(LIMIT_MS)
        self.page.goto(f"{url}?name={name}")
        self.until("the page runs", lambda: "running" in self.text)
        self.page.wait_for_selector("canvas[data-engine]")
        self.page.wait_for_function(FITS, arg=SMALL[0] - PANEL)

    @property
    def text(self) -> str:
        return self.page.text_content("body") or ""

    @property
    def force(self) -> float:
        """The force on the hand that the page shows [N]."""
        found = FORCE.search(self.text)
        return 0.0 if found is None else float(found[1])

    def take(self) -> None:
        """Press at the handle."""
        self.page.mouse.move(*Open.scene_point(self, *self.at))  # type: ignore[arg-type]
        self.page.mouse.down()

    def drag(self, x: float, z: float = 0.0) -> None:
        """Move the pressed mouse to this place, for the handle to follow."""
        self.page.mouse.move(*Open.scene_point(self, x, z), steps=4)  # type: ignore[arg-type]
        self.at = x, z

    def until(self, what: str, condition: Callable[[], bool]) -> None:
        until(condition, 90.0, lambda: f"not in time for {self.name}: {what}; {self.text[:600]}")


@pytest.fixture
def play() -> Iterator[Program]:
    with started("play", "--seats", "2", "--no-browser", "--port", "0", "--link", "") as program:
        program.until_line("open http")
        yield program


@pytest.fixture
def browser() -> Iterator[Browser]:
    with sync_playwright() as driver, ExitStack() as closing:
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        closing.callback(chromium.close)
        yield chromium


def test_each_feels_the_others_push(play: Program, browser: Browser) -> None:
    """The block is between the hands. At rest the two pushes and the block's spring add up to nothing."""
    url = next(found[0] for line in play.out if (found := re.search(r"http://\S+", line)))
    alice, bob = Player(browser, url, "Alice"), Player(browser, url, "Bob")
    for one in (alice, bob):
        one.until("both names", lambda one=one: "Alice" in one.text and "Bob" in one.text)
        one.take()
    for place in ((0.0, 0.035), (0.07, 0.035), (0.07, 0.0), (0.04, 0.0)):  # above the block, to its other side
        bob.drag(*place)
    alice.drag(0.02)
    for one in (alice, bob):
        one.until("the block is felt", lambda one=one: one.force > 0.1)
    for pushing, other, far, near in ((alice, bob, 0.05, 0.02), (bob, alice, 0.01, 0.04)):
        before = other.force
        pushing.drag(far)
        other.until("the other's push is felt", lambda other=other, before=before: other.force > before + 0.2)
        pushing.until("two pushes and a spring", lambda: abs(alice.force - bob.force) < SPRING_N_M * MOST_M)
        pushing.drag(near)
        other.until("the push is over", lambda other=other, before=before: other.force < before + 0.1)
    third = browser.new_page()
    answer = third.goto(url)
    assert answer is not None
    assert answer.status == 503
    assert (
        third.inner_text("body").strip()
        == "All 2 seats of this world are taken. Reload this page when somebody has left."
    )
    before = alice.force
    bob.page.close()
    alice.until("Bob has left", lambda: "Bob, left" in alice.text)
    play.until_line("Bob: PASSIVE")
    play.process.send_signal(signal.SIGINT)
    code, out, err = play.end()
    assert (code, err) == (130, "")
    assert "Alice: PASSIVE" in out
