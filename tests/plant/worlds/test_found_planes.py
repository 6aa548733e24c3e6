"""The planes that are found from a force function, beside those that follow from its formula."""

import math
from collections.abc import Callable
from itertools import count
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize

from hapnet import ForceWorld, Plane, simulate
from hapnet.checks import Array, Vector
from hapnet.ext.engines import found_planes
from hapnet.ext.engines.found_planes import can_be_searched
from hapnet.ext.engines.obstacle import Law
from hapnet.mechanics.effects import Effects
from hapnet.plant.worlds.registry import make_scene
from tests.conftest import mostly_slow

STEPS = 2 * 26 // found_planes.RAYS
"""Steps in which every ray of three axes is used."""


def pillow(position: Vector, velocity: Vector, time: float) -> list[float]:
    """The world that the pages begin with: soft from 10 mm on, along every axis."""
    return [-400.0 * (x - 0.01) - 2.0 * v if x > 0.01 else 0.0 for x, v in zip(position, velocity, strict=True)]


def along_first(push: Callable[[float], float], normal: Vector = (1.0,)) -> Law:
    """A push [N] against `normal`, as a function of the depth behind the plane 20 mm in front of the origin."""

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        depth = sum(x * n for x, n in zip(position, normal, strict=True)) - 0.02
        return [-push(depth) * n if depth > 0.0 else 0.0 for n in normal]

    return law


def found(law: Law, position: Vector, steps: int = STEPS) -> list[Plane] | None:
    """The planes for a proxy that rests there."""
    world = ForceWorld(law, dof=len(position))
    for _ in range(steps):
        planes = world.planes(position, 0.1)
    return None if planes is None else list(planes)


def directions(n: int) -> st.SearchStrategy[Vector]:
    parts = st.lists(st.floats(-1.0, 1.0), min_size=n, max_size=n).filter(lambda one: math.hypot(*one) > 0.1)
    return parts.map(lambda one: tuple(part / math.hypot(*one) for part in one))


@settings(max_examples=40, deadline=None)
@given(st.data(), st.integers(1, 3), st.floats(10.0, 3e4), st.floats(-0.05, 0.015))
def test_a_linear_law_gives_its_own_plane(data: st.DataObject, n: int, stiffness: float, depth: float) -> None:
    """In contact, and in front of it on the way to it."""
    normal = data.draw(directions(n))
    law = along_first(lambda deep: stiffness * deep, normal)
    world = ForceWorld(law, dof=n)
    for k in range(2):
        there = tuple([(0.02 + depth - 0.001 * (1 - k)) * part for part in normal])
        planes = world.planes(there, 0.1)
    assert planes is not None
    (plane,) = planes
    assert plane.normal == pytest.approx(normal, abs=1e-6)
    assert plane.offset_m == pytest.approx(0.02, abs=1e-7)
    assert plane.stiffness == pytest.approx(stiffness, rel=1e-5)
    assert not plane.curvatures or max(abs(bend.per_m) for bend in plane.curvatures) < 0.1
    assert plane.effects is None


def ball(centre: Vector, radius: float, stiffness: float) -> Law:
    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        away = [x - c for x, c in zip(position, centre, strict=True)]
        distance = math.hypot(*away)
        return [max(0.0, stiffness * (radius - distance)) * part / (distance or 1.0) for part in away]

    return law


@settings(max_examples=30, deadline=None)
@given(st.data(), st.integers(2, 3), st.floats(0.01, 0.05), st.floats(0.7, 2.5))
def test_a_ball_gives_the_tangent_plane_of_its_nearest_point(
    data: st.DataObject, n: int, radius: float, share: float
) -> None:
    """From 0.7 radii from its centre to 2.5, in all directions, after it was touched at another place. From 0.6 radii a
    ray through the centre can meet the far side, whose force points along the ray: then the earlier planes stay."""
    towards, beside, centre = data.draw(directions(n)), data.draw(directions(n)), (0.05,) + (0.0,) * (n - 1)
    world = ForceWorld(ball(centre, radius, 1000.0), dof=n)
    for part, aside in ((0.9, 0.6), (share, 0.0)):
        away = [a + aside * b for a, b in zip(towards, beside, strict=True)]
        there = tuple([c + part * radius * a / math.hypot(*away) for c, a in zip(centre, away, strict=True)])
        planes = world.planes(there, 0.15)
    assert planes is not None
    (plane,), true = planes, Plane.of_ball(there, centre, radius, 1000.0)
    nearest = [x + true.normal[i] * -true.depth(there) for i, x in enumerate(there)]
    assert plane.normal == pytest.approx(true.normal, abs=2e-3)
    assert plane.depth(nearest) == pytest.approx(0.0, abs=2e-6)
    assert plane.stiffness == pytest.approx(1000.0, rel=1e-3)
    assert [bend.per_m for bend in plane.curvatures] == pytest.approx([1.0 / radius] * (n - 1), rel=1e-2)


