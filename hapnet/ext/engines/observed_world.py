"""The common part of worlds that need not be passive: a world that is its own surroundings, with an observer."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf

import numpy as np

from hapnet.checks import MOST_PLANES, Array, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.observer import Observer
from hapnet.loading import failure
from hapnet.mechanics.contacts import Inverse, Observed, Surroundings
from hapnet.mechanics.plane import Plane, checked
from hapnet.plant.worlds.protocol import Surface, WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import check_number
from hapnet.units import METRES


class ObservedWorld(WorldDefaults, Surroundings):
    """A world with the forces of its subclass (`solve`). An object serves one run.

    dof : n. name : in summaries and figures.
    energy_J : energy that the forces may give out from the start, as a field with a falling potential does [J]. Without
        it they can give back only energy that was put in.
    min_s, max_s : range of the step time T_k [s]. start : where the proxy starts (n,) [m]; the origin by default.
    surfaces : for plots. units : of the axes.

    Raises InvalidParameter.
    """

    dof: int = 1
    surfaces: tuple[Surface, ...] = ()
    units: str = METRES

    def __init__(
        self,
        *,
        dof: int = 1,
        name: str = "own",
        energy_J: float = 0.0,
        min_s: float = STEP_MIN_S,
        max_s: float = STEP_MAX_S,
        start: Sequence[float] = (),
        surfaces: tuple[Surface, ...] = (),
        units: str = METRES,
    ) -> None:
        check_number("energy_J", energy_J, "zero or a positive number [J]", lambda energy: 0.0 <= energy < inf)
        self._steps = Scene(name, dof, (), min_s, max_s, tuple(start), units)  # Scene checks these, and draws the steps
        self.name: str = name
        self.dof = dof
        self.start: Vector = self._steps.start
        self.surfaces, self.units = surfaces, units
        self._observer = Observer(energy_J)

    @property
    def contacts(self) -> ObservedWorld:
        return self

    @property
    def observed(self) -> Observed:
        return self._observer.observed

    @property
    def bodies_J(self) -> float:
        """Energy stored in the world's bodies [J]."""
        return 0.0

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the world's bodies, and the rest of `energy_J` [J]."""
        return self.bodies_J + self._observer.stored_J

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._steps.next_step_s(rng)

    def towards(self, position: Vector) -> Vector:
        """`position`: the proxy can be placed anywhere, as the forces start without energy to give out."""
        return position


def nearest(planes: Iterable[Plane], position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
    """The planes that `position` (n,) [m] is behind, or within `reach_m` [m] of, the deepest first."""
    within = [plane for plane in planes if plane.depth(position) >= -reach_m]
    return tuple(sorted(within, key=lambda plane: -plane.depth(position))[:MOST_PLANES])


def contact_planes(scene: str, reported: Iterable[Plane], dof: int) -> tuple[Plane, ...]:
    """The first four planes that a user's scene returns. Raises HapnetError: they are no planes, or not valid."""
    try:
        return checked(reported, dof)
    except BaseException as error:  # see `loading.failure`
        why = str(error) if isinstance(error, InvalidParameter) else failure(error)
        raise HapnetError(f"the scene {scene} failed: it gave {reported!r:.120}, not hapnet.Planes ({why})") from error


def compliance_of(inverse: Inverse, dof: int) -> Array:
    """A^-1 as a matrix (n, n)."""
    return np.array([inverse(tuple(row)) for row in np.eye(dof).tolist()]).T
