"""The page's buttons and switches, without a browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser

from hapnet.laws import COUPLING_NAMES
from hapnet.params import Params
from hapnet.recording.telemetry import Status
from hapnet.view.choices import CHOICES, words_of
from hapnet.view.history import Episode, Snapshot
from hapnet.view.panel import ControlPanel, Numbers
from tests.view.feed import FakeControls


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(port=0, verbose=False)
    yield server
    server.stop()


def snapshot(coupling: str, rendering: str, past: tuple[Episode, ...] = ()) -> Snapshot:
    about = {"coupling": coupling, "params": Params().set({"rendering": rendering}).as_dict()}
    status = Status("device", 0, 1, True, False, "", about, {"profile": ""}, {})
    return Snapshot(None, None, status, None, False, None, None, (), 0, past=past)


@pytest.mark.parametrize(("coupling", "rendering", "label", "asked"), [
    ("pspm", "hapnet", "hapnet", ("pspm", "hapnet")),
    ("pspm", "paper", "paper", ("pspm", "paper")),
    ("zoh", "paper", "zoh", ("zoh", "paper")),
    ("zoh", "hapnet", "zoh, hapnet's rendering", ("zoh", "hapnet")),
    *((name, "paper", name, (name, "auto")) for name in COUPLING_NAMES[2:]),
    ("examples.own_law:Mine", "hapnet", "examples.own_law:Mine", ("examples.own_law:Mine", "auto")),
])  # fmt: skip
def test_the_switch_shows_what_runs_and_asks_for_what_is_chosen(
    coupling: str, rendering: str, label: str, asked: tuple[str, str], server: viser.ViserServer
) -> None:
    controls = FakeControls()
    panel = ControlPanel(server.gui, controls, lambda position: None, lambda starting: None)
    panel.update(snapshot("wave", "hapnet"))
    panel.update(snapshot(coupling, rendering))
    assert panel._choice.value == label
    assert label in panel._choice.options
    panel._couple(label)
    assert controls.named("coupling") == [asked]


def test_every_coupling_can_be_chosen_and_is_said_in_words() -> None:
    assert {coupling for coupling, _ in CHOICES.values()} == set(COUPLING_NAMES)
    assert list(CHOICES)[:3] == ["hapnet", "paper", "zoh"]
    assert all(words_of(label) for label in CHOICES)


def test_the_page_says_how_stiff_the_wall_is_felt(server: viser.ViserServer) -> None:
    shown = snapshot("pspm", "hapnet")
    assert shown.device_status is not None
    numbers = Numbers(server.gui)
    numbers.update(shown, "running")
    assert "felt" not in numbers._html.content
    shown.device_status.about["felt"] = {"stiffness_N_m": 3000.0, "felt_stiffness_N_m": 85.7142, "springs_N_m": ()}
    numbers.update(shown, "running")
    assert "wall3000 N/m, felt as 85.71 N/m" in re.sub("<[^>]*>", "", numbers._html.content)
    shown.device_status.about["felt"] = "hard"
    numbers.update(shown, "running")
    assert "felt as" not in numbers._html.content


def test_each_pair_keeps_its_own_verdict(server: viser.ViserServer) -> None:
    """One that was not passive is still said when another coupling runs, and passive is not said of it."""

    def account(coupling: str, margin_J: float) -> dict[str, Any]:
        sides = {side: {"ledger": {"slack_J": 0.0}, "incarnations": 1} for side in ("device", "world")}
        return {"theorem": {"margin_J": margin_J}, **sides, "coupling": coupling}

    past = (Episode("zoh", "paper", account("zoh", -0.2)), Episode("pspm", "hapnet", account("pspm", 0.09)))
    numbers = Numbers(server.gui)
    numbers.update(snapshot("wave", "hapnet", past), "running")
    text = re.sub("<[^>]*>", "", numbers._html.content)
    assert "before: zoh NOT passive · hapnet passive" in text
    assert "wave: wave variables" in text
