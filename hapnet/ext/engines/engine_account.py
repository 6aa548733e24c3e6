"""An engine's substeps with the environment's account: energy put in, energy stored, and the debt to pay back.

The work of the coupling's force is exact, F . (x_{k+1} - x_k). With the motors' work S
(`hapnet.plant.worlds.account`) and the kinetic and potential energy U

    account += F . (x_{k+1} - x_k) + S_{k+1} - S_k - (U_{k+1} - U_k)

is the energy that contacts, dampers and friction have dissipated. Below 0 the engine has made energy. The debt is paid
at once by damping: all velocities are scaled by sqrt(1 - debt/kinetic energy), which takes exactly the debt. Contacts
give back some of the energy pressed into them, which U does not include, so the account keeps dissipated energy, up to
a ceiling. If an engine does not report U, the account is the energy that the coupling put in, without a ceiling.

An engine that integrates the proxy on its coupling is charged by the terms of (13), at the positions that it reached:

    F = -B' (x_{k+1} - x_k)/h - K' ((x_k + x_{k+1})/2 - ybar),      F . (x_{k+1} - x_k) = -dphi - |vhat|_B'^2 h
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt
from operator import add, sub
from typing import Any

from hapnet.checks import Array, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.engine import Engine
from hapnet.loading import failure
from hapnet.mechanics.contacts import Observed
from hapnet.plant.worlds.scene import checked_dof
from hapnet.records.vectors import inner
from hapnet.units import POSE

CEILING_J = 0.05
"""The most dissipated energy that the account keeps [J]: contacts and flexes store less."""

_MOST_J = 1e15
"""An engine with more energy than this has failed [J]."""

_FARTHEST = 1e3
"""A proxy that is farther away or deeper [m], or faster [m/s], has failed."""

_MOST_N = 1e6
"""A contact force above this [N] cannot be sent: it is the protocol's limit of coordinates."""

_ROUNDING = 1e-14
"""A debt of this share of the energy [J] is rounding."""

_SAME = 1e-9
"""A restored value may differ by this share, or by this number in SI units."""

Coupling = Callable[[Vector, Vector], Vector]
"""The coupling's force of a substep from x_k to x_{k+1} [m], by (13) [N]."""


class EngineFailed(HapnetError):
    """The engine of `scene` returned an invalid value, or raised an exception; `why` describes it."""

    def __init__(self, scene: str, why: str) -> None:
        self.why: str = " ".join(why.split())  # an array takes several lines
        self.scene: str = scene
        super().__init__(f"the scene {scene} failed: {self.why}")

    def __reduce__(self) -> tuple[type[EngineFailed], tuple[str, str]]:
        return type(self), (self.scene, self.why)


