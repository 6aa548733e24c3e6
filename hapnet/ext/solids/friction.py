"""Coulomb's friction as a damper across the contact's normal, chosen anew each step.

With ``D = sum c_i P_i``, ``P_i = I - n_i n_i' / |n_i|^2``, the step is ``(A + D) vhat = c + sum n_i f_i``. The energy
that D dissipates, ``vhat' D vhat T``, is never negative for any c_i >= 0: so friction is passive, and c_i only affects
its feel. With s the tangential speed without friction and a = A along it, c = mu |F| / (s - mu |F|/a) makes
the friction mu |F| while it slides. If it sticks, a mass that began the step with the tangential velocity v0 would end
it with -v0 if vhat became 0, and would chatter: so c is limited to the value that ends it at rest, |vhat| = |v0|/2.

mu may vary over the surface: a step takes its value where the step begins. That is passive for the same reason.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi, sin

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.records.record import FloatRows, Reals, Record, equation
from hapnet.records.vectors import dot

Friction = Callable[[Vector], float]
"""Coulomb's mu at a place (3,) [m]; a value that is not above 0 counts as 0."""

_STUCK = 1e5
"""The largest c, in units of a: a held force falls by 1 % in minutes. A larger one costs digits of the force."""


def at(friction: float | Friction, place: Vector) -> float:
    """mu at a place (3,) [m]; 0 where the function returns no positive number."""
    if not callable(friction):
        return friction
    found = friction(place)
    return found if 0.0 < found < inf else 0.0


class FrictionTexture(Record):
    """A `Friction` that varies: ``mu (1 + share/3 (sin kx + sin ky + sin kz))``, k = 2 pi / wavelength.

    mu : its mean. share : 0 to 1. wavelength : [m].
    """

    mu: float
    third: float
    wave: float

    def __init__(self, mu: float, share: float, wavelength: float) -> None:
        self.mu = checks.positive("friction", mu)
        if not 0.0 <= share <= 1.0:
            raise InvalidParameter("texture", share, "a share of the friction from 0 to 1, and a wavelength")
        self.third = share / 3.0
        self.wave = 2.0 * pi / checks.positive("wavelength", wavelength)

    @equation
    def __call__(self, position: Vector) -> float:
        k, x, y, z = self.wave, position[0], position[1], position[2]
        return self.mu * (1.0 + self.third * (sin(k * x) + sin(k * y) + sin(k * z)))


textured = FrictionTexture.__call__


@equation
def coefficient(grip_N: float, speed: float, resistance: float, start: float) -> float:
    """c [Ns/m] for one contact.

    grip_N : mu |F|. speed : of the step without friction, across the normal [m/s]. resistance : a [Ns/m] along it.
    start : the speed at the step's start, in the direction in which the point slides [m/s].
    """
    if not (grip_N > 0.0 and speed > 0.0):
        return 0.0
    slip = speed - grip_N / resistance
    c = grip_N / slip if slip > 0.0 else inf
    if start != 0.0:
        c = min(c, max(0.0, resistance * (2.0 * speed / start - 1.0)))
    return min(c, _STUCK * resistance)


@equation
def along(vector: Vector, across: Vector, speed: float) -> float:
    """The size of the component of `vector` along `across`, whose length is `speed`."""
    return abs(dot(3, vector, across)) / speed if speed > 0.0 else 0.0


@equation
def resistance_along(vector: Vector, size: float, C: FloatRows) -> float:
    """a [Ns/m] along a vector of this size, where C = A^-1 (3, 3)."""
    if size == 0.0:
        return inf
    x, y, z = vector[0] / size, vector[1] / size, vector[2] / size
    along = 0.0
    along += x * dot(3, C[0], (x, y, z))
    along += y * dot(3, C[1], (x, y, z))
    along += z * dot(3, C[2], (x, y, z))
    return 1.0 / along if along > 0.0 else inf  # it cannot move that way, with fewer axes


@equation
def tangential(vector: Vector, normal: Vector) -> tuple[float, float, float]:
    """The component of `vector` across `normal`."""
    x, y, z = vector[0], vector[1], vector[2]
    a, b, c = normal[0], normal[1], normal[2]
    share = (x * a + y * b + z * c) / (a * a + b * b + c * c)
    return (x - share * a, y - share * b, z - share * c)


@equation
def add_drag(c: float, normal: Reals, D: FloatRows) -> None:
    """Add a contact's part to D (3, 3) [Ns/m]."""
    square = dot(3, normal, normal)
    for i in range(3):
        for j in range(3):
            D[i][j] = D[i][j] + c * ((1.0 if i == j else 0.0) - normal[i] * normal[j] / square)
