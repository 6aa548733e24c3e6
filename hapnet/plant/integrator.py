"""The passive midpoint integrator L_dp of the virtual world (D. J. Lee and K. Huang, World Haptics 2009).

The virtual coupling K', B' ties a virtual mass to the set-position ybar, and the environment's force f acts on it. A
step of any length T, with the mean velocity vhat = (v_{k+1} + v_k)/2, is

    M (v_{k+1} - v_k)/T = tau + f,    x_{k+1} - x_k = T vhat,    tau = -B' vhat - K' ((x_{k+1} + x_k)/2 - ybar)

or ``A vhat = c + f`` with ``A = 2M/T + B' + K' T/2`` and ``c = 2M/T v_k - K' (x_k - ybar)``, without iteration. With
kappa = 1/2 |v|_M^2 and phi = 1/2 |x - ybar|_K'^2 it obeys, exactly and for any T,

    f . vhat T = kappa_{k+1} + phi_{k+1} - kappa_k - phi_k + |vhat|_B'^2 T                                   (13)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, isfinite
from operator import add, mul, neg, sub
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.plant.worlds.protocol import Surroundings

# A matrix with a greater condition number is refused: v' M v could round to a negative number.
_MAX_CONDITION = 1e12


class Step(NamedTuple):
    """The result of one step; vectors are (n,) tuples."""

    velocity: Vector  #: vhat [m/s], the mean over the step
    force: Vector  #: f [N], all force on the mass except the virtual coupling's
    work_J: float  #: f . vhat T, put in at the world's port
    dissipated_J: float  #: |vhat|_B'^2 T, dissipated by the virtual coupling's damper; the exact D of PSPM
    coupling_force: Vector  #: tau [N]
    position: Vector  #: x_{k+1} [m]
    penetration_m: float  #: depth of x_{k+1} in the wall where it is deepest, 0 outside


class PassiveIntegrator:
    """A virtual mass on a virtual coupling, integrated passively with steps of any length.

    Parameters
    ----------
    mass, damping, stiffness : M [kg], B' [Ns/m], K' [N/m]; each is a positive scalar (times the identity), n positive
        numbers (a diagonal), or a symmetric positive definite n x n matrix.
    position : x_0 [m]; sets n.
    velocity : v_0 [m/s]; at rest by default.

    Raises InvalidParameter.

    Vectors are returned as tuples of floats. Any sequence of numbers is accepted; tuples cost least. Floats are used
    because for n <= 3 one numpy call costs several times the arithmetic.
    """

    def __init__(
        self,
        mass: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike,
        position: ArrayLike,
        velocity: ArrayLike | None = None,
    ) -> None:
        self._x = checks.vector("position", position)
        self._n = n = len(self._x)
        self._v = (0.0,) * n if velocity is None else checks.vector("velocity", velocity, n)
        M = _positive_definite("mass", mass, n)
        B = _positive_definite("damping", damping, n)
        K = _positive_definite("stiffness", stiffness, n)
        self._M, self._B, self._K = _product(M), _product(B), _product(K)
        self._scalars = M[0][0], B[0][0], K[0][0]  # all there is in one dimension
        self._diagonals = [[matrix[i][i] for i in range(n)] for matrix in (M, B, K)]
        self.terms: Final = [[(2.0 * M[i][j], B[i][j], 0.5 * K[i][j]) for j in range(i + 1)] for i in range(n)]
        """Lower triangle of A in powers of T: 2M, B', K'/2."""
        self._diagonal = all(_is_diagonal(matrix) for matrix in (M, B, K))
        self._factored: tuple[float, float | None] = (0.0, None)
        self._contacts: Surroundings | None = None
        self._pushed_on: Surroundings | None = None  # separate in a push too

    @property
    def position(self) -> Vector:
        """x_k [m]."""
        return self._x

    @property
    def velocity(self) -> Vector:
        """v_k [m/s]."""
        return self._v

    @property
    def kinetic_J(self) -> float:
        """kappa_k = 1/2 |v_k|_M^2."""
        return 0.5 * _dot(self._v, self._M(self._v))

    def potential_J(self, set_position: ArrayLike) -> float:
        """phi_k = 1/2 |x_k - ybar|_K'^2 for the set-position ybar (n,) [m]."""
        ybar = self._input("set_position", set_position)
        error = tuple(map(sub, self._x, ybar))
        return 0.5 * _dot(error, self._K(error))

    def adopt(self, contacts: Surroundings | None) -> None:
        """Check `contacts` against this mass, as `step` does when it first gets them. Call this to fail early.

        Raises InvalidParameter if the dimension differs, the mass is inside a wall (that creates energy), or the
        contacts cannot be solved with these M, B' and K' (`Surroundings.require_separate`).
        """
        if contacts is not None:
            if contacts.dof != self._n:
                raise InvalidParameter("contacts.dof", contacts.dof, f"{self._n}, the dimension of the position")
            contacts.require_outside(self._x)
            self._require_separate(contacts)
        self._contacts = contacts

    def _require_separate(self, contacts: Surroundings, drag: float | None = None) -> None:
        # Up to positive factors, n_i' A^-1 n_j is a polynomial in T of degree 2 (n - 1). If it is zero at 2n - 1 values
        # of T, it is zero for every step. With a drag, only its ratio to 2M/T matters, so it is zero for every drag.
        for dt in np.geomspace(1e-4, 1.0, 2 * self._n - 1).tolist():
            self._factor(dt, drag)
            contacts.require_separate(self._solve)

    def place(self, position: ArrayLike) -> None:
        """Start again at rest at `position` (n,) [m]. Raises InvalidParameter if that is inside a wall."""
        x = self._input("position", position)
        if self._contacts is not None:
            self._contacts.require_outside(x)
        self._x, self._v = x, (0.0,) * self._n

    def restore(self, position: Vector, velocity: Vector) -> None:
        """Go on from the state [m], [m/s] that another integrator with the same M, B', K' and contacts has reached."""
        self._x, self._v = position, velocity

    def step(
        self,
        dt: float,
        set_position: ArrayLike,
        contacts: Surroundings | None = None,
        force: ArrayLike | None = None,
    ) -> Step:
        """Advance by `dt`.

        Parameters
        ----------
        dt : T_k [s], positive; may differ from step to step.
        set_position : (n,) ybar_k [m], held over the step.
        contacts : the surroundings of the mass; their force is solved together with the step.
        force : (n,) additional force on the mass [N], constant over the step.

        Raises InvalidParameter; the state is then unchanged.
        """
        ybar = self._input("set_position", set_position)
        if contacts is not self._contacts:
            self.adopt(contacts)
        if self._factored != (dt, None):
            self._factor(dt)
        if force is None and self._n == 1:
            return self._step_1dof(dt, ybar[0], contacts)
        if force is None and self._n == 3 and self._diagonal:
            return self._step_3dof(dt, ybar, contacts)
        x, v, K = self._x, self._v, self._K
        error = tuple(map(sub, x, ybar))
        gain = 2.0 / dt
        c = list(map(sub, [gain * momentum for momentum in self._M(v)], K(error)))
        f: Sequence[float] = (0.0,) * self._n
        if force is not None:
            f = self._input("force", force)
            c = list(map(add, c, f))
        vhat = self._solve(c)
        if contacts is not None:
            push, vhat = contacts.solve(dt, x, vhat, self._solve)
            f = push if force is None else [g + p for g, p in zip(f, push, strict=True)]

        half = 0.5 * dt
        damper = self._B(vhat)
        pull = K(list(map(add, error, [half * u for u in vhat])))
        tau = tuple(map(sub, map(neg, damper), pull))
        self._x = x = tuple(map(add, x, [dt * u for u in vhat]))
        self._v = tuple(map(sub, [2.0 * u for u in vhat], v))
        return Step(
            tuple(vhat),
            tuple(f),
            dt * sum(map(mul, f, vhat)),
            dt * sum(map(mul, damper, vhat)),
            tau,
            x,
            0.0 if contacts is None else contacts.penetration(x),
        )

    def _step_1dof(self, dt: float, ybar: float, contacts: Surroundings | None) -> Step:
        """The rest of `step` in one dimension: the same operations in the same order, without lists."""
        (x,), (v,) = self._x, self._v
        M, B, K = self._scalars
        error = x - ybar
        vhat = (2.0 / dt * (M * v) - K * error) * self._inverse_pivots[0]
        f = 0.0
        if contacts is not None:
            (f,), (vhat,) = contacts.solve(dt, self._x, [vhat], self._solve)
        damper = B * vhat
        tau = -damper - K * (error + 0.5 * dt * vhat)
        self._x = end = (x + dt * vhat,)
        self._v = (2.0 * vhat - v,)
        depth = 0.0 if contacts is None else contacts.penetration(end)
        return Step((vhat,), (f,), dt * (0.0 + f * vhat), dt * (0.0 + damper * vhat), (tau,), end, depth)

    def _step_3dof(self, dt: float, ybar: Vector, contacts: Surroundings | None) -> Step:
        """The rest of `step` in three dimensions with diagonal M, B', K': the same operations in the same order."""
        x, y, z = self._x
        u, v, w = self._v
        (m0, m1, m2), (b0, b1, b2), (k0, k1, k2) = self._diagonals
        i0, i1, i2 = self._inverse_pivots
        e0, e1, e2 = x - ybar[0], y - ybar[1], z - ybar[2]
        gain, half = 2.0 / dt, 0.5 * dt
        vhat = [
            (gain * (m0 * u) - k0 * e0) * i0,
            (gain * (m1 * v) - k1 * e1) * i1,
            (gain * (m2 * w) - k2 * e2) * i2,
        ]
        f: Sequence[float] = _NO_FORCE
        if contacts is not None:
            f, vhat = contacts.solve(dt, self._x, vhat, self._solve)
        a, b, c = vhat
        f0, f1, f2 = f
        d0, d1, d2 = b0 * a, b1 * b, b2 * c
        tau = (-d0 - k0 * (e0 + half * a), -d1 - k1 * (e1 + half * b), -d2 - k2 * (e2 + half * c))
        self._x = end = (x + dt * a, y + dt * b, z + dt * c)
        self._v = (2.0 * a - u, 2.0 * b - v, 2.0 * c - w)
        return Step(
            (a, b, c), (f0, f1, f2), dt * (0.0 + f0 * a + f1 * b + f2 * c), dt * (0.0 + d0 * a + d1 * b + d2 * c),
            tau, end, 0.0 if contacts is None else contacts.penetration(end),
        )  # fmt: skip

    def push(self, dt: float, drag: float, push: ArrayLike, contacts: Surroundings | None = None) -> Step:
        """Advance by `dt` on a law's coupling, ``tau = push - drag vhat``, solved together with the contacts.

        ``(2M/T + drag) vhat = 2M/T v_k + push + f``. The step's `dissipated_J` is 0, because the law accounts for its
        own damping.

        Parameters
        ----------
        dt : T_k [s], positive. drag : [Ns/m], 0 or above, on all axes. push : (n,) [N].
        contacts : the surroundings of the mass.

        Raises InvalidParameter; the state is then unchanged.
        """
        p = self._input("push", push)
        if not 0.0 <= drag < inf:
            raise InvalidParameter("drag", drag, "0 Ns/m or above")
        if contacts is not self._contacts:
            self.adopt(contacts)
        if contacts is not None and contacts is not self._pushed_on:
            self._require_separate(contacts, 1.0)
            self._pushed_on = contacts
        if self._factored != (dt, drag):
            self._factor(dt, drag)
        x, v = self._x, self._v
        gain = 2.0 / dt
        vhat = self._solve([gain * momentum + force for momentum, force in zip(self._M(v), p, strict=True)])
        f: Sequence[float] = (0.0,) * self._n
        if contacts is not None:
            f, vhat = contacts.solve(dt, x, vhat, self._solve)
        self._x = x = tuple([q + dt * u for q, u in zip(x, vhat, strict=True)])
        self._v = tuple([2.0 * u - w for u, w in zip(vhat, v, strict=True)])
        tau = tuple([force - drag * u for force, u in zip(p, vhat, strict=True)])
        depth = 0.0 if contacts is None else contacts.penetration(x)
        return Step(tuple(vhat), tuple(f), dt * sum(map(mul, f, vhat)), 0.0, tau, x, depth)

    def _input(self, name: str, value: ArrayLike) -> Vector:
        if isinstance(value, tuple) and len(value) == self._n:
            try:
                if isfinite(sum(value)):
                    return value
            except TypeError as error:
                raise InvalidParameter(name, value, f"{self._n} finite numbers ({error})") from None
        return checks.vector(name, value, self._n)

    def _factor(self, dt: float, drag: float | None = None) -> None:
        """Factor A = L D L' for this step. Keeps the strict lower rows of L and 1/D. `drag` replaces B' + K' T/2."""
        if not 0.0 < dt < inf:
            raise InvalidParameter("dt", dt, "a positive, finite number of seconds")
        all_terms = self.terms
        if drag is not None:
            all_terms = [
                [(m, drag * (i == j), 0.0) for j, (m, *_) in enumerate(row)] for i, row in enumerate(all_terms)
            ]
        if self._diagonal:
            pivots = [m / dt + b + k * dt for *_, (m, b, k) in all_terms]
            if not 0.0 < min(pivots) <= max(pivots) < inf:
                raise InvalidParameter("dt", dt, "a step that 2M/T + B' + K' T/2 can be computed for")
            self._factored, self._inverse_pivots = (dt, drag), [1.0 / pivot for pivot in pivots]
            return
        rows: list[list[float]] = []
        inverse_pivots: list[float] = []
        for terms in all_terms:
            u = [m / dt + b + k * dt for m, b, k in terms]
            pivot = u.pop()
            row: list[float] = []
            for j, other in enumerate(rows):
                for k in range(j):
                    u[j] -= u[k] * other[k]
                row.append(u[j] * inverse_pivots[j])
                pivot -= u[j] * row[j]
            if not 0.0 < pivot < inf:
                raise InvalidParameter("dt", dt, "a step that 2M/T + B' + K' T/2 can be computed for")
            rows.append(row)
            inverse_pivots.append(1.0 / pivot)
        self._factored, self._L, self._inverse_pivots = (dt, drag), rows, inverse_pivots

    def _solve(self, b: Sequence[float]) -> list[float]:
        """A^-1 b by substitution: the residual stays at rounding, however badly conditioned A is."""
        if self._diagonal:
            return list(map(mul, b, self._inverse_pivots))
        z: list[float] = []
        for value, row in zip(b, self._L, strict=True):
            z.append(value - sum(map(mul, row, z)))
        z = list(map(mul, z, self._inverse_pivots))
        for i in range(self._n - 1, 0, -1):
            top = z[i]
            for j, factor in enumerate(self._L[i]):
                z[j] -= factor * top
        return z