def test_an_ellipsoid_gives_the_plane_at_the_nearest_point() -> None:
    """The nearest point is found by minimising the distance."""
    axes = np.array([0.02, 0.03, 0.045])

    def inside(x: Array) -> float:
        return 1.0 - float(np.linalg.norm(x / axes))

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        x = np.array(position)
        push = max(0.0, 20.0 * inside(x)) / (float(np.linalg.norm(x / axes)) or 1.0)
        return list(push * x / axes**2 * 0.02)

    for place in ((0.03, 0.02, 0.01), (-0.02, 0.03, 0.03), (0.022, -0.01, 0.0)):
        planes = found(law, place)
        assert planes
        start = np.array(place) / np.linalg.norm(np.array(place) / axes)
        answer = minimize(
            lambda x, place=place: 1e6 * float(np.sum((x - np.array(place)) ** 2)), start, tol=1e-12,
            constraints=[{"type": "eq", "fun": inside}],
        )  # fmt: skip
        away = answer.x - np.array(place)
        assert np.array(planes[0].normal) == pytest.approx(away / np.linalg.norm(away), abs=0.01)
        assert -planes[0].depth(place) == pytest.approx(np.linalg.norm(away), abs=2e-5)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_a_corner_gives_the_planes_of_its_walls(angle: float) -> None:
    walls = [((math.cos(angle), math.sin(angle)), 400.0), ((-math.sin(angle), math.cos(angle)), 900.0)]

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        force = np.zeros(2)
        for normal, stiffness in walls:
            force -= stiffness * max(0.0, float(np.dot(position, normal)) - 0.02) * np.array(normal)
        return list(force)

    there = tuple([0.022 * a + 0.025 * b for a, b in zip(walls[0][0], walls[1][0], strict=True)])
    planes = found(law, there)
    assert planes
    for plane, (normal, stiffness) in zip(sorted(planes, key=lambda one: one.stiffness), walls, strict=True):
        assert plane.normal == pytest.approx(normal, abs=1e-6)
        assert plane[1:3] == pytest.approx((0.02, stiffness), rel=1e-6)


def pushed(planes: list[Plane], x: float) -> float:
    return sum(plane.stiffness * max(0.0, plane.depth((x,))) for plane in planes)


@pytest.mark.parametrize(
    "push",
    [
        lambda deep: 1e5 * deep**2,
        lambda deep: 3e7 * deep**3,
        lambda deep: 3.0 * deep / (deep + 0.004),
        lambda deep: min(2.0, 400.0 * deep),
        lambda deep: 0.5 + 400.0 * deep,
        lambda deep: 2.0,
    ],
    ids=["square", "cube", "softens", "clipped", "begins with a step", "only a step"],
)
def test_the_planes_have_the_force_of_a_law_that_is_not_linear(push: Callable[[float], float]) -> None:
    """Exactly so where the proxy is, and none in front of the surface; and at the depths ahead if it grows stiffer."""
    law = along_first(push)
    for deep in (0.001, 0.004, 0.012):
        planes = found(law, (0.02 + deep,))
        assert planes
        assert pushed(planes, 0.02 + deep) == pytest.approx(push(deep), rel=1e-3)
        assert pushed(planes, 0.02) == pytest.approx(0.0, abs=1e-3)
    planes = found(law, (0.0,))
    assert planes
    assert pushed(planes, 0.02) == pytest.approx(0.0, abs=1e-3)
    if push(0.006) > 3.0 * push(0.002):
        for ahead in found_planes.AHEAD_M:
            x = planes[0].offset_m + ahead
            assert pushed(planes, x) == pytest.approx(push(x - 0.02), rel=1e-3)


numbers = count()
sure = Random(1)


class Clay:
    """A dent that stays, in a method that `can_be_searched` does not see."""

    deepest = 0.01

    def force(self, x: float) -> float:
        self.deepest = max(self.deepest, x)
        return -400.0 * max(0.0, x - self.deepest + 0.002)


clay, deepest = Clay(), 0.0

