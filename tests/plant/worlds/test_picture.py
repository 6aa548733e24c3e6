"""What a world looks like, as recordings and telemetry show it: against shapes and motions that are known."""

import zlib
from contextlib import suppress
from math import cos, hypot, pi, sin
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet import ForceWorld, Obstacle, Params, simulate
from hapnet.errors import BadMessage
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.engines.mujoco_engine import mujoco_world
from hapnet.ext.solids.rigid import rigid
from hapnet.ext.solids.shapes import Sphere
from hapnet.ext.solids.shapes_picture import ShapesPicture
from hapnet.mechanics.plane import Plane
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.picture import RESTS, SOFT, Part, Touch, shared
from hapnet.realtime.telemetry_publisher import TelemetryPublisher
from hapnet.recording.drawing import LARGEST, Drawing, SceneSample, observe, pack, unpack
from hapnet.recording.mcap import read_recording, repair, save
from hapnet.recording.samples import Recording, join
from hapnet.recording.telemetry import VERSION, decode, encode

TURN_S = 2.0


def circling(*, dof: int = 2) -> ForceWorld:
    """A ball on a circle, which a proxy at the origin never meets, and one that rests."""

    def none(position: object, velocity: object, time: float) -> list[float]:
        return [0.0] * dof

    def circle(time: float) -> list[float]:
        return [0.04 * cos(2.0 * pi * time / TURN_S), 0.04 * sin(2.0 * pi * time / TURN_S), 0.0][:dof]

    ball = Sphere((0.0, 0.0, 0.0), 0.01)
    return ForceWorld([Obstacle(none, shape=ball), Obstacle(none, motion=circle, shape=ball), Obstacle(none)], dof=dof)


@pytest.fixture(scope="module")
def recording() -> Recording:
    params = Params().set({"scene": f"{__name__}:circling", "dof": 2, "operator": "rest", "duration_s": 1.0})
    return simulate(params, seed=1).recording


def test_an_obstacle_that_moves_is_recorded_where_its_script_puts_it(recording: Recording) -> None:
    skippable_ticks, moving = unpack(recording.drawing.data)
    assert (skippable_ticks.body, moving.body) == (RESTS, 0)
    assert np.linalg.norm(moving.vertices, axis=1) == pytest.approx(0.01, rel=1e-5)
    assert len(recording.scene) > 20
    lengths = np.concatenate([[0.0], np.cumsum(recording.world["step_s"])])
    times = [0.0, *recording.world["time_ns"].tolist()]
    for sample in recording.scene:
        time = float(lengths[times.index(sample.time_ns)])
        turn = 2.0 * pi * time / TURN_S
        ((*place, z, w, a, b, c),) = sample.bodies().tolist()
        assert place == pytest.approx([0.04 * cos(turn), 0.04 * sin(turn)], abs=1e-6)
        assert (z, w, a, b, c) == (0.0, 1.0, 0.0, 0.0, 0.0)


