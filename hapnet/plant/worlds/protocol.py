"""The protocol of a world: what it receives and what it returns.

In each step of length T the proxy, a virtual mass on its virtual coupling, has a mean velocity vhat with

    A vhat = c + f                                          A = 2M/T + B' + K' T/2, see `hapnet.plant.integrator`

where f is the force of its surroundings. The surroundings get A (as a function that applies its inverse) and the
velocity ``A^-1 c`` that the step would have without them. They return f and vhat. So contact, friction and bodies that
the proxy deforms are solved together with the step, whatever its length. Bodies make their own step in the same call,
which comes once a step. Theorem 1 holds for any f. It remains to show that the surroundings do not output more energy
than they have: with U = `stored_J` and S = `supplied_J`,

    -sum f . vhat T + S - (U - U(0)) >= 0

A physics engine that integrates the proxy itself does not fit here: it replaces the integrator (`EngineWorld`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from hapnet.checks import Vector
from hapnet.mechanics.plane import Plane as Plane

if TYPE_CHECKING:
    from hapnet.plant.integrator import Step
    from hapnet.plant.worlds.walls import Wall

Inverse = Callable[[Vector], Sequence[float]]
"""Applies A^-1 [m/s per N] to a vector (n,)."""


class Surface(NamedTuple):
    """A wall perpendicular to an axis, as a plot draws it: a line at one coordinate, hatched on its solid side."""

    axis: int  #: index of the coordinate
    position_m: float
    solid: int  #: +1: solid at greater coordinates, -1: at smaller ones


class Observed(NamedTuple):
    """What an observer saw of surroundings that promise nothing, and what it made them pay."""

    given_J: float  #: energy that they would have given out beyond what they had, summed over the steps
    paid_J: float  #: what damping took back


class Surroundings(Protocol):
    """Everything around the proxy that acts on it; `dof` is n.

    Those that promise nothing have an attribute `observed` too (`Observed`): what their observer saw. An engine that
    moves the proxy itself has `contact_force`, of all contacts on the proxy, the mean over the last step (n,) [N].
    """

    @property
    def dof(self) -> int: ...

    def require_outside(self, position: Sequence[float]) -> None:
        """Raise InvalidParameter if a proxy that starts at `position` (n,) [m] would create energy."""

    def require_separate(self, inverse: Inverse) -> None:
        """Raise InvalidParameter if a step with this A cannot be solved; called for several A before the first step."""

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Make one step. Returns the force f (n,) [N] and vhat (n,) [m/s], with ``A vhat = c + f``.

        Parameters
        ----------
        dt : T [s], also the length of the surroundings' own step. position : x_k [m] at the step's start.
        velocity : ``A^-1 c`` [m/s]. inverse : applies A^-1.
        """

    def penetration(self, position: Sequence[float]) -> float:
        """Penetration depth of `position` (n,) in the obstacle where it is deepest [m]; 0 outside."""

    def plane(self, position: Sequence[float]) -> Plane | None:
        """The plane that a proxy at `position` (n,) [m] touches: of several, the one where it is deepest. Or None."""

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """The planes that a proxy at `position` (n,) [m] touches, or has within `reach_m` [m]: at most four, the
        deepest or nearest first. A curved obstacle gives its tangent plane at the nearest point, and how its surface
        bends there, if it is known (`Plane.curvatures`). The device feels these planes and nothing else.

        None: this world can tell no planes, or has forces that no plane describes.
        """

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the surroundings' springs and in their bodies' motion, with the proxy at `position` (n,) [m]."""

    @property
    def supplied_J(self) -> float:
        """Total work put in by obstacles that are moved from outside; 0 if none is moved."""


@runtime_checkable
class World(Protocol):
    """A world that a user can choose."""

    @property
    def name(self) -> str:
        """Its name in summaries and figures."""

    @property
    def dof(self) -> int: ...

    @property
    def start(self) -> Vector:
        """Where the proxy starts (n,) [m], outside every obstacle."""

    @property
    def contacts(self) -> Surroundings: ...

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Its flat walls at rest, for metrics; other obstacles are left out."""

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces that plots draw."""

    def next_step_s(self, rng: np.random.Generator) -> float:
        """Duration of the next step, T_k [s]."""

    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` (n,) [m] where a proxy can be placed."""


class VirtualMass(Protocol):
    """What is tied to the virtual coupling, as the world's side moves it; see `hapnet.plant.integrator`."""

    @property
    def position(self) -> Vector: ...
    @property
    def velocity(self) -> Vector: ...
    @property
    def kinetic_J(self) -> float:
        """Its kinetic energy; 0 if that belongs to the environment."""

    def adopt(self, contacts: Surroundings) -> None:
        """Check its surroundings. Raises InvalidParameter."""

    def place(self, position: Vector) -> None:
        """Start at rest there (n,) [m]. Raises InvalidParameter."""

    def step(self, dt: float, set_position: Vector, contacts: Surroundings) -> Step: ...
    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings) -> Step: ...


@runtime_checkable
class EngineMass(VirtualMass, Protocol):
    """One that an engine moves, with the coupling's force held: it may take no more energy than there is."""

    available_J: float
    """What the reservoir holds at the start of a step [J]."""


@runtime_checkable
class EngineWorld(Protocol):
    """A `World` that integrates the proxy itself."""

    warnings: tuple[str, ...]

    def proxy(self, mass: Any, damping: Any, stiffness: Any) -> EngineMass:
        """The proxy on its coupling with B' [Ns/m] and K' [N/m]; `mass` [kg] is of a proxy that the world has added."""
