"""The passive midpoint integrator L_dp of the virtual world (D. J. Lee and K. Huang, World Haptics 2009).

The virtual coupling K', B' ties a virtual mass to the set-position ybar, and the environment's force f acts on it. A
step of any length T, with the mean velocity vhat = (v_{k+1} + v_k)/2, is

    M (v_{k+1} - v_k)/T = tau + f,    x_{k+1} - x_k = T vhat,    tau = -B' vhat - K' ((x_{k+1} + x_k)/2 - ybar)

or ``A vhat = c + f`` with ``A = 2M/T + B' + K' T/2`` and ``c = 2M/T v_k - K' (x_k - ybar)``, without iteration. With
kappa = 1/2 |v|_M^2 and phi = 1/2 |x - ybar|_K'^2 it obeys, exactly and for any T,

    f . vhat T = kappa_{k+1} + phi_{k+1} - kappa_k - phi_k + |vhat|_B'^2 T                                   (13)
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.mechanics.sliding import clearance, stays
from hapnet.records.record import FloatRows, Floats, MatrixOfAxes, OfAxes, Reals, Record, equation
from hapnet.records.vectors import dot, times

OWN = -1.0
"""Value of the drag for a step on the mass's own coupling, in which A contains B' + K' T/2."""


class PassiveIntegrator(Record, Mass):
    """A virtual mass on a virtual coupling, integrated passively with steps of any length.

    Parameters
    ----------
    mass, damping, stiffness : M [kg], B' [Ns/m], K' [N/m]; each is a positive scalar (times the identity), n positive
        numbers (a diagonal), or a symmetric positive definite n x n matrix.
    position : x_0 [m]; sets n.
    velocity : v_0 [m/s]; at rest by default.

    Attributes
    ----------
    n : the number of axes. M, B, K : the matrices; diagonal : whether all three are diagonal. x, v : x_k and v_k.
    factored_dt, factored_drag : the step length and drag of the last factored A, see `OWN`. L, inverse_pivots : A's
        factors.
    vhat, force, coupling_force, work, dissipated, penetration : of the last step, as in `Step`.
    error, c, damper, product : work arrays of a step.

    Raises InvalidParameter.

    Vectors are returned as tuples of floats. Any sequence of numbers is accepted; tuples cost least. Floats are used
    because for n <= 3 one numpy call costs several times the arithmetic.
    """

    n: int
    diagonal: int
    M: MatrixOfAxes
    B: MatrixOfAxes
    K: MatrixOfAxes
    x: OfAxes
    v: OfAxes
    factored_dt: float
    factored_drag: float
    L: MatrixOfAxes
    inverse_pivots: OfAxes
    vhat: OfAxes
    force: OfAxes
    coupling_force: OfAxes
    work: float
    dissipated: float
    penetration: float
    error: OfAxes
    c: OfAxes
    damper: OfAxes
    product: OfAxes

    def __init__(
        self,
        mass: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike,
        position: ArrayLike,
        velocity: ArrayLike | None = None,
    ) -> None:
        super().__init__()
        self.x = list(checks.vector("position", position))
        self.n = n = len(self.x)
        self.v = [0.0] * n if velocity is None else list(checks.vector("velocity", velocity, n))
        self.M = checks.spd("mass", mass, n).tolist()
        self.B = checks.spd("damping", damping, n).tolist()
        self.K = checks.spd("stiffness", stiffness, n).tolist()
        self.diagonal = int(all(_is_diagonal(matrix) for matrix in (self.M, self.B, self.K)))
        self.L = [[0.0] * n for _ in range(n)]
        self.inverse_pivots, self.vhat, self.force, self.coupling_force = ([0.0] * n for _ in range(4))
        self.error, self.c, self.damper, self.product = ([0.0] * n for _ in range(4))
        self._contacts: Surroundings | None = None
        self._pushed_on: Surroundings | None = None  # separate in a push too

    @property
    def position(self) -> Vector:
        """x_k [m]."""
        return tuple(self.x)

    @property
    def velocity(self) -> Vector:
        """v_k [m/s]."""
        return tuple(self.v)

    @property
    def kinetic_J(self) -> float:
        """kappa_k = 1/2 |v_k|_M^2."""
        return kinetic(self)

    @property
    def can_be_carried(self) -> bool:
        """True: position and velocity are its whole state."""
        return True

    def potential_J(self, set_position: ArrayLike) -> float:
        """phi_k = 1/2 |x_k - ybar|_K'^2 for the set-position ybar (n,) [m]."""
        ybar = self._input("set_position", set_position)
        for i in range(self.n):
            self.error[i] = self.x[i] - ybar[i]
        _multiply(self, self.K, self.error, self.product)
        return 0.5 * dot(self.n, self.error, self.product)

    def displace(self, way: Floats, dt: float, contacts: Surroundings) -> bool:
        return displace(self, way, dt, contacts)

    def set_contacts(self, contacts: Surroundings | None) -> None:
        """Check `contacts` against this mass, as `step` does when it first gets them. Call this to fail early.

        Raises InvalidParameter if the dimension differs, the mass is inside a wall (that creates energy), or the
        contacts cannot be solved with these M, B' and K' (`Surroundings.require_separate`).
        """
        if contacts is not None:
            if contacts.dof != self.n:
                raise InvalidParameter("contacts.dof", contacts.dof, f"{self.n}, the dimension of the position")
            contacts.require_outside(self.position)
            self._require_separate(contacts)
        self._contacts = contacts

    def _require_separate(self, contacts: Surroundings, drag: float = OWN) -> None:
        # Up to positive factors, n_i' A^-1 n_j is a polynomial in T of degree 2 (n - 1). If it is zero at 2n - 1 values
        # of T, it is zero for every step. With a drag, only its ratio to 2M/T matters, so it is zero for every drag.
        for dt in np.geomspace(1e-4, 1.0, 2 * self.n - 1).tolist():
            self._factor(dt, drag)
            contacts.require_separate(self._solve)

    def place(self, position: ArrayLike) -> None:
        """Start again at rest at `position` (n,) [m]. Raises InvalidParameter if that is inside a wall."""
        x = self._input("position", position)
        if self._contacts is not None:
            self._contacts.require_outside(x)
        self.x, self.v = list(x), [0.0] * self.n

    def step(
        self,
        dt: float,
        set_position: ArrayLike,
        contacts: Surroundings | None = None,
        force: ArrayLike | None = None,
    ) -> Step:
        """Advance by `dt`.

        dt : T_k [s], positive; may differ from step to step.
        set_position : (n,) ybar_k [m], held over the step.
        contacts : the surroundings of the mass; their force is solved together with the step.
        force : (n,) additional force on the mass [N], constant over the step.

        Raises InvalidParameter; the state is then unchanged.
        """
        ybar = self._input("set_position", set_position)
        if contacts is not self._contacts:
            self.set_contacts(contacts)
        if self.factored_dt != dt or self.factored_drag != OWN:
            self._factor(dt)
        extra = None if force is None else self._input("force", force)
        if extra is None:
            spring_among(self, dt, ybar, contacts)
            return self._step(contacts)
        drive(self, dt, ybar)
        for i in range(self.n):
            self.c[i] += extra[i]
        self.respond(dt, contacts)
        for i in range(self.n):
            self.force[i] = extra[i] + self.force[i]
        finish(self, dt)
        return self._step(contacts)

    def push(self, dt: float, drag: float, push: ArrayLike, contacts: Surroundings | None = None) -> Step:
        """Advance by `dt` on a law's coupling, ``tau = push - drag vhat``, solved together with the contacts.

        ``(2M/T + drag) vhat = 2M/T v_k + push + f``. The step's `dissipated_J` is 0, because the law accounts for its
        own damping.

        dt : T_k [s], positive. drag : [Ns/m], 0 or above, on all axes. push : (n,) [N].
        contacts : the surroundings of the mass.

        Raises InvalidParameter; the state is then unchanged.
        """
        p = self._input("push", push)
        if not 0.0 <= drag < inf:
            raise InvalidParameter("drag", drag, "0 Ns/m or above")
        if contacts is not self._contacts:
            self.set_contacts(contacts)
        if contacts is not None and contacts is not self._pushed_on:
            self._require_separate(contacts, 1.0)
            self._pushed_on = contacts
        if self.factored_dt != dt or self.factored_drag != drag:
            self._factor(dt, drag)
        push_among(self, dt, drag, p, contacts)
        return self._step(contacts)

    def respond(self, dt: float, contacts: Surroundings | None) -> None:
        """Compute vhat and the contacts' force."""
        solve(self, self.c, self.vhat)
        if contacts is None:
            self.force = [0.0] * self.n
            return
        force, vhat = contacts.solve(dt, tuple(self.x), list(self.vhat), self._solve)
        self.force[:], self.vhat[:] = force, vhat

    def _step(self, contacts: Surroundings | None) -> Step:
        """Return the result of the step that has ended."""
        end = tuple(self.x)
        depth = 0.0 if contacts is None else contacts.penetration(end)
        tau = tuple(self.coupling_force)
        return Step(tuple(self.vhat), tuple(self.force), self.work, self.dissipated, tau, end, depth)

    def _input(self, name: str, value: ArrayLike) -> Vector:
        if isinstance(value, tuple) and len(value) == self.n:
            try:
                if isfinite(sum(value)):
                    return value
            except TypeError as error:
                raise InvalidParameter(name, value, f"{self.n} finite numbers ({error})") from None
        return checks.vector(name, value, self.n)

    def _factor(self, dt: float, drag: float = OWN) -> None:
        """Factor A = L D L' for this step. `drag` replaces B' + K' T/2. Raises InvalidParameter."""
        if not 0.0 < dt < inf:
            raise InvalidParameter("dt", dt, "a positive, finite number of seconds")
        if not factor(self, dt, drag):
            raise InvalidParameter("dt", dt, "a step that 2M/T + B' + K' T/2 can be computed for")

    def _solve(self, b: Sequence[float]) -> list[float]:
        """Return A^-1 b."""
        z = [0.0] * self.n
        solve(self, b, z)
        return z


