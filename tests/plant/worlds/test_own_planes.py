"""What worlds of the user's own send of their surfaces, and what the device makes of it."""

from typing import Any

import pytest

from examples.own_moving_world import magnet, workshop
from hapnet import ForceWorld, HapnetError, Obstacle, Params, Plane, simulate
from hapnet.ext.engines.own_worlds import SteppedWorld
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scenes import SCENES
from hapnet.plant.worlds.registry import make_scene
from tests.measure.curved import error_N
from tests.plant.worlds.test_own_worlds import HeldWall, wall


def press(*, dof: int = 1) -> ForceWorld:
    return workshop(dof=dof, magnetic=False)


FACE = Plane((1.0,), 0.02, 3000.0, 10.0)


def test_a_scripted_obstacle_takes_its_plane_along() -> None:
    world = press()
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    for _ in range(15):
        proxy.step(0.02, (0.0,), world)
    (plane,) = world.planes(proxy.position, 0.1)
    stroke = [0.035 - 0.03 * s for s in (0.770513, 0.809017)]  # sin(pi t) at 0.28 and 0.3 s
    assert plane[:4] == ((1.0,), pytest.approx(stroke[1] - 0.01, abs=1e-8), 2000.0, 5.0)
    assert plane.velocity_mps == pytest.approx((stroke[1] - stroke[0]) / 0.02, abs=1e-4)
    assert world.planes((0.0,), 1e-4) == ()
    assert world.penetration((plane.offset_m + 0.001,)) == pytest.approx(0.001)
    assert world.penetration((plane.offset_m - 0.001,)) == 0.0


def test_a_driven_obstacle_tells_how_fast_it_is() -> None:
    world = ForceWorld([Obstacle(wall, mass=0.5, drive=lambda x, v, t: -1.0, planes=FACE)])
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    for _ in range(5):
        proxy.step(0.01, (0.0,), world)
    (plane,) = world.planes((0.0,), 0.1)  # it fell by -2 m/s^2 t^2/2
    assert plane.offset_m == pytest.approx(0.02 - 0.0025)
    assert plane.velocity_mps == pytest.approx(-0.1)


def test_a_world_with_a_field_tells_none() -> None:
    """Else the device would feel the surface, but not the field."""
    assert workshop().planes((0.0,), 1.0) is None
    assert ForceWorld(magnet).planes((0.0,), 1.0) is None


def test_several_obstacles_are_told_the_deepest_first() -> None:
    faces = [FACE._replace(offset_m=0.01 * k) for k in range(6)]
    world = ForceWorld([Obstacle(wall, planes=lambda x, t, face=face: [face]) for face in faces])
    assert world.planes((0.025,), 1.0) == tuple(faces[:4])
    assert world.plane((0.025,)) == faces[0]
    assert ForceWorld([Obstacle(wall, planes=lambda x, t: [])]).planes((0.0,), 1.0) == ()


class Reported(HeldWall):
    def planes(self, position: Any, reach_m: float) -> Any:
        return [FACE] if position[0] > -0.1 else None


def test_an_object_that_steps_may_tell_planes() -> None:
    assert SteppedWorld(HeldWall()).planes((0.0,), 1.0) is None
    world = SteppedWorld(Reported())
    assert world.planes((0.0,), 1.0) == (FACE,)
    assert world.planes((-0.2,), 1.0) is None


def fails(position: Any, *others: Any) -> Any:
    raise KeyError("no surface")


def test_what_fails_names_the_scene() -> None:
    with pytest.raises(HapnetError, match="the scene own failed: its planes raised KeyError"):
        ForceWorld([Obstacle(wall, planes=fails)]).planes((0.0,), 1.0)
    stepping = HeldWall()
    stepping.planes = fails  # type: ignore[attr-defined]  # as a user's object has it
    with pytest.raises(HapnetError, match=r"planes\(\) raised KeyError"):
        SteppedWorld(stepping, name="own").planes((0.0,), 1.0)
    with pytest.raises(HapnetError, match=r"the scene own failed: it gave .*a plane's normal"):
        ForceWorld([Obstacle(wall, planes=FACE)], dof=2).planes((0.0, 0.0), 1.0)


def test_a_ball_of_ones_own_is_felt_as_a_ball() -> None:
    """Told with its curvature, what is felt is the law, without delay; untold, the delay is felt."""
    reported, own = error_N(0.05, (0.01, 0.05), dof=2, scene="tests.measure.curved:own_ball", seconds=2.0)
    untold, _ = error_N(0.05, (0.01, 0.05), dof=2, scene="tests.measure.curved:untold", seconds=2.0)
    assert reported < 0.01 * own
    assert untold > 0.1 * own


def test_a_press_is_felt_and_passive_over_a_bad_link() -> None:
    scene = {"scene": "tests.plant.worlds.test_own_planes:press", "operator": "rest", "duration_s": 2.0}
    result = simulate(Params().set({**scene, "link.up": "4g", "link.down": "4g"}), seed=1)
    device = result.recording.device
    assert device["force_N"].min() < -0.3
    assert result.summary["verdict"]["passive"]
    assert result.summary["device"]["ledger"]["slack_J"] >= -1e-12


@pytest.mark.parametrize("name", [*SCENES, "sphere", "cuboid", "cylinder", "plane"])
def test_every_scene_of_the_registry_tells_its_planes(name: str) -> None:
    planes = make_scene(name, dof=3).contacts.planes((0.0, 0.0, 0.0), 0.05)
    assert len(planes) >= (name != "free")