REFUSED: dict[str, Law] = {
    "the same force everywhere": lambda x, v, t: -5.0,
    "attraction": lambda x, v, t: -200.0 * (x[0] - 0.03) * math.exp(-(((x[0] - 0.03) / 0.01) ** 2)),
    "drag in free space": lambda x, v, t: -3.0 * v[0],
    "dry friction in free space": lambda x, v, t: -0.1 * math.copysign(1.0, v[0]) if v[0] else 0.0,
    "a wall that moves": lambda x, v, t: -400.0 * max(0.0, x[0] - 0.012 - 0.001 * math.sin(3.0 * t)),
    "noise": lambda x, v, t: -400.0 * max(0.0, x[0] - 0.01) * (1.0 + 0.1 * sure.random()),
    "a state": lambda x, v, t: -1.0 * next(numbers) * max(0.0, x[0] - 0.01),
    "a dent": lambda x, v, t: clay.force(x[0]),
    "a heavy damper": lambda x, v, t: -400.0 * (x[0] - 0.01) - 20.0 * v[0] if x[0] > 0.01 else 0.0,
}


@pytest.mark.parametrize("name", [*REFUSED])
def test_a_force_that_no_plane_describes_is_refused(name: str) -> None:
    clay.deepest = 0.01
    for position in (0.0, 0.013) if name not in ("a wall that moves", "a heavy damper", "a dent") else (0.013,):
        assert found(REFUSED[name], (position,)) is None


def test_friction_is_refused_and_drag_along_a_surface_is_told() -> None:
    """A floor of 1000 N/m with Coulomb's friction 0.3, and one with a damper of 2 Ns/m in all directions."""

    def rough(position: Vector, velocity: Vector, time: float) -> list[float]:
        push, speed = 1000.0 * max(0.0, position[0] - 0.02), math.hypot(*velocity[1:])
        return [-push, *(-0.3 * push * v / (speed or 1.0) for v in velocity[1:])]

    def sticky(position: Vector, velocity: Vector, time: float) -> list[float]:
        deep = position[0] - 0.02
        return [-2.0 * v - (1000.0 * deep if k == 0 else 0.0) if deep > 0.0 else 0.0 for k, v in enumerate(velocity)]

    for position in ((0.0, 0.0, 0.0), (0.023, 0.0, 0.0)):
        assert found(rough, position) is None
        planes = found(sticky, position)
        assert planes
        effects = planes[0].effects
        assert isinstance(effects, Effects)
        assert effects.viscosity == pytest.approx(2.0)


def test_one_bad_step_changes_nothing_and_some_end_the_search() -> None:
    """So that the device is not given planes and none in turn."""
    drag = [0.0]

    def law(position: Vector, velocity: Vector, time: float) -> float:
        return -400.0 * max(0.0, position[0] - 0.02) - drag[0] * velocity[0]

    world = ForceWorld(law)
    for _ in range(3):
        drag[0] = 0.0
        told = world.planes((0.0,), 0.1)
        assert told
        drag[0] = 3.0
        for _ in range(2):
            assert world.planes((0.0,), 0.1) == told
    drag[0] = 0.0
    assert world.planes((0.0,), 0.1)
    drag[0] = 3.0
    for _ in range(3):
        told = world.planes((0.0,), 0.1)
    drag[0] = 0.0
    assert told is None
    assert world.planes((0.0,), 0.1) is None


def test_a_table_has_no_plane_beside_it() -> None:
    """A table of 40 mm by 40 mm, 20 mm in front."""

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        over = max(abs(position[1]), abs(position[2])) < 0.02
        return [-1000.0 * max(0.0, min(position[0] - 0.02, 0.01)) if over else 0.0, 0.0, 0.0]

    above = found(law, (0.015, 0.015, 0.0))
    assert above
    assert above[0].normal == (1.0, 0.0, 0.0)
    assert above[0][1:3] == pytest.approx((0.02, 1000.0))
    world = ForceWorld(law, dof=3)
    for y in np.arange(0.0, 0.04, 0.001).tolist():
        planes = world.planes((0.01, y, 0.0), 0.1)
        assert planes is not None
        assert len(planes) == (1 if y < 0.02 else 0)


def test_a_function_that_keeps_a_state_is_never_called_ahead() -> None:
    total, kept = 0.0, {"deepest": 0.0}

    def outer(position: Vector, velocity: Vector, time: float) -> float:
        nonlocal total
        total = max(total, position[0])
        return -400.0 * max(0.0, position[0] - 0.02)

    def globally(position: Vector, velocity: Vector, time: float) -> float:
        global deepest
        deepest = position[0]
        return 0.0

    def attribute(position: Vector, velocity: Vector, time: float) -> float:
        attribute.deepest = position[0]  # type: ignore[attr-defined]
        return 0.0

    def item(position: Vector, velocity: Vector, time: float) -> float:
        kept["deepest"] = position[0]
        return 0.0

    for law in (outer, globally, attribute, item):
        assert not can_be_searched(law, 1, "m")
        assert found(law, (0.0,)) is None
    assert total == 0.0

    def local(position: Vector, velocity: Vector, time: float) -> Array:
        force, stiffness = np.zeros(3), 400.0
        force[0] = -sum(stiffness * x for x in position)
        return force

    assert can_be_searched(local, 3, "m")
    assert can_be_searched(pillow, 3, "m")
    assert not can_be_searched(pillow, 3, "m,m,rad")
    assert not can_be_searched(pillow, 6, "pose")