@equation
def kinetic(mass: PassiveIntegrator) -> float:
    """kappa [J]."""
    _multiply(mass, mass.M, mass.v, mass.product)
    return 0.5 * dot(mass.n, mass.v, mass.product)


@equation
def factor(mass: PassiveIntegrator, dt: float, drag: float) -> bool:
    """Factor A = L D L' for this step; false: it cannot be computed."""
    n, L, pivots, row = mass.n, mass.L, mass.inverse_pivots, mass.error
    mass.factored_dt = 0.0
    for i in range(n):
        for j in range(i if mass.diagonal else 0, i + 1):
            row[j] = 2.0 * mass.M[i][j] / dt
            if drag == OWN:
                row[j] = row[j] + mass.B[i][j] + 0.5 * mass.K[i][j] * dt
            elif i == j:
                row[j] += drag
        pivot = row[i]
        if not mass.diagonal:
            for j in range(i):
                for k in range(j):
                    row[j] -= row[k] * L[j][k]
                L[i][j] = row[j] * pivots[j]
                pivot -= row[j] * L[i][j]
        if not 0.0 < pivot < inf:
            return False
        pivots[i] = 1.0 / pivot
    mass.factored_dt, mass.factored_drag = dt, drag
    return True


@equation
def factored(mass: PassiveIntegrator, dt: float, drag: float) -> bool:
    """Factor A, unless it is already factored for this step; false: it cannot be computed."""
    return (mass.factored_dt == dt and mass.factored_drag == drag) or factor(mass, dt, drag)


