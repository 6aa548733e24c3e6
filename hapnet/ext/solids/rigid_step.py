"""A step of a point among rigid solids: the equations of `hapnet.ext.solids.rigid_contacts`."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Annotated

from hapnet.checks import Vector
from hapnet.ext.solids.friction import add_drag, along, coefficient, resistance_along, tangential
from hapnet.ext.solids.secant import GOOD_MPS, Secant, correct, end_J, farther_than, meets, near, onset_J
from hapnet.ext.solids.shapes import Triple, triple
from hapnet.ext.solids.sight import Sight
from hapnet.mechanics.contacts import Inverse
from hapnet.plant import integrator
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds import coupled
from hapnet.plant.worlds.coupled import MOST, Coupled
from hapnet.plant.worlds.walls import force_along
from hapnet.records.record import FloatRows, Floats, MatrixOfAxes, OfAxes, Record, Wholes, compiled_as, equation
from hapnet.records.vectors import dot, length as norm

ANCHOR_CEILING_J = 0.01
"""Ceiling of E_c. The springs store some 5 mJ in a firm contact."""

CORRECTIONS = 8
"""The most secants after the first plane; 1 is usual."""

SWEEPS, _SETTLED = 60, 1e-13
"""The most rounds over the friction of contacts, which act on one another; they end when no drag changes by more than
this share."""

_STILL: Vector = (0.0, 0.0, 0.0)
_UNITS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class SolidContact(Record):
    """The contact of one mass with rigid solids.

    count, secants : the solids. touching, met : the number of solids that a step meets, and their indices.
    energy_J : e + E_c after the last step. scale : s of the last step; 1: its depths were the true ones.
    has_friction : whether any solid has friction. is_scalar : whether A is a multiple of the identity, for three axes;
        below 0: not computed yet. went : whether there was a step; end, velocity : its end, and the velocity there.
    response and the attributes after it: work arrays. sights, order : work arrays of the planes, deepest first.
    """

    dof: int = 0
    supplied_J: float = 0.0
    count: int
    secants: Annotated[Sequence[Secant], (MOST,)]
    touching: int
    met: Annotated[Wholes, (MOST,)]
    energy_J: float
    scale: float
    has_friction: int
    is_scalar: int
    went: int
    end: OfAxes
    velocity: OfAxes
    response: OfAxes
    together: Coupled
    free: OfAxes
    C: MatrixOfAxes
    columns: MatrixOfAxes
    D: MatrixOfAxes
    sights: Annotated[Sequence[Sight], (MOST,)]
    order: Annotated[Wholes, (MOST,)]


@equation
def deepest(contacts: SolidContact, x: Vector) -> float:
    """The deepest penetration of the solids at `x` (3,) [m]: `RigidContacts.penetration`."""
    found = 0.0
    for k in range(contacts.count):
        secant = contacts.secants[k]
        if not farther_than(secant, 0.0, x):
            found = max(found, -near(secant, x).distance_m)
    return found


def _respond(contacts: SolidContact, inverse: PassiveIntegrator, vector: Vector) -> Triple:
    integrator.solve(inverse, vector, contacts.response)
    return triple(contacts.response)


@compiled_as(_respond)
def respond(contacts: SolidContact, inverse: Inverse, vector: Vector) -> Vector:
    """A^-1 times a vector (3,). Compiled code has the mass itself as `inverse`."""
    return tuple(inverse(vector))


@equation
def react(contacts: SolidContact, inverse: Inverse, dt: float, x: Vector, w: Vector) -> tuple[Vector, Vector]:
    """The force of a step and its vhat, all (3,); w : vhat without contact."""
    a, b, c = w
    delta: Vector = (dt * a, dt * b, dt * c)
    length = dt * sqrt(a * a + b * b + c * c)
    contacts.touching = 0
    for k in range(contacts.count):
        contacts.secants[k].met = 0
    _meet(contacts, x, delta, length)
    force, vhat, held = _STILL, w, 0.0
    if contacts.touching:
        _anchor(contacts)
        force, vhat, delta = _touch(contacts, inverse, dt, x, w)
        for i in range(contacts.touching):
            held += end_J(contacts.secants[contacts.met[i]], delta)
        contacts.energy_J = max(held, contacts.energy_J - _dot(force, delta))  # without rounding max would do nothing
    contacts.energy_J = min(contacts.energy_J, held + ANCHOR_CEILING_J)
    if contacts.has_friction:
        a, b, c = _begun(contacts, x)
        _put(contacts.velocity, (2.0 * vhat[0] - a, 2.0 * vhat[1] - b, 2.0 * vhat[2] - c))
        _put(contacts.end, _plus(x, delta))
        contacts.went = 1
    return force, vhat


@equation
def _meet(contacts: SolidContact, x: Vector, delta: Vector, length: float) -> bool:
    """Whether the displacement meets further solids. They are added to `met`."""
    before = contacts.touching
    for k in range(contacts.count):
        secant = contacts.secants[k]
        if not secant.met and meets(secant, x, delta, length):
            secant.met = 1
            contacts.met[contacts.touching] = k
            contacts.touching += 1
    return contacts.touching > before


@equation
def _anchor(contacts: SolidContact) -> None:
    """Scale the depths down if there is not enough energy for them."""
    true_J = 0.0
    for i in range(contacts.touching):
        true_J += onset_J(contacts.secants[contacts.met[i]])
    contacts.scale = 1.0
    if true_J > contacts.energy_J:
        contacts.scale = sqrt(contacts.energy_J / true_J)
        for i in range(contacts.touching):
            secant = contacts.secants[contacts.met[i]]
            if secant.depth > 0.0:
                secant.depth *= contacts.scale


@equation
def _touch(contacts: SolidContact, inverse: Inverse, dt: float, x: Vector, w: Vector) -> tuple[Vector, Vector, Vector]:
    """The step's force, vhat and displacement, with corrected planes, and with all solids that it meets."""
    force, vhat = _step(contacts, inverse, dt, x, w)
    delta = _scaled(vhat, dt)
    for _ in range(CORRECTIONS):
        end, wrong = _plus(x, delta), False
        for i in range(contacts.touching):
            wrong = correct(contacts.secants[contacts.met[i]], x, delta, end, dt * GOOD_MPS) or wrong
        if contacts.touching < contacts.count:  # it may have been deflected to another solid
            wrong = _meet(contacts, x, delta, sqrt(_dot(delta, delta))) or wrong
        if not wrong:
            break
        force, vhat = _step(contacts, inverse, dt, x, w)
        delta = _scaled(vhat, dt)
    return force, vhat, delta