def own(position: Vector, velocity: Vector, time: float) -> float:
    return -400.0 * max(0.0, position[0] - 0.02)


def test_a_function_may_have_planes_of_its_own_or_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def told() -> tuple[Plane, ...] | None:
        return make_scene(f"{__name__}:own", dof=1).contacts.planes((0.0,), 0.1)

    planes, mine = told(), Plane((1.0,), 0.02, 300.0, 1.0)
    assert planes
    assert planes[0][1:3] == pytest.approx((0.02, 400.0))
    monkeypatch.setattr(own, "planes", mine, raising=False)
    assert told() == (mine,)
    monkeypatch.setattr(own, "planes", None)
    assert told() is None
    assert ForceWorld(own, planes=mine).planes((0.0,), 0.1) == (mine,)


def test_an_error_ahead_ends_nothing() -> None:
    def law(position: Vector, velocity: Vector, time: float) -> float:
        if position[0] > 0.03:
            raise ValueError("too far")
        return -400.0 * (position[0] - 0.02) if position[0] > 0.02 else 0.0

    planes = found(law, (0.0,))
    assert planes
    assert planes[0][1:3] == pytest.approx((0.02, 400.0))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_any_force_gives_valid_planes_or_none(seed: int, n: int) -> None:
    """Waves and steps of all sizes, and places without a number: `ForceWorld.planes` checks what it returns."""
    rng = np.random.default_rng(seed)
    waves = rng.standard_normal((6, n)) * 10.0 ** rng.uniform(0, 4, (6, 1))
    sizes, steps = rng.standard_normal((6, n)) * 10.0 ** rng.uniform(-6, 6), rng.uniform(-0.02, 0.02, 6)

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        x = np.array(position)
        force = (np.sin(waves @ x) * (waves @ x > 100.0 * steps)) @ sizes
        return list(np.sqrt(force) if seed % 3 == 0 else force)

    world = ForceWorld(law, dof=n)
    for _ in range(4):
        world.planes(tuple(rng.uniform(-0.03, 0.03, n).tolist()), 0.1)


@pytest.mark.parametrize(("dof", "most"), [(1, 100), (3, 250)])
def test_the_calls_of_a_step(dof: int, most: int) -> None:
    """The page says about how many."""
    calls = count()

    def law(position: Vector, velocity: Vector, time: float) -> list[float]:
        next(calls)
        return pillow(position, velocity, time)

    world, before = ForceWorld(law, dof=dof), 0
    for k in range(40):
        world.planes((0.0005 * k,) * dof, 0.1)
        after = next(calls)
        assert after - before < most
        before = after


@pytest.mark.parametrize(
    ("link", "hand"),
    mostly_slow([("4g", "hand-31"), ("lan", "hand-77"), ("lan", "hand-31"), ("4g", "hand-77")], 1, 2),
)
def test_a_force_function_is_felt_as_its_springs_in_series(link: str, hand: str) -> None:
    """F = K K_w/(K' + K_w) depth, with K' from 10 mm on: the device's own tick beside what a wall would give."""
    run = simulate(
        {
            "scene": f"{__name__}:pillow", "operator": hand, "link.up": link, "link.down": link, "duration_s": 12.0,
            "device.stiffness": 200.0, "world.stiffness": 500.0, "record_hz": 1000.0,
        },
        seed=5,
    )  # fmt: skip
    device = run.recording.device
    assert device is not None
    x, force = np.array(device["position_m"])[1000:, 0], np.array(device["force_N"])[1000:, 0]
    ideal = -200.0 * 400.0 / (500.0 + 400.0) * np.maximum(0.0, x - 0.01)
    touching = x > 0.01
    assert touching.sum() > 1000
    assert np.sqrt(np.mean((force - ideal)[touching] ** 2) / np.mean(ideal[touching] ** 2)) < 0.05
    assert np.percentile(np.abs(force[x < 0.007]), 99) < 0.1
    assert run.summary["verdict"]["passive"]
