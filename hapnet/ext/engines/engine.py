"""The protocol of a physics engine as a world, which integrates the proxy itself, in substeps.

Five methods are required. All others have a default, so an engine need not inherit from `Engine`. Vectors have one
number for each axis of the hand, in SI units, and may be any sequences. The energy that an engine reports is always
checked: work is computed from force and displacement, and the stored energy may not grow by more
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
    """A physics engine with a proxy, the body that the hand holds."""

    substep_s: float = 0.001
    """The longest substep, 10 us or more [s]. A step of the world has as many equal substeps as necessary."""

    warnings: tuple[str, ...] = ()
    """Warnings for the user at the start of a run."""

    units: str = METRES
    """The units of its axes: ``m``, ``rad``, or a unit for each axis as in ``m,m,rad``."""

    overlaps: int = 0
    """The number of pairs of bodies that overlap at the start."""

    @abstractmethod
    def position(self) -> Sequence[float]:
        """The proxy's position (n,) [m]; before the first step, its start."""

    @abstractmethod
    def velocity(self) -> Sequence[float]:
        """The proxy's velocity (n,) [m/s]."""

    @abstractmethod
    def substep(self, dt: float, force: Vector) -> float | None:
        """Advance by `dt` [s] with the coupling's `force` (n,) on the proxy [N], held.

        Returns the work of the model's motors in it [J]; None: there are no motors.
        """

    @abstractmethod
    def save(self) -> Any:
        """The present state, of any type. Only the state saved last is restored, perhaps several times."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Restore a saved state: all motion, and all else that the next substep depends on."""

    def energy_J(self) -> tuple[float, float] | None:
        """Kinetic and potential energy of all bodies, the proxy too [J]. None: not known.

        If it is not known, the engine can give back only energy that was put in since the start.
        """
        return None

    def slow(self, factor: float) -> None:
        """Multiply all velocities by `factor`, 0 to 1. This removes energy that the engine made."""
        return

    def inverse_mass(self) -> ArrayLike | None:
        """The proxy's inverse mass [1/kg]: one number, or (n, n). None: 1/mass of the parameters.

        With it the coupling's force is computed for the substep's end. A wrong value makes the coupling soft or shaky.
        """
        return None

    def weigh(self, mass: ArrayLike) -> None:
        """Set the proxy's mass [kg], before the first step. Raises InvalidParameter."""
        return

    def place(self, position: Vector) -> bool:
        """Put the proxy at rest at `position` (n,) [m], before the first step. Returns whether it is free there.

        By default the proxy stays where it is.
        """
        return False

    def depth(self) -> float:
        """The proxy's greatest depth in the bodies that it touches [m]."""
        return 0.0

    def contact_force(self) -> Sequence[float] | None:
        """The present force of all contacts on the proxy (n,) [N], up to 1e6 N. None: not known."""
        return None

    def planes(self, position: Vector, reach_m: float) -> Sequence[Plane] | None:
        """As `hapnet.Surroundings`: planes that the proxy touches or is near, the deepest or nearest first."""
        return None

    def shapes(self) -> Sequence[Shape]:
        """The shapes for pictures, each in the frame of its body."""
        return ()

    def poses(self) -> ArrayLike:
        """The present poses of the bodies of `shapes`: place [m] and unit quaternion w, x, y, z, (B, 7)."""
        poses: Array = at_rest([()] * len(self.shapes()))
        return poses

    def picture(self) -> Picture | None:
        """The engine's own picture, in place of `shapes`."""
        return None

    def signal(self, name: str, value: Signal) -> None:
        """Take a signal from the device's side."""
        return

    def signals(self) -> Mapping[str, Signal]:
        """The signals of the world to the device's side."""
        return {}

    def diagnosis(self) -> str:
        """A possible reason for a failure, appended to the error that ends the run."""
        return ""


@runtime_checkable
class CoupledEngine(Engine, Protocol):
    """An engine that can integrate the proxy on its virtual coupling, from the set-position and both gains."""

    @abstractmethod
    def coupled_substep(self, dt: float, set_position: Vector, stiffness: Array, damping: Array) -> float | None:
        """Advance by `dt` [s] with the coupling's force -B' v - K' (x - ybar) on the proxy, continuously updated.

        set_position : ybar (n,) [m]. stiffness, damping : K' [N/m], B' [Ns/m], both (n, n). Returns as `substep`.
        """
