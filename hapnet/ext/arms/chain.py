"""A serial chain of rigid links on hinges and slides: inertia M(q), Coriolis matrix C(q, q') and gravity g(q) of (1).

Every point r of link b moves with ``r' = sum_i q_i' (z_i x r + u_i)`` for the joints up to b, all in the world's frame:
``u_i = p_i x z_i`` at a hinge; at a slide z_i is 0 and u_i the direction. So all sums over masses follow from mass,
first moment s and second moment E (Uicker's and Paul's form with pseudo-inertias), summed over a link and all links
after it:

    M_ij = z_i . h_j + u_i . l_j, + armature        h = I z + s x u, l = z x s + m u, I = tr(E) 1 - E
    C_ij = Christoffel's symbols, contracted with q'; so M' = C + C'
    g_i  = -gamma . (z_i x s_i + m_i u_i)

The change of a point between two postures is exact too: ``x(q1) - x(q0) = J_d (q1 - q0)``. With Rz averaged over both
ends, ``cos(d/2) Rz(q_m)`` in the plane, the product rule of differences holds at every joint, so J_d needs no division.

A joint that mimics another has no coordinate of its own: all joints are at ``G q + g0`` with a constant G, so
``G' M G``, ``G' C G``, ``G' g`` and ``J_d G`` are those of the arm's coordinates q.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from hapnet.mechanics.pose import cross as product
from hapnet.records.record import FloatRows, Floats, Reals, Record, equation

JOINTS = 10
"""The greatest number of joints of an arm."""

OfJoints = Annotated[Floats, (JOINTS,)]
MatrixOfJoints = Annotated[FloatRows, (JOINTS, JOINTS)]
Vector3 = Annotated[Floats, (3,)]
Matrix3 = Annotated[FloatRows, (3, 3)]

_SMALL = 1e-2
"""Below this angle a series gives sin(x)/x, exact to rounding [rad]."""


class ArmLink(Record):
    """A link with its joint, which turns about the z axis of its frame or slides along it; the first is the base.

    coordinate : the number of the q that moves the joint, which is at ``multiplier q + addend``.
    slides : whether the joint slides. armature : what its motor's rotor adds to M [kg m^2] or [kg].
    rotation, offset : of the frame at q = 0, in the frame of the link before [m]. mass [kg], moment [kg m], second
    [kg m^2] : of the link about the origin of its frame, ``m``, ``m c`` and the integral of ``r r'``.

    Attributes
    ----------
    turned, place : the frame in the world. axis, lever : z and u. spin, drift : the link's motion, ``r' = spin x r +
        drift``. all_mass, all_moment, all_second, flow, stir : of this and all later links, in the world: m, s, E,
        and the integrals of r' and of r' times r.
    angular, linear, angular_change, linear_change, returned : terms of M and C for the joint.
    """

    coordinate: int
    multiplier: float
    addend: float
    slides: int
    armature: float
    rotation: Matrix3
    offset: Vector3
    mass: float
    moment: Vector3
    second: Matrix3
    turned: Matrix3
    place: Vector3
    axis: Vector3
    lever: Vector3
    spin: Vector3
    drift: Vector3
    all_mass: float
    all_moment: Vector3
    all_second: Matrix3
    flow: Vector3
    stir: Matrix3
    angular: Vector3
    linear: Vector3
    angular_change: Vector3
    linear_change: Vector3
    returned: Vector3


class Lever(Record):
    """A point that the chain carries, or the sum of all first moments, between two postures.

    arms : the part of it in each link's frame, from the base to the last. begin, end : the point at both postures.
    columns : J_d, a row for each coordinate; whole : for each joint, if some mimic others. shifted : what a slide's way
        is multiplied by: 1 for a point, the mass behind the slide for the sum of first moments [kg].
    """

    arms: Annotated[FloatRows, (JOINTS + 1, 3)]
    begin: Vector3
    end: Vector3
    columns: Annotated[FloatRows, (JOINTS, 3)]
    whole: Annotated[FloatRows, (JOINTS, 3)]
    shifted: OfJoints


class Chain(Record):
    """The links, the tip, and the matrices of the latest posture.

    n : the number of coordinates. bodies : that of joints, each with its link.
    tip_mass : of an additional body fixed to the tip [kg]. gamma : the acceleration of gravity [m/s^2].
    tip : its lever; its `arms` begin at the origin of positions. weight : the lever of the first moments [kg m].
    inertia, coriolis : M and C.
    """

    n: int
    bodies: int
    tip_mass: float
    gamma: Vector3
    links: Annotated[Sequence[ArmLink], (JOINTS + 1,)]
    tip: Lever
    weight: Lever
    inertia: MatrixOfJoints
    coriolis: MatrixOfJoints
    rest: OfJoints


@equation
def cross(a: Reals, b: Reals, out: Floats) -> None:
    """``a x b`` into `out`."""
    out[0], out[1], out[2] = product(a, b)


@equation
def dot3(a: Reals, b: Reals) -> float:
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@equation
def place(chain: Chain, q: Reals, rates: Reals) -> None:
    """Compute frames, axes and motions of all links at q [rad] and q' [rad/s]."""
    for i in range(1, chain.bodies + 1):
        link, before = chain.links[i], chain.links[i - 1]
        R, W, T = link.rotation, before.turned, link.turned
        at, rate = link.multiplier * q[link.coordinate] + link.addend, link.multiplier * rates[link.coordinate]
        angle, way = 0.0 if link.slides else at, at if link.slides else 0.0
        c, s = math.cos(angle), math.sin(angle)
        o, axis, lever, spin, drift = link.offset, link.axis, link.lever, link.spin, link.drift
        for r in range(3):
            row = W[r]
            a = row[0] * R[0][0] + row[1] * R[1][0] + row[2] * R[2][0]
            b = row[0] * R[0][1] + row[1] * R[1][1] + row[2] * R[2][1]
            T[r][0], T[r][1] = c * a + s * b, c * b - s * a
            T[r][2] = axis[r] = row[0] * R[0][2] + row[1] * R[1][2] + row[2] * R[2][2]
            link.place[r] = before.place[r] + row[0] * o[0] + row[1] * o[1] + row[2] * o[2] + way * axis[r]
        cross(link.place, axis, lever)
        for r in range(3):
            if link.slides:
                lever[r], axis[r] = axis[r], 0.0
            spin[r] = before.spin[r] + rate * axis[r]
            drift[r] = before.drift[r] + rate * lever[r]


