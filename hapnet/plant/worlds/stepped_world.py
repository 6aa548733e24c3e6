"""A world of the user's own that steps by itself: an object with ``step(dt, position, velocity)``, which gives a force.

The force is held over the step that follows, which is why it promises nothing: a held spring gives out energy. An
observer keeps its account (hapnet/plant/worlds/observer.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any, Protocol, runtime_checkable

import numpy as np

from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.loading import failure
from hapnet.plant.worlds.observed_world import ObservedWorld, compliance_of, nearest, told_planes
from hapnet.plant.worlds.protocol import Inverse, Plane


@runtime_checkable
class Stepping(Protocol):
    """What the user writes.

    It may have attributes too: `dof`, `name`, and the others of `ObservedWorld`; `supplied_J`, the total work of its
    motors, and `stored_J`, the energy in its bodies and springs, both numbers [J]. And it may have a method
    `planes(position, reach_m)` with all surfaces near the proxy as they are now (`Surroundings.planes`); a method
    `signal(name, value)` that hears the device's signals, and one `signals()` that gives its own as a dict.
    """

    def step(self, dt: float, position: Vector, velocity: Vector) -> Sequence[float] | float:
        """Advance by `dt` [s], with the proxy at `position` [m] at the step's start; `velocity` is its mean over the
        last step [m/s]. Returns the force on the proxy [N] for this step.
        """


_ATTRIBUTES = ("dof", "name", "energy_J", "min_s", "max_s", "start", "surfaces")


class SteppedWorld(ObservedWorld):
    """The world of a `Stepping` object.

    Raises InvalidParameter; HapnetError from `solve` if the object fails or gives something else.
    """

    def __init__(self, stepping: Stepping, **others: Any) -> None:
        own = {name: getattr(stepping, name) for name in _ATTRIBUTES if hasattr(stepping, name)}
        super().__init__(**{**others, **own})
        self._stepping = stepping
        self._velocity: Vector = (0.0,) * self.dof

    @property
    def supplied_J(self) -> float:
        return self._energy("supplied_J")

    @property
    def bodies_J(self) -> float:
        return self._energy("stored_J")

    def _energy(self, part: str) -> float:
        """What the object tells of its energy; 0 if it does not tell [J]."""
        try:
            told = getattr(self._stepping, part, 0.0)
            energy = float(told)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: its {part} is no number ({failure(error)})") from error
        if not isfinite(energy):
            raise HapnetError(f"the scene {self.name} failed: its {part} is {told!r}, not a finite number")
        return energy

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """What the object tells; None if it has no method `planes`."""
        tell: Callable[[Vector, float], Sequence[Plane] | None] | None = getattr(self._stepping, "planes", None)
        if tell is None:
            return None
        try:
            told = tell(tuple(position), reach_m)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: planes() raised {failure(error)}") from error
        return None if told is None else nearest(told_planes(self.name, told, self.dof), position, reach_m)

    def signal(self, name: str, value: object) -> None:
        """The device's side tells a value beside the stream; the object gets it if it has a method `signal`."""
        if (take := getattr(self._stepping, "signal", None)) is not None:
            take(name, value)

    def signals(self) -> Mapping[str, Any]:
        """What the object's method `signals` tells the device's side beside the stream, if it has one."""
        tell = getattr(self._stepping, "signals", None)
        return {} if tell is None else tell()

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        had = self.supplied_J - self.bodies_J
        force = self._force(dt, tuple(position))
        self._observer.charge(self.supplied_J - self.bodies_J - had)
        applied, mean = self._observer.passive(dt, force, np.array(velocity), compliance_of(inverse, self.dof))
        self._velocity = tuple(mean.tolist())
        return tuple(applied.tolist()), mean.tolist()

    def _force(self, dt: float, position: Vector) -> np.ndarray[Any, np.dtype[np.float64]]:
        try:
            force = np.array(self._stepping.step(dt, position, self._velocity), dtype=float, ndmin=1)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self.name} failed: step() raised {failure(error)}") from error
        if force.shape != (self.dof,) or not isfinite(force.sum()):
            numbers = f"{self.dof} finite number{'s' * (self.dof > 1)}"
            raise HapnetError(f"the scene {self.name} failed: step() gave {force.tolist()}, not {numbers}")
        return force
