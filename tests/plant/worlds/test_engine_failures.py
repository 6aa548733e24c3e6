"""Engines that fail: each in one line; and any numbers at all, with which both accounts hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapnet import HapnetError, cli
from hapnet.plant.worlds.registry import make_scene
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
    "Speeds": "slow() may take kinetic energy and nothing else",
    "Words": "substep() gave ('a lot',), not 1 numbers",
    "Standing": "its substep_s is 0.0, not a positive number",
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
    assert name in complaint
    assert len(complaint.strip().splitlines()) == 1


def test_every_engine_of_the_tests_is_used() -> None:
    mine = {
        name for name, each in vars(engines).items() if isinstance(each, type) and each.__module__ == engines.__name__
    }
    assert mine == {*HONEST, *LIARS, *FAILS}
    assert make_scene(scene("Bead")).name == "Bead"


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
        mass.afford(E)
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
