"""The virtual mass of a pose: a rigid tool on the virtual coupling, for `hapnet.mechanics.contacts.Mass`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.tools.body import RigidBody, settle, weigh
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.mechanics.contacts import Mass, Step, Surroundings, doing
from hapnet.mechanics.pose import AXES, nearest
from hapnet.records.vectors import added, inner

HALVINGS = 12
"""The greatest number of times that a step is halved: its turn is then small enough for Newton's method, and a point
that friction stops is stopped in time."""


class _Moved(NamedTuple):
    """The result of a step."""

    force: Vector  #: of the solids, mean (12,) [N]
    work_J: float  #: of that force
    damped_J: float  #: lost in the damper
    spin_J: float  #: lost by the spin beside that
    pull: Vector  #: of spring, damper and push, mean (12,) [N]


class ToolMass(Mass):
    """A tool among its solids, moved by the step of `hapnet.ext.tools.body`, which obeys (13) for any length; the
    energy that it dissipates is that of the damper, and what a stiff damper takes of the spin within the step.

    mass [kg] : a number: the tool's; or one for each coordinate: of a robot that carries it, whose inertia is
        ``2 m l^2`` about every axis. damping B' [Ns/m], stiffness K' [N/m] : a number for all coordinates, or one for
        each. Of numbers for each one is for the point's coordinates, and one for the arms'. position : the pose (12,)
        [m] in which it starts at rest.

    Raises InvalidParameter: a value is not allowed.
    """

    def __init__(
        self, contacts: ToolContacts, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike, position: Vector
    ) -> None:
        self.contacts = contacts
        (K, K_arms), (B, B_arms) = _pair("stiffness", stiffness), _pair("damping", damping)
        self._own = K, B, K_arms, B_arms
        (m, m_arms), arm_m = _pair("mass", mass), contacts.arm_m
        carried = np.ndim(mass) > 0
        inertia = (2.0 * m_arms * arm_m * arm_m,) * 3 if carried else contacts.tool.inertia_of(m)
        self.body = RigidBody(m, inertia, position, arm_m)
        settle(self.body)
        self._hold(*self._own)
        self._touched = False

    def _hold(self, K: float, B: float, K_arms: float, B_arms: float) -> None:
        """Set the spring and the damper for the next steps."""
        self._K, self._B = (K,) * 3 + (K_arms,) * 9, (B,) * 3 + (B_arms,) * 9
        self.body.hold(K, B, K_arms, B_arms)

    @property
    def position(self) -> Vector:
        return tuple(self.body.x)

    @property
    def velocity(self) -> Vector:
        return tuple(self.body.v)

    @property
    def kinetic_J(self) -> float:
        return self.body.kinetic

    @property
    def can_be_carried(self) -> bool:
        """True: pose, velocity and spin are its whole state in free space."""
        return True

    def displace(self, way: list[float], dt: float, contacts: Surroundings) -> bool:
        body = self.body
        end = nearest([x + part for x, part in zip(body.x, way, strict=False)], body.arm_m)
        if self._touched or contacts.clearance(end) <= 0.0:
            return False
        for i in range(AXES):
            way[i] = end[i] - body.x[i]
        body.x[:] = end
        settle(body)  # the spin turns with the body's axes, so the kinetic energy stays
        self.contacts.at = end
        return True

    def set_contacts(self, contacts: Surroundings) -> None:
        contacts.require_outside(self.position)

    def place(self, position: Vector) -> None:
        position = nearest(position, self.body.arm_m)
        self.contacts.require_outside(position)
        body = self.body
        body.x[:] = position
        for i in range(3):
            body.velocity[i] = body.spin[i] = 0.0
        settle(body)

    def step(self, dt: float, set_position: Vector, contacts: Surroundings) -> Step:
        self._hold(*self._own)
        return self._step(dt, set_position, (0.0,) * AXES)

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings) -> Step:
        """Step under a push that is held along the coordinates: its torque turns with the tool."""
        self._hold(0.0, drag, 0.0, drag)
        return self._step(dt, self.position, push)

    def _step(self, dt: float, ybar: Vector, push: Vector) -> Step:
        """Step with the spring and damper that hold the tool to `ybar`, and under `push`."""
        begun, before = self.position, self._potential(ybar)
        done = self._advance(dt, ybar, push, HALVINGS)
        self._touched = any(done.force)
        moved = [end - begin for begin, end in zip(begun, self.body.x, strict=True)]
        velocity = tuple([part / dt for part in moved])
        force = doing(done.work_J, done.force, moved)  # if the step was cut: the mean force that does the same work
        pull = doing(inner(push, moved) + before - self._potential(ybar) - done.damped_J, done.pull, moved)
        self.contacts.at = end = self.position
        lost = done.damped_J + done.spin_J
        return Step(velocity, force, done.work_J, lost, pull, end, self.contacts.penetration(end))

    def _potential(self, ybar: Vector) -> float:
        """The spring's energy phi [J]."""
        return 0.5 * added([k * (x - y) * (x - y) for k, x, y in zip(self._K, self.body.x, ybar, strict=True)])

    def _advance(self, dt: float, ybar: Vector, push: Vector, halvings: int) -> _Moved:
        """Step, in halves if it is not found at once."""
        body = self.body
        weigh(body, dt)
        found = self.contacts.move(body, dt, ybar, push, halvings > 0)
        if found is None:
            if not halvings:
                raise HapnetError(f"no step of {dt:g} s was found for the tool")
            first = self._advance(0.5 * dt, ybar, push, halvings - 1)
            second = self._advance(0.5 * dt, ybar, push, halvings - 1)
            return _Moved(
                _mean(first.force, second.force),
                first.work_J + second.work_J,
                first.damped_J + second.damped_J,
                first.spin_J + second.spin_J,
                _mean(first.pull, second.pull),
            )
        mean, middle = body.mean, body.middle
        damper = [b * v for b, v in zip(self._B, mean, strict=True)]
        spring = [k * (x - y) for k, x, y in zip(self._K, middle, ybar, strict=True)]
        pull = tuple([given - a - b for given, a, b in zip(push, damper, spring, strict=True)])
        return _Moved(found[0], found[1], dt * inner(damper, mean), body.lost, pull)


def _mean(one: Vector, other: Vector) -> Vector:
    return tuple([0.5 * (a + b) for a, b in zip(one, other, strict=True)])


def _pair(name: str, value: ArrayLike) -> tuple[float, float]:
    """The number for the point's coordinates, and the number for the arms'."""
    given = np.asarray(value, dtype=float)
    if given.shape != (AXES,):
        number = _number(name, value)
        return number, number
    first, second = float(given[0]), float(given[3])
    if (given[:3] != first).any() or (given[3:] != second).any() or not min(first, second) > 0.0:
        raise InvalidParameter(name, value, "one number above 0 for the point, and one for turning")
    return first, second


def _number(name: str, value: ArrayLike) -> float:
    given = np.asarray(value, dtype=float)
    if given.ndim != 0:
        raise InvalidParameter(name, value, "one number with a pose")
    number = float(given)
    if not 0.0 < number < float("inf"):
        raise InvalidParameter(name, value, "a positive number")
    return number
