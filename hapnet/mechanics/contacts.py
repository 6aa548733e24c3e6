"""The interfaces between a world and its proxy: the surroundings that act on it, and the mass that moves.

In each step of length T the proxy, a virtual mass on its virtual coupling, has a mean velocity vhat with

    A vhat = c + f                                          A = 2M/T + B' + K' T/2, see `hapnet.plant.integrator`

where f is the force of its surroundings. The surroundings receive A (as a function that applies its inverse) and the
velocity ``A^-1 c`` that the step would have without them. They return f and vhat. So contact, friction and bodies that
the proxy deforms are solved together with the step, whatever its length. Bodies make their own step in the same call,
which comes once per step. Theorem 1 holds for any f. In addition, the surroundings must not output more energy than
they have: with U = `stored_J` and S = `supplied_J`,

    -sum f . vhat T + S - (U - U(0)) >= 0

A physics engine that integrates the proxy itself does not use this interface: it has its own `Mass`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, MutableSequence, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from hapnet.checks import Vector
from hapnet.mechanics.plane import Plane
from hapnet.records.vectors import inner

Inverse = Callable[[Vector], Sequence[float]]
"""Applies A^-1 [m/s per N] to a vector (n,)."""


class Observed(NamedTuple):
    """An observer's account of surroundings that may be active: their excess energy, and the part taken back."""

    given_J: float  #: energy that they would have output beyond what they had, summed over the steps
    paid_J: float  #: the part that damping took back
    undone: int = 0  #: substeps of an engine that were repeated
    undone_J: float = 0.0  #: energy that an engine's bodies lost because they were stopped for a repeated substep
    overlaps: int = 0  #: pairs of bodies that overlapped at the start


@runtime_checkable
class Surroundings(Protocol):
    """Everything around the proxy that acts on it; `dof` is n. Methods with a body here are optional."""

    @property
    @abstractmethod
    def dof(self) -> int: ...

    @abstractmethod
    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Make a step. Returns the force f (n,) [N] and vhat (n,) [m/s], with ``A vhat = c + f``.

        dt : T [s], also the length of the surroundings' own step. position : x_k [m] at the step's start.
        velocity : ``A^-1 c`` [m/s]. inverse : applies A^-1.
        """

    @abstractmethod
    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the surroundings' springs and in their bodies' motion, with the proxy at `position` (n,) [m]."""

    @property
    def supplied_J(self) -> float:
        """Total work put in by obstacles that are moved from outside; 0 if no obstacle is moved."""
        return 0.0

    @property
    def observed(self) -> Observed | None:
        """The account of their observer; None: they are passive by design, so they are not observed."""
        return None

    @property
    def contact_force(self) -> Vector | None:
        """The mean force of all contacts on the proxy in the last step (n,) [N]; None: f is that force."""
        return None

    def require_outside(self, position: Sequence[float]) -> None:
        """Raise InvalidParameter if a proxy that starts at `position` (n,) [m] would create energy."""
        return

    def require_separate(self, inverse: Inverse) -> None:
        """Raise InvalidParameter if a step with this A cannot be solved; called for several A before the first step."""
        return

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """The planes that a proxy at `position` (n,) [m] touches, or has within `reach_m` [m]: at most four (eight for
        a pose), the deepest or nearest first. A curved obstacle returns its tangent plane at the nearest point, with
        its curvatures there, if they are known (`Plane.curvatures`). The device renders only these planes.

        None: this world cannot send planes, or has forces that no plane describes.
        """
        return None

    def clearance(self, position: Sequence[float]) -> float:
        """A distance [m] within which nothing acts on a proxy that moves around `position` (n,) [m]; 0 or below: none
        is known. The proxy may be carried through this space (`hapnet.control.carrying`).
        """
        return 0.0

    def slide(
        self, position: Sequence[float], gap_m: float, way: MutableSequence[float], pull: MutableSequence[float]
    ) -> bool:
        """Reduce `way` and `pull` (n,) [m] to their parts along all surfaces within `gap_m` [m] of `position` (n,) [m]:
        no force acts along these. Shorten the way to end that far from others. False: no such way is known."""
        return False

    def stays(self, position: Sequence[float], place: Sequence[float]) -> bool:
        """Whether a proxy's contacts are known to be the same at both places (n,) [m]: the way does no work."""
        return False

    def plane(self, position: Sequence[float]) -> Plane | None:
        """The plane in which a proxy at `position` (n,) [m] is deepest; None: it touches no plane."""
        deepest = next(iter(self.planes(position, 0.0) or ()), None)
        return None if deepest is None or deepest.depth(position) <= 0.0 else deepest

    def penetration(self, position: Sequence[float]) -> float:
        """Largest penetration depth of `position` (n,) in an obstacle [m]; 0 outside, or if it is unknown."""
        plane = self.plane(position)
        return 0.0 if plane is None else plane.depth(position)


