"""The page's buttons and switches, without a browser."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser

from hapnet.params import Params
from hapnet.recording.telemetry import Status
from hapnet.view.history import Snapshot
from hapnet.view.panel import ControlPanel
from tests.view.feed import FakeControls


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(port=0, verbose=False)
    yield server
    server.stop()


def snapshot(coupling: str) -> Snapshot:
    about = {"coupling": coupling, "params": Params().as_dict()}
    status = Status("device", 0, 1, True, False, "", about, {"profile": ""}, {})
    return Snapshot(None, None, status, None, False, None, None, (), 0)


@pytest.mark.parametrize(
    ("coupling", "on"), [("pspm", True), ("zoh", False), ("popc", False), ("examples.own_law:Mine", False)]
)
def test_the_switch_is_on_if_the_coupling_limits_set_positions(
    coupling: str, on: bool, server: viser.ViserServer
) -> None:
    controls = FakeControls()
    panel = ControlPanel(server.gui, controls, lambda position: None, lambda starting: None)
    panel.update(snapshot("zoh" if on else "pspm"))
    panel.update(snapshot(coupling))
    assert panel._pspm.value is on
    panel._couple(False)
    panel._couple(True)
    assert controls.named("coupling") == [("zoh" if on else coupling,), ("pspm",)]
