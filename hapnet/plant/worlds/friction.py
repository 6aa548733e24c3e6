"""Coulomb's friction as a damper across the contact's normal, chosen anew each step.

With ``D = sum c_i P_i``, ``P_i = I - n_i n_i' / |n_i|^2``, the step is ``(A + D) vhat = c + sum n_i f_i``. What D
dissipates, ``vhat' D vhat T``, is never negative for any c_i >= 0: so friction is passive, and the choice of c_i only
decides how it feels. With s the tangential speed without friction and a = A along it, c = mu |F| / (s - mu |F|/a) makes
the friction mu |F| while it slides. If it sticks, a mass that began the step with the tangential velocity v0 would end
it with -v0 if vhat became 0, and would chatter: so no c is greater than what makes it end at rest, |vhat| = |v0|/2.

mu may vary over the surface: a step takes its value where the step begins. That is passive for the same reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot, inf, pi, sin, sqrt

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.records.vectors import added

Friction = Callable[[Vector], float]
"""Coulomb's mu at a place (3,) [m]; what is not above 0 there counts as 0."""

_STUCK = 1e3
"""The largest c, in units of a."""


def at(friction: float | Friction, place: Vector) -> float:
    """mu at a place (3,) [m]; 0 where the function gives none, or no number."""
    if not callable(friction):
        return friction
    found = friction(place)
    return found if 0.0 < found < inf else 0.0


class FrictionTexture:
    """A `Friction` that varies: ``mu (1 + share/3 (sin kx + sin ky + sin kz))``, k = 2 pi / wavelength.

    mu : its mean. share : 0 to 1. wavelength : [m].
    """

    def __init__(self, mu: float, share: float, wavelength: float) -> None:
        self.mu: float = checks.positive("friction", mu)
        if not 0.0 <= share <= 1.0:
            raise InvalidParameter("texture", share, "a share of the friction from 0 to 1, and a wavelength")
        self._third = share / 3.0
        self._wave = 2.0 * pi / checks.positive("wavelength", wavelength)

    def __call__(self, position: Vector) -> float:
        x, y, z = position
        k = self._wave
        return self.mu * (1.0 + self._third * (sin(k * x) + sin(k * y) + sin(k * z)))


def coefficient(
    normal: Vector, grip_N: float, vhat: Vector, v0: Vector, resistance: Callable[[Vector], float]
) -> float:
    """c [Ns/m] for one contact.

    Parameters
    ----------
    normal : (3,) of the contact, of any length. grip_N : mu |F|. vhat : (3,) the step's velocity without friction
        [m/s]. v0 : (3,) at its start [m/s]. resistance : a [Ns/m] along a unit vector.
    """
    x, y, z = tangential(vhat, normal)
    speed = sqrt(x * x + y * y + z * z)
    if not (grip_N > 0.0 and speed > 0.0):
        return 0.0
    a = resistance((x / speed, y / speed, z / speed))
    slip = speed - grip_N / a
    c = grip_N / slip if slip > 0.0 else inf
    if start := 0.5 * hypot(*tangential(v0, normal)):
        c = min(c, max(0.0, a * (speed / start - 1.0)))
    return min(c, _STUCK * a)


def tangential(vector: Vector, normal: Vector) -> Vector:
    """The part of `vector` across `normal`."""
    x, y, z = vector
    a, b, c = normal
    share = (x * a + y * b + z * c) / (a * a + b * b + c * c)
    return (x - share * a, y - share * b, z - share * c)


def drag_of(coefficients: Sequence[float], normals: Sequence[Vector]) -> list[list[float]]:
    """D (3, 3) [Ns/m]."""
    D = [[0.0] * 3 for _ in range(3)]
    for c, normal in zip(coefficients, normals, strict=True):
        square = added([part * part for part in normal])
        for i in range(3):
            for j in range(3):
                D[i][j] += c * ((i == j) - normal[i] * normal[j] / square)
    return D
