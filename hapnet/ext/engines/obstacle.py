"""A user-defined obstacle: a force law, and the obstacle's motion.

The law is a function of the proxy's position and velocity, relative to the obstacle, and of time. The obstacle rests,
or follows a script (`motion`: its position as a function of time), or is a driven mass (`mass`, `drive`), which the
proxy can push back. The work of the script's motor or the drive is counted at a separate port:

    scripted:  S += f . (r(t + T) - r(t))            the motor holds the obstacle against the reaction -f
    driven:    m (u_1 - u_0)/T = d - f,   S += d . uhat T,   uhat = (u_0 + u_1)/2

The sign may be either: a wall that is pushed away takes energy out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.implicit import solved
from hapnet.ext.engines.observed_world import contact_planes
from hapnet.ext.solids.shapes import Shape
from hapnet.loading import failure
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.walls import check_number

Law = Callable[[Vector, Vector, float], Sequence[float] | float]
"""A force (n,) [N] at a position (n,) [m], with a velocity (n,) [m/s], at a time [s]."""

Planes = Callable[[Vector, float], Sequence[Plane]]
"""The planes near a position (n,) [m], at a time [s]."""

Motion = Callable[[float], Sequence[float] | float]
"""A position (n,) [m] at a time [s]."""


_points, _weights = np.polynomial.legendre.leggauss(8)
_RULE = tuple(zip((0.5 + 0.5 * _points).tolist(), (0.5 * _weights).tolist(), strict=True))
"""Gauss's rule on the path of a step: shares of it, and their weights."""


@dataclass(frozen=True)
class Obstacle:
    """The surroundings that act on the proxy.

    force : the force on the proxy, a `Law` of its position and velocity relative to the obstacle.
    motion : a script of the obstacle's position; None: it rests at the origin, or is driven.
    mass : of a driven obstacle [kg], which starts at rest at the origin; 0: it is not driven.
    drive : the force on a driven obstacle, a `Law` of its own position and velocity.
    planes : to be sent, so that the hand feels the surface without delay: a plane, or a function of the proxy's
        position and of time that returns planes; all relative to the obstacle. None: no plane describes the force.
    shape : for pictures, relative to the obstacle (`hapnet.ext.solids.shapes`); it has no effect on forces.

    Raises InvalidParameter.
    """

    force: Law
    motion: Motion | None = None
    mass: float = 0.0
    drive: Law | None = None
    planes: Plane | Planes | None = None
    shape: Shape | None = None

    def __post_init__(self) -> None:
        check_number("mass", self.mass, "zero or a positive number [kg]", lambda m: 0.0 <= m < inf)
        if self.mass and self.motion is not None:
            raise InvalidParameter("mass", self.mass, "0 with a motion: a script moves it, whatever its mass")
        if self.drive is not None and not self.mass:
            raise InvalidParameter("mass", self.mass, "a positive number [kg] with a drive")


class ObstacleState:
    """The state of one obstacle with n axes. `scene`: the world's name, for errors."""

    def __init__(self, obstacle: Obstacle, dof: int, scene: str) -> None:
        self.obstacle = obstacle
        self._dof, self._scene = dof, scene
        self.position = np.zeros(dof) if obstacle.motion is None else self._evaluated("motion", obstacle.motion, 0.0)
        self.velocity: Array = np.zeros(dof)
        self.drive: Array = np.zeros(dof)
        self.ahead: Array = np.zeros(dof)
        """uhat without the proxy's reaction [m/s]."""

    @property
    def kinetic_J(self) -> float:
        return 0.5 * self.obstacle.mass * float(self.velocity @ self.velocity)

    def compliance(self, dt: float) -> float:
        """The change of uhat with the proxy's push [m/s per N]."""
        return 0.5 * dt / self.obstacle.mass if self.obstacle.mass else 0.0

    def begin(self, dt: float, time: float) -> None:
        """Begin a step of `dt` [s] at `time` [s]: compute `ahead`."""
        obstacle = self.obstacle
        if obstacle.motion is not None:
            self.ahead = (self._evaluated("motion", obstacle.motion, time + dt) - self.position) / dt
        elif obstacle.mass:
            if obstacle.drive is not None:  # solved for the obstacle alone, then held
                drive = partial(self._mean, "drive", obstacle.drive, dt, self.position, time=time)
                self.drive = solved(drive, self.velocity, self.compliance(dt) * np.eye(self._dof), self._dof)
            self.ahead = self.velocity + self.compliance(dt) * self.drive

    def average(self, dt: float, position: Array, velocity: Array, time: float) -> Array:
        """The mean force on the proxy [N] over a step from a position with a velocity, relative to the obstacle."""
        return self._mean("force", self.obstacle.force, dt, position, velocity, time)

    def end(self, dt: float, force: Array) -> float:
        """End the step, with `force` [N] on the proxy. Returns the energy supplied [J]."""
        mean = self.ahead - self.compliance(dt) * force
        moved = dt * mean
        self.position = self.position + moved
        if not self.obstacle.mass:
            return float(force @ moved)
        self.velocity = 2.0 * mean - self.velocity
        return float(self.drive @ moved)

    def planes(self, position: Sequence[float], time: float) -> tuple[Plane, ...] | None:
        """The planes around `position` [m] at `time` [s], moved with the obstacle; None: it has none."""
        report = self.obstacle.planes
        if report is None:
            return None
        away = tuple([x - r for x, r in zip(position, self.position.tolist(), strict=True)])
        if isinstance(report, Plane):
            found: Sequence[Plane] = (report,)
        else:
            try:
                found = tuple(report(away, time))
            except BaseException as error:  # see `loading.failure`
                raise HapnetError(f"the scene {self._scene} failed: its planes raised {failure(error)}") from error
        moves = self.velocity if self.obstacle.mass else self.ahead
        return tuple(
            [
                plane._replace(
                    offset_m=plane.offset_m + float(self.position @ plane.normal),
                    velocity_mps=plane.velocity_mps + float(moves @ plane.normal),
                )
                for plane in contact_planes(self._scene, found, self._dof)
            ]
        )

    def _mean(self, name: str, law: Law, dt: float, position: Array, velocity: Array, time: float) -> Array:
        """The mean of `law` over a step of `dt` [s]."""
        x, v = position.tolist(), tuple(velocity.tolist())
        total = np.zeros(self._dof)
        for share, weight in _RULE:
            passed = share * dt
            there = tuple([a + passed * b for a, b in zip(x, v, strict=True)])
            total += weight * self._evaluated(name, law, there, v, time + passed)
        return total

    def _evaluated(self, name: str, function: Callable[..., Sequence[float] | float], *arguments: object) -> Array:
        try:
            result = function(*arguments)
            values = np.array(result, dtype=float, ndmin=1)
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self._scene} failed: its {name} raised {failure(error)}") from error
        if values.shape != (self._dof,) or not isfinite(values.sum()):
            numbers = f"{self._dof} finite number{'s' * (self._dof > 1)}"
            shown = None if result is None else values.tolist()
            raise HapnetError(f"the scene {self._scene} failed: its {name} is {shown}, not {numbers}")
        return values
