"""Engines of any kind as the world: what they are charged, what they are told, and what becomes of those that lie."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hapnet import Engine, EngineWorld, Plane, Sphere
from hapnet.ext.engines.engine_account import CEILING_J, EngineAccount
from hapnet.simulation.simulation import Result
from tests.conftest import mostly_slow
from tests.support.engines import (
    AT,
    B_PROXY,
    HONEST,
    K_PROXY,
    LIARS,
    Bare,
    Bead,
    Coupled,
    K,
    M,
    check_account,
    made,
    over_random_link,
    scene,
)


def over_a_link(name: str, index: int) -> Result:
    hand = {"operator": ("sine", "press", "hand-3")[index % 3], "duration_s": 1.5}
    return over_random_link(scene(name), index, ((0.01, 0.03), (0.001, 0.001), (0.05, 0.1)), hand)


def check(result: Result) -> None:
    check_account(result, 1e-12)


@pytest.mark.parametrize("index", mostly_slow(range(11), 1, 2))
@pytest.mark.parametrize("name", mostly_slow([(one,) for one in [*HONEST, *LIARS]], 1))
def test_it_is_passive_whatever_the_engine_does(name: str, index: int) -> None:
    check(over_a_link(name, index))


@pytest.mark.parametrize("name", mostly_slow(["Pump", "Modest", "Jumps", "Strong", "Against"], 1))
def test_what_a_liar_would_have_given_is_said(name: str) -> None:
    own = over_a_link(name, 0).summary["environment"]
    assert (own["env_given_J"] or 0.0) > 1e-4
    assert (own["env_undone"] or 0) > 0 or (own["env_paid_J"] or 0.0) > 1e-5


# -- what it is charged, and what it feels like ------------------------------------------------------------------------


@pytest.mark.parametrize("engine", [Bare, Bead, Coupled])
def test_the_wall_holds_the_spring(engine: Any) -> None:
    """K' (ybar - x) = K (x - wall) at rest, whoever integrates the bead."""
    _, mass = made(engine())
    for _ in range(100):
        done = mass.step(0.02, (0.03,))
    rest = (K_PROXY * 0.03 + K * AT) / (K_PROXY + K)
    assert done.position[0] == pytest.approx(rest, rel=1e-4)
    assert done.force[0] == pytest.approx(-K * (rest - AT), rel=1e-3)


def test_a_held_force_is_charged_by_the_way_of_the_bead() -> None:
    """By the bead's own arithmetic, substep by substep."""

    class Witness(Bead):
        work = 0.0

        def substep(self, dt: float, force: Any) -> None:
            before = self.x
            super().substep(dt, force)
            self.work += force[0] * (self.x - before)

    world, mass = made(bead := Witness())
    total = -sum(mass.step(dt, (0.008 * np.sin(0.3 * k),)).work_J for k, dt in enumerate([0.02, 0.003, 0.05] * 10))
    assert world.account.undone == 0
    assert total == pytest.approx(bead.work, rel=1e-12)
    assert total > 1e-4


def test_one_that_is_told_the_coupling_is_charged_by_13() -> None:
    """D = |vhat|_B'^2 h and W = dphi + D of each substep, from where the bead was; never more than the spring had."""

    class Witness(Coupled):
        def __init__(self) -> None:
            super().__init__()
            self.places = [0.0]

        def coupled_substep(self, *told: Any) -> None:
            super().coupled_substep(*told)
            self.places.append(self.x)

    world, mass = made(bead := Witness())
    for k in range(50):
        goal, first = (0.009 * np.sin(0.4 * k),), len(bead.places) - 1
        mass.limit_energy(0.0)
        done = mass.step(0.02, goal)
        x = np.array(bead.places[first:])
        assert len(x) == 21
        dissipated = float(np.sum(np.diff(x) ** 2)) * B_PROXY / 0.001
        phi = 0.5 * K_PROXY * (x[[0, -1]] - goal[0]) ** 2
        assert bead.told == [*goal, K_PROXY, B_PROXY]
        assert done.dissipated_J == pytest.approx(dissipated, abs=1e-15)
        assert done.work_J == pytest.approx(dissipated + phi[1] - phi[0], abs=1e-15)
    assert world.account.undone == 0


