"""What a MuJoCo scene sends the device: planes from its geometry, stiffness from rest; how that renders."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.engines.engine_world import EngineMass, EngineWorld
from hapnet.ext.engines.mujoco_engine import mujoco_world
from hapnet.mechanics.plane import Plane
from tests.conftest import mostly_slow
from tests.plant.worlds.test_mujoco import check, over_a_link
from tests.support.mujoco_models import BALL, BLOCK, BOX, DOOR, FLEX, found_of, model

pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")

SMOOTH = 'condim="1" priority="1"'
RADIUS = 0.005


def made(folder: Path, content: str, dof: int = 3, more: str = "") -> tuple[EngineWorld, EngineMass]:
    """A world without a floor, with the sphere at the origin of the hand's coordinates and 0.1 m over the model's."""
    path = folder / "m.xml"
    path.write_text(f'<mujoco><option timestep="0.002"/><worldbody>{content}</worldbody></mujoco>')
    world = mujoco_world(f"mujoco:{path}?at=0,0,0.1{more}", dof=dof)
    return world, world.proxy(0.02, 14.0, 500.0)


def pressed(mass: EngineMass, goal: tuple[float, ...], seconds: float = 1.0) -> None:
    for _ in range(round(seconds / 0.01)):
        mass.step(0.01, goal)


def only(world: EngineWorld, position: tuple[float, ...]) -> Plane:
    (plane,) = world.planes(position, 0.05) or ()
    return plane


ROUND = {  # with the centre at (0.05, 0, 0), and its radii across (0, 1, 0) and (0, 0, 1); 0: straight
    "sphere": ('type="sphere" size=".03"', (0.03, 0.03)),
    "capsule": ('type="capsule" size=".03 .04"', (0.03, 0.0)),
    "cylinder": ('type="cylinder" size=".03 .04"', (0.03, 0.0)),
    "ellipsoid": ('type="ellipsoid" size=".03 .05 .02"', (0.05**2 / 0.03, 0.02**2 / 0.03)),
    "box": ('type="box" size=".03 .05 .02"', (0.0, 0.0)),
}


@pytest.mark.parametrize("kind", ROUND)
@pytest.mark.parametrize("touching", [False, True])
def test_the_planes_are_those_of_the_geoms(kind: str, touching: bool, tmp_path: Path) -> None:
    """Straight ahead of its middle: each surface is 20 mm away, less the sphere's radius; its radii grow by that."""
    geom, radii = ROUND[kind]
    world, mass = made(tmp_path, f'<geom {geom} pos=".05 0 .1" {SMOOTH}/>')
    if touching:
        pressed(mass, (0.02, 0.0, 0.0))
    plane = only(world, mass.position)
    assert plane.normal == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    assert plane.offset_m == pytest.approx(0.02 - RADIUS, abs=1e-6)
    assert plane.velocity_mps == 0.0
    wanted = sorted(1.0 / (radius + RADIUS) for radius in radii if radius)
    assert sorted(bend.per_m for bend in plane.curvatures) == pytest.approx(wanted, rel=1e-3)
    assert plane.depth(mass.position) == pytest.approx(
        world.penetration(mass.position) if touching else -0.015, abs=1e-6
    )


def test_on_an_ellipsoid_the_curvatures_are_those_of_its_cuts(tmp_path: Path) -> None:
    """Obliquely: the sphere's centre moves on the tangent plane and finds how far the surface has gone, t = k u^2/2."""
    geom = f'<geom type="ellipsoid" size=".03 .05 .02" pos=".05 0.01 .095" euler="0 0 20" {SMOOTH}/>'
    world, _ = made(tmp_path, geom)
    plane = only(world, (0.0, 0.0, 0.0))
    foot, step = plane.offset_m * np.array(plane.normal), 1e-3
    for direction, per_m in plane.curvatures:
        falls = []
        for way in (-step, step):
            place = tuple((foot - 0.004 * np.array(plane.normal) + way * np.array(direction)).tolist())
            world.engine.place(place)
            falls.append(-only(world, place).depth(place) - 0.004)
        assert sum(falls) == pytest.approx(per_m / (1.0 + per_m * 0.004) * step**2, rel=0.02)


@pytest.mark.parametrize("solref", ["0.02 1", "0.02 0.7", "-2000 -40"])
def test_the_stiffness_is_that_of_the_engine_at_rest(solref: str, tmp_path: Path) -> None:
    """The force is the virtual spring's, 500 N/m, as nothing else is there; the depth is the way behind the face."""
    block = f'<geom type="box" size=".03 .1 .1" pos=".05 0 .1" solref="{solref}" {SMOOTH}/>'
    world, mass = made(tmp_path, block)
    assert world.contact_force == (0.0, 0.0, 0.0)
    pressed(mass, (0.03, 0.0, 0.0), 2.0)
    force = 500.0 * (0.03 - mass.position[0])
    assert world.contact_force[0] == pytest.approx(-force, rel=1e-3)
    plane = only(world, mass.position)
    assert plane.stiffness * (mass.position[0] - 0.015) == pytest.approx(force, rel=1e-3)


