"""Worlds of the user's own: force laws, obstacles that move, objects that step; and their account."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet import ForceWorld, HapnetError, InvalidParameter, Obstacle, Params, simulate
from hapnet.ext.engines.observed_world import ObservedWorld
from hapnet.ext.engines.observer import Observer
from hapnet.ext.engines.own_worlds import SteppedWorld
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scenes.wall import wall as flat_wall
from hapnet.plant.worlds.registry import make_scene
from tests.conftest import mostly_slow
from tests.support.theorem_cases import random_case

Vector = tuple[float, ...]
K, B, AT = 3000.0, 10.0, 0.02


def wall(position: Vector, velocity: Vector, time: float) -> Vector:
    depth = position[0] - AT
    return (-K * depth - B * velocity[0] if depth > 0.0 else 0.0, *(0.0 for _ in position[1:]))


def pump(position: Vector, velocity: Vector, time: float) -> Vector:
    """Pushes outwards, and along with the motion: it gives out all that it can."""
    return tuple(300.0 * x + 2.0 * v for x, v in zip(position, velocity, strict=True))


def shaking(position: Vector, velocity: Vector, time: float) -> float:
    return 2.0 * sin(40.0 * time)


def stroke(time: float) -> float:
    return 0.01 * sin(5.0 * time)


def motor(position: Vector, velocity: Vector, time: float) -> Vector:
    return tuple(-50.0 * x - 2.0 * v + sin(3.0 * time) for x, v in zip(position, velocity, strict=True))


class HeldWall:
    """Explicit: the spring is computed at the step's start and held, which gives out energy."""

    supplied_J, stored_J = 0.0, 0.0

    def __init__(self, *, dof: int = 1) -> None:
        self.dof = dof

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        return wall(position, velocity, 0.0)


MAKE: dict[str, Callable[[], ObservedWorld]] = {
    "wall": lambda: ForceWorld(wall),
    "pump": lambda: ForceWorld(pump),
    "pump with a store": lambda: ForceWorld(pump, energy_J=0.02),
    "shaking": lambda: ForceWorld(shaking),
    "scripted": lambda: ForceWorld([Obstacle(wall, motion=stroke)]),
    "driven": lambda: ForceWorld([Obstacle(wall, mass=0.3, drive=motor)]),
    "driven, three axes": lambda: ForceWorld([Obstacle(wall, mass=0.3, drive=motor), Obstacle(pump)], dof=3),
    "all": lambda: ForceWorld([Obstacle(wall, motion=stroke), Obstacle(wall, mass=0.3, drive=motor), Obstacle(pump)]),
    "stepped": lambda: SteppedWorld(HeldWall()),
}


def run(world: Any, dts: Sequence[float], seed: int, reach: float = 0.03) -> list[tuple[float, float, float, float]]:
    """After each step: the work done on the world, S, U [J], and the proxy's first coordinate [m]."""
    rng = np.random.default_rng(seed)
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, world.start)
    found, work, goal = [], 0.0, world.start
    for k, dt in enumerate(dts):
        if k % 4 == 0:
            goal = tuple(rng.normal(0.0, reach, world.dof).tolist())
        before = np.array(proxy.position)
        done = proxy.step(dt, goal, world.contacts)
        work -= float(np.dot(done.force, np.array(done.position) - before))  # of the force that was really applied
        found.append((work, world.contacts.supplied_J, world.contacts.stored_J(done.position), done.position[0]))
    return found


def slacks(world: Any, found: list[tuple[float, float, float, float]], start_J: float) -> list[float]:
    return [work + supplied - (stored - start_J) for work, supplied, stored, _ in found]


@pytest.mark.parametrize("name", MAKE)
@settings(max_examples=4, deadline=None)
@given(
    dts=st.lists(st.sampled_from([0.001, 0.004, 0.01, 0.03, 0.05, 0.1]), min_size=10, max_size=40),
    seed=st.integers(0, 2**20),
)
def test_a_world_that_promises_nothing_gives_no_more_than_it_has(name: str, dts: list[float], seed: int) -> None:
    world = MAKE[name]()
    start_J = world.stored_J(world.start)
    assert min(slacks(world, run(world, dts, seed), start_J)) >= -1e-13