@equation
def gather(chain: Chain) -> None:
    """Compute the sums over each link and all links after it, in the world."""
    n = chain.bodies
    for i in range(n, 0, -1):
        link = chain.links[i]
        T, p, m, S, c = link.turned, link.place, link.mass, link.second, link.moment
        E, s, flow, stir, spin, drift = (
            link.all_second,
            link.all_moment,
            link.flow,
            link.stir,
            link.spin,
            link.drift,
        )
        for r in range(3):
            s[r] = T[r][0] * c[0] + T[r][1] * c[1] + T[r][2] * c[2]
        for r in range(3):
            a = T[r][0] * S[0][0] + T[r][1] * S[1][0] + T[r][2] * S[2][0]
            b = T[r][0] * S[0][1] + T[r][1] * S[1][1] + T[r][2] * S[2][1]
            d = T[r][0] * S[0][2] + T[r][1] * S[1][2] + T[r][2] * S[2][2]
            for k in range(r + 1):
                E[r][k] = a * T[k][0] + b * T[k][1] + d * T[k][2] + p[r] * s[k] + s[r] * p[k] + m * p[r] * p[k]
        for r in range(3):
            s[r] += m * p[r]
        if i == n and chain.tip_mass != 0.0:
            held, t, tip = chain.tip_mass, chain.tip.arms[n], flow
            for r in range(3):
                tip[r] = p[r] + T[r][0] * t[0] + T[r][1] * t[1] + T[r][2] * t[2]
            for r in range(3):
                s[r] += held * tip[r]
                for k in range(r + 1):
                    E[r][k] += held * tip[r] * tip[k]
            m += held
        E[0][1], E[0][2], E[1][2] = E[1][0], E[2][0], E[2][1]
        cross(spin, s, flow)
        for k in range(3):
            stir[0][k] = spin[1] * E[2][k] - spin[2] * E[1][k] + drift[0] * s[k]
            stir[1][k] = spin[2] * E[0][k] - spin[0] * E[2][k] + drift[1] * s[k]
            stir[2][k] = spin[0] * E[1][k] - spin[1] * E[0][k] + drift[2] * s[k]
            flow[k] += m * drift[k]
        link.all_mass = m
        if i < n:
            after = chain.links[i + 1]
            link.all_mass += after.all_mass
            for r in range(3):
                s[r] += after.all_moment[r]
                flow[r] += after.flow[r]
                for k in range(3):
                    E[r][k] += after.all_second[r][k]
                    stir[r][k] += after.stir[r][k]