def test_a_body_that_moves_takes_its_plane_along(tmp_path: Path) -> None:
    body = (
        '<body pos=".05 0 .1" gravcomp="1"><joint type="slide" axis="1 0 0"/>'
        f'<joint type="hinge" axis="0 0 1" pos="0 .1 0"/><geom type="box" size=".03 .1 .1" mass="50" {SMOOTH}/></body>'
    )
    world, _ = made(tmp_path, body)
    data: Any = found_of(world).data
    data.qvel[0:2] = -0.1, 0.5  # at the face's middle 0.1 m from the hinge: -0.1 + 0.5 * 0.1
    assert only(world, (0.0, 0.0, 0.0)).velocity_mps == pytest.approx(-0.05)


def test_with_fewer_axes_a_plane_is_cut(tmp_path: Path) -> None:
    for dof in (1, 2):
        world, _ = made(tmp_path, f'<geom type="sphere" size=".03" pos=".05 0 .1" {SMOOTH}/>', dof)
        plane = only(world, (0.0,) * dof)
        assert plane.normal == (1.0, 0.0)[:dof]
        assert [bend.per_m for bend in plane.curvatures] == pytest.approx([1.0 / 0.035] * (dof - 1))


def test_several_are_told_and_none_twice(tmp_path: Path) -> None:
    """The corner of a room, of boxes and a plane; the far box is not sent."""
    room = f'<geom type="plane" size="1 1 .1" pos="0 0 .08" {SMOOTH}/>' + "".join(
        f'<geom type="box" size=".1 .1 .1" pos="{at}" {SMOOTH}/>' for at in (".12 0 .1", "0 .13 .1", "-.2 0 .1")
    )
    world, mass = made(tmp_path, room)
    pressed(mass, (0.02, 0.03, -0.02))
    planes = world.planes(mass.position, 0.05) or ()
    assert len(planes) == 3
    assert {tuple(round(n) for n in plane.normal) for plane in planes} == {(1, 0, 0), (0, 1, 0), (0, 0, -1)}
    assert all(plane.depth(mass.position) > 0.0 for plane in planes)
    assert world.plane(mass.position) == planes[0]


def test_what_no_plane_describes_is_felt_through_the_proxy(tmp_path: Path) -> None:
    """Friction and light bodies are not sent, unless that is asked for; nor anything while one is touched."""
    rough, smooth = (
        '<geom type="box" size=".03 .1 .1" pos=".05 0 .1"/>',
        f'<geom type="box" size=".1 .1 .1" pos="0 .12 .1" {SMOOTH}/>',
    )
    light = f'<body pos=".05 0 .1" gravcomp="1"><freejoint/><geom type="sphere" size=".03" mass=".05" {SMOOTH}/></body>'
    for odd in (rough, light):
        world, mass = made(tmp_path, odd + smooth)
        assert only(world, (0.0, 0.0, 0.0)).normal == pytest.approx((0.0, 1.0, 0.0))
        for _ in range(100):
            mass.step(0.004, (0.03, 0.0, 0.0))
            if world.penetration(mass.position) > 0.0:
                break
        assert world.planes(mass.position, 0.05) is None
        assert made(tmp_path, odd)[0].planes((0.0, 0.0, 0.0), 0.05) is None
        assert len(made(tmp_path, odd + smooth, more="&planes=all")[0].planes((0.0, 0.0, 0.0), 0.05) or ()) == 2
        assert made(tmp_path, odd + smooth, more="&planes=none")[0].planes((0.0, 0.0, 0.0), 0.05) is None
    for content, proxy in ((FLEX, "?planes=all"), (DOOR, "?proxy=handle&planes=all")):
        assert mujoco_world(model(tmp_path / "f.xml", content) + proxy).planes((0.0, 0.0, 0.0), 0.05) is None
    with pytest.raises(InvalidParameter, match="planes= one of auto, all, none"):
        mujoco_world(model(tmp_path / "f.xml", BLOCK) + "?planes=some")


@pytest.mark.slow
def test_planes_make_the_force_truer_and_steadier_over_a_bad_link() -> None:
    """Against the springs in series, felt without delay, with steps of 10 to 30 ms."""
    from tests.measure.mujoco_rendering import felt

    without, reported = felt("block", "none"), felt("block", "auto")
    assert reported.error < 0.015 * reported.own < 0.03 * without.own < without.error
    assert reported.ripple < 0.5 * without.ripple
    for one in (without, reported):
        check(one.result)
        device = one.result.summary["device"]
        assert device["ledger"]["slack_J"] >= -1e-12


@pytest.mark.parametrize("index", mostly_slow([1, 6, *range(20, 40)], 2, 10))
def test_with_all_planes_told_it_is_passive_over_random_links(index: int, tmp_path: Path) -> None:
    content = (BLOCK, BOX, BALL + BOX, BLOCK + DOOR + BALL)[index % 4]
    result = over_a_link(model(tmp_path / "m.xml", content) + "?at=0,0,0.03&planes=all", index)
    check(result)
    assert math.isfinite(result.summary["motion"]["peak_force_N"])