@pytest.mark.parametrize("h", [0.001, 0.0004])
@pytest.mark.parametrize("lighter", [1.0, 3.0])
def test_the_held_force_is_that_of_the_substeps_end(h: float, lighter: float) -> None:
    """From rest, with W the inverse mass: F = (1 + (h B' + h^2 K') W)^-1 K' (ybar - x), now and after a new start."""

    class Lighter(Seen):
        def inverse_mass(self) -> float:
            return self.W

    Lighter.W = lighter / M  # type: ignore[attr-defined]
    _, mass = made(bead := Lighter())
    for times in (1.0, 2.0):
        for dt in (0.02, 0.02):  # it moves, and has been pushed
            mass.step(dt, (0.03,))
        bead.W = times * lighter / M  # type: ignore[attr-defined]
        mass.place((0.0,))
        wanted = K_PROXY * 0.005 / (1.0 + (h * B_PROXY + h**2 * K_PROXY) * bead.W)
        assert mass.step(h, (0.005,)).coupling_force[0] == pytest.approx(wanted, rel=1e-12)


def test_a_force_may_use_what_the_reservoir_has_and_no_more() -> None:
    """The damper pushes a bead that goes 1 mm along with it; the spring itself has nothing."""

    class Moving(Bead):
        def substep(self, dt: float, force: Any) -> None:
            self.x += 0.001 * np.sign(force[0] or 1.0)

    asked = 1.0
    for share, taken in ((1.0, True), (1.001, True), (0.999, False)):  # at first of 1 J, then of what was asked
        world, mass = made(bead := Moving())
        mass.limit_energy(share * asked)
        bead.v = -0.5  # so the damper pushes
        world.account.look()
        work = -mass.step(0.001, (0.0,)).work_J
        assert (work > 1e-3) is taken
        asked = work or asked


def test_what_the_hands_mass_changes_is_there_from_the_start() -> None:
    class Heavy(Bead):
        mass = 1.0

        def weigh(self, mass: Any) -> None:
            self.mass = float(mass)

        def energy_J(self) -> Any:
            kinetic, potential = super().energy_J()
            return kinetic, potential - 9.81 * self.mass

    world, mass = made(Heavy())
    assert world.stored_J(()) == -9.81 * M
    mass.step(0.01, (0.0,))
    assert world.account.account_J == 0.0
    assert world.observed.given_J == 0.0


def test_undo_is_exact() -> None:
    """A substep that may not be is made again without force from the same state: the bead coasts."""
    world, mass = made(bead := Bead())
    bead.v = 0.1
    world.account.look()
    applied, work = world.account.substep(0.001, (1.0,), 0.0)  # it would do 1e-4 J
    assert (applied, work) == ((0.0,), 0.0)
    assert bead.v == pytest.approx(0.1 * (1.0 - 0.001 * 0.2 / M), rel=1e-15)
    assert world.observed.undone == 1
    assert mass.position == (bead.x,)


def test_without_its_energy_it_gives_back_no_more_than_it_got() -> None:
    """A bead that is thrown by hand gives its kinetic energy back; one that was thrown by nobody gives nothing."""
    world, mass = made(thrown := Bare())
    assert any("does not report its energy" in line for line in world.warnings)
    thrown.v = 1.0
    world.account.look()
    works = np.cumsum([-mass.step(0.001, (0.0,)).work_J for _ in range(50)])
    assert works.min() >= 0.0
    world, mass = made(Bare())
    works = np.cumsum([-mass.step(0.001, (-0.15 if k < 20 else 0.1,)).work_J for k in range(60)])
    assert works.min() >= 0.0
    assert works.max() - works[-1] > 2.0 * CEILING_J  # what was put in comes back, however much


class Given(Bead):
    """A bead that gets `extra_J` of kinetic energy in its next substep, and a motor that works where it is pushed."""

    extra_J, stubborn = 0.0, False

    def slow(self, factor: float) -> None:
        if not self.stubborn or self.v == 1.0:
            super().slow(factor)

    def substep(self, dt: float, force: Any) -> float:
        self.x += dt * self.v
        self.v = float(np.sqrt(self.v**2 + 2.0 * self.extra_J / M))
        return 1e-3 if force[0] else 0.0


def given(v: float, extra_J: float) -> tuple[Given, EngineAccount]:
    bead = Given()
    bead.v, bead.extra_J = v, extra_J
    return bead, EngineWorld(bead).account


def test_a_debt_is_paid_to_the_joule_by_what_moves() -> None:
    bead, account = given(1.0, 2e-3)
    assert account.substep(0.001, (0.0,), 1.0) == ((0.0,), 0.0)
    assert bead.v == pytest.approx(1.0, rel=1e-12)
    assert account.observed == pytest.approx((2e-3, 2e-3, 0, 0.0, 0))
    assert account.energy_J == pytest.approx(0.5 * M, rel=1e-12)


