"""What a world is asked, and what it tells.

Each step of length T the proxy, a virtual mass on its virtual coupling, has a mean velocity vhat with

    A vhat = c + f                                          A = 2M/T + B' + K' T/2, see `hapnet.plant.integrator`

where f is the force of all that stands around it. The surroundings get A (as what applies its inverse) and the velocity
``A^-1 c`` that the step would have without them, and answer with f and vhat. So contact, friction and bodies that the
proxy deforms are solved together with the step, whatever its length; bodies take their own step in the same call, which
comes once a step. Theorem 1 holds for any f. What is left to show is that the surroundings give no more than they have:
with U = `stored_J` and S the sum of `supplied_J`,

    -sum f . vhat T + S - (U - U(0)) >= 0

A physics engine that integrates the proxy itself does not fit in here: it takes the integrator's place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from hapnet.checks import Vector

if TYPE_CHECKING:
    from hapnet.plant.worlds.walls import Wall

Inverse = Callable[[Vector], Sequence[float]]
"""Applies A^-1 [m/s per N] to a vector (n,)."""


class Surface(NamedTuple):
    """A wall perpendicular to an axis, as a plot draws it: a line at one coordinate, hatched on its solid side."""

    axis: int  #: index of the coordinate
    position_m: float
    solid: int  #: +1: solid at greater coordinates, -1: at smaller ones


class Plane(NamedTuple):
    """What the proxy touches, as a plane: solid where ``normal . x > offset_m``.

    stiffness, damping : of what is behind it, along the normal [N/m], [Ns/m].
    velocity_mps : of the plane along its normal; 0: it stands still.
    """

    normal: Vector
    offset_m: float
    stiffness: float
    damping: float
    velocity_mps: float = 0.0


class Surroundings(Protocol):
    """What stands around the proxy, of `dof` n."""

    @property
    def dof(self) -> int: ...

    def require_outside(self, position: Sequence[float]) -> None:
        """Raise InvalidParameter if a proxy cannot start at `position` (n,) [m] without energy from nothing."""

    def require_separate(self, inverse: Inverse) -> None:
        """Raise InvalidParameter if a step with this A cannot be solved; asked for several A before the first step."""

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """One step: the force f (n,) [N] and vhat (n,) [m/s], with ``A vhat = c + f``.

        Parameters
        ----------
        dt : T [s], also of the surroundings' own step. position : x_k [m] at its start.
        velocity : ``A^-1 c`` [m/s]. inverse : applies A^-1.
        """

    def penetration(self, position: Sequence[float]) -> float:
        """How deep `position` (n,) [m] is in what it is deepest in [m]; 0 outside."""

    def plane(self, position: Sequence[float]) -> Plane | None:
        """What a proxy at `position` (n,) [m] touches; of several, that which it is deepest in. None: nothing."""

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the surroundings' springs and in their bodies' motion, the proxy being at `position` (n,) [m]."""

    @property
    def supplied_J(self) -> float:
        """Work that obstacles which are moved from outside have put in so far; 0 where nothing is moved."""


@runtime_checkable
class World(Protocol):
    """A world that a user can choose."""

    @property
    def name(self) -> str:
        """What it is called in summaries and figures."""

    @property
    def dof(self) -> int: ...

    @property
    def start(self) -> Vector:
        """Where the proxy starts (n,) [m], outside of everything."""

    @property
    def contacts(self) -> Surroundings: ...

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Its flat walls that stand still, for metrics; others are left out."""

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """For drawing."""

    def next_step_s(self, rng: np.random.Generator) -> float:
        """How long the next step takes, T_k [s]."""

    def towards(self, position: Vector) -> Vector:
        """As far on the straight way from `start` to `position` (n,) [m] as a proxy can be put."""