@equation
def momentum(link: ArmLink, a: Reals, b: Reals, angular: Floats, linear: Floats) -> None:
    """The momentum of a link and all links after it if ``r' = a x r + b``: ``I a + s x b`` and ``a x s + m b``."""
    E, s = link.all_second, link.all_moment
    trace = E[0][0] + E[1][1] + E[2][2]
    cross(s, b, angular)
    cross(a, s, linear)
    for r in range(3):
        angular[r] += trace * a[r] - (E[r][0] * a[0] + E[r][1] * a[1] + E[r][2] * a[2])
        linear[r] += link.all_mass * b[r]


@equation
def matrices(chain: Chain, q: Reals, rates: Reals) -> None:
    """Compute M and C at q [rad] and q' [rad/s]."""
    place(chain, q, rates)
    gather(chain)
    n, M, C = chain.n, chain.inertia, chain.coriolis
    for a in range(n):
        for b in range(n):
            M[a][b] = C[a][b] = 0.0
    for j in range(1, chain.bodies + 1):
        link = chain.links[j]
        b = link.coordinate
        z, u, N, flow = link.axis, link.lever, link.stir, link.flow
        turn, shift, back = link.angular, link.linear, link.returned
        cross(link.spin, z, turn)  # z' and u', the rates of the axis as the arm moves
        cross(z, link.drift, back)
        cross(link.spin, u, shift)
        for r in range(3):
            shift[r] -= back[r]
        momentum(link, turn, shift, link.angular_change, link.linear_change)
        trace = N[0][0] + N[1][1] + N[2][2]
        cross(z, flow, back)
        for r in range(3):
            link.angular_change[r] += trace * z[r] - (N[r][0] * z[0] + N[r][1] * z[1] + N[r][2] * z[2])
            link.linear_change[r] += back[r]
        for i in range(1, j + 1):
            other = chain.links[i]
            share = other.multiplier * link.multiplier
            C[other.coordinate][b] += share * (
                dot3(other.axis, link.angular_change) + dot3(other.lever, link.linear_change)
            )
        momentum(link, z, u, link.angular_change, link.linear_change)
        for i in range(1, j + 1):
            other = chain.links[i]
            value = dot3(other.axis, link.angular_change) + dot3(other.lever, link.linear_change)
            value *= other.multiplier * link.multiplier
            M[other.coordinate][b] += value
            if i < j:
                M[b][other.coordinate] += value
        M[b][b] += link.multiplier * link.multiplier * link.armature
        cross(flow, u, back)
        for r in range(3):
            back[r] += trace * z[r] - (N[0][r] * z[0] + N[1][r] * z[1] + N[2][r] * z[2])
        for i in range(1, j):
            other = chain.links[i]
            C[b][other.coordinate] += (other.multiplier * link.multiplier) * (
                dot3(other.angular, link.angular_change)
                + dot3(other.linear, link.linear_change)
                + dot3(other.axis, back)
            )