@equation
def solve(mass: PassiveIntegrator, b: Reals, z: Floats) -> None:
    """Compute A^-1 b into z, by substitution: the residual stays at rounding, however badly conditioned A is."""
    n, L, pivots = mass.n, mass.L, mass.inverse_pivots
    if mass.diagonal:
        for i in range(n):
            z[i] = b[i] * pivots[i]
        return
    for i in range(n):
        total = 0.0
        for j in range(i):
            total += L[i][j] * z[j]
        z[i] = b[i] - total
    for i in range(n):
        z[i] = z[i] * pivots[i]
    for i in range(n - 1, 0, -1):
        for j in range(i):
            z[j] -= L[i][j] * z[i]


@equation
def carry_on(mass: PassiveIntegrator, dt: float) -> None:
    """Compute ``2M/T v_k`` into c."""
    gain = 2.0 / dt
    _multiply(mass, mass.M, mass.v, mass.c)
    for i in range(mass.n):
        mass.c[i] = gain * mass.c[i]


@equation
def drive(mass: PassiveIntegrator, dt: float, ybar: Reals) -> None:
    """Compute c."""
    carry_on(mass, dt)
    for i in range(mass.n):
        mass.error[i] = mass.x[i] - ybar[i]
    _multiply(mass, mass.K, mass.error, mass.product)
    for i in range(mass.n):
        mass.c[i] -= mass.product[i]