@equation
def _step(contacts: SolidContact, inverse: Inverse, dt: float, x: Vector, w: Vector) -> tuple[Vector, Vector]:
    """The force and vhat against these planes."""
    secant = contacts.secants[contacts.met[0]]
    if contacts.touching > 1 or (secant.friction != 0.0 and contacts.is_scalar != 1):
        return _step_together(contacts, inverse, dt, x, w)
    normal = triple(secant.normal)
    r0, r1, r2 = respond(contacts, inverse, normal)
    n0, n1, n2 = normal
    softness = n0 * r0 + n1 * r1 + n2 * r2
    if softness == 0.0:
        return _STILL, w
    push = force_along(secant.plane, secant.depth, n0 * w[0] + n1 * w[1] + n2 * w[2], 1.0 / softness, dt)
    vhat = (w[0] + push * r0, w[1] + push * r1, w[2] + push * r2)
    force = (push * n0, push * n1, push * n2)
    if push == 0.0 or secant.friction == 0.0:
        return force, vhat
    # A is a multiple of the identity, so friction changes nothing along the normal.
    square = _dot(normal, normal)
    alpha = softness / square
    grip, across = -secant.friction * push * sqrt(square), tangential(vhat, normal)
    speed = sqrt(_dot(across, across))
    drag = coefficient(grip, speed, 1.0 / alpha, along(_begun(contacts, x), across, speed))
    drag /= 1.0 + drag * alpha
    t0, t1, t2 = across
    force = (force[0] - drag * t0, force[1] - drag * t1, force[2] - drag * t2)
    return force, (w[0] + alpha * force[0], w[1] + alpha * force[1], w[2] + alpha * force[2])


