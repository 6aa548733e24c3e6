"""The velocities of a step in which the contacts of all bodies are in balance, by a semismooth Newton method.

Each degree of freedom is a resistance a and a velocity w that it would have without contact. A contact's push N
depends on its approach velocity and never falls with it. Its friction g acts across its normal. It is the force of a
spring and a damper, of the stiffness K_t and the damping B_t, up to Coulomb's limit. With s the stretch of the spring
at the step's start and u the mean velocity across the normal

    g = P(K_t s + (K_t T + B_t) u),    P(t) = t if |t| <= mu N, else mu N t/|t|
    s' = s + (g - K_t s) / (K_t + B_t/T)

So what sticks is held by the spring, and does not creep. As P keeps the direction, the way that is no stretch,
T u - (s' - s), goes along g, and friction never gives out energy, for any T and for any limit:

    g . u T = K_t/2 (|s'|^2 - |s|^2) + K_t/2 |s' - s|^2 + B_t/T |s' - s|^2 + g . (T u - (s' - s))

With given limits (Tresca's friction) g is the gradient of a convex function of u too, so the velocities are the
minimum of a strictly convex function. Coulomb's limits are those of the pushes: a fixed point, after Panagiotopoulos
(Ingenieur-Archiv 44, 1975), solved anew until the limits stay. Where they do not, those of the last round hold, and
friction takes energy all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array

_ROUNDS = 60
"""The most rounds of Newton's method; 3 to 8 are usual."""

_EXACT = 1e-14
"""A residual below this share of the largest term counts as 0."""

_LIMITS = 40
"""The most rounds for the limits of friction; 3 to 8 are usual."""

_SETTLED = 1e-10
"""A change of the limits below this share of the largest counts as 0."""


Row = Sequence[tuple[int, float]]
"""A speed: numbers of degrees of freedom, each with the factor of its velocity."""


class Contact(NamedTuple):
    """A contact in a step: its approach velocity, its depth [m], and the largest force [N]."""

    approach: Row
    depth: float
    limit: float


class Rub(NamedTuple):
    """The friction of a contact, whose number is `contact`: mu, the velocity of its first body across its normal, a row
    for each direction, and the stretch of its spring s [m]."""

    contact: int
    mu: float
    across: Sequence[Row]
    stretch: Array


class Firmness(NamedTuple):
    """K_t [N/m] and B_t [Ns/m] of all friction, and the length of the step T [s]."""

    stiffness: float
    damping: float
    dt: float

    def stretched(self, stretch: Array, force: Array) -> Array:
        """s' [m], from s [m] and g [N]."""
        after: Array = stretch + (force - self.stiffness * stretch) / (self.stiffness + self.damping / self.dt)
        return after


Law = Callable[[Contact, float], tuple[float, float]]
"""The push of a contact [N] and its rate [Ns/m], from its approach velocity [m/s]."""