@equation
def finish(mass: PassiveIntegrator, dt: float) -> None:
    """Complete a step after `drive`, from vhat and the force."""
    n, error, damper, half = mass.n, mass.error, mass.damper, 0.5 * dt
    _multiply(mass, mass.B, mass.vhat, damper)
    for i in range(n):
        error[i] += half * mass.vhat[i]
    _multiply(mass, mass.K, error, mass.product)
    for i in range(n):
        mass.coupling_force[i] = -damper[i] - mass.product[i]
    mass.dissipated = dt * dot(n, damper, mass.vhat)
    move(mass, dt)


@equation
def spring_among(mass: PassiveIntegrator, dt: float, ybar: Reals, contacts: Surroundings | None) -> None:
    """Advance the mass on a spring, once A is factored: `PassiveIntegrator.step`."""
    drive(mass, dt, ybar)
    respond(mass, dt, contacts)
    finish(mass, dt)


@equation
def push_among(mass: PassiveIntegrator, dt: float, drag: float, push: Reals, contacts: Surroundings | None) -> None:
    """Advance the mass on a law's coupling, once A is factored: `PassiveIntegrator.push`."""
    carry_on(mass, dt)
    for i in range(mass.n):
        mass.c[i] += push[i]
    respond(mass, dt, contacts)
    mass.dissipated = 0.0
    for i in range(mass.n):
        mass.coupling_force[i] = push[i] - drag * mass.vhat[i]
    move(mass, dt)


def respond(mass: PassiveIntegrator, dt: float, contacts: Surroundings | None) -> None:
    """Solve a step with the contacts: `PassiveIntegrator.respond`; compiled versions are in ext/compiled/kinds.py."""
    mass.respond(dt, contacts)


@equation
def move(mass: PassiveIntegrator, dt: float) -> None:
    """Compute position and velocity at the step's end, and the work of its force."""
    x, v, vhat = mass.x, mass.v, mass.vhat
    for i in range(mass.n):
        x[i] += dt * vhat[i]
        v[i] = 2.0 * vhat[i] - v[i]
    mass.work = dt * dot(mass.n, mass.force, vhat)


@equation
def displace(mass: PassiveIntegrator, way: Reals, dt: float, contacts: Surroundings) -> bool:
    """Move the mass by `way` [m] at the end of a step: `Mass.displace`."""
    place, touched = mass.error, False
    for i in range(mass.n):
        place[i] = mass.x[i] + way[i]
        touched = touched or mass.force[i] != 0.0
    if (touched or clearance(contacts, place) <= 0.0) and not stays(contacts, mass.x, place):
        return False
    for i in range(mass.n):
        mass.x[i] += way[i]
        mass.vhat[i] += way[i] / dt
    return True


@equation
def _multiply(mass: PassiveIntegrator, matrix: FloatRows, vector: Reals, out: Floats) -> None:
    """Multiply one of the mass's matrices by a vector."""
    n = mass.n
    if mass.diagonal:
        for i in range(n):
            out[i] = matrix[i][i] * vector[i]
        return
    times(n, matrix, vector, out)


def _is_diagonal(matrix: FloatRows) -> bool:
    return not any(value for i, row in enumerate(matrix) for j, value in enumerate(row) if i != j)