_AT_REST_M = 1e-13
"""A shorter way is rounding, some 1e-16 m on each axis: divided by it, rounding of the work would be newtons."""


def doing(work_J: float, force: Vector, moved: Sequence[float]) -> Vector:
    """The force nearest to `force` (n,) [N] that does this work along `moved` (n,) [m]: the mean force of a step that
    was made in parts. `force` itself if nothing moved but by rounding.
    """
    if not (square := inner(moved, moved)) > _AT_REST_M * _AT_REST_M:
        return force
    more = (work_J - inner(force, moved)) / square
    return tuple([part + more * along for part, along in zip(force, moved, strict=True)])


class Step(NamedTuple):
    """The result of one step of the mass; vectors are (n,) tuples."""

    velocity: Vector  #: vhat [m/s], the mean over the step
    force: Vector  #: f [N], all force on the mass except the virtual coupling's
    work_J: float  #: f . vhat T, put in at the world's port
    dissipated_J: float  #: |vhat|_B'^2 T, dissipated by the virtual coupling's damper; the exact D of PSPM
    coupling_force: Vector  #: tau [N]
    position: Vector  #: x_{k+1} [m]
    penetration_m: float  #: largest depth of x_{k+1} in a wall, 0 outside


class Mass(Protocol):
    """The mass at the virtual coupling, moved by the world's end of a law; see `hapnet.plant.integrator`."""

    @property
    def position(self) -> Vector: ...
    @property
    def velocity(self) -> Vector: ...
    @property
    def kinetic_J(self) -> float:
        """Its kinetic energy; 0 if the environment counts that energy."""

    @property
    def can_be_carried(self) -> bool:
        """Whether its position may be set while nothing touches it, see `hapnet.control.carrying`."""
        return False

    def displace(self, way: list[float], dt: float, contacts: Surroundings) -> bool:
        """Move by `way` (n,) [m] at the end of a step of `dt` seconds; velocity and energy stay. Where not every
        position is one of the mass, `way` becomes what was done. False: something touched the mass in that step, or
        would touch it then, and nothing has changed.
        """
        return False

    @property
    def waits(self) -> bool:
        """Whether it starts at the device's first position, and so waits for it."""
        return False

    def port_J(self, counted_J: float) -> float:
        """Work put in at its port so far [J]: the mass's own count, or by default the ledger's, `counted_J`."""
        return counted_J

    def set_contacts(self, contacts: Surroundings) -> None:
        """Check its surroundings. Raises InvalidParameter."""
        return

    def place(self, position: Vector) -> None:
        """Start at rest at `position` (n,) [m]. Raises InvalidParameter."""

    def limit_energy(self, energy_J: float) -> None:
        """Limit the next step's energy to the reservoir's [J], for a coupling that holds its force: it may then use
        this energy and its spring's. A coupling that is solved together with the step needs no limit.
        """
        return

    def step(self, dt: float, set_position: Vector, contacts: Surroundings) -> Step:
        """Make a step of `dt` seconds with the mass's own spring and damper, tied to `set_position`."""

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings) -> Step:
        """Make a step of `dt` seconds with a law's drag [Ns/m] and push [N]."""
