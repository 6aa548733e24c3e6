"""Engines that fail: each in one line; and any numbers at all, with which both accounts hold."""

import sys
from collections.abc import Sequence
from math import nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet import EngineWorld, HapnetError, cli
from hapnet.plant.worlds.registry import make_scene
from hapnet.wire import fields
from tests.conftest import mostly_slow
from tests.support import engines
from tests.support.engines import HONEST, K_PROXY, LIARS, Bead, made, scene

FAILS = {
    "Raises": "substep() raised ArithmeticError: two contacts at once",
    "NotANumber": "its position is [nan]",
    "Faster": "its velocity is [inf]",
    "Explodes": "its energy is 1e+18 J",
    "Forgets": "restore() does not bring back the position",
    "TwoAxes": "velocity() gave (0.0, 0.0), not 1 numbers",
    "OneNumber": "energy_J() gave 0.0, not 2 numbers",
    "Speeds": "slow() may reduce kinetic energy and nothing else",
    "Words": "substep() gave ('a lot',), not 1 numbers",
    "Standing": "its substep_s is 0.0; allowed: 1e-05 s or more",
    "SilentPump": "its velocity is [",
    "Nowhere": "position() gave ()",
    "Lacks": "its engine has no restore, save, velocity",
    "Below": "its kinetic energy is -1 J",
}


