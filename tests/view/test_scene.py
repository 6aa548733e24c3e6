"""Geometry of the 3-D part."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser
import viser.transforms

from hapnet.ext.arms.picture import ArmPicture, described
from hapnet.ext.arms.table import omni
from hapnet.ext.page.cameras import view_of
from hapnet.ext.page.contacts import turned_to
from hapnet.ext.page.history import Snapshot, Track
from hapnet.ext.page.marks import PROXY_RADIUS, THIN, UNIT, coil
from hapnet.ext.page.scene import PageScene
from hapnet.ext.solids.mesh_surface import volume
from hapnet.ext.solids.outlines import cylinder
from hapnet.ext.solids.rigid import parts_of_words
from hapnet.ext.solids.shapes import Cylinder
from hapnet.mechanics.curvature import Curvature
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import part
from tests.support.solids import torus, write_stl


def test_the_spring_is_turned_to_where_it_leads() -> None:
    rng = np.random.default_rng(2)
    directions = [*np.eye(3), *-np.eye(3), *rng.normal(size=(100, 3))]
    for direction in directions:
        unit = direction / np.linalg.norm(direction)
        turned = viser.transforms.SO3(turned_to(unit)) @ np.array([1.0, 0.0, 0.0])
        np.testing.assert_allclose(turned, unit, atol=1e-9)


@pytest.mark.parametrize("normal", [(1.0,), (0.6, -0.8), (0.0, 0.0, 1.0)])
def test_a_plane_that_the_device_knows_lies_where_a_wall_of_its_place_does(normal: tuple[float, ...]) -> None:
    """Its near face is the proxy's radius behind the plane, and across its normal; what is no longer sent is hidden."""
    server = viser.ViserServer(port=0, verbose=False)
    scene = PageScene(server, len(normal), [], None)
    still = Snapshot(None, None, None, None, False, (), 0)
    scene.update(replace(still, planes=(Plane(normal, 0.02, 3000.0, 10.0),)))
    first, *others = scene._planes.nodes
    assert [first.visible, *(other.visible for other in others)] == [True, False, False, False]
    along = np.zeros(3)
    along[: len(normal)] = normal
    turned = viser.transforms.SO3(np.array(first.wxyz)) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, along, atol=1e-9)
    assert np.dot(first.position, along) - THIN / 2.0 == pytest.approx(0.02 * UNIT + PROXY_RADIUS)
    for planes in ((), None):
        scene.update(replace(still, planes=planes))
        assert not any(node.visible for node in scene._planes.nodes)
    server.stop()


def test_a_plane_of_a_ball_is_a_small_piece_where_the_proxy_is() -> None:
    """Of a ball of 50 mm it reaches 10 mm far, where the ball is 1 mm behind it. Then it is flat and whole again."""
    server = viser.ViserServer(port=0, verbose=False)
    scene = PageScene(server, 2, [], None)
    plane = Plane((1.0, 0.0), 0.02, 3000.0, 10.0, 0.0, (Curvature((0.0, 1.0), 20.0),))
    scene._planes.show((plane,), np.array((1.5, 3.0, 0.0)))
    (node, *_) = scene._planes.nodes
    np.testing.assert_allclose(node.position, (0.02 * UNIT + PROXY_RADIUS + THIN / 2.0, 3.0, 0.0))
    sizes = np.array(node.dimensions) * node.scale
    assert sizes[1] == pytest.approx(2.0 * 0.01 * UNIT)
    scene._planes.show((plane._replace(curvatures=()),), np.array((1.5, 3.0, 0.0)))
    assert node.position[1] == 0.0
    assert tuple(node.scale) == (1.0, 1.0, 1.0)
    server.stop()


def test_the_solids_of_a_rigid_scene_are_drawn_and_where_a_wall_is_touched(tmp_path: Path) -> None:
    file = write_stl(tmp_path / "torus.stl", *torus(24, 12))
    words = f"sphere + mesh:{file}?unit=mm + plane + cuboid + cylinder?axis=y + sphere?relief=0.3mm,4mm"
    server = viser.ViserServer(port=0, verbose=False)
    parts = parts_of_words(words)
    assert len(parts) == 6
    scene = PageScene(server, 3, [], None, parts=parts)
    still = Snapshot(None, None, None, None, False, (), 0)
    many, none = np.zeros((1, 3)), np.zeros(1)
    place, force = np.array([[0.021, 0.0, 0.0]]), np.array([[-3.0, 0.0, 0.0]])
    world = Track(none, place, many, force, np.zeros((1, 0, 3)), none + 1e-3, none, none)
    scene.update(replace(still, world=world))
    assert scene._touch.visible
    np.testing.assert_allclose(scene._touch.position, (0.020 * UNIT, 0.0, 0.0), atol=1e-9)  # on the surface
    scene.update(replace(still, world=replace(world, penetration_m=none)))
    assert not scene._touch.visible
    server.stop()


