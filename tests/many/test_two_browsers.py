"""Two people at two browsers, each with a hand of their own in the same world: each feels the other's push.

By hand (``-m soak``): two pages drawn without a graphics card need more than two cores.
"""

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")
pytest.importorskip("playwright.sync_api", reason="playwright drives the browser and is not installed")

from playwright.sync_api import Browser, Page, sync_playwright

from hapnet.transport.config import free_address
from tests.many.test_seats import LAB
from tests.support.processes import Program, started, until
from tests.view.test_page import CHROMIUM, FITS, LIMIT_MS, PANEL, SMALL, Open

pytestmark = [
    pytest.mark.soak,
    pytest.mark.realtime,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (Debian: apt install chromium)"),
]
FORCE = re.compile(r"force on the hand\s+([\d.]+) N")
AWAY_M, TOUCHING_M, PUSHING_M = 0.0, 0.036, 0.056  # the block's faces are 30 mm from either hand


class Player:
    """A person with a page: `hapnet play` in a seat of the world at this address, and the mouse at the handle."""

    def __init__(self, name: str, address: str, browser: Browser, program: Program, side: float) -> None:
        program.until_line("drag the handle")
        url = next(found[0] for line in program.out if (found := re.search(r"http://\S+", line)))
        self.side = side
        self.page: Page = browser.new_page(viewport={"width": SMALL[0], "height": SMALL[1]})
        self.page.set_default_timeout(LIMIT_MS)
        self.page.goto(url)
        self.until("the page runs", lambda: "running" in self.page.inner_text("body"))
        self.page.wait_for_selector("canvas[data-engine]")
        self.page.wait_for_function(FITS, arg=SMALL[0] - PANEL)

    def spot(self, way_m: float) -> tuple[float, float]:
        """The place on the screen, towards the block."""
        return Open.scene_point(self, self.side * way_m)  # type: ignore[arg-type]

    def take(self) -> None:
        """Press at the handle."""
        self.page.mouse.move(*self.spot(AWAY_M))
        self.page.mouse.down()

    def drag(self, way_m: float) -> None:
        """Move the pressed mouse to this place, for the handle to follow."""
        self.page.mouse.move(*self.spot(way_m), steps=20)

    @property
    def force(self) -> float:
        """The force on the hand that the page shows [N]."""
        found = FORCE.search(self.page.inner_text("body"))
        return 0.0 if found is None else float(found[1])

    def until(self, what: str, condition: object) -> None:
        until(condition, 60.0, lambda: f"not in time: {what}; {self.page.inner_text('body')[:600]}")  # type: ignore[arg-type]


@pytest.fixture
def players(tmp_path: Path) -> Iterator[tuple[Player, Player]]:
    """Alice, who pushes to the right, and Bob, on the other side of the block."""
    lab, address = tmp_path / "lab.toml", free_address()
    lab.write_text(LAB)
    with ExitStack() as stack:
        world = stack.enter_context(started("world", "--graph", lab, "-l", address, "--no-files"))
        world.until_line("bob: waiting for the device")
        plays = [
            stack.enter_context(
                started("play", "-e", address, "--name", name, "--no-browser", "--no-files", "--port", port)
            )
            for name, port in (("alice", "8301"), ("bob", "8351"))
        ]
        driver = stack.enter_context(sync_playwright())
        browser = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        stack.callback(browser.close)
        sides = (("alice", 1.0), ("bob", -1.0))
        yield tuple(Player(name, address, browser, play, side) for play, (name, side) in zip(plays, sides, strict=True))  # type: ignore[misc]


def test_each_feels_the_others_push(players: tuple[Player, Player]) -> None:
    alice, bob = players
    for one in players:
        one.take()
        one.drag(TOUCHING_M)
    for one in players:
        one.until("the block is felt", lambda one=one: one.force > 0.15)
    for pushing, other in ((alice, bob), (bob, alice)):
        before = other.force
        pushing.drag(PUSHING_M)
        other.until("the other's push is felt", lambda other=other, before=before: other.force > before + 0.3)
        pushing.drag(TOUCHING_M)
        other.until("the push is over", lambda other=other, before=before: other.force < before + 0.2)
    if (kept := os.environ.get("HAPNET_SCREENSHOTS")) is not None:
        alice.page.screenshot(path=str(Path(kept) / "two_hands.png"))