_NO_FORCE = (0.0, 0.0, 0.0)


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return float(sum(map(mul, one, other)))


Product = Callable[[Sequence[float]], list[float]]


def _product(matrix: tuple[Vector, ...]) -> Product:
    """A function that multiplies a vector by `matrix`."""
    if _is_diagonal(matrix):
        diagonal = tuple(row[i] for i, row in enumerate(matrix))
        return lambda vector: list(map(mul, diagonal, vector))
    return lambda vector: [sum(map(mul, row, vector)) for row in matrix]


def _is_diagonal(matrix: tuple[Vector, ...]) -> bool:
    return not any(value for i, row in enumerate(matrix) for j, value in enumerate(row) if i != j)


def _positive_definite(name: str, value: ArrayLike, n: int) -> tuple[Vector, ...]:
    """Rows of the n x n matrix given as a scalar, a diagonal or a matrix."""
    allowed = f"a positive number, {n} positive numbers, or a symmetric positive definite {n} x {n} matrix"
    try:
        matrix = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InvalidParameter(name, value, allowed) from None
    if matrix.ndim == 0 or matrix.shape == (n,):
        matrix = np.diag(np.broadcast_to(matrix, (n,)))
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        raise InvalidParameter(name, value, allowed)
    symmetric = (matrix + matrix.T) / 2
    if np.abs(matrix - symmetric).max() > 1e-12 * np.abs(matrix).max():
        raise InvalidParameter(name, value, allowed)
    eigenvalues = np.linalg.eigvalsh(symmetric)
    if not eigenvalues[0] * _MAX_CONDITION > eigenvalues[-1]:
        raise InvalidParameter(name, value, allowed)
    return tuple(tuple(row) for row in symmetric.tolist())
