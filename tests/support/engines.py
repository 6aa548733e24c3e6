"""Small engines for tests: a bead on a rail with a wall, in plain Python, and beads that fail or lie."""

from collections.abc import Mapping, Sequence
from typing import Any

from hapnet import EngineWorld, Params
from hapnet.simulation.simulation import Result, Simulation
from tests.support.theorem_cases import random_case

M, K, AT = 0.05, 2000.0, 0.01
"""The bead's mass [kg], the wall's stiffness [N/m] and place [m]."""

HONEST = ["Bare", "Bead", "Coupled", "Driven"]
LIARS = ["Pump", "Modest", "Jumps", "Hurries", "Light", "Strong", "Against"]
K_PROXY, B_PROXY = 500.0, 14.0


def scene(name: str) -> str:
    return f"tests.support.engines:{name}"


def made(engine: Any) -> tuple[EngineWorld, Any]:
    world = EngineWorld(engine)
    return world, world.proxy(M, B_PROXY, K_PROXY)


def over_random_link(
    scene: str, index: int, steps_s: Sequence[tuple[float, float]], changes: Mapping[str, object]
) -> Result:
    """A run at a scene over one of the theorem's random links; every other one has next to no energy to begin with."""
    link = {key: value for key, value in random_case(index).flat().items() if key.startswith("link.")}
    shortest, longest = steps_s[index % len(steps_s)]
    own = {"world.step_min_s": shortest, "world.step_max_s": longest, "scene": scene}
    poor = {"world.ceiling_J": 2e-4, "device.ceiling_J": 2e-4} if index % 2 else {}
    return Simulation(Params().set({**link, **own, **poor, **changes}), index).run()


def check_account(result: Result, rounding_J: float) -> None:
    """Both halves of Theorem 1, and the environment's account, from what the run measured."""
    summary = result.summary
    assert summary["theorem"]["margin_J"] >= -1e-9
    for part in (summary["device"], summary["world"]):
        assert part["ledger"]["slack_J"] >= -1e-12
        assert part["reservoir_min_J"] >= 0.0
        assert part["deficit_max_J"] == 0.0
    assert summary["environment"]["env_slack_J"] >= -rounding_J
    assert summary["verdict"]["passive"] is True


class Bare:
    """What is required and nothing else: semi-implicit Euler, a wall and a little friction."""

    substep_s = 0.001

    def __init__(self) -> None:
        self.x, self.v = 0.0, 0.0

    def position(self) -> tuple[float, ...]:
        return (self.x,)

    def velocity(self) -> tuple[float, ...]:
        return (self.v,)

    def substep(self, dt: float, force: tuple[float, ...]) -> Any:
        self.v += dt * (force[0] - K * max(0.0, self.x - AT) - 0.2 * self.v) / M
        self.x += dt * self.v

    def save(self) -> Any:
        return self.x, self.v

    def restore(self, state: Any) -> None:
        self.x, self.v = state


class Bead(Bare):
    """One that says what it stores and can be damped."""

    def energy_J(self) -> Any:
        return 0.5 * M * self.v**2, 0.5 * K * max(0.0, self.x - AT) ** 2

    def slow(self, factor: float) -> None:
        self.v *= factor

    def inverse_mass(self) -> float:
        return 1.0 / M


class Coupled(Bead):
    """One that integrates the bead on its coupling, in ten parts of a substep."""

    told: list[float]
    times = 1.0
    """The coupling's force that it uses, in units of the one that it is told."""

    def coupled_substep(self, dt: float, set_position: Any, stiffness: Any, damping: Any) -> None:
        self.told = [*set_position, float(stiffness[0, 0]), float(damping[0, 0])]
        for _ in range(10):
            pull = stiffness[0, 0] * (set_position[0] - self.x) - damping[0, 0] * self.v
            self.substep(0.1 * dt, (self.times * float(pull),))


# -- what lies ---------------------------------------------------------------------------------------------------------


class Pump(Bead):
    """It makes energy: it speeds up what moves, and pushes what rests."""

    def substep(self, dt: float, force: tuple[float, ...]) -> None:
        super().substep(dt, (force[0] + 0.5,))
        self.v *= 1.05


class SilentPump(Pump):
    """It does not say what it stores."""

    def energy_J(self) -> None:
        return None


class Modest(Pump):
    """It says that it stores nothing."""

    def energy_J(self) -> Any:
        return 0.0, 0.0


class Jumps(Bead):
    """Each substep the bead is somewhere else."""

    def substep(self, dt: float, force: tuple[float, ...]) -> None:
        super().substep(dt, force)
        self.x += 0.002 if int(1e6 * self.x) % 3 else -0.003


class Hurries(Bead):
    """The velocity that it says is five times what it is, the other way."""

    def velocity(self) -> tuple[float, ...]:
        return (-5.0 * self.v,)


class Light(Bead):
    """It says that the bead weighs a thousandth of what it does, the other way round would be soft."""

    def inverse_mass(self) -> float:
        return 1e-3 / M


class Strong(Coupled):
    """It uses a force that is ten times what it was told."""

    times = 10.0


class Against(Coupled):
    """It pushes away from the set-position."""

    times = -1.0


class Driven(Bead):
    """Its motor turns the other way at times, and says what it does."""

    steps = 0

    def substep(self, dt: float, force: tuple[float, ...]) -> float:
        push, before = (0.3 if (self.steps // 400) % 2 else -0.3), self.x
        self.steps += 1
        super().substep(dt, (force[0] + push,))
        return push * (self.x - before)

    def save(self) -> Any:
        return self.x, self.v, self.steps

    def restore(self, state: Any) -> None:
        self.x, self.v, self.steps = state


# -- what fails --------------------------------------------------------------------------------------------------------


class Raises(Bead):
    def substep(self, dt: float, force: tuple[float, ...]) -> None:
        raise ArithmeticError("two contacts\nat once")


class NotANumber(Bare):
    def substep(self, dt: float, force: tuple[float, ...]) -> None:
        self.x = float("nan")


class Faster(Bare):
    def substep(self, dt: float, force: tuple[float, ...]) -> None:
        self.v = float("inf")


class Explodes(Bead):
    def energy_J(self) -> Any:
        return (0.0, 1e18) if self.x or self.v else (0.0, 0.0)


class Forgets(Pump):
    """It restores nothing."""

    def slow(self, factor: float) -> None:
        pass

    def restore(self, state: Any) -> None:
        pass


class TwoAxes(Bead):
    def velocity(self) -> tuple[float, ...]:
        return self.v, 0.0


class OneNumber(Bead):
    def energy_J(self) -> Any:
        return 0.5 * M * self.v**2


class Speeds(Pump):
    """Where it has to be damped it goes faster."""

    def slow(self, factor: float) -> None:
        self.v = 2.0 * self.v + 1.0


class Words(Bead):
    def substep(self, dt: float, force: tuple[float, ...]) -> str:
        return "a lot"


class Standing(Bead):
    substep_s = 0.0


class Nowhere(Bead):
    def position(self) -> tuple[float, ...]:
        return ()


class Lacks:
    """No more than a substep and a place."""

    def substep(self, dt: float, force: tuple[float, ...]) -> None: ...

    def position(self) -> tuple[float, ...]:
        return (0.0,)


class Below(Bead):
    def energy_J(self) -> Any:
        return -1.0, 0.0