@pytest.mark.parametrize("name", ["pump", "stepped", "shaking"])
def test_without_the_observer_it_would(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same worlds, and what they say of themselves: the observer saw it, and damping took it back."""
    world = MAKE[name]()
    run(world, [0.03] * 100, 1)
    assert world.observed.given_J > 1e-3
    assert world.observed.paid_J > 1e-6
    free = MAKE[name]()
    monkeypatch.setattr(free._observer, "passive", lambda dt, force, free, G: (force, free + G @ force))
    assert min(slacks(free, run(free, [0.03] * 100, 1), 0.0)) < -1e-3


def test_a_law_with_a_potential_is_as_the_wall_in_closed_form() -> None:
    """Nothing has to be paid, and the proxy goes as deep: to the error of Gauss's rule at the surface's kink."""
    mine, closed = ForceWorld(wall), flat_wall(dof=1)
    ours, theirs = run(mine, [0.02] * 400, 3), run(closed, [0.02] * 400, 3)
    assert mine.observed.paid_J == 0.0
    deepest = [max(x for *_, x in found) - AT for found in (ours, theirs)]
    assert deepest[1] > 0.005
    assert deepest[0] == pytest.approx(deepest[1], rel=0.05)


def test_a_spring_keeps_its_energy_at_any_step() -> None:
    """The mean force of a linear spring is its discrete gradient: W = k x^2 / 2, and all comes back."""
    world = ForceWorld(lambda x, v, t: -40.0 * x[0], energy_J=1.0)
    found = run(world, [0.001, 0.05, 0.1, 0.02] * 40, 5)
    for work, _, _, x in found:
        assert work == pytest.approx(20.0 * x * x, abs=1e-12)


def test_the_work_of_a_script_is_force_times_the_obstacles_way() -> None:
    world = ForceWorld([Obstacle(wall, motion=stroke)])
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    supplied, most = 0.0, 0.0
    times = np.cumsum([0.0, *np.random.default_rng(2).uniform(0.005, 0.05, 400)])
    for before, after in pairwise(times.tolist()):
        done = proxy.step(after - before, (0.03,), world)
        supplied += done.force[0] * (stroke(after) - stroke(before))
        most = max(most, abs(supplied))
        assert world.supplied_J == pytest.approx(supplied, abs=1e-12)
    assert most > 1e-2


def test_a_driven_obstacle_is_pushed_back_and_its_drive_alone_supplies() -> None:
    """Momentum: m du = (d - f) T. With no drive nothing is supplied, and the obstacle takes what the proxy gives."""
    world = ForceWorld([Obstacle(wall, mass=0.3)])
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    body, given = world.obstacles[0], 0.0
    for _ in range(200):
        speed = float(body.velocity[0])
        done = proxy.step(0.01, (0.03,), world)
        assert 0.3 * (float(body.velocity[0]) - speed) == pytest.approx(-done.force[0] * 0.01, abs=1e-12)
        given -= done.work_J
    assert world.supplied_J == 0.0
    assert 1e-4 < 0.5 * 0.3 * float(body.velocity[0]) ** 2 <= given
    driven = ForceWorld([Obstacle(wall, mass=0.3, drive=lambda x, v, t: 0.5)])
    run(driven, [0.01] * 10, 1, reach=0.0)  # away from the proxy: only the motor
    assert driven.supplied_J == pytest.approx(0.5 * 0.5 * 0.5 / 0.3 * 0.1**2, rel=1e-9)  # d x, x = d t^2 / 2 m


@pytest.mark.parametrize("index", mostly_slow(range(2), 1))
@pytest.mark.parametrize("name", ["pump", "stepped", "all"])
def test_over_any_link_both_accounts_hold(name: str, index: int, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[ObservedWorld] = []

    def built(*, dof: int = 1) -> ObservedWorld:
        made.append(MAKE[name]())
        return made[-1]

    monkeypatch.setattr(f"{__name__}.BUILT", built)
    link = {key: value for key, value in random_case(index).flat().items() if key.startswith("link.")}
    changes = {**link, "scene": f"{__name__}:BUILT", "operator": "sine", "duration_s": 2.0}
    summary = simulate(Params().set(changes), index).summary
    own = summary["environment"]
    assert own["env_slack_J"] >= -1e-13
    assert summary["world"]["ledger"]["slack_J"] >= -1e-12
    assert summary["theorem"]["margin_J"] >= -1e-9
    assert summary["verdict"]["passive"] is True


BUILT: Any = None


def test_a_function_is_a_world_and_so_is_an_object_that_steps() -> None:
    world = make_scene(f"{__name__}:wall", dof=2)
    assert isinstance(world, ForceWorld)
    assert (world.name, world.dof, world.start) == ("wall", 2, (0.0, 0.0))
    stepped = make_scene(f"{__name__}:HeldWall", dof=3)
    assert isinstance(stepped, SteppedWorld)
    assert (stepped.name, stepped.dof) == ("HeldWall", 3)


def magnet(position: Vector, velocity: Vector, time: float) -> list[float]:
    """It draws towards 40 mm: its potential falls by 60 mJ from the origin."""
    return [75.0 * (0.04 - x) for x in position]


def test_a_function_may_have_energy_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """1/2 75 N/m (40 mm)^2 = 60 mJ: with that a proxy is drawn in as by the spring, without it nothing is given."""
    for energy_J, drawn in ((0.06, True), (0.0, False)):
        monkeypatch.setattr(magnet, "energy_J", energy_J, raising=False)
        world = make_scene(f"{__name__}:magnet")
        mass = PassiveIntegrator(0.02 * np.eye(1), 14.0 * np.eye(1), 1e-6 * np.eye(1), (0.0,))
        for _ in range(100):
            done = mass.step(0.01, (0.0,), world.contacts)
        assert (done.position[0] > 0.03) is drawn
        observed = world.contacts.observed
        assert (observed.given_J > 1e-6) is not drawn


def broken(position: Vector, velocity: Vector, time: float) -> Any:
    return {1: (1.0, 2.0), 2: (float("nan"),) * 2}[len(position)]


@pytest.mark.parametrize(
    ("dof", "words"), [(1, r"its force is \[1.0, 2.0\], not 1 finite number$"), (2, "nan"), (3, "raised KeyError: 3")]
)
def test_a_law_that_fails_ends_the_run_with_one_line(dof: int, words: str) -> None:
    with pytest.raises(HapnetError, match=words) as caught:
        simulate(Params().set({"scene": f"{__name__}:broken", "dof": dof, "duration_s": 1.0}))
    assert "the scene broken failed" in str(caught.value)


def test_what_makes_no_obstacle() -> None:
    for mistake in (
        lambda: Obstacle(wall, motion=stroke, mass=1.0),
        lambda: Obstacle(wall, drive=motor),
        lambda: Obstacle(wall, mass=-1.0),
        lambda: ForceWorld([]),
        lambda: ForceWorld(wall, energy_J=-1.0),
    ):
        with pytest.raises(InvalidParameter):
            mistake()


class Driven:
    """An object that steps by itself, and says that its motor puts in 1 mJ in each step."""

    supplied_J = 0.0

    def step(self, dt: float, position: Vector, velocity: Vector) -> float:
        self.supplied_J += 1e-3
        return 0.5


def test_what_a_stepping_objects_motor_puts_in_is_counted_and_may_be_given_out() -> None:
    """Its steady push does force times way, and nothing is left to pay while the motor gives more than that."""
    world = SteppedWorld(Driven(), dof=1)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    work = sum(mass.step(0.01, (0.0,), world).work_J for _ in range(20))
    assert world.supplied_J == pytest.approx(0.02)
    assert world.observed.given_J == 0.0
    assert work == pytest.approx(0.5 * mass.position[0], rel=1e-9)
    assert mass.position[0] > 5e-4


def test_a_push_from_rest_gives_just_what_the_account_has() -> None:
    """At rest there is nothing to damp. With G = g I the applied force is w/g, so its work is T w^2/g."""
    dt, compliance, energy_J = 0.01, 0.05, 1e-9
    observer = Observer(energy_J)
    applied, w = observer.passive(dt, np.array([10.0]), np.zeros(1), np.array([[compliance]]))
    assert w[0] == pytest.approx((energy_J * compliance / dt) ** 0.5, rel=1e-6)
    assert applied[0] == pytest.approx(w[0] / compliance)
    assert 0.0 <= observer.energy_J <= 1e-6 * energy_J


@pytest.mark.parametrize("energy_J", [0.0, 2e-4])
def test_the_damper_is_the_smallest_that_pays(energy_J: float) -> None:
    """All that is there is given: E + T (b w - f) w = 0, w = (w_0 + g f) / (1 + g b), with one g for both axes."""
    dt, g, force, free = 0.01, 0.05, np.array([3.0, 1.0]), np.array([0.4, -0.1])
    observer = Observer(energy_J)
    applied, w = observer.passive(dt, force, free, g * np.eye(2))
    begun = free + g * force
    power, square = float(force @ begun), float(begun @ begun)
    roots = np.roots([energy_J * g**2, 2.0 * energy_J * g + dt * (square - g * power), energy_J - dt * power])
    b = min(root for root in roots if root > 0.0)
    assert w == pytest.approx(begun / (1.0 + g * b), rel=1e-6)
    assert applied == pytest.approx(force - b * w, rel=1e-6)
    assert observer.energy_J == pytest.approx(0.0, abs=1e-10)
    assert observer.paid_J == pytest.approx(dt * b * (w @ w), rel=1e-6)