class _Problem:
    """The residual of the balance a (v - w) + ways' F = 0, and its derivative, for given limits of friction [N].

    moving : the degrees of freedom that take part and move; v, w and a are theirs.
    """

    def __init__(
        self, w: Array, a: Array, contacts: Sequence[Contact], law: Law, rubs: Sequence[Rub], firm: Firmness
    ) -> None:
        rows = [contact.approach for contact in contacts]
        self.places = list[slice]()
        for rub in rubs:
            self.places.append(slice(len(rows), len(rows) + len(rub.across)))
            rows += rub.across
        self.moving = sorted({k for row in rows for k, _ in row if a[k] < inf})
        self.w, self.a = w[self.moving], a[self.moving]
        self.contacts, self.law, self.rubs, self.firm = contacts, law, rubs, firm
        self.ways = np.zeros((len(rows), len(self.moving)))
        at = {k: i for i, k in enumerate(self.moving)}
        for into, row in zip(self.ways, rows, strict=True):
            for k, way in row:
                if k in at:
                    into[at[k]] = way
        self.limits = np.zeros(len(rubs))

    def forces(self, v: Array) -> tuple[Array, Array, Array]:
        """All forces [N], the derivative of the residual, and the residual itself."""
        u = self.ways @ v
        rows = [self.law(contact, speed) for contact, speed in zip(self.contacts, u.tolist(), strict=False)]
        found = np.array([row[0] for row in rows])
        count, ways = len(self.contacts), self.ways
        slope = np.diag(self.a) + (ways[:count].T * np.array([row[1] for row in rows])) @ ways[:count]
        if self.rubs:
            found = np.concatenate([found, np.zeros(len(u) - count)])
            for rub, limit, place in zip(self.rubs, self.limits.tolist(), self.places, strict=True):
                found[place], rate = _friction(rub, limit, u[place], self.firm)
                slope += ways[place].T @ rate @ ways[place]
        return found, slope, self.a * (v - self.w) + found @ ways

    def solve(self, v: Array) -> tuple[Array, Array]:
        """The forces and the velocities in balance, from a start `v`."""
        found, slope_of, residual = self.forces(v)
        best, least = found, inf
        for _ in range(_ROUNDS):
            size = float(np.abs(residual).max())
            if size < least:
                best, least = found, size
            if size <= _EXACT * float(np.abs(self.a * v).max() + np.abs(found).max()):
                break
            step = np.linalg.solve(slope_of, -residual)
            slope, length = float(residual @ step), 1.0
            for _ in range(40):
                found, slope_of, residual = self.forces(v + length * step)
                if float(residual @ step) <= -0.5 * slope:  # slope < 0: it may overshoot, by less than it was short
                    break
                length *= 0.5
            v = v + length * step
        return best, v


def _friction(rub: Rub, limit: float, u: Array, firm: Firmness) -> tuple[Array, Array]:
    """g [N] and its derivative [Ns/m], with this limit [N]."""
    gain = firm.stiffness * firm.dt + firm.damping
    trial = firm.stiffness * rub.stretch + gain * u
    size = float(np.sqrt(trial @ trial))
    if size <= limit:
        return trial, gain * np.eye(len(u))
    along = trial / size
    return limit * along, gain * limit / size * (np.eye(len(u)) - np.outer(along, along))


class Balance(NamedTuple):
    """The forces on all degrees of freedom [N], the friction of each of the `rubs` on its first body, reversed, g [N],
    and Coulomb's limits, mu times the pushes found [N]."""

    forces: Array
    frictions: list[Array]
    limits: Array


def balance(
    w: Array,
    a: Array,
    contacts: Sequence[Contact],
    law: Law,
    rubs: Sequence[Rub],
    firm: Firmness,
    given: tuple[Array, Array] | None = None,
) -> Balance:
    """The forces in balance.

    w, a : velocities without contact [m/s] and resistances [Ns/m] (infinite: it does not move). law : of the pushes.
    firm : of all friction. given : velocities to start from, and limits [N] that hold as they are; None: the limits
    become Coulomb's.
    """
    forces = np.zeros(len(w))
    if not contacts:
        return Balance(forces, [], np.zeros(0))
    problem = _Problem(w, a, contacts, law, rubs, firm)
    if given is not None:
        problem.limits = given[1]
    found, v = problem.solve((w if given is None else given[0])[problem.moving])
    for count in range(_LIMITS if rubs and given is None else 0):
        limits = _coulomb(rubs, found)
        if float(np.abs(limits - problem.limits).max()) <= _SETTLED * float(limits.max()):
            break
        problem.limits = limits if count < _LIMITS // 2 else 0.5 * (problem.limits + limits)  # two that change places
        found, v = problem.solve(v)
    np.add.at(forces, problem.moving, -(found @ problem.ways))
    return Balance(forces, [found[place] for place in problem.places], _coulomb(rubs, found))


def _coulomb(rubs: Sequence[Rub], found: Array) -> Array:
    return np.array([rub.mu * found[rub.contact] for rub in rubs])
