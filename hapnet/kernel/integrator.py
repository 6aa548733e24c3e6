"""The virtual mass on its virtual coupling: `hapnet.plant.integrator`."""

from __future__ import annotations

from hapnet.plant.worlds import walls
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.equation import equation
from hapnet.records.record import FloatRows, Floats, MatrixOfAxes, OfAxes, Reals, Record
from hapnet.records.vectors import copy, dot


class PassiveIntegrator(Record):
    """`PassiveIntegrator` with the result of its last step.

    is_diagonal : are M, B' and K' diagonal? factor, inverse_pivots : of A, for the present step.
    """

    n: int
    is_diagonal: int
    M: MatrixOfAxes
    B: MatrixOfAxes
    K: MatrixOfAxes
    x: OfAxes
    v: OfAxes
    factor: MatrixOfAxes
    inverse_pivots: OfAxes
    error: OfAxes
    c: OfAxes
    vhat: OfAxes
    response: OfAxes
    force: OfAxes
    damper: OfAxes
    coupling_force: OfAxes
    work: float
    dissipated: float
    penetration: float


@equation
def kinetic(mass: PassiveIntegrator) -> float:
    """kappa [J]."""
    _product(mass.n, mass.is_diagonal != 0, mass.M, mass.v, mass.response)
    return 0.5 * dot(mass.n, mass.v, mass.response)


@equation
def step(mass: PassiveIntegrator, contacts: Contacts, dt: float, ybar: Floats) -> None:
    """`PassiveIntegrator.step`."""
    n, x, v, vhat, diagonal = mass.n, mass.x, mass.v, mass.vhat, mass.is_diagonal != 0
    _factor(mass, dt)
    for i in range(n):
        mass.error[i] = x[i] - ybar[i]
    gain = 2.0 / dt
    _product(n, diagonal, mass.M, v, mass.c)
    _product(n, diagonal, mass.K, mass.error, mass.response)
    for i in range(n):
        mass.c[i] = gain * mass.c[i] - mass.response[i]
    _solve(mass, mass.c, vhat)
    copy(n, vhat, mass.c)
    for i in range(n):
        mass.force[i] = 0.0
    for k in range(contacts.lines):
        if walls.meets(contacts, k, dt, x, mass.c):
            _solve(mass, contacts.axes[k].normal, contacts.response)
            walls.push(contacts, k, dt, x, mass.c, mass.force, vhat)
    half = 0.5 * dt
    _product(n, diagonal, mass.B, vhat, mass.damper)
    for i in range(n):
        mass.error[i] = mass.error[i] + half * vhat[i]
    _product(n, diagonal, mass.K, mass.error, mass.response)
    for i in range(n):
        mass.coupling_force[i] = -mass.damper[i] - mass.response[i]
        x[i] = x[i] + dt * vhat[i]
        v[i] = 2.0 * vhat[i] - v[i]
    mass.work = dt * dot(n, mass.force, vhat)
    mass.dissipated = dt * dot(n, mass.damper, vhat)
    mass.penetration = walls.penetration(contacts, x)


@equation
def _factor(mass: PassiveIntegrator, dt: float) -> None:
    """`PassiveIntegrator._factor`: A = L D L'."""
    n, row = mass.n, mass.error
    for i in range(n):
        for j in range(i + 1):
            row[j] = 2.0 * mass.M[i][j] / dt + mass.B[i][j] + 0.5 * mass.K[i][j] * dt
        pivot = row[i]
        if not mass.is_diagonal:
            for j in range(i):
                for k in range(j):
                    row[j] -= row[k] * mass.factor[j][k]
                mass.factor[i][j] = row[j] * mass.inverse_pivots[j]
                pivot -= row[j] * mass.factor[i][j]
        mass.inverse_pivots[i] = 1.0 / pivot


@equation
def _solve(mass: PassiveIntegrator, b: Reals, z: Floats) -> None:
    """`PassiveIntegrator._solve`: A^-1 b into z."""
    n = mass.n
    if mass.is_diagonal:
        for i in range(n):
            z[i] = b[i] * mass.inverse_pivots[i]
        return
    for i in range(n):
        total = 0.0
        for j in range(i):
            total += mass.factor[i][j] * z[j]
        z[i] = b[i] - total
    for i in range(n):
        z[i] = z[i] * mass.inverse_pivots[i]
    for i in range(n - 1, 0, -1):
        for j in range(i):
            z[j] -= mass.factor[i][j] * z[i]


@equation
def _product(n: int, diagonal: bool, matrix: FloatRows, vector: Floats, out: Floats) -> None:
    """A matrix times a vector."""
    for i in range(n):
        if diagonal:
            out[i] = matrix[i][i] * vector[i]
        else:
            total = 0.0
            for j in range(n):
                total += matrix[i][j] * vector[j]
            out[i] = total
