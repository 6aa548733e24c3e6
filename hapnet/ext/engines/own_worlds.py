"""User-defined worlds, given as ``module:Name``, which this module completes to a `World`.

The name is that of a function of position, velocity and time that returns a force, or of a class or function that makes
one of these:

* a world of hapnet's classes, such as `Scene` or `ForceWorld`;
* an object with ``step(dt, position, velocity)``, which returns a force (`Stepping`). The force is held over the next
  step, so it need not be passive: a held spring gives out energy. An observer keeps its account
  (hapnet/ext/engines/observer.py);
* a physics engine, with ``substep(dt, force)`` and the other parts of an `Engine`, which integrates the proxy itself
  (hapnet/ext/engines/engine.py);
* an object with the parts of a `World` that have no default, and `contacts` with those of `Surroundings`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite
from typing import Any, Protocol, cast

import numpy as np

from hapnet.checks import Array, Signal, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.engine_account import EngineFailed
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.engines.force_world import ForceWorld
from hapnet.ext.engines.observed_world import ObservedWorld, compliance_of, contact_planes, nearest
from hapnet.ext.engines.obstacle import Law
from hapnet.ext.solids.field_picture import StillPicture, surface
from hapnet.loading import failure, load
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.protocol import Completed, World, is_world, lacking
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S


class Stepping(Protocol):
    """The interface of a user-defined world that computes its force in each step.

    It may also have attributes: `dof`, `name`, and the others of `ObservedWorld`; `supplied_J`, the total work of its
    motors, and `stored_J`, the energy in its bodies and springs, both numbers [J]. And it may have methods:
    `planes(position, reach_m)` returns all surfaces near the proxy (`Surroundings.planes`), `signal(name, value)` takes
    a signal of the device's side, and `signals()` returns its own as a dict.
    """

    def step(self, dt: float, position: Vector, velocity: Vector) -> Sequence[float] | float:
        """Advance by `dt` [s], with the proxy at `position` [m] at the step's start; `velocity` is its mean over the
        last step [m/s]. Returns the force on the proxy [N] for this step.
        """


def builder(name: str, allowed: str, known: Iterable[str]) -> Callable[..., object]:
    """Return the function that makes the world ``module:Name``, with its keywords; see `adapted`.

    allowed, known : for the error. Raises InvalidParameter: it cannot be imported, or has no keywords.
    """
    target: Callable[..., object] = load("scene", name, allowed, known)
    try:
        required = [p for p in inspect.signature(target).parameters.values() if p.default is p.empty]
    except (TypeError, ValueError):
        raise InvalidParameter("scene", name, "module:Name of a class or function with named parameters") from None
    if inspect.iscoroutinefunction(target) or inspect.isgeneratorfunction(target):
        raise InvalidParameter("scene", name, "a plain function, neither `async` nor with a `yield`")
    if inspect.isfunction(target) and [p.kind is p.POSITIONAL_OR_KEYWORD for p in required].count(True) == 3:
        return partial(_force_world, target, name.rpartition(":")[2])
    return target


def _force_world(
    force: Law, name: str, /, *, dof: int = 1, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S
) -> ForceWorld:
    own: dict[str, Any] = {
        part: getattr(force, part) for part in ("energy_J", "planes", "units") if hasattr(force, part)
    }
    return ForceWorld(force, dof=dof, name=name, min_s=step_min_s, max_s=step_max_s, **own)


def made(build: Callable[..., object], name: str, parameters: Mapping[str, object]) -> World:
    """The world that `build` makes of the user's scene `name`.

    Raises InvalidParameter: it cannot be made, or is no world; HapnetError: its contacts lack a part.
    """
    try:
        scene = build(**parameters)
        if not is_world(scene) and not lacking(scene, ("step",)):
            scene = SteppedWorld(cast(Stepping, scene), dof=parameters.get("dof", 1), name=name.rpartition(":")[2])
        if not is_world(scene) and hasattr(scene, "substep") and not isinstance(scene, type):
            scene = EngineWorld(scene, name=name.rpartition(":")[2])
    except EngineFailed as error:
        raise EngineFailed(name, error.why) from error
    except BaseException as error:  # see `loading.failure`
        raise InvalidParameter("scene", name, f"a scene that can be built ({failure(error)})") from error
    if isinstance(scene, EngineWorld):
        scene.account.name = name
    if not is_world(scene):
        allowed = "a function of position, velocity and time, or a function that returns a world, such as hapnet.Scene"
        raise InvalidParameter(f"scene {name}", scene, allowed)
    if missing := lacking(scene.contacts, Surroundings.__abstractmethods__):
        raise HapnetError(f"the scene {name} failed: its contacts have no {', '.join(missing)}")
    whole = isinstance(scene, World) and isinstance(scene.contacts, Surroundings)
    return scene if whole else cast(World, _OwnWorld(scene))


class _OwnWorld(Completed):
    """A user's world with the missing parts of its contacts added."""

    def __init__(self, own: World) -> None:
        super().__init__(own, World)
        self._world = own
        self._contacts: object = None

    @property
    def contacts(self) -> Surroundings:
        if self._world.contacts is not self._contacts:
            self._contacts = self._world.contacts
            self._around = cast(Surroundings, Completed(self._contacts, Surroundings))
        return self._around