@equation
def _begun(contacts: SolidContact, x: Vector) -> Vector:
    """The velocity at the step's beginning at `x`, as estimated from the last step."""
    end = contacts.end
    if contacts.went and end[0] == x[0] and end[1] == x[1] and end[2] == x[2]:
        return triple(contacts.velocity)
    return _STILL


@equation
def _step_together(contacts: SolidContact, inverse: Inverse, dt: float, x: Vector, w: Vector) -> tuple[Vector, Vector]:
    """Solve a step as `_step`, with several planes, or with friction and any A."""
    planes, C = contacts.together, contacts.C
    for j in range(3):
        _put(contacts.columns[j], respond(contacts, inverse, _UNITS[j]))
    coupled.compliance(3, contacts.columns, C)
    planes.count = 0
    for i in range(contacts.touching):
        secant = contacts.secants[contacts.met[i]]
        coupled.put(planes, secant.normal, secant.depth, secant.stiffness, secant.damping)
    coupled.solve(planes, w, C, dt)
    coupled.total(planes, planes.f)
    force = triple(planes.f)
    vhat, start = _plus(w, _times(C, force)), _begun(contacts, x)
    for i in range(contacts.touching):
        planes.drags[i] = 0.0
    for _ in range(SWEEPS):
        if not _rub(contacts, vhat, start):
            break
        _drag(contacts, w)
        coupled.solve(planes, contacts.free, contacts.columns, dt)
        coupled.total(planes, planes.f)
        force = triple(planes.f)
        slid = _times(contacts.D, _plus(triple(contacts.free), _times(contacts.columns, force)))
        force = (force[0] - slid[0], force[1] - slid[1], force[2] - slid[2])
        vhat = _plus(w, _times(C, force))
    return force, vhat


@equation
def _rub(contacts: SolidContact, vhat: Vector, start: Vector) -> bool:
    """Compute all contacts' drags at the velocity vhat, and D; return whether one has changed."""
    planes, C, D, changed = contacts.together, contacts.C, contacts.D, False
    for j in range(3):
        _put(D[j], _STILL)
    for i in range(contacts.touching):
        normal, mu, before = triple(planes.normals[i]), contacts.secants[contacts.met[i]].friction, planes.drags[i]
        across = tangential(vhat, normal)
        speed = sqrt(_dot(across, across))
        resistance = resistance_along(across, speed, C)
        # the speed without this contact's friction, but with that of all others
        alone = speed * (1.0 + before / resistance)
        grip = -mu * planes.pushes[i] * norm(3, normal)
        drag = coefficient(grip, alone, resistance, along(start, across, speed))
        planes.drags[i] = drag
        add_drag(drag, normal, D)
        changed = changed or abs(drag - before) > _SETTLED * drag
    return changed


@equation
def _drag(contacts: SolidContact, w: Vector) -> None:
    """Compute ``(A + D)^-1`` into `columns`, and the velocity without contact but with D, from w, into `free`."""
    rows, C, D = contacts.together.rows, contacts.C, contacts.D
    for i in range(3):
        for j in range(3):
            entry = 0.0
            for k in range(3):
                entry += C[i][k] * D[k][j]
            rows[i][j] = (1.0 if i == j else 0.0) + entry
            rows[i][4 + j] = C[i][j]
        rows[i][3] = w[i]
    coupled.eliminate(3, 4, rows)
    for i in range(3):
        contacts.free[i] = rows[i][3] / rows[i][i]
        for j in range(3):  # its columns, made symmetric
            contacts.columns[i][j] = 0.5 * (rows[i][4 + j] / rows[i][i] + rows[j][4 + i] / rows[j][j])


@equation
def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@equation
def _plus(one: Vector, other: Vector) -> Triple:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


@equation
def _scaled(vector: Vector, factor: float) -> Triple:
    return (factor * vector[0], factor * vector[1], factor * vector[2])


@equation
def _times(matrix: FloatRows, vector: Vector) -> Triple:
    return (dot(3, matrix[0], vector), dot(3, matrix[1], vector), dot(3, matrix[2], vector))


@equation
def _put(target: Floats, vector: Vector) -> None:
    target[0], target[1], target[2] = vector[0], vector[1], vector[2]
