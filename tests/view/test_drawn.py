"""What a page draws and says of a pair, without a browser."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser

from hapnet.ext.page import page as pages
from hapnet.ext.page.history import History
from hapnet.ext.page.page import RETRY_S
from tests.view.feed import FakeControls
from tests.view.test_history import MS, device, pair_of, reports, world


@pytest.fixture
def server() -> Iterator[Any]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


class Drawn:
    """A page of a pair that runs, drawn at given times."""

    def __init__(self, server: Any) -> None:
        self.history = pair_of()
        self.page = pages.Page(server, self.history, FakeControls())

    def draw(self, now_s: float, *, samples: bool = True, paused: bool = False) -> None:
        """Both parts, as of `now_s`, with what came until then."""
        if samples:
            self.history.take(world(round(1000 * now_s) * MS))
            self.history.take(device(round(1000 * now_s) * MS))
        self.history.take(replace(reports("device"), paused=paused, time_ns=round(1000 * now_s) * MS))
        self.page.draw_scene(now_s)
        self.page.draw_rest(now_s)

    @property
    def content(self) -> str:
        return str(self.page._numbers._html.content)

    @property
    def says(self) -> str:
        return re.sub("<[^>]*>", " ", self.content)

    @property
    def state(self) -> str:
        found = re.search('hapnet-state">([^<]*)<', self.content)
        return "" if found is None else found[1]

    @property
    def grey(self) -> bool:
        return "hapnet-old" in self.content


def test_nothing_is_shown_of_a_pair_that_has_reported_nothing(server: Any) -> None:
    """No verdict, no value, no control, no plot; then all of them, and five values in front."""
    page = pages.Page(server, History(), FakeControls())
    assert page._numbers._html.content == ""
    page.draw_scene(10.0)
    page.draw_rest(10.0)
    assert re.sub("<[^>]*>", "", page._numbers._html.content) == "connecting ..."
    assert [part.visible for part in (page._settings, page._numbers._folder, page._plots._force)] == [False] * 3
    page._history = pair_of()
    for sample in (world(10_000 * MS), device(10_000 * MS)):
        page._history.take(sample)
    page.draw_scene(10.1)
    page.draw_rest(10.1)
    assert [part.visible for part in (page._settings, page._numbers._folder, page._plots._force)] == [True] * 3
    assert 'hapnet-passive">passive<' in page._numbers._html.content
    assert page._numbers._html.content.count("<tr>") <= 5
    assert re.findall("> *[-–.]+ *(?:m[JNms]|%)?<", page._numbers._html.content + page._numbers._more.content) == []


def test_the_hint_at_the_handle_stays_until_the_first_drag_whatever_the_scene(server: Any) -> None:
    drawn = Drawn(server)
    drawn.draw(10.0)
    assert drawn.page._scene.hints
    drawn.page._drop_scene()
    drawn.draw(10.1)
    assert drawn.page._scene.hints
    drawn.page._scene._follow(lambda position: None, np.array([1.0, 0.0, 0.0]))
    assert not drawn.page._scene.hints
    drawn.page._drop_scene()
    drawn.draw(10.2)
    assert not drawn.page._scene.hints
    watched = pages.Page(server, pair_of(), None)
    watched._history.take(device(10_000 * MS))
    watched.draw_scene(10.0)
    assert not watched._scene.hints  # there is no handle to drag


def test_a_page_says_what_the_pair_does(server: Any) -> None:
    drawn, said = Drawn(server), []
    for now_s, samples, paused in ((10.0, True, False), (10.1, True, True), (10.2, True, False), (100.0, False, False)):
        drawn.draw(now_s, samples=samples, paused=paused)
        said.append(drawn.state)
    assert said == ["running", "paused", "running", "no telemetry"]


def test_what_is_older_than_a_second_is_grey_unless_the_pair_is_paused(server: Any) -> None:
    drawn = Drawn(server)
    for now_s, samples, paused, grey in (
        (10.0, True, False, False), (10.9, False, False, False), (11.1, False, False, True),
        (11.2, True, False, False), (13.0, False, True, False),
    ):  # fmt: skip
        drawn.draw(now_s, samples=samples, paused=paused)
        assert drawn.grey is grey, now_s
    drawn.page.draw_rest(14.1)  # nothing comes of a pair that was paused
    assert drawn.grey


def test_each_drawing_begins_the_second_anew_in_the_browser(server: Any) -> None:
    """A browser begins an animation anew where its name is another one (`STYLE` in page.py)."""
    drawn, names = Drawn(server), []
    for number in range(3):
        drawn.draw(10.0 + 0.25 * number)
        names += re.findall("hapnet-drawn-[01]", drawn.content)
    assert names == ["hapnet-drawn-0", "hapnet-drawn-1", "hapnet-drawn-0"] or names[0] == names[2] != names[1]


def test_while_another_pair_starts_the_verdict_of_the_old_one_is_gone(server: Any) -> None:
    drawn = Drawn(server)
    drawn.draw(10.0)
    assert re.search('hapnet-passive">passive<', drawn.content)
    drawn.history.leave()
    drawn.draw(10.1)
    assert "hapnet-passive" not in drawn.content
    assert "margin" not in drawn.says


@pytest.mark.parametrize(("owner", "name", "part"), [
    ("PageScene", "__init__", "scene"), ("PageScene", "update", "scene"), ("PageScene", "fit", "handle"),
    ("Plots", "update", "plots"), ("ControlPanel", "update", "controls"), ("Numbers", "update", "numbers"),
])  # fmt: skip
def test_a_part_that_cannot_be_drawn_once_is_drawn_again_and_the_others_meanwhile(
    owner: str, name: str, part: str, server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Drawn(server)
    if name != "__init__":
        drawn.draw(10.0)
    kind, calls = getattr(pages, owner), []
    real = getattr(kind, name)

    def fails_once(*args: Any, **more: Any) -> None:
        calls.append(1)
        if len(calls) == 1:
            raise RuntimeError("deque mutated during iteration")
        real(*args, **more)

    monkeypatch.setattr(kind, name, fails_once)
    before = drawn.content
    drawn.draw(10.5)
    assert len(calls) == 1
    if part != "numbers":
        assert drawn.content != before
        assert f"the {part} cannot be drawn now: RuntimeError: deque mutated during iteration" in drawn.says
    drawn.draw(10.5 + RETRY_S)
    drawn.draw(10.6 + RETRY_S)
    assert len(calls) >= 2
    assert "cannot be drawn" not in drawn.says
    assert drawn.state == "running"


def test_controls_that_were_shown_in_part_are_shown_in_full_afterwards(
    server: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Drawn(server)
    panel = drawn.page._panel
    real, failed = panel._show_scene, []

    def fails_once(side: Any) -> None:
        if not failed:
            failed.append(side)
            raise RuntimeError("once")
        real(side)

    monkeypatch.setattr(panel, "_show_scene", fails_once)
    drawn.history = drawn.page._history = History()
    for role in ("device", "world"):
        status = reports(role, coupling="zoh")
        drawn.history.take(replace(status, about={**status.about, "scene": "sphere"}))
    drawn.page.draw_rest(10.0)
    drawn.page.draw_rest(10.1)  # too soon
    assert panel._scene.value != "sphere"
    drawn.page.draw_rest(10.0 + RETRY_S)
    assert (panel._choice.value, panel._scene.value) == ("zoh", "sphere")