class SteppedWorld(ObservedWorld):
    """The world of a `Stepping` object; `others` are parameters of `ObservedWorld` that it does not set itself.

    Raises InvalidParameter; HapnetError from `solve` if the object fails or returns an invalid value.
    """

    def __init__(self, stepping: Stepping, **others: Any) -> None:
        names = ("dof", "name", "energy_J", "min_s", "max_s", "start", "surfaces", "units")
        own = {name: getattr(stepping, name) for name in names if hasattr(stepping, name)}
        super().__init__(**{**others, **own})
        self.robot = bool(getattr(stepping, "robot", False))
        self._has_steps = bool({"min_s", "max_s"} & set(own))
        self._stepping = stepping
        self._velocity: Vector = (0.0,) * self.dof

    def steps_between(self, min_s: float, max_s: float) -> bool:
        if not self._has_steps:
            self._steps = replace(self._steps, min_s=min_s, max_s=max_s)
        return not self._has_steps

    @property
    def supplied_J(self) -> float:
        return self._energy("supplied_J")

    @property
    def bodies_J(self) -> float:
        return self._energy("stored_J")

    def _energy(self, part: str) -> float:
        """The energy that the object reports; 0 if it reports none [J]."""
        try:
            value = getattr(self._stepping, part, 0.0)
            energy = float(value)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: its {part} is no number ({failure(error)})") from error
        if not isfinite(energy):
            raise HapnetError(f"the scene {self.name} failed: its {part} is {value!r}, not a finite number")
        return energy

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """Return the planes from the object; None if it has no method `planes`."""
        method: Callable[[Vector, float], Sequence[Plane] | None] | None = getattr(self._stepping, "planes", None)
        if method is None:
            return None
        try:
            returned = method(tuple(position), reach_m)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: planes() raised {failure(error)}") from error
        return None if returned is None else nearest(contact_planes(self.name, returned, self.dof), position, reach_m)

    def picture(self) -> StillPicture | None:
        """The surface that the object's planes touch; None if it reports none."""
        parts = surface(self.planes, self.dof)
        return StillPicture(parts) if parts else None

    def signal(self, name: str, value: Signal) -> None:
        if (take := getattr(self._stepping, "signal", None)) is not None:
            take(name, value)

    def signals(self) -> Mapping[str, Signal]:
        report: Callable[[], Mapping[str, Signal]] | None = getattr(self._stepping, "signals", None)
        return {} if report is None else report()

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        had = self.supplied_J - self.bodies_J
        force = self._force(dt, tuple(position))
        self._observer.charge(self.supplied_J - self.bodies_J - had)
        applied, mean = self._observer.passive(dt, force, np.array(velocity), compliance_of(inverse, self.dof))
        self._velocity = tuple(mean.tolist())
        return tuple(applied.tolist()), mean.tolist()

    def _force(self, dt: float, position: Vector) -> Array:
        try:
            force = np.array(self._stepping.step(dt, position, self._velocity), dtype=float, ndmin=1)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: step() raised {failure(error)}") from error
        if force.shape != (self.dof,) or not isfinite(force.sum()):
            numbers = f"{self.dof} finite number{'s' * (self.dof > 1)}"
            raise HapnetError(f"the scene {self.name} failed: step() gave {force.tolist()}, not {numbers}")
        return force
