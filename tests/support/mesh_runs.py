"""A stiff hand that follows a path into a mesh through a bad link: the force that it gets beside the solid's own."""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.simulation.simulation import Simulation
from tests.support.solids import Account, write_stl

K, K_WORLD, K_WALL = 100.0, 500.0, 3000.0
FELT = K * K_WALL / (K_WORLD + K_WALL)
"""The springs in series, as the hand feels a wall [N/m]."""

_BOX = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_HALVES = np.array([half for a, b, c, d in _FACES for half in ((a, b, c), (a, c, d))])


def boxes(*parts: tuple[Sequence[float], Sequence[float]]) -> tuple[Array, Any]:
    """A mesh of boxes, each by its centre and size [m]; they are not joined."""
    vertices = np.concatenate([_BOX * size + centre for centre, size in parts])
    return vertices, np.concatenate([_HALVES + 8 * i for i in range(len(parts))])


def extruded(outline: Sequence[tuple[float, float]], triangles: Sequence[tuple[int, int, int]], length: float) -> Any:
    """A solid whose section in (x, y) is this polygon, anticlockwise [m], with its triangles; along z about 0."""
    n = len(outline)
    low = np.column_stack([np.array(outline), np.full(n, -0.5 * length)])
    top = np.array(triangles)
    sides = [t for i in range(n) for j in [(i + 1) % n] for t in ((i, j, j + n), (i, j + n, i + n))]
    return np.concatenate([low, low + np.array((0.0, 0.0, length))]), np.concatenate([top[:, ::-1], top + n, sides])


def ball(rounds: int, radius: float, centre: Sequence[float]) -> tuple[Array, Any]:
    """An icosahedron whose triangles are cut in four, `rounds` times, with its vertices on a sphere; 4: 5,120."""
    g = 0.5 * (1.0 + 5.0**0.5)
    vertices = np.array([(0, s, t * g) for s in (-1, 1) for t in (-1, 1)], dtype=float)
    vertices = np.concatenate([np.roll(vertices, k, axis=1) for k in range(3)]) / np.hypot(1.0, g)
    side = 2.0 / np.hypot(1.0, g)
    near = np.abs(np.linalg.norm(vertices[:, None] - vertices[None], axis=-1) - side) < 1e-9
    triangles = [
        (i, j, k) if np.linalg.det(vertices[[i, j, k]]) > 0.0 else (i, k, j)
        for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[k, i]
    ]  # fmt: skip
    points, corners = [*vertices], triangles
    for _ in range(rounds):
        middles: dict[tuple[int, int], int] = {}
        cut = []
        for a, b, c in corners:
            x, y, z = (_middle(points, middles, *edge) for edge in ((a, b), (b, c), (c, a)))
            cut += [(a, x, z), (b, y, x), (c, z, y), (x, y, z)]
        corners = cut
    return radius * np.array(points) + centre, np.array(corners)


def _middle(points: list[Array], middles: dict[tuple[int, int], int], a: int, b: int) -> int:
    key = (min(a, b), max(a, b))
    if key not in middles:
        middle = points[a] + points[b]
        points.append(middle / np.linalg.norm(middle))
        middles[key] = len(points) - 1
    return middles[key]


def words(directory: Path, mesh: tuple[Array, Any]) -> str:
    """The scene of a mesh that stays where it is."""
    return f"mesh:{write_stl(directory / 'mesh.stl', *mesh)}?unit=mm&at=file"


Reference = Callable[[float], Sequence[float]]


class Follow:
    """A stiff hand that follows `path`."""

    path: Reference = staticmethod(lambda t: (0.0, 0.0, 0.0))

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = Impedance(0.5, 60.0, 3000.0)

    def reference(self, t: float) -> Vector:
        return tuple(Follow.path(t))


class Felt(NamedTuple):
    error: float  #: of the force, root mean square, as a share of the solid's own
    env_slack_J: float
    most_N: float  #: the largest force of the world
    device_m: Array
    world: dict[str, Array]


def felt(
    scene: str,
    path: Reference,
    own: Callable[[Array], Array],
    steps_s: tuple[float, float],
    *,
    link: str = "4g",
    seconds: float = 3.0,
    **more: object,
) -> Felt:
    """A simulated run.

    own : for the device's positions (N, 3) [m] how deep they are in the solid (N, 3) [m], towards the free side.
    """
    result, account = _run(scene, path, steps_s, link, seconds, more)
    device, world = result.recording.device, result.recording.world
    x = device["position_m"]
    force = device["force_N"] + Params().device.damping * np.gradient(x, 1e-3, axis=0)
    sliding = slice(1000, len(x) - 50)
    wanted = FELT * own(x)[sliding]
    error = float(np.sqrt(np.mean((force[sliding] - wanted) ** 2) / np.mean(wanted**2)))
    most = max(float(np.linalg.norm(f)) for f in account.forces)
    return Felt(error, account.least_slack_J, most, x, dict(world))


class Pressed(NamedTuple):
    held_N: float  #: at the device
    most_N: float  #: the largest force of the world
    last_N: float  #: and its last one


def pressed(scene: str, speed: float, steps_s: tuple[float, float], aside: Sequence[float], deep_m: float) -> Pressed:
    """A simulated run over 4G: the stiff hand goes in along x at one speed, holds for 0.4 s and goes out."""
    way = deep_m / speed

    def path(t: float) -> Sequence[float]:
        return (max(-0.01, min(speed * max(0.0, t - 0.2), deep_m, deep_m - speed * (t - 0.6 - way))), *aside)

    result, account = _run(scene, path, steps_s, "4g", 1.4 + 2.0 * way, {})
    device = result.recording.device
    held = np.linalg.norm(device["force_N"], axis=1)[round(1000 * (way + 0.5)) : round(1000 * (way + 0.6))]
    sizes = np.linalg.norm(account.forces, axis=1)
    return Pressed(float(held.mean()), float(sizes.max()), float(sizes[-1]))


def _run(
    scene: str, path: Reference, steps_s: tuple[float, float], link: str, seconds: float, more: Mapping[str, object]
) -> tuple[Any, Account]:
    import_module("tests.support.mesh_runs").Follow.path = staticmethod(path)  # of the module that the run imports
    params = Params().set({
        "device.stiffness": K, "scene": scene, "dof": 3, "operator": "tests.support.mesh_runs:Follow",
        "link.up": link, "link.down": link, "duration_s": seconds, "record_hz": 1000.0,
        "world.step_min_s": steps_s[0], "world.step_max_s": steps_s[1], **more,
    })  # fmt: skip
    run = Simulation(params, 1, kernel=False)  # compiled code does not call what watches
    account = Account(run.setup.scene.contacts, 0.02 * np.eye(3), 14.0 * np.eye(3), 500.0 * np.eye(3))
    result = run.run()
    assert result.summary["verdict"]["passive"]
    account.close()
    return result, account