def test_a_file_holds_it_torn_repaired_or_joined(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    save(recording, path)
    for file in (path, repair(path)):
        found = read_recording(file)
        assert (found.scene, found.drawing) == (recording.scene, recording.drawing)
    device = Recording({**recording.meta, "role": "device"}, recording.device, None, [], None)
    world = Recording({**recording.meta, "role": "world"}, None, recording.world, [], None, False,
                      recording.scene, recording.drawing)  # fmt: skip
    both = join(device, world)
    assert (both.scene, both.drawing) == (recording.scene, recording.drawing)
    save(both, path)
    assert read_recording(path).scene == recording.scene


def test_a_contact_of_a_rigid_scene_is_on_the_surface_with_a_force_in_its_friction_cone() -> None:
    """A proxy that slides along a plane x = 10 mm: Coulomb's law puts the force on the cone's rim."""
    scene = rigid("plane?normal=1,0,0&at=10mm,0,0&friction=0.4", dof=3)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    mass.set_contacts(scene.contacts)
    for step in range(400):
        done = mass.step(1e-3, (0.015, 0.1 * 1e-3 * step, 0.0), scene.contacts)
    (touch,) = observe(scene.picture(), 5, done.position, done.force).contacts()
    assert touch.point == pytest.approx((0.010, done.position[1], 0.0), abs=1e-8)
    assert touch.normal == pytest.approx((-1.0, 0.0, 0.0))
    assert touch.friction == pytest.approx(0.4)
    along, across = -touch.force_N[0], hypot(*touch.force_N[1:])
    assert along > 1.0
    assert across == pytest.approx(0.4 * along, rel=0.02)
    assert observe(scene.picture(), 5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).contacts() == []


@given(pushes=st.lists(st.floats(0.0, 5.0), min_size=2, max_size=3), seed=st.integers(0, 99))
def test_contacts_without_friction_share_a_force_as_they_made_it(pushes: list[float], seed: int) -> None:
    """Independent normals: there is one way to make the force of pushes along them."""
    frame = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    normals = [tuple(row) for row in frame[: len(pushes)].tolist()]
    force = tuple((np.array(pushes) @ np.array(normals)).tolist())
    touches = shared(force, [((0.0, 0.0, 0.0), normal, 0.0) for normal in normals])
    for touch, normal, push in zip(touches, normals, pushes, strict=True):
        assert touch.force_N == pytest.approx([push * part for part in normal], abs=1e-6)


MODEL = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  .02 0 0  0 .04 0  0 0 .06"/>
    <hfield name="ground" nrow="2" ncol="3" size=".03 .02 .01 .001" elevation="0 .5 0  1 0 0"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="ground" pos="0.5 0 0"/>
    <geom type="mesh" mesh="wedge" pos="0.7 0 0" density="0"/>
    <geom type="plane" size="0 0 1" pos="0 0 -0.02" friction="0.7"/>
    <geom type="sphere" size="0.01" pos="0 0 9" rgba="1 0 0 0"/>
    <geom type="sphere" size="0.01" pos="0 0 9" group="4"/>
    <body pos="0.2 0.1 0.03" euler="0 0 90">
      <joint type="hinge" axis="0 0 1"/>
      <geom type="box" size="0.01 0.02 0.03" pos="0.05 0 0" rgba="1 0 0 1"/>
      <geom type="capsule" size="0.01 0.02"/><geom type="cylinder" size="0.01 0.02"/>
      <geom type="ellipsoid" size="0.01 0.02 0.03"/>
    </body>
    <flexcomp name="soft" type="grid" count="3 3 3" spacing=".01 .01 .01" pos="0.3 0 0.1"
      radius=".001" dim="3" mass="0.1">
      <elasticity young="1e4" poisson="0.1" damping="0.01"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def model(tmp_path: Path) -> EngineWorld:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    file = tmp_path / "model.xml"
    file.write_text(MODEL, "utf-8")
    return mujoco_world(f"mujoco:{file}?at=0,0,0.005", dof=3)


def placed(part: Part, poses: np.ndarray) -> np.ndarray:
    """The part's vertices in the scene, turned by Rodrigues' formula of its quaternion."""
    if part.body < 0:
        return part.vertices
    place, w, v = poses[part.body, :3], poses[part.body, 3], poses[part.body, 4:]
    crossed = 2.0 * np.cross(v, part.vertices)
    return np.asarray(part.vertices + w * crossed + np.cross(v, crossed) + place)


def test_a_models_geoms_are_where_the_engine_has_them(model: EngineWorld) -> None:
    """In the frame of the hand, which begins 5 mm above the model's origin; invisible ones are left out."""
    picture = model.picture()
    ground, wedge, plane, box, capsule, cylinder, ellipsoid, ball, soft = picture.parts
    poses = picture.poses()
    assert plane.body == RESTS
    assert plane.vertices[:, 2].max() == pytest.approx(-0.025)
    low_high = {"box": box, "capsule": capsule, "cylinder": cylinder, "ellipsoid": ellipsoid, "ball": ball}
    sizes = {name: np.ptp(placed(part, poses), axis=0).tolist() for name, part in low_high.items()}
    assert sizes["box"] == pytest.approx([0.04, 0.02, 0.06], abs=1e-6)  # turned by a quarter
    assert sizes["capsule"] == pytest.approx([0.02, 0.02, 0.06], abs=2e-4)
    assert sizes["cylinder"] == pytest.approx([0.02, 0.02, 0.04], abs=2e-4)
    assert sizes["ellipsoid"] == pytest.approx([0.04, 0.02, 0.06], abs=2e-4)
    assert placed(box, poses).mean(axis=0) == pytest.approx([0.2, 0.15, 0.025], abs=1e-6)
    assert placed(ball, poses).mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    heights = [[-0.03, -0.02, 0.01], [0.0, -0.02, 0.0], [0.03, -0.02, 0.0],  # as MuJoCo's rays meet them
               [-0.03, 0.02, 0.0], [0.0, 0.02, 0.005], [0.03, 0.02, 0.0]]  # fmt: skip
    by_place = ground.vertices[np.lexsort(ground.vertices.T[:2])]
    assert by_place == pytest.approx(np.add(heights, (0.5, 0.0, -0.005)), abs=1e-6)
    assert len(wedge.triangles) == 4
    assert np.ptp(wedge.vertices, axis=0) == pytest.approx([0.02, 0.04, 0.06], abs=1e-6)
    assert wedge.vertices.min(axis=0) == pytest.approx([0.7, 0.0, -0.005], abs=1e-6)
    assert box.color == (255, 0, 0, 255)
    assert ball.color[3] < 255  # one sees the contact through it
    assert soft.body == SOFT
    assert len(soft.vertices) == 27
    assert picture.soft() == pytest.approx(soft.vertices, abs=1e-6)
    assert picture.soft().mean(axis=0) == pytest.approx([0.3, 0.0, 0.095], abs=1e-6)
    assert soft.triangles.max() < 27


def test_a_models_contact_is_under_the_sphere_with_the_friction_of_what_it_touches(model: EngineWorld) -> None:
    """The sphere of 5 mm is pressed down onto the plane, whose mu is 0.7."""
    mass, before = model.proxy(0.05, 14.0, 500.0), model.picture()
    for _ in range(200):
        done = mass.step(2e-3, (0.0, 0.0, -0.03))
    (touch,) = observe(model.picture(), 5, done.position, done.force).contacts()
    assert touch.point == pytest.approx((0.0, 0.0, -0.025), abs=3e-3)
    assert touch.normal == pytest.approx((0.0, 0.0, 1.0))
    assert touch.friction == pytest.approx(0.7)
    assert touch.force_N[2] == pytest.approx(500.0 * (done.position[2] + 0.03), rel=0.05)
    assert before.soft()[:, 2].mean() < before.parts[-1].vertices[:, 2].mean() - 0.01  # what is soft has fallen


def test_a_body_is_touched_from_its_surface_on() -> None:
    flat = Plane((0.0, 0.0, -1.0), 0.0, 100.0, 0.0, friction=0.4)
    picture = ShapesPicture((), lambda: (), lambda position, reach_m: (flat,))
    (touch,) = picture.touches((0.01, 0.0, 0.0), (0.0, 0.0, 2.0))
    assert touch == Touch((0.01, 0.0, 0.0), (0.0, 0.0, 1.0), 0.4, (0.0, 0.0, 2.0))
    assert picture.touches((0.01, 0.0, 1e-9), (0.0, 0.0, 2.0)) == []


PARTS = rigid("sphere + cuboid").picture().parts
SCENE = SceneSample(7, np.arange(14, dtype="<f4").tobytes(), np.arange(10, dtype="<f4").tobytes(), b"")
DRAWING = Drawing(3, pack(PARTS))


def test_what_is_told_is_what_is_read() -> None:
    for message in (SCENE, DRAWING):
        assert decode(encode(message)) == message
    for reported, part in zip(unpack(DRAWING.data), PARTS, strict=True):
        assert reported.vertices == pytest.approx(part.vertices)
        assert (reported.triangles == part.triangles).all()
        assert reported[2:] == part[2:]
    assert SCENE.contacts() == [Touch((0.0, 1.0, 2.0), (3.0, 4.0, 5.0), 6.0, (7.0, 8.0, 9.0))]


def test_a_picture_that_is_too_large_is_not_told() -> None:
    rng = np.random.default_rng(1)
    vertices = rng.normal(size=(LARGEST // 8, 3)).astype(np.float32)  # random bytes cannot be compressed
    part = PARTS[0]._replace(vertices=vertices)
    assert pack((part,)) == b""


_PART = (bytes(36), bytes(12), (1, 2, 3, 255), RESTS, True)


@pytest.mark.parametrize(
    "frame",
    [
        [VERSION, "scene", 1, b"123", b"", b""],
        [VERSION, "scene", 1, np.full(7, np.nan, "<f4").tobytes(), b"", b""],
        [VERSION, "scene", 2**63, b"", b"", b""],
        [VERSION, "scene", 1, b"", b""],
        [VERSION, "drawing", 1, b"nothing"],
        [VERSION, "drawing", 1, bytes(LARGEST + 100)],
        *(
            [VERSION, "drawing", 1, zlib.compress(msgpack.packb(parts))]
            for parts in (
                3,
                [3],
                [(bytes(35), *_PART[1:])],
                [(np.full(9, np.inf, "<f4").tobytes(), *_PART[1:])],
                [(_PART[0], np.array([0, 1, 3], "<u4").tobytes(), *_PART[2:])],
                [(*_PART[:2], (1, 2, 3), *_PART[3:])],
                [(*_PART[:2], (1, 2, 3, 256), *_PART[3:])],
                [(*_PART[:3], -3, True)],
            )
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(frame: list[object]) -> None:
    with pytest.raises(BadMessage):
        decode(msgpack.packb(frame))


@given(data=st.binary(max_size=100), at=st.integers(0, 10**6), value=st.integers(0, 255))
def test_any_bytes_are_parts_or_are_refused(data: bytes, at: int, value: int) -> None:
    flipped = bytearray(encode(DRAWING))
    flipped[at % len(flipped)] = value
    for some in (msgpack.packb((VERSION, "drawing", 1, zlib.compress(data))), bytes(flipped)):
        with suppress(BadMessage):
            decode(some)


def test_only_the_newest_scene_is_published_and_nothing_twice() -> None:
    sent: list[bytes] = []
    publisher = TelemetryPublisher(60.0, sent.append, lambda: pytest.fail("no status is due"))
    for time_ns in (1, 2, 3):
        publisher.keep(SCENE._replace(time_ns=time_ns))
    publisher.publish()
    publisher.publish()
    assert [decode(one) for one in sent] == [SCENE._replace(time_ns=3)]