class EngineAccount:
    """A running `engine` with its account. name : of the scene, for errors.

    position, velocity : of the proxy, as last reported by the engine [m], [m/s].

    Raises HapnetError, as every call does: the engine raised an exception, or returned an invalid value.
    """

    def __init__(self, engine: Engine, name: str) -> None:
        self.engine: Engine = engine
        self.supplied_J: float = 0.0
        self.given_J: float = 0.0
        self.paid_J: float = 0.0
        self.account_J: float = 0.0
        self.undone: int = 0
        self.undone_J: float = 0.0
        self.name: str = name
        self.dof: int = self._axes()
        self._saved: Any = None
        self._substeps, self._touch = 0, list[float]()
        self.knows_energy: bool = self.ask("energy_J") is not None
        self._ceiling_J = CEILING_J if self.knows_energy else inf
        self.look()

    def _axes(self) -> int:
        place = self.ask("position")
        try:
            return len(place) if self.engine.units == POSE else checked_dof(len(place))
        except (TypeError, InvalidParameter):
            axes = "for 1 to 3 axes or a pose's twelve coordinates"
            raise self.failed(f"position() gave {place!r:.80}, not one number for each axis, {axes}") from None

    def ask(self, method: str, *given: object) -> Any:
        """Call a method of the engine and return its result."""
        try:
            return getattr(self.engine, method)(*given)
        except HapnetError:  # its message is complete
            raise
        except BaseException as error:  # see `loading.failure`
            raise self.failed(f"{method}() raised {failure(error)}") from error

    def look(self) -> None:
        """Read the proxy's state and the stored energy, before the first step."""
        self.position: Vector = self._vector("position")
        self.velocity: Vector = self._vector("velocity")
        self._energy_J = self.energy_J

    def place(self, position: Vector) -> bool:
        """Put the proxy at rest at `position` (n,) [m], and return whether it is free there: `Engine.place`."""
        free = bool(self.ask("place", position))
        self.look()
        return free

    @property
    def observed(self) -> Observed:
        return Observed(self.given_J, self.paid_J, self.undone, self.undone_J, self.engine.overlaps)

    @property
    def energy_J(self) -> float:
        """U, or 0 if it is not known [J]."""
        kinetic, potential = self._energies()
        return potential + kinetic

    @property
    def depth(self) -> float:
        """The proxy's greatest depth in the bodies that it touches [m]: `Engine.depth`."""
        given = self.ask("depth")
        (depth,) = self._numbers("depth", (given,), 1)
        if not abs(depth) < _FARTHEST:
            raise self.failed(f"depth() gave {given!r:.80}; allowed: numbers below {_FARTHEST:g} m")
        return depth

    @property
    def contact_force(self) -> Vector | None:
        """The force of all contacts on the proxy, its mean over this step's substeps [N]; None: not known."""
        if (now := self.ask("contact_force")) is None:
            return None
        now, count = self._numbers("contact_force", now, self.dof), max(1, self._substeps)
        mean = tuple([f / count for f in self._touch or (0.0,) * self.dof])
        for force in (now, mean):
            if not inner(force, force) <= _MOST_N**2:  # also false for NaN
                raise self._diverged(
                    f"contact_force() gave {list(force)}; allowed: finite numbers, up to {_MOST_N:g} N"
                )
        return mean

    def begin(self) -> None:
        """Begin a step of the world."""
        self._substeps, self._touch = 0, []

    def substep(self, h: float, force: Vector, most_J: float) -> tuple[Vector, float]:
        """Advance by `h` [s] with the coupling's `force` (n,) held [N], which may do `most_J` of work.

        Returns the force that was applied [N] and its work [J]. If the work would be larger, the substep is
        repeated without force. If it makes a debt that cannot be paid, it is repeated from rest and without force; if
        the debt remains, the world does not move. `undone` counts repeated substeps; `undone_J` is the energy that
        stopping took out of the world [J].
        """
        self._save()
        moved, supplied = self._advance("substep", h, force)
        return self._entered(h, force, inner(force, moved), supplied, most_J)

    def coupled_substep(
        self, h: float, goal: tuple[Vector, Array, Array], force_of: Coupling, most_J: float
    ) -> tuple[Vector, float]:
        """As `substep`, for a `CoupledEngine`; `goal` is the set-position, K' and B'."""
        self._save()
        before = self.position
        moved, supplied = self._advance("coupled_substep", h, *goal)
        force = force_of(before, self.position)
        return self._entered(h, force, inner(force, moved), supplied, most_J)

    def _advance(self, method: str, h: float, *coupling: object) -> tuple[Vector, float]:
        """Do one substep of the engine; returns the proxy's displacement [m], and the motors' work [J]."""
        before = self.position
        supplied = self.ask(method, h, *coupling)
        self.position = self._vector("position")
        moved = tuple(map(sub, self.position, before))
        if supplied is None:
            return moved, 0.0
        (work,) = self._numbers(method, (supplied,), 1)
        if not abs(work) < _MOST_J:
            raise self._diverged(f"the work of its motors is {work:.3g} J")
        return moved, work

    def _entered(self, h: float, force: Vector, work: float, supplied: float, most_J: float) -> tuple[Vector, float]:
        none = (0.0,) * self.dof
        if work > most_J:
            self._return(at_rest=False)
            force, work = none, 0.0
            _, supplied = self._advance("substep", h, none)
        self._substeps += 1
        if self._settle(work, supplied):
            if (given := self.ask("contact_force")) is not None:
                touch = self._numbers("contact_force", given, self.dof)
                self._touch = list(map(add, self._touch, touch)) if self._touch else list(touch)
        else:
            self._return(at_rest=True)
            force, work = none, 0.0
            _, supplied = self._advance("substep", h, none)
            if not self._settle(0.0, supplied):
                self._return(at_rest=True)
        self.velocity = self._vector("velocity")
        return force, work

    def _return(self, *, at_rest: bool) -> None:
        """Restore the state before this substep. at_rest : stop all bodies, and enter this energy in the account."""
        self.undone += 1
        self.ask("restore", self._saved)
        self._compare()
        if at_rest and self.knows_energy:
            kinetic, energy = self._slowed(0.0, *self._energies())
            energy += kinetic
            self.account_J += self._energy_J - energy
            self.paid_J += self._energy_J - energy
            self.undone_J += self._energy_J - energy
            self._energy_J = energy

    def _settle(self, work: float, supplied: float) -> bool:
        """Enter the energies of this substep, and pay a debt. False: it cannot be paid, and nothing is entered."""
        kinetic, potential = self._energies()
        energy = potential + kinetic
        left = self.account_J + work + supplied - (energy - self._energy_J)
        if left < 0.0:
            self.given_J -= left
            paid = self._pay(-left, kinetic, potential)
            energy, left = energy - paid, left + paid
            if left < -_ROUNDING * abs(energy) - _ROUNDING:
                return False
            self.paid_J += paid
        self.supplied_J += supplied
        self._energy_J = energy
        self.account_J = min(max(0.0, left), self._ceiling_J)
        return True

    def _pay(self, debt: float, kinetic: float, potential: float) -> float:
        """Damp all bodies. Returns the energy paid, at most the kinetic energy [J]."""
        if not kinetic > 0.0:
            return 0.0
        return kinetic - self._slowed(sqrt(max(0.0, 1.0 - debt / kinetic)), kinetic, potential)[0]

    def _slowed(self, factor: float, kinetic: float, potential: float) -> tuple[float, float]:
        """Scale all velocities. Returns the kinetic and the potential energy afterwards [J]."""
        self.ask("slow", factor)
        now = self._energies()
        if now[0] - kinetic > _SAME * (1.0 + kinetic) or abs(now[1] - potential) > _SAME * (1.0 + abs(potential)):
            was = f"{kinetic:.3g} J and {potential:.3g} J into {now[0]:.3g} J and {now[1]:.3g} J"
            raise self.failed(f"slow() may reduce kinetic energy and nothing else; it changed {was}")
        return now

    def _save(self) -> None:
        self._saved, self._before = self.ask("save"), (self.position, self.velocity, (self._energy_J,))

    def _compare(self) -> None:
        """Check that the restored state equals the saved one."""
        now = self._vector("position"), self._vector("velocity"), (self.energy_J,)
        for what, was, here in zip(("position", "velocity", "energy"), self._before, now, strict=True):
            if any(abs(a - b) > _SAME * (1.0 + abs(a)) for a, b in zip(was, here, strict=True)):
                raise self.failed(f"restore() does not bring back the {what} {list(was)}: it is {list(here)}")
        self.position = self._before[0]

    def _energies(self) -> tuple[float, float]:
        """Kinetic and potential energy [J]; 0 if they are not known."""
        if not self.knows_energy:
            return 0.0, 0.0
        kinetic, potential = self._numbers("energy_J", self.ask("energy_J"), 2)
        if not abs(kinetic + potential) < _MOST_J:
            raise self._diverged(f"its energy is {kinetic + potential:.3g} J")
        if kinetic < 0.0:
            raise self.failed(f"its kinetic energy is {kinetic:.3g} J")
        return kinetic, potential

    def _vector(self, method: str) -> Vector:
        found = self._numbers(method, self.ask(method), self.dof)
        if not inner(found, found) < _FARTHEST**2:
            raise self._diverged(f"its {method} is {list(found)}")
        return found

    def _numbers(self, method: str, given: Any, count: int) -> Vector:
        """Convert the result of a method of the engine to `count` floats."""
        try:
            found = tuple(map(float, given))
        except (TypeError, ValueError, OverflowError):
            found = ()
        if len(found) != count:
            raise self.failed(f"{method}() gave {given!r:.80}, not {count} numbers")
        return found

    def _diverged(self, why: str) -> HapnetError:
        return self.failed(f"{why}{self.ask('diagnosis')}")

    def failed(self, why: str) -> HapnetError:
        """The error for this failure, in one line."""
        return EngineFailed(self.name, why)
