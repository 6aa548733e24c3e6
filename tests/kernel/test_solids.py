"""Scenes of solids give the same bits compiled, with one to three axes; what equations do not know is not compiled."""

from collections.abc import Sequence
from math import sqrt
from typing import Any

import pytest

from hapnet.checks import Vector
from hapnet.ext.compiled.names import Kind
from hapnet.ext.compiled.whole_runs import coverage
from hapnet.ext.solids.rigid import RigidScene
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import Near, Sphere
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.support.kernel_cases import differences
from tests.support.solids import stair, write_stl

SOLIDS = Params().set(
    {"device.servo": "sampled", "operator": "hand-4", "duration_s": 1.5, "link.up": "4g", "link.down": "wifi"}
)  # fmt: skip
TURNED = [[500.0, 100.0, 20.0], [100.0, 400.0, 50.0], [20.0, 50.0, 600.0]]
"""A spring of the world's with which A is no multiple of the identity."""


@pytest.mark.parametrize("dof", mostly_slow([3, 2, 1], 0, 1))
@pytest.mark.parametrize(
    "scene",
    [
        "sphere",
        "cuboid",
        "cylinder + cylinder?axis=x&at=20mm,50mm,0",
        "plane?normal=1,0.3,-0.1",
        "plane?relief=0.9mm,4mm + sphere?radius=10mm",
        "cuboid + plane?normal=0,0,-1",
        "plane + plane?normal=1,1,0 + plane?normal=0,1,0",
        "cuboid?size=2mm,60mm,60mm&stiffness=300",
        "sphere?friction=0.5",
        "cuboid?friction=0.5&texture=0.8,4mm",
        "sphere?friction=1 + plane?normal=1,1,0&friction=0.6",
    ],
)
def test_solids_give_the_same_bits(scene: str, dof: int) -> None:
    rendering = "paper" if dof == 2 else "hapnet"
    assert not differences(SOLIDS.set({"scene": scene, "dof": dof, "rendering": rendering}), dof)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"coupling": "tdpa", "scene": "sphere?friction=0.5 + plane?normal=0,0,-1", "rendering": "paper"},
        {"scene": "sphere", "dof": 2},
        {"scene": "cylinder?friction=0.5 + plane?normal=0,1,0&friction=0.3", "dof": 2},
        {"scene": "cylinder + sphere?at=20mm,30mm,0", "operator": "sine", "link.down": "delay 30ms 10ms rate 200kbit"},
        {"scene": "sphere?radius=3mm&friction=1 + cuboid?friction=0.5", "operator": "hand-7"},
        {"coupling": "zoh", "scene": "cuboid?friction=0.5", "operator": "sine", "dof": 2},
        {"device.servo": "continuous", "scene": "cylinder?axis=y"},
        {"world.stiffness": TURNED, "scene": "sphere"},
        {"world.stiffness": TURNED, "scene": "cuboid?friction=0.4 + plane?normal=1,1,0"},
    ],
)
def test_other_laws_servos_and_springs_give_the_same_bits(changes: dict[str, Any]) -> None:
    assert not differences(SOLIDS.set(changes), 6)


class Ellipsoid:
    """A user's own shape: 20 mm about x, twice as far along it."""

    slope, flat_m = 1.0, 0.0

    def near(self, position: Sequence[float]) -> Near:
        x, y, z = 0.5 * (position[0] - 0.07), position[1], position[2]
        size = sqrt(x * x + y * y + z * z) or 1.0
        return Near(size - 0.02, (0.5 * x / size, y / size, z / size))


class Dented(Sphere):
    """A ball with another distance than a ball's."""

    def near(self, position: Vector) -> Near:
        distance, gradient = super().near(position)
        return Near(distance + 0.001, gradient)


def ellipsoid() -> RigidScene:
    return RigidScene("ellipsoid", 3, [Solid(Ellipsoid())])


def dented() -> RigidScene:
    return RigidScene("dented", 3, [Solid(Dented((0.05, 0.0, 0.0), 0.02))])


def slippery() -> RigidScene:
    return RigidScene("slippery", 3, [Solid(Sphere((0.05, 0.0, 0.0), 0.02), friction=lambda place: place[1])])


def ball() -> RigidScene:
    return RigidScene("ball", 3, [Solid(Sphere((0.05, 0.0, 0.0), 0.02), friction=0.3)])


@pytest.mark.parametrize("scene", ["ellipsoid", "dented", "slippery"])
def test_what_a_user_wrote_is_run_by_python(scene: str) -> None:
    simulation = Simulation(SOLIDS.set({"scene": f"{__name__}:{scene}"}), kernel=True)
    assert simulation.not_compiled == "a mesh, a field, a layer, or a user's shape or friction"


def test_a_mesh_is_run_by_python(tmp_path: Any) -> None:
    file = write_stl(tmp_path / "stair.stl", *stair((0.05, 0.0, 0.0)))
    simulation = Simulation(SOLIDS.set({"scene": f"mesh:{file}?unit=mm"}), kernel=True)
    assert simulation.not_compiled == "a mesh, a field, a layer, or a user's shape or friction"


@pytest.mark.slow
def test_a_users_scene_of_known_solids_gives_the_same_bits() -> None:
    assert not differences(SOLIDS.set({"scene": f"{__name__}:ball"}), 2)


def test_more_solids_than_a_compiled_step_has_room_for_are_run_by_python() -> None:
    scene = " + ".join(["sphere"] * 9)
    assert Simulation(SOLIDS.set({"scene": scene}), kernel=True).not_compiled == "a scene with 9 solids"


def test_scenes_of_solids_and_of_walls_are_two_kinds() -> None:
    assert coverage.kind_of(SOLIDS.set({"scene": "sphere + plane"})) == Kind(solid=True)
    assert coverage.kind_of(SOLIDS) == Kind()
    assert Kind(solid=True).name != Kind().name