@pytest.mark.parametrize("by_joints", [False, True])
def test_an_arms_links_are_drawn_where_they_are(by_joints: bool) -> None:
    """Joint by joint the tip stands for the handle, and torques are no arrow in space."""
    server = viser.ViserServer(port=0, verbose=False)
    arm = ArmPicture(described(omni(), by_joints))
    scene = PageScene(server, 3, [{"axis": 0, "solid": 1, "position_m": 0.02}], None, arm=arm)
    still = Snapshot(None, None, None, None, False, (), 0)
    none, at = np.zeros(1), np.array([[0.02, -0.01, 0.03]])
    device = Track(none, at, at, np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 4, 3)), none, none, none)
    posture = (0.4, 0.1, -0.3)
    scene.update(replace(still, device=device, posture=() if by_joints else posture))
    poses = arm.poses([a + b for a, b in zip(omni().home, at[0].tolist(), strict=True)] if by_joints else posture)
    for body, frame in scene._links._frames.items():
        np.testing.assert_allclose(frame.position, UNIT * poses[body, :3], atol=1e-9)
        np.testing.assert_allclose(frame.wxyz, poses[body, 3:], atol=1e-9)
    np.testing.assert_allclose(scene._handle.position, UNIT * np.array(arm.tip(at[0].tolist())), atol=1e-9)
    assert scene._force.arrow.visible is not by_joints
    server.stop()


def test_solids_that_cannot_be_made_here_are_not_drawn() -> None:
    for words in ("wall", "mesh:not_here.stl?unit=mm", "tests.plant.worlds.test_scene:Own", None, 3):
        assert parts_of_words(words) == ()


def test_a_cylinder_is_drawn_as_it_is() -> None:
    for axis in range(3):
        shape = Cylinder((0.01, 0.02, 0.03), 0.005, 0.02, axis)
        vertices, triangles = cylinder(shape)
        assert all(abs(shape.near(tuple(vertex)).distance_m) < 1e-12 for vertex in vertices.tolist())
        assert volume(vertices, triangles) == pytest.approx(np.pi * 0.005**2 * 0.02, rel=0.02)


def test_the_coil_is_one_line_from_end_to_end() -> None:
    spring = coil()
    assert spring[0, 0].tolist() == [0.0, 0.0, 0.0]
    assert spring[-1, 1].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(spring[1:, 0], spring[:-1, 1])


def test_with_three_axes_the_cameras_see_the_solids_beside_the_hand() -> None:
    """A ring from x = 20 to 104 mm, which is cut at 100, and 30 mm on the other side of the hand."""
    middle, distance = view_of([part([(0.02, 0.0, 0.0), (0.104, 0.0, 0.0)], [(0, 0, 1)])])
    assert middle == pytest.approx((3.5, 0.0, 0.0))
    assert distance == pytest.approx(24.0 * 13.0 / 10.0)
    server = viser.ViserServer(port=0, verbose=False)
    for dof, parts in ((1, ()), (3, ())):
        PageScene(server, dof, [], None, parts=parts)
        assert server.initial_camera.look_at == pytest.approx((0.0, 0.0, 0.0))
        assert np.linalg.norm(server.initial_camera.position) == pytest.approx(24.0)
    server.stop()


@pytest.mark.parametrize("dof", [1, 3])
def test_it_can_be_seen_from_the_front_again(dof: int) -> None:
    server = viser.ViserServer(port=0, verbose=False)
    scene, camera = PageScene(server, dof, [], None), server.initial_camera
    front = np.array([camera.position, camera.look_at])
    camera.position, camera.look_at = np.array([9.0, 8.0, 7.0]), np.ones(3)
    scene.cameras.look(camera)
    np.testing.assert_array_equal([camera.position, camera.look_at], front)
    server.stop()


def test_names_stay_apart() -> None:
    """Each name is on the side where the other ball is not."""
    server = viser.ViserServer(port=0, verbose=False)
    scene = PageScene(server, 1, [], None)
    still, none = np.zeros((1, 1)), np.zeros(1)
    proxy = Track(none, still, still, still, np.zeros((1, 0, 1)), none, none, none)
    for handle_m, anchors in ((0.03, ["top-left", "top-right"]), (-0.03, ["top-right", "top-left"])):
        handle = replace(proxy, position_m=np.array([[handle_m]]))
        scene.update(Snapshot(handle, proxy, None, None, False, (), 0))
        assert [name.anchor for name in scene._names.labels] == anchors
    server.stop()
