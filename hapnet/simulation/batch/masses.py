"""Virtual masses among contacts, many scenarios at once: `hapnet.plant.integrator`, operation by operation."""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Axis, Contacts
from hapnet.simulation.batch.arrays import Index, pick, place, vectors


class Masses:
    """The masses' state, vectors (n, N); M, B' and K' are the same in all scenarios."""

    def __init__(self, masses: list[PassiveIntegrator], contacts: Contacts) -> None:
        first = masses[0]
        self.dof = len(first.position)
        self.position = vectors([mass.position for mass in masses])
        self.velocity = vectors([mass.velocity for mass in masses])
        doubled, self._B, halved = (_symmetric([[term[k] for term in line] for line in first.terms]) for k in range(3))
        self._M, self._K = 0.5 * doubled, 2.0 * halved
        self._terms = first.terms
        self._contacts = contacts

    def write_back(self, i: int, mass: PassiveIntegrator) -> None:
        """Give scenario i's state back."""
        mass.restore(tuple(self.position[:, i].tolist()), tuple(self.velocity[:, i].tolist()))

    def kinetic(self, at: Index) -> Array:
        """kappa [J]."""
        v = pick(self.velocity, at)
        return 0.5 * _dot(v, _rows(self._M, v))

    def step(self, at: Index, dt: Array, ybar: Array) -> tuple[Array, Array]:
        """Advance the scenarios `at` by `dt` [s] with ybar (n, M) [m]. Returns each one's work and dissipation [J]."""
        x, v = pick(self.position, at), pick(self.velocity, at)
        factors = _Factors(self._terms, dt)
        error = x - ybar
        c = 2.0 / dt * _rows(self._M, v) - _rows(self._K, error)
        vhat = factors.solve(c)
        force, vhat = self._push(dt, x, vhat, factors)
        damper = _rows(self._B, vhat)
        place(self.position, at, x + dt * vhat)
        place(self.velocity, at, 2.0 * vhat - v)
        return dt * _dot(force, vhat), dt * _dot(damper, vhat)

    def _push(self, dt: Array, x: Array, velocity: Array, factors: _Factors) -> tuple[Array, Array]:
        """`Contacts.solve`."""
        force, vhat = np.zeros_like(x), velocity
        for axis, normal, low, high in self._contacts.spans:
            direction = np.array(normal)[:, None]
            q, w = _dot(direction, x), _dot(direction, velocity)
            end = q + dt * w
            touching = ((q < low) | (q > high) | (end < low) | (end > high)).nonzero()[0]
            if not touching.size:
                continue
            response = factors.solve(np.broadcast_to(direction, x.shape))[:, touching]
            resistance = 1.0 / _dot(direction, response)
            f = _forces(axis, q[touching], w[touching], resistance, dt[touching])
            force[:, touching] += f * direction
            vhat = vhat.copy()
            vhat[:, touching] += f * response
        return force, vhat


def _forces(axis: Axis, q: Array, w: Array, a: Array, dt: Array) -> Array:
    """`Axis.force` in each scenario: vectorised if the mass stays inside a face and is pushed, else one at a time."""
    force = np.zeros(len(q))
    left = np.ones(len(q), dtype=np.bool_)
    for face, side in ((axis.upper, 1.0), (axis.lower, -1.0)):
        inside = (side * (q - face.at) > 0.0).nonzero()[0]
        if not inside.size:
            continue
        K, B, d, out = face.stiffness, face.damping, side * (q[inside] - face.at), -side * w[inside]
        A, T = a[inside], dt[inside]
        push = A * (K * d - (K * T / 2 + B) * out) / (A + K * T / 2 + B)
        pushed = ((A - K * T / 2 + B) * d >= A * out * T) & (push >= 0.0)
        force[inside[pushed]] = -side * push[pushed]
        left[inside[pushed]] = False
    for k in left.nonzero()[0].tolist():
        force[k] = axis.force(float(q[k]), float(w[k]), float(a[k]), float(dt[k]))
    return force


class _Factors:
    """A = L D L' of each scenario's step, as `PassiveIntegrator._factor` makes it."""

    def __init__(self, terms: list[list[tuple[float, float, float]]], dt: Array) -> None:
        self._rows: list[list[Array]] = []
        self._inverse_pivots: list[Array] = []
        for line in terms:
            u = [m / dt + b + k * dt for m, b, k in line]
            pivot = u.pop()
            row: list[Array] = []
            for j, other in enumerate(self._rows):
                for k in range(j):
                    u[j] = u[j] - u[k] * other[k]
                row.append(u[j] * self._inverse_pivots[j])
                pivot = pivot - u[j] * row[j]
            self._rows.append(row)
            self._inverse_pivots.append(1.0 / pivot)

    def solve(self, b: Array) -> Array:
        """A^-1 b by substitution."""
        z: list[Array] = []
        for value, row in zip(b, self._rows, strict=True):
            for factor, earlier in zip(row, z, strict=True):
                value = value - factor * earlier
            z.append(value)
        z = [value * inverse for value, inverse in zip(z, self._inverse_pivots, strict=True)]
        for i in range(len(z) - 1, 0, -1):
            for j, factor in enumerate(self._rows[i]):
                z[j] = z[j] - factor * z[i]
        return np.array(z)


def _symmetric(lower: list[list[float]]) -> Array:
    """The matrix with this lower triangle."""
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(len(lower))] for i in range(len(lower))])


def _rows(matrix: Array, vector: Array) -> Array:
    product: Array = matrix[0, 0] * vector if len(matrix) == 1 else matrix @ vector
    return product


def _dot(a: Array, b: Array) -> Array:
    total: Array = a[0] * b[0]
    for one, other in zip(a[1:], b[1:], strict=True):
        total = total + one * other
    return total
