"""What a page draws and says of a pair, without a browser."""

from collections.abc import Iterable
from dataclasses import replace

import pytest

from hapnet.view.history import Snapshot
from tests.view.feed import FakeControls
from tests.view.test_history import pair_of, status


def test_a_page_says_what_the_pair_does(monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser", reason="the live page's library is not installed")
    from hapnet.view import page as pages

    said: list[str] = []

    def update(_: object, snapshot: Snapshot, state: str, troubles: Iterable[str]) -> None:
        said.append(state)

    monkeypatch.setattr(pages.Numbers, "update", update)
    history = pair_of(2.0)
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        page = pages.Page(server, history, FakeControls())
        for now_s, paused in ((10.0, False), (10.1, True), (10.2, False), (100.0, False)):
            history.take(replace(status("device", coupling="pspm"), paused=paused))
            page.draw_scene(now_s)
            page.draw_rest(now_s)
    finally:
        server.stop()
    assert said == ["running", "paused", "running", "no telemetry"]