def test_what_nothing_can_pay_for_is_made_again_from_rest_and_then_not_at_all() -> None:
    """1 J a substep comes from nowhere, whatever the bead does: it stops, and what it had counts as dissipated."""
    bead, account = given(1.0, 1.0)
    bead.stubborn = True
    assert account.substep(0.001, (2.0,), 1.0) == ((0.0,), 0.0)
    assert (bead.x, bead.v) == (0.0, 0.0)
    assert account.supplied_J == 0.0
    assert account.undone == 2
    assert account.undone_J == account.account_J == pytest.approx(0.5 * M, rel=1e-12)


def test_of_a_substep_that_was_made_again_only_the_second_counts() -> None:
    _, account = given(1.0, 0.0)
    assert account.substep(0.001, (1.0,), 1e-6) == ((0.0,), 0.0)  # it would do 1 mJ, and its motor too
    assert account.supplied_J == 0.0
    assert account.undone == 1
    assert account.substep(0.001, (1.0,), 1e-2)[1] == pytest.approx(1e-3)
    assert account.supplied_J == 1e-3
    assert account.account_J == pytest.approx(2e-3)


def test_of_what_was_dissipated_no_more_than_a_ceiling_is_kept() -> None:
    """A hand's work of 30 mJ a substep is lost three times; then 1 J is made: all but 50 mJ of it is a debt."""
    bead, account = given(1.0, 0.0)
    for _ in range(3):
        account.substep(0.001, (30.0,), 1.0)
    assert account.account_J == CEILING_J
    bead.extra_J = 1.0
    account.substep(0.001, (0.0,), 1.0)
    assert account.observed.given_J == account.observed.paid_J == pytest.approx(1.0 - CEILING_J, rel=1e-9)


def test_a_motor_has_a_port_of_its_own() -> None:
    result = over_a_link("Driven", 0)
    assert abs(result.summary["environment"]["env_supplied_J"] or 0.0) > 1e-4
    assert made(Bead())[0].supplied_J == 0.0


# -- what else it can say ----------------------------------------------------------------------------------------------


class Seen(Bead):
    def planes(self, position: Sequence[float], reach_m: float) -> list[Plane]:
        return [Plane((1.0,), AT, K, 0.0, friction=0.25)]

    def contact_force(self) -> list[float]:
        return [-K * max(0.0, self.x - AT)]

    def depth(self) -> float:
        return max(0.0, self.x - AT)

    def shapes(self) -> list[Sphere]:
        return [Sphere((0.0, 0.0, 0.0), 0.002)]

    def poses(self) -> list[tuple[float, ...]]:
        return [(self.x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]

    def place(self, position: Sequence[float]) -> bool:
        self.x, self.v = position[0], 0.0
        return self.x <= AT

    def signals(self) -> dict[str, float]:
        return {"speed": self.v}


def test_its_planes_forces_and_pictures_are_those_of_the_world() -> None:
    world, mass = made(Seen())
    assert world.towards((0.03,))[0] == pytest.approx(AT, abs=4e-5)
    mass.place((0.0,))
    for _ in range(100):
        done = mass.step(0.02, (0.03,))
    assert world.planes(done.position, 0.01) == (Plane((1.0,), AT, K, 0.0, friction=0.25),)
    assert world.contact_force == pytest.approx((done.force[0],), rel=1e-3)
    assert done.penetration_m == world.penetration(done.position) == pytest.approx(done.position[0] - AT)
    picture = world.picture()
    assert picture.poses()[0, 0] == done.position[0]
    (touch,) = picture.touches(done.position, done.force)
    assert touch.point == pytest.approx((AT, 0.0, 0.0))
    assert touch.normal == (-1.0, 0.0, 0.0)
    assert touch.friction == 0.25
    assert np.abs(np.linalg.norm(picture.parts[0].vertices, axis=1) - 0.002).max() < 1e-4
    assert set(world.signals()) == {"speed"}


def test_one_that_says_nothing_of_these_has_none() -> None:
    world, mass = made(Bare())
    assert [world.planes((0.0,), 0.01), world.contact_force, world.picture()] == [None] * 3
    assert world.penetration((0.0,)) == 0.0
    assert world.towards((0.02,)) == world.start == (0.0,)
    mass.place((0.02,))
    assert mass.position == (0.0,)
    assert not world.signals()
    assert not isinstance(Bare(), Engine)
    assert isinstance(world.engine, Engine)


def test_steps_are_those_of_the_parameters_unless_the_world_says_its_own() -> None:
    rng = np.random.default_rng(1)
    world = EngineWorld(Bead(), min_s=0.004, max_s=0.005)
    assert not world.steps_between(0.1, 0.2)
    assert 0.004 <= world.next_step_s(rng) <= 0.005
    world = EngineWorld(Bead())
    assert world.steps_between(0.1, 0.2)
    assert 0.1 <= world.next_step_s(rng) <= 0.2