@equation
def difference(chain: Chain, lever: Lever, q0: Reals, q1: Reals) -> None:
    """Compute the lever at two postures, and J_d between them; for equal postures J_d is the Jacobian."""
    n, begin, end, columns = chain.bodies, lever.begin, lever.end, lever.columns
    for r in range(3):
        begin[r] = end[r] = lever.arms[n][r]
    for i in range(n, 0, -1):
        link = chain.links[i]
        R, arm, one = link.rotation, lever.arms[i - 1], columns[i - 1]
        at0 = link.multiplier * q0[link.coordinate] + link.addend
        at1 = link.multiplier * q1[link.coordinate] + link.addend
        if link.slides:
            one[0], one[1], one[2] = 0.0, 0.0, lever.shifted[i - 1]
            begin[2] += at0 * one[2]
            end[2] += at1 * one[2]
        else:
            _turn(lever, i, n, at0, at1)
        for j in range(i - 1, n):
            _rotate(R, columns[j])
        _rotate(R, begin)
        _rotate(R, end)
        for r in range(3):
            begin[r] += arm[r]
            end[r] += arm[r]
    if n > chain.n:
        _lead(chain, lever)


@equation
def _lead(chain: Chain, lever: Lever) -> None:
    """Compute the columns of coordinates from those of joints."""
    columns, whole = lever.columns, lever.whole
    for i in range(chain.bodies):
        for r in range(3):
            whole[i][r], columns[i][r] = columns[i][r], 0.0
    for i in range(chain.bodies):
        link = chain.links[i + 1]
        for r in range(3):
            columns[link.coordinate][r] += link.multiplier * whole[i][r]


@equation
def _turn(lever: Lever, i: int, n: int, q0: float, q1: float) -> None:
    """Turn both postures' points and the columns behind joint i about its axis, and compute its own column."""
    begin, end, columns, one = lever.begin, lever.end, lever.columns, lever.columns[i - 1]
    middle, half = 0.5 * (q0 + q1), 0.5 * (q1 - q0)
    square = half * half
    share = 1.0 - square * (1.0 - square / 20.0) / 6.0 if abs(half) < _SMALL else math.sin(half) / half
    cosine, c, s = math.cos(half), math.cos(middle), math.sin(middle)
    x, y = 0.5 * (begin[0] + end[0]), 0.5 * (begin[1] + end[1])
    one[0], one[1], one[2] = -share * (s * x + c * y), share * (c * x - s * y), 0.0
    for j in range(i, n):
        x, y = columns[j][0], columns[j][1]
        columns[j][0], columns[j][1] = cosine * (c * x - s * y), cosine * (s * x + c * y)
    c, s = math.cos(q0), math.sin(q0)
    x, y = begin[0], begin[1]
    begin[0], begin[1] = c * x - s * y, s * x + c * y
    c, s = math.cos(q1), math.sin(q1)
    x, y = end[0], end[1]
    end[0], end[1] = c * x - s * y, s * x + c * y


@equation
def _rotate(R: FloatRows, vector: Floats) -> None:
    x, y, z = vector[0], vector[1], vector[2]
    for r in range(3):
        vector[r] = R[r][0] * x + R[r][1] * y + R[r][2] * z


@equation
def gravity(chain: Chain, q0: Reals, q1: Reals, out: Floats) -> None:
    """The discrete gradient of the potential of gravity between two postures [Nm]; for equal postures it is g."""
    difference(chain, chain.weight, q0, q1)
    for i in range(chain.n):
        out[i] = -dot3(chain.gamma, chain.weight.columns[i])


@equation
def height(chain: Chain, q: Reals) -> float:
    """The potential of gravity at q [J]; 0 where all masses are at the base's origin."""
    difference(chain, chain.weight, q, q)
    return -dot3(chain.gamma, chain.weight.begin)


def zero_chain(n: int) -> Chain:
    """A chain of n joints, all zero, each with its coordinate; the base's frame is the world's."""
    chain = Chain()
    chain.n = chain.bodies = n
    chain.links = [ArmLink() for _ in range(n + 1)]
    for i, link in enumerate(chain.links[1:]):
        link.coordinate, link.multiplier = i, 1.0
    for k in range(3):
        chain.links[0].turned[k][k] = 1.0
    return chain
