"""The page's buttons and switches, without a browser."""

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser

from hapnet.errors import InvalidParameter
from hapnet.ext.page.choices import CHOICES, LARGEST_FILE, SCENES, words_of
from hapnet.ext.page.history import Episode, Snapshot
from hapnet.ext.page.numbers import Numbers
from hapnet.ext.page.panel import ControlPanel
from hapnet.laws import COUPLING_NAMES
from hapnet.params import Params
from hapnet.recording.telemetry import Status
from hapnet.summary.reported import present
from tests.view.feed import FakeControls


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(port=0, verbose=False)
    yield server
    server.stop()


def snapshot(coupling: str, rendering: str, past: tuple[Episode, ...] = ()) -> Snapshot:
    about = {"coupling": coupling, "params": Params().set({"rendering": rendering}).as_dict()}
    status = Status("device", 0, 1, True, False, "", about, {"profile": ""}, {})
    return Snapshot(None, None, status, None, False, (), 0, past=past)


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


def test_the_scene_shown_is_the_one_that_runs_and_a_users_own_is_offered_too(server: viser.ViserServer) -> None:
    controls = FakeControls()
    panel = ControlPanel(server.gui, controls, lambda position: None, lambda starting: None)
    for number, (words, label) in enumerate((("box", "box"), (SCENES["mesh"], "mesh"), ("mine:pillow", "mine:pillow"))):
        shown = snapshot("pspm", "hapnet")
        about = {**shown.device_status.about, "params": {"scene": words}}
        panel.update(replace(shown, device_status=replace(shown.device_status, about=about, incarnation=number)))
        assert panel._scene.value == label
    assert list(panel._scene.options) == [*SCENES, "mine:pillow"]
    assert {"free", "wall", "box", "sphere", "mesh", "dominoes", "planet"} == set(SCENES)


def test_the_page_has_the_total_time_without_force_as_long_as_the_pair_runs(server: viser.ViserServer) -> None:
    numbers, account = Numbers(server.gui), {"ledger.margin_J": 0.1, "ledger.bound_J": 0.1}
    for seconds, shown in ((42.031, True), (0.0, False)):
        servo = {"servo.overruns": 402, "servo.without_force_s": seconds}
        device, world = (
            Status(role, 0, 1, True, False, "", {"coupling": "pspm"}, {}, {}, {**account, **more})
            for role, more in (("device", servo), ("world", {}))
        )
        both = Snapshot(None, None, device, world, True, (), 2, summary=present(device, world, {}))
        numbers.update(both, "running", (), fresh=True)
        assert ("time without force" in numbers._more.content) == shown
        assert ("42.0 s" in numbers._more.content) == shown


@pytest.mark.parametrize(("name", "size", "says"), [
    ("notes.txt", 10, "a mesh"), ("model.xml", 10, "a mesh"), ("large.stl", LARGEST_FILE + 1, "at most 32 MB"),
])  # fmt: skip
def test_only_a_mesh_is_taken_for_a_world(name: str, size: int, says: str, server: viser.ViserServer) -> None:
    controls = FakeControls()
    panel = ControlPanel(server.gui, controls, lambda position: None, lambda starting: None)
    with pytest.raises(InvalidParameter, match=says):
        panel._take_file(name, b"x" * size)
    panel._take_file("Ring.OBJ", b"v 0 0 0")
    assert controls.calls == [("mesh", "Ring.OBJ", 7)]


def test_what_the_other_host_decides_is_shown_and_cannot_be_changed(server: viser.ViserServer) -> None:
    controls = FakeControls()
    controls.fixed = "elsewhere"
    panel = ControlPanel(server.gui, controls, lambda position: None, lambda starting: None)
    panel.update(snapshot("wave", "hapnet"))
    assert panel._choice.value == "wave"
    assert panel._choice.disabled
    assert panel._scene.disabled
    assert panel._up.folder.label == "link, device to world"
    assert not panel._down.folder.visible
    assert not panel._record.visible
    assert list(panel._directions_of_first()) == ["up"]


def test_every_coupling_can_be_chosen_and_is_said_in_words() -> None:
    assert {coupling for coupling, _ in CHOICES.values()} == set(COUPLING_NAMES)
    assert list(CHOICES)[:3] == ["hapnet", "paper", "zoh"]
    assert all(words_of(label) for label in CHOICES)


def test_the_page_says_how_stiff_the_wall_is_felt(server: viser.ViserServer) -> None:
    shown = snapshot("pspm", "hapnet")
    numbers = Numbers(server.gui)
    numbers.update(shown, "running")
    assert "felt" not in numbers._more.content
    shown.device_status.about["felt"] = {"stiffness_N_m": 3000.0, "felt_stiffness_N_m": 85.7142, "springs_N_m": ()}
    numbers.update(shown, "running")
    assert "wall3000 N/m, felt as 85.71 N/m" in re.sub("<[^>]*>", "", numbers._more.content)
    shown.device_status.about["felt"] = "hard"
    numbers.update(shown, "running")
    assert "felt as" not in numbers._more.content


def test_each_pair_keeps_its_own_verdict(server: viser.ViserServer) -> None:
    """One that was not passive is still said when another coupling runs, and passive is not said of it."""

    past = (
        Episode("zoh", "paper", {"passive": False, "reason": "margin -0.2 mJ"}),
        Episode("pspm", "hapnet", {"passive": True, "reason": "at most 12 mJ ever came out"}),
    )
    numbers = Numbers(server.gui)
    numbers.update(snapshot("wave", "hapnet", past), "running")
    text = re.sub("<[^>]*>", "", numbers._html.content)
    assert "before: zoh NOT passive · hapnet passive" in text
    assert "wave: wave variables" in text