@pytest.mark.parametrize("name", FAILS)
def test_what_fails_is_one_line_and_exit_code_2(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", "--scene", scene(name), "--operator", "press", "--duration", "2", "--no-files"]) == 2
    complaint = capsys.readouterr().err
    assert FAILS[name] in complaint
    assert f"the scene {scene(name)} failed: " in complaint
    assert len(complaint.strip().splitlines()) == 1


def test_every_engine_of_the_tests_is_used() -> None:
    mine = {
        name for name, each in vars(engines).items() if isinstance(each, type) and each.__module__ == engines.__name__
    }
    assert mine == {*HONEST, *LIARS, *FAILS}
    assert make_scene(scene("Bead")).name == "Bead"


GAVE = [
    ("contact_force", [nan], "contact_force() gave [nan]; allowed: finite numbers, up to 1e+06 N"),
    ("contact_force", [1e300], "contact_force() gave [1e+300]; allowed: finite"),
    ("contact_force", [-1.1e6], "contact_force() gave [-1100000.0]; allowed: finite"),
    ("contact_force", [1.0, 2.0], "contact_force() gave [1.0, 2.0], not 1 numbers"),
    ("contact_force", 3.0, "contact_force() gave 3.0, not 1 numbers"),
    ("contact_force", "ab", "contact_force() gave 'ab', not 1 numbers"),
    ("contact_force", [10**400], "contact_force() gave [1000"),
    ("contact_force", np.ones((2, 2)), "contact_force() gave array([[1., 1.], [1., 1.]]), not 1 numbers"),
    ("depth", nan, "depth() gave nan; allowed: numbers below 1000 m"),
    ("depth", 1e300, "depth() gave 1e+300; allowed"),
    ("depth", "deep", "depth() gave ('deep',), not 1 numbers"),
    ("depth", None, "depth() gave (None,), not 1 numbers"),
    ("inverse_mass", nan, "inverse_mass() gave nan; allowed: one number"),
    ("inverse_mass", -5.0, "inverse_mass() gave -5.0; allowed"),
    ("inverse_mass", -5, "inverse_mass() gave -5; allowed"),
    ("inverse_mass", 1e300, "inverse_mass() gave 1e+300; allowed"),
    ("inverse_mass", [[1.0, 2.0], [3.0]], "inverse_mass() gave [[1.0, 2.0], [3.0]]; allowed"),
    ("inverse_mass", [1.0, 2.0], "inverse_mass() gave [1.0, 2.0]; allowed"),
    ("inverse_mass", "light", "inverse_mass() gave 'light'; allowed"),
    ("energy_J", 5, "energy_J() gave 5, not 2 numbers"),
]
"""Of a method of the engine: what it gives, and what the line says."""


def giving(method: str, given: Any) -> Any:
    engine = Bead()
    setattr(engine, method, lambda: given)
    return engine


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize(("method", "given", "says"), mostly_slow(GAVE, 11))
def test_what_a_method_may_not_give_ends_the_run_with_its_name(
    method: str,
    given: Any,
    says: str,
    wrapped: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Whether the scene is an engine, or an `EngineWorld` without a name: the line has the scene as it was given."""

    def build() -> Any:
        engine = giving(method, given)
        return EngineWorld(engine) if wrapped else engine

    monkeypatch.setattr(engines, "build", build, raising=False)
    assert (
        cli.main(["simulate", "--scene", scene("build"), "--operator", "press", "--duration", "1", "--no-files"]) == 2
    )
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith(f"hapnet: the scene {scene('build')} failed: {says}")


def test_a_contact_force_up_to_the_protocols_limit_is_sent() -> None:
    world, mass = made(giving("contact_force", [-fields.MAX_COORDINATE]))
    mass.step(0.01, (0.0,))
    assert world.contact_force == (-fields.MAX_COORDINATE,)


def test_a_contact_force_that_was_no_number_for_one_substep_is_seen() -> None:
    forces = iter([[1.0], [nan], [1.0], [1.0]])
    engine: Any = Bead()
    engine.contact_force = lambda: next(forces)
    world, mass = made(engine)
    mass.step(0.003, (0.0,))
    with pytest.raises(HapnetError, match=r"contact_force\(\) gave \[nan\]"):
        _ = world.contact_force


def test_substeps_are_at_least_10_us() -> None:
    class Hasty(Bead):
        substep_s = 1e-9

    with pytest.raises(HapnetError, match=r"^the scene own failed: its substep_s is 1e-09; allowed: 1e-05 s or more$"):
        EngineWorld(Hasty())
    Hasty.substep_s = 1e-5
    EngineWorld(Hasty())


def test_without_pybullet_its_example_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    assert cli.main(["simulate", "--scene", "examples.bullet_world:Boxes", "--no-files"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "this world needs PyBullet: pip install pybullet" in line


number = st.floats(-999.0, 999.0)


@settings(max_examples=150, deadline=None)
@given(
    tape=st.lists(st.tuples(number, number, st.floats(0.0, 1e3), number, number), min_size=8, max_size=40),
    goals=st.lists(st.tuples(number, st.floats(1e-4, 0.3), st.floats(0.0, 1.0)), min_size=1, max_size=12),
    knows=st.booleans(),
    damps=st.booleans(),
    coupled=st.booleans(),
)
def test_whatever_an_engine_says_both_accounts_hold(
    tape: list[tuple[float, ...]], goals: list[tuple[float, ...]], knows: bool, damps: bool, coupled: bool
) -> None:
    """Places, velocities, energies and motors' work are any numbers; only what was saved comes back."""

    class Anything:
        substep_s = 0.05

        def __init__(self) -> None:
            self.now, self.at = tape[0], 0

        def position(self) -> Sequence[float]:
            return (self.now[0],)

        def velocity(self) -> Sequence[float]:
            return (self.now[1],)

        def energy_J(self) -> Any:
            return self.now[2:4] if knows else None

        def substep(self, dt: float, force: Any) -> float:
            self.at += 1
            self.now = tape[self.at % len(tape)]
            return self.now[4]

        def save(self) -> Any:
            return self.now

        def restore(self, state: Any) -> None:
            self.now = state

        def slow(self, factor: float) -> None:
            if damps:
                self.now = (*self.now[:2], factor**2 * self.now[2], *self.now[3:])

    class AnythingCoupled(Anything):
        def coupled_substep(self, dt: float, *told: Any) -> float:
            return self.substep(dt, None)

    world, mass = made(AnythingCoupled() if coupled else Anything())
    start, given_J, E, scale = world.stored_J(()), 0.0, 0.0, 1e3
    for goal, dt, extra in goals:
        E += extra
        before = 0.5 * K_PROXY * (mass.position[0] - goal) ** 2
        mass.limit_energy(E)
        done = mass.step(dt, (goal,))
        after = 0.5 * K_PROXY * (done.position[0] - goal) ** 2
        scale = max(scale, before, after, abs(done.work_J))
        assert -done.work_J <= before + E  # it takes no more than there is
        assert E + done.dissipated_J + after >= -1e-12 * scale
        E = max(0.0, E + done.dissipated_J)
        given_J -= done.work_J
        assert given_J + world.supplied_J - (world.stored_J(()) - start) >= -1e-11 * scale


def test_an_engine_that_raises_a_hapnet_error_says_it_itself() -> None:
    class Own(Bead):
        def substep(self, dt: float, force: Any) -> None:
            raise HapnetError("the rail is too short")

    with pytest.raises(HapnetError, match=r"^the rail is too short$"):
        made(Own())[1].step(0.01, (0.0,))
