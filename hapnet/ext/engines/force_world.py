"""A user-defined world: obstacles with any force law, passive or not.

A force is averaged over the displacement of a step, and solved together with the step: with the relative positions q
and mean velocities w

    f = int_0^1 F(q + s T w, w, t + s T) ds,     w = w_0 + G f

by Gauss's rule and Newton's method with differences. So a force with a potential keeps its energy at any T, as far as
the rule is exact (the average vector field method: Quispel, McLaren, "A new class of energy-preserving numerical
integration methods", J. Phys. A 2008). Passivity does not depend on the law, or on the accuracy of
the solution: the observer (hapnet/ext/engines/observer.py) uses the work of the force that is really applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.found_planes import FoundPlanes, can_be_searched
from hapnet.ext.engines.implicit import solved
from hapnet.ext.engines.observed_world import ObservedWorld, compliance_of, nearest
from hapnet.ext.engines.obstacle import Law, Obstacle, ObstacleState, Planes
from hapnet.ext.engines.obstacles_picture import ObstaclesPicture
from hapnet.mechanics.contacts import Inverse
from hapnet.mechanics.plane import Plane, checked
from hapnet.records.vectors import added


class ForceWorld(ObservedWorld):
    """User-defined obstacles around the proxy.

    force : a function of position (n,) [m], velocity (n,) [m/s] and time [s] that gives the force on the proxy [N]; or
        obstacles, each with its own force.
    planes : of a force function, as `Obstacle.planes`; by default they are found (hapnet/ext/engines/found_planes.py).
    others : parameters of `ObservedWorld`.

    Raises InvalidParameter; HapnetError from `solve` if a function fails or returns an invalid value.
    """

    def __init__(
        self, force: Law | Sequence[Obstacle], planes: Plane | Planes | Literal["found"] | None = "found", **others: Any
    ) -> None:
        super().__init__(**others)
        own = None if planes == "found" else planes
        obstacles = [Obstacle(force, planes=own)] if callable(force) else list(force)
        if not obstacles or not all(isinstance(obstacle, Obstacle) for obstacle in obstacles):
            raise InvalidParameter("force", force, "a function, or hapnet.Obstacle objects")
        self.obstacles: list[ObstacleState] = [ObstacleState(obstacle, self.dof, self.name) for obstacle in obstacles]
        searched = planes == "found" and can_be_searched(force, self.dof, self.units)
        self._found = FoundPlanes(force, self.dof) if callable(force) and searched else None
        self.time_s: float = 0.0
        self._supplied_J = 0.0

    @property
    def supplied_J(self) -> float:
        return self._supplied_J

    @property
    def bodies_J(self) -> float:
        """Kinetic energy of driven obstacles [J]."""
        return added(body.kinetic_J for body in self.obstacles)

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """The planes of all obstacles; None if an obstacle has none, as the device would not feel it."""
        if self._found is not None:
            found = self._found.around(tuple(position), reach_m, self.time_s)
            return None if found is None else nearest(checked(found, self.dof), position, reach_m)
        by_obstacle = [body.planes(position, self.time_s) for body in self.obstacles]
        if None in by_obstacle:
            return None
        return nearest([plane for planes in by_obstacle for plane in planes or ()], position, reach_m)

    def picture(self) -> ObstaclesPicture:
        return ObstaclesPicture(self.obstacles, self.dof)

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        n, bodies, count = self.dof, self.obstacles, len(self.obstacles)
        for body in bodies:
            body.begin(dt, self.time_s)
        own = compliance_of(inverse, n)
        G = np.tile(own, (count, count))
        for i, body in enumerate(bodies):
            G[i * n : i * n + n, i * n : i * n + n] += body.compliance(dt) * np.eye(n)
        x, v = np.array(position, dtype=float), np.array(velocity)
        free = np.concatenate([v - body.ahead for body in bodies])
        away = [x - body.position for body in bodies]

        def law(w: Array) -> Array:
            parts = zip(bodies, away, w.reshape(count, n), strict=True)
            return np.concatenate([body.average(dt, q, part, self.time_s) for body, q, part in parts])

        applied, _ = self._observer.passive(dt, solved(law, free, G, n), free, G)
        forces = applied.reshape(count, n)
        self._supplied_J += added(body.end(dt, force) for body, force in zip(bodies, forces, strict=True))
        self.time_s += dt
        total = forces.sum(axis=0)
        return tuple(total.tolist()), (v + own @ total).tolist()
