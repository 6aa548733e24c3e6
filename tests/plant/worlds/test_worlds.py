"""What every world owes (`hapnet.plant.worlds.protocol`), and a world of another kind that needs no more than that."""

from collections.abc import Sequence

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scenes import SCENES
from hapnet.plant.worlds.coupled import eliminate
from hapnet.plant.worlds.protocol import World, WorldDefaults
from hapnet.plant.worlds.registry import make_scene
from hapnet.simulation.simulation import Simulation, simulate

STIFFNESS = 2000.0


class Drifting(WorldDefaults, Surroundings):
    """A spring wall that is moved towards the proxy from outside, as a world and its own surroundings.

    In the wall's frame the spring is a wall that stands still. There the midpoint rule is exact, as the force is taken
    where the penetration is in the mean: ``f = -K max(0, (p0 + p1)/2)`` while it stays inside, and else the discrete
    gradient, found by bisection since f falls with the velocity.
    """

    name, dof, start, supplied_J = "drifting", 1, (0.0,), 0.0

    def __init__(self, *, dof: int = 1, speed: float = -0.02) -> None:
        if dof != 1:
            raise InvalidParameter("dof", dof, "1")
        self.speed, self.at = speed, 0.02
        self.forces: list[float] = []

    @property
    def contacts(self) -> Surroundings:
        return self

    def next_step_s(self, rng: np.random.Generator) -> float:
        return 0.01 + 0.03 * float(rng.random())

    def towards(self, position: Vector) -> Vector:
        return self.start

    def require_outside(self, position: Sequence[float]) -> None:
        if self.penetration(position) > 0.0:
            raise InvalidParameter("position", tuple(position), "outside")

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        compliance = inverse((1.0,))[0]
        before = position[0] - self.at

        def force(v: float) -> float:
            after = before + dt * (v - self.speed)
            if after == before:
                return -STIFFNESS * max(0.0, before)
            return -0.5 * STIFFNESS * (max(0.0, after) ** 2 - max(0.0, before) ** 2) / (after - before)

        low, high = velocity[0] - 1e3, velocity[0]
        for _ in range(200):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if middle < velocity[0] + compliance * force(middle) else (low, middle)
        f = (high - velocity[0]) / compliance
        self.supplied_J += f * self.speed * dt
        self.at += self.speed * dt
        self.forces.append(f)
        return [f], [high]

    def penetration(self, position: Sequence[float]) -> float:
        return max(0.0, position[0] - self.at)

    def plane(self, position: Sequence[float]) -> Plane | None:
        if position[0] <= self.at:
            return None
        return Plane((1.0,), self.at, STIFFNESS, 0.0, self.speed)

    def stored_J(self, position: Sequence[float]) -> float:
        return 0.5 * STIFFNESS * self.penetration(position) ** 2


def slack_of(world: World, steps: int, rng: np.random.Generator) -> tuple[float, float]:
    """The least that the surroundings had left [J], and the most that they stored."""
    contacts = world.contacts
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, world.start)
    stored_J = contacts.stored_J(proxy.position)
    work = minimum = most = 0.0
    for _ in range(steps):
        goal = tuple(rng.normal(0.0, 0.03, world.dof).tolist())
        for dt in rng.uniform(0.001, 0.05, 5).tolist():
            done = proxy.step(dt, goal, contacts)
            work -= done.work_J
            held = contacts.stored_J(proxy.position)
            minimum, most = min(minimum, work + contacts.supplied_J - held + stored_J), max(most, held)
            touched = contacts.plane(proxy.position)
            assert (touched is None) == (done.penetration_m == 0.0)
            if touched is not None:
                depth = float(np.dot(touched.normal, proxy.position)) - touched.offset_m
                assert depth == pytest.approx(done.penetration_m, abs=1e-15)
    return minimum, most


@pytest.mark.parametrize("name", [*SCENES, f"{__name__}:Drifting"])
def test_the_surroundings_give_no_more_than_they_have(name: str) -> None:
    world = make_scene(name)
    minimum, most = slack_of(world, 40 if name.endswith("Drifting") else 200, np.random.default_rng(5))
    assert minimum >= -1e-12
    assert (most > 1e-3) == (name != "free")


