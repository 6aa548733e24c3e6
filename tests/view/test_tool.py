"""A tool that turns on the page: what is shown of its point, and its torque."""

import math

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet.ext.page.bodies import HandleTool
from hapnet.ext.page.force import force_now, torque_now
from hapnet.ext.page.history import History, of_point
from hapnet.ext.tools.device import TurningHand, turned
from hapnet.mechanics.pose import ARM_M, AXES, along_coordinates
from hapnet.plant.live_hand import LiveHand
from hapnet.plant.operator import Impedance
from hapnet.plant.worlds.picture import part
from hapnet.recording.drawing import SceneSample
from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.recording.telemetry import Status

PLACE, FORCE, TORQUE = (0.01, -0.02, 0.03), (0.3, 0.0, -0.4), (0.0, 0.012, -0.016)
POSE = turned(PLACE, (0.0, 0.0, math.pi / 3.0))


def history(units: str) -> History:
    """Of one sample at `POSE`, with `FORCE` and `TORQUE` on the hand."""
    found = History()
    about = {"params": {"units": units}, "scene": "tool:stick"}
    found.take(Status("device", 0, 1, True, False, "", about, {}, {}))
    force = along_coordinates(POSE, FORCE, TORQUE, ARM_M)
    sample = DeviceSample(1, POSE, POSE, POSE, force, None, *[0.0] * 7, spring_force_N=force)
    found.take(sample)
    return found


def test_of_a_pose_the_page_plots_its_point() -> None:
    whole = history("pose").snapshot()
    assert whole.device is not None
    point = of_point(whole).device
    assert point.position_m.tolist() == [list(PLACE)]
    assert point.parts_N.shape == (1, 4, 3)
    assert force_now(point)[0] == ("force on the hand", "0.50 N")
    assert torque_now(whole.device) == "20 mNm"
    plain = history("auto").snapshot()
    assert of_point(plain) is plain


def test_the_handle_lies_at_the_devices_pose() -> None:
    viser = pytest.importorskip("viser")
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        nodes = {}
        add = server.scene.add_frame
        server.scene.add_frame = lambda name, **more: nodes.setdefault(name, add(name, **more))
        surfaces = []
        server.scene.add_mesh_simple = lambda name, vertices, *_, **more: surfaces.append(vertices)
        tool = HandleTool(server.scene, [part([[k, 0, 0]] * 3, [[0, 1, 2]], body=k) for k in (0, 1)], 100.0)
        shown = history("pose")
        shown.take(WorldSample(1, 0.01, POSE, *[(0.0,) * AXES] * 5, *[0.0] * 7))
        shown.take(SceneSample(1, np.array([0, 0, 0, 1, 0, 0, 0, *PLACE, 1, 0, 0, 0], "<f4").tobytes(), b"", b""))
        for _ in range(2):
            tool.update(shown.snapshot())
        assert [vertices[0].tolist() for vertices in surfaces] == [[100.0, 0.0, 0.0]]  # of the second body, and once
        assert nodes["/tool"].position == pytest.approx([1.0, -2.0, 3.0])
        assert nodes["/tool"].wxyz == pytest.approx([math.cos(math.pi / 6.0), 0.0, 0.0, math.sin(math.pi / 6.0)])
        assert nodes["/tool"].visible
    finally:
        server.stop()


def test_a_mouse_moves_a_tool_and_does_not_turn_it() -> None:
    mouse = LiveHand((0.0, 0.0, 0.0), Impedance(), 0.01)
    hand = TurningHand(mouse, 0.5, 1.0)
    mouse.lead((0.02, 0.0, 0.0))
    for k in range(1, 1001):
        x = hand.reference(1e-3 * k)
    assert x[:3] == pytest.approx((0.02, 0.0, 0.0), abs=1e-9)
    assert np.abs(x[3:]).max() < 1e-15
    mouse.place(POSE)
    assert hand.reference(1.0)[:3] == PLACE
