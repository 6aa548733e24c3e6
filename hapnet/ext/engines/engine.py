"""The protocol of a physics engine that is a world: it integrates the proxy itself, in substeps.

Five methods are required. All others have a default, so an engine need not inherit from `Engine`. Vectors have one
number an axis of the hand, in SI units, and may be any sequences. Nothing that an engine says is trusted where energy
is concerned: work is force times the way between two of its positions, and what it stores has to explain it
(`hapnet.ext.engines.engine_account`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from hapnet.checks import Array, Signal, Vector
from hapnet.ext.solids.shapes import Shape
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import Picture, at_rest
from hapnet.units import METRES


@runtime_checkable
class Engine(Protocol):
    """A physics engine with a proxy in it, a body that the hand holds."""

    substep_s: float = 0.001
    """The longest substep, 10 us or more [s]. A step of the world is made of as many equal ones as it takes."""

    warnings: tuple[str, ...] = ()
    """What somebody who runs it should know."""

    units: str = METRES
    """Of its axes: ``m``, ``rad``, or one for each as in ``m,m,rad``."""

    overlaps: int = 0
    """Pairs of bodies that begin inside one another."""

    @abstractmethod
    def position(self) -> Sequence[float]:
        """Of the proxy (n,) [m]. At first: where it starts."""

    @abstractmethod
    def velocity(self) -> Sequence[float]:
        """Of the proxy (n,) [m/s]."""

    @abstractmethod
    def substep(self, dt: float, force: Vector) -> float | None:
        """Advance by `dt` [s] with the coupling's `force` (n,) on the proxy [N], held.

        Returns the work that motors did in it [J]; None: there are none.
        """

    @abstractmethod
    def save(self) -> Any:
        """The present state, of any type. Only the one that was saved last is restored, perhaps several times."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Go back there: all that moves, and what the next substep depends on."""

    def energy_J(self) -> tuple[float, float] | None:
        """Kinetic and potential energy of all that moves, the proxy too [J]. None: not known.

        Then the engine can give back only what was put in since the start.
        """
        return None

    def slow(self, factor: float) -> None:
        """Multiply all velocities by `factor`, 0 to 1. So the engine pays for energy that it made."""
        return

    def inverse_mass(self) -> ArrayLike | None:
        """How the proxy's velocity answers to an impulse [1/kg]: one number, or (n, n). None: 1/mass of the parameters.

        With it the coupling's force is computed for the substep's end. A wrong one makes it soft or shaky.
        """
        return None

    def weigh(self, mass: ArrayLike) -> None:
        """The proxy's mass is to be this [kg], before the first step. Raises InvalidParameter."""
        return

    def place(self, position: Vector) -> bool:
        """Put the proxy at rest there (n,) [m], before the first step. Returns whether it is free there.

        By default it stays where it is.
        """
        return False

    def depth(self) -> float:
        """How deep the proxy is in what it touches, where it is deepest [m]."""
        return 0.0

    def contact_force(self) -> Sequence[float] | None:
        """Of all contacts on the proxy, now (n,) [N], up to 1e6 N. None: not known."""
        return None

    def planes(self, position: Vector, reach_m: float) -> Sequence[Plane] | None:
        """As `hapnet.Surroundings`: what the proxy touches or is near, the deepest or nearest first."""
        return None

    def shapes(self) -> Sequence[Shape]:
        """The shapes for pictures, each as seen from its body."""
        return ()

    def poses(self) -> ArrayLike:
        """How the bodies of `shapes` lie now: place [m] and quaternion w, x, y, z, of unit length (B, 7)."""
        poses: Array = at_rest([()] * len(self.shapes()))
        return poses

    def picture(self) -> Picture | None:
        """A picture of the engine's own, in place of `shapes`."""
        return None

    def signal(self, name: str, value: Signal) -> None:
        """The device's side reports a value beside the stream."""
        return

    def signals(self) -> Mapping[str, Signal]:
        """The signals that the world reports to the device's side beside the stream."""
        return {}

    def diagnosis(self) -> str:
        """Why it may have failed: what the line that ends the run goes on with."""
        return ""


@runtime_checkable
class CoupledEngine(Engine, Protocol):
    """One that can integrate the proxy on its virtual coupling: it takes the set-position and the two gains."""

    @abstractmethod
    def coupled_substep(self, dt: float, set_position: Vector, stiffness: Array, damping: Array) -> float | None:
        """Advance by `dt` [s] with the coupling's force -B' v - K' (x - ybar) on the proxy, from moment to moment.

        set_position : ybar (n,) [m]. stiffness, damping : K' [N/m], B' [Ns/m], both (n, n). Returns as `substep`.
        """