def test_of_several_walls_the_plane_is_the_one_it_is_deepest_in() -> None:
    plane = make_scene("box", dof=3, size=0.03, stiffness=1500.0, damping=7.0).contacts.plane((0.031, -0.034, 0.0))
    assert plane == Plane((0.0, -1.0, 0.0), 0.03, 1500.0, 7.0)


def test_a_world_of_another_kind_runs_and_what_moves_it_is_accounted_for() -> None:
    """The wall is moved into a hand at rest: the hand feels it, and both accounts close."""
    params = Params().set({"scene": f"{__name__}:Drifting", "operator": "rest", "duration_s": 3.0})
    simulation = Simulation(params, seed=2)
    world = simulation.setup.scene
    result = simulation.run()
    assert result.summary["world"]["ledger"]["slack_J"] >= -1e-9
    assert result.summary["device"]["ledger"]["slack_J"] >= -1e-9
    work = simulation.world.coupling.ledger.work  # what the surroundings put in
    left = -work + world.supplied_J - world.stored_J(simulation.world.mass.position)
    assert left == pytest.approx(0.0, abs=1e-9)  # a spring keeps all
    assert world.supplied_J > 1e-3
    assert min(world.forces) < -0.5


class Field:
    """The least that a world must have: a constant force, held over the step, from contacts of three parts."""

    name, dof, start = "field", 1, (0.0,)

    class Around:
        dof = 1

        def __init__(self) -> None:
            self.given = 0.0

        def solve(
            self, dt: float, x: Vector, velocity: list[float], inverse: Inverse
        ) -> tuple[list[float], list[float]]:
            force = [FORCE_N]
            moved = [v + r for v, r in zip(velocity, inverse((FORCE_N,)), strict=True)]
            self.given += dt * force[0] * moved[0]
            return force, moved

        def stored_J(self, position: Sequence[float]) -> float:
            return 1.0 - self.given

    def __init__(self) -> None:
        self.contacts = self.Around()

    def next_step_s(self, rng: np.random.Generator) -> float:
        return 0.02

    def towards(self, position: Vector) -> Vector:
        return position


FORCE_N = -0.6


def test_a_world_needs_no_more_than_that_and_what_it_lacks_has_defaults() -> None:
    world = make_scene(f"{__name__}:Field")
    assert (world.walls, world.surfaces, world.warnings, world.picture(), world.signals()) == ((), (), (), None, {})
    assert world.contacts is world.contacts
    assert world.contacts.planes((0.0,), 1.0) is None
    assert world.contacts.penetration((0.5,)) == 0.0
    assert not world.moves_proxy
    summary = simulate({"scene": f"{__name__}:Field", "operator": "rest", "duration_s": 3.0}).summary
    assert summary["verdict"]["passive"] is True
    # what the field gives comes out of what it stores, so that its account is closed
    assert summary["environment"]["env_slack_J"] == pytest.approx(0.0, abs=1e-12)


class Bare(Field):
    """Its contacts cannot be solved."""

    def __init__(self) -> None:
        self.contacts = object()  # type: ignore[assignment]


def test_contacts_without_a_needed_part_are_named() -> None:
    with pytest.raises(HapnetError, match=r"Bare failed: its contacts have no dof, solve, stored_J$"):
        make_scene(f"{__name__}:Bare")


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_elimination_finds_numpys_solutions_also_where_a_pivot_is_zero(n: int) -> None:
    """Also of a permutation, whose diagonal is zero at first, and of a pivot that is next to nothing."""
    rng = np.random.default_rng(n)
    tiny = rng.normal(size=(n, n))
    tiny[0, 0] = 1e-18
    for matrix in (rng.normal(size=(n, n)), np.roll(np.eye(n), 1, axis=0), tiny if n > 1 else np.eye(1)):
        right = rng.normal(size=(n, 2))
        rows = np.hstack([matrix, right]).tolist()
        eliminate(n, 2, rows)
        found = [[rows[i][n + k] / rows[i][i] for k in range(2)] for i in range(n)]
        assert found == pytest.approx(np.linalg.solve(matrix, right), rel=1e-9)
