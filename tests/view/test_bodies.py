"""The page draws what a world looks like: surfaces are sent once, then only what moves; contacts with their cones."""

import math

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser
import viser.transforms

from hapnet.ext.page.bodies import Bodies
from hapnet.ext.page.contacts import ContactMarks, cone
from hapnet.ext.page.history import History
from hapnet.plant.worlds.picture import RESTS, SOFT, Touch, part
from hapnet.recording.drawing import Drawing, SceneSample, pack
from hapnet.recording.telemetry import Status

CORNERS, TRIANGLES = np.eye(3), [(0, 1, 2)]
PARTS = (
    part(CORNERS, TRIANGLES, (1, 2, 3, 255), RESTS),
    part(CORNERS, TRIANGLES, (1, 2, 3, 100), 0),
    part(CORNERS, TRIANGLES, (1, 2, 3, 255), SOFT),
    part(2.0 * CORNERS, TRIANGLES, (1, 2, 3, 255), SOFT),
)


def reported(poses: list[list[float]], soft: object = ()) -> SceneSample:
    return SceneSample(1, np.array(poses, "<f4").tobytes(), b"", np.array(soft, "<f4").tobytes())


def test_a_surface_is_sent_once_and_its_body_only_where_it_has_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    server = viser.ViserServer(port=0, verbose=False)
    bodies = Bodies(server.scene, PARTS, 100.0)
    sent: list[object] = []
    interface = server.scene._websock_interface
    monkeypatch.setattr(interface, "queue_message", sent.append)
    pose = [0.01, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    soft = np.concatenate([CORNERS, 3.0 * CORNERS])
    bodies.update(reported([pose], soft))
    assert {type(message).__name__ for message in sent} >= {"SetPositionMessage"}
    assert bodies._frames[0].position == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert [handle.vertices.max() for handle, _ in bodies._soft] == [100.0, 300.0]
    sent.clear()
    pose[0] += 1e-8  # as of what lies still in a simulation
    bodies.update(reported([pose]))
    assert sent == []
    pose[3:] = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    bodies.update(reported([pose]))
    assert 0 < len(sent) <= 2
    assert not any("Mesh" in type(message).__name__ for message in sent)
    bodies.update(reported([]))  # fewer than there are
    server.stop()


def test_a_friction_cone_stands_on_the_contact_and_opens_by_mu() -> None:
    """A force on the cone's edge ends on the rim of its base, one within it inside."""
    server = viser.ViserServer(port=0, verbose=False)
    marks = ContactMarks(server.scene, 100.0, 1.0)
    mu, normal = 0.5, (0.6, 0.0, -0.8)
    along, across = np.array(normal), np.array((0.8, 0.0, 0.6))
    force = 2.0 * along + mu * 2.0 * across
    marks.update([Touch((0.01, 0.02, 0.03), normal, mu, tuple(force))])
    (drawn,) = marks._marks
    turn = viser.transforms.SO3(np.array(drawn.cone.wxyz))
    rim = np.array([turn @ (np.array(drawn.cone.scale) * vertex) for vertex in cone()[0][1:]]) + drawn.cone.position
    tip = np.array(drawn.arrow.points)[0, 1]
    assert drawn.cone.position == pytest.approx((1.0, 2.0, 3.0))
    assert np.linalg.norm(rim - tip, axis=1).min() == pytest.approx(0.0, abs=0.11)  # between two of its 32 corners
    assert (rim - drawn.cone.position) @ along == pytest.approx(np.full(len(rim), 2.0))
    assert np.linalg.norm(rim - tip, axis=1).max() == pytest.approx(2.0 * mu * 2.0, rel=0.01)
    marks.update([Touch((0.0, 0.0, 0.0), normal, 0.0, (0.0, 0.0, 0.0))])
    assert (drawn.point.visible, drawn.cone.visible, drawn.arrow.visible) == (True, False, False)
    marks.update([])
    assert not drawn.point.visible
    server.stop()


def status(incarnation: int, scene: str) -> Status:
    return Status("world", 1, incarnation, True, False, "", {"scene": scene}, {}, {})


def test_the_same_drawing_is_unpacked_once_and_another_scene_forgets_it() -> None:
    history = History()
    history.take(status(1, "sphere"))
    history.take(Drawing(1, pack(PARTS)))
    history.take(reported([]))
    parts = history.snapshot().parts
    assert len(parts) == 4
    history.take(Drawing(9, pack(PARTS)))
    history.take(status(2, "sphere"))
    assert history.snapshot().parts is parts
    assert history.snapshot().scene is None  # of the pair before
    history.take(status(3, "cuboid"))
    assert history.snapshot().parts is None
