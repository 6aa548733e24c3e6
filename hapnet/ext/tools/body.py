"""A step of a rigid body in the twelve coordinates of `hapnet.mechanics.pose`: exact in energy and in momentum.

With the arms P_j, the mean velocity u of the point, the mean angular velocity w and the arms in the middle of the step,
``Pm_j = (P_j(0) + P_j(1))/2``,

    m (v1 - v0)/T = F,    (R1 I W1 - R0 I W0)/T = sum Pm_j x f_j,    w = R0 (W0 + W1)/2,    R1 = cay(T w) R0

where W is the angular velocity in the body's axes, in which I is diagonal, and cay the Cayley transform, for which
``P_j(1) - P_j(0) = T w x Pm_j`` holds exactly. As R1 w and R0 w are the same, w times the second equation is

    (W1 . I W1 - W0 . I W0)/2 = T sum f_j . (w x Pm_j) = f . (x1 - x0)

so a step neither makes nor loses energy for any force f (12,), and a free body keeps its angular momentum R I W
(Simo, Wong, Int. J. Numer. Meth. Engng 31, 1991). A spring K and a damper B along the coordinates act at the middle:
``f = push - K (xm - y) - B (x1 - x0)/T``. So do planes that touch points of the body: a point moves as the coordinates
do, ``p = c + sum a_j P_j/l``, so a plane's law of its depth (`hapnet.plant.worlds.coupled`) is one of the coordinates.

The point c is the centre of mass, and the arms lie along the principal axes. Newton's method finds u and w; if it does
not converge, the caller should halve the step.
"""

from __future__ import annotations

from math import inf
from typing import Annotated

from hapnet import checks
from hapnet.checks import Vector
from hapnet.mechanics.pose import ARM_M, AXES, DOF, Of3, OfPose, arm, cross, in_world
from hapnet.plant.worlds.coupled import eliminate, force as push_of
from hapnet.records.record import FloatRows, Floats, Reals, Record, equation

MOST = 128
"""The greatest number of planes in a step."""

ROUNDS = 60
"""The greatest number of Newton rounds in a step; 3 to 5 are usual."""

GROWTHS = 6
"""The number of rounds with a growing change after which a step counts as not found."""

_NONE = 3e-16
"""Changes below this share of the velocities are rounding."""

_SLOW = 1e-6
"""A negligible velocity [m/s]."""

_SMALL = 1e-9
"""Below this share of the velocities changes should shrink; when rounding stops that, the step is found."""


class Touched(Record):
    """Planes that points of the body touch.

    places : a, the points in the body's axes [m]. normals : into the solid (3,), of any length. depths [m],
    stiffnesses [N/m], dampings [Ns/m] : as in `hapnet.plant.worlds.coupled.Coupled`. drags : across the normals, of
    friction [Ns/m]. pushes : along the normals, none above 0 [N].
    """

    count: int
    places: Annotated[FloatRows, (MOST, 3)]
    normals: Annotated[FloatRows, (MOST, 3)]
    depths: Annotated[Floats, (MOST,)]
    stiffnesses: Annotated[Floats, (MOST,)]
    dampings: Annotated[Floats, (MOST,)]
    drags: Annotated[Floats, (MOST,)]
    pushes: Annotated[Floats, (MOST,)]


class RigidBody(Record):
    """A rigid body: its state, and the results of a step.

    mass : m [kg]. inertia : I about the arms' axes [kg m^2]. arm_m : l. x : the coordinates [m]. stiffness [N/m],
    damping [Ns/m] : K and B of the spring that holds it, along the point's coordinates; arms_... : along the arms'.
    velocity : of the point [m/s]. spin : W, in the body's axes [rad/s].

    Attributes
    ----------
    v : velocity of the coordinates at x [m/s]. mean : their mean velocity in the last step [m/s].
    middle : of the coordinates in it [m]. w : the mean angular velocity [rad/s]. rounds : of the last step.
    """

    mass: float
    inertia: Of3
    arm_m: float
    stiffness: float
    damping: float
    arms_stiffness: float
    arms_damping: float
    x: OfPose
    velocity: Of3
    spin: Of3
    v: OfPose
    mean: OfPose
    middle: OfPose
    w: Of3
    rounds: int
    ends: OfPose
    spun: Of3
    begun: Of3
    ended: Of3
    rows: Annotated[FloatRows, (DOF, DOF + 1)]

    def __init__(self, mass: float, inertia: Vector, x: Vector = (0.0,) * AXES, arm_m: float = ARM_M) -> None:
        super().__init__()
        self.mass = checks.positive("mass", mass)
        self.inertia = [checks.positive("inertia", moment) for moment in checks.vector("inertia", inertia, 3)]
        self.arm_m = checks.positive("arm_m", arm_m)
        self.x, self.middle = list(checks.vector("position", x, AXES)), list(x)

    @property
    def kinetic(self) -> float:
        """Its kinetic energy [J]."""
        return kinetic(self)

    @property
    def momentum(self) -> Vector:
        """Angular momentum about the point, in the world's axes [kg m^2/s]."""
        return momentum(self)

    def hold(self, stiffness: float, damping: float, arms_stiffness: float, arms_damping: float) -> None:
        """Set the spring and damper that hold it, as for the attributes."""
        self.stiffness, self.damping = stiffness, damping
        self.arms_stiffness, self.arms_damping = arms_stiffness, arms_damping


@equation
def kinetic(body: RigidBody) -> float:
    """Kinetic energy [J]."""
    twice = 0.0
    for i in range(3):
        twice += body.mass * body.velocity[i] * body.velocity[i] + body.inertia[i] * body.spin[i] * body.spin[i]
    return 0.5 * twice


@equation
def momentum(body: RigidBody) -> tuple[float, float, float]:
    """The angular momentum R I W."""
    about, spin = body.inertia, body.spin
    return in_world(body.x, body.arm_m, (about[0] * spin[0], about[1] * spin[1], about[2] * spin[2]))


@equation
def settle(body: RigidBody) -> None:
    """Compute `v` from the present state."""
    moving(body, body.x, body.velocity, in_world(body.x, body.arm_m, body.spin), body.v)


@equation
def moving(body: RigidBody, x: Reals, u: Reals, w: Reals, out: Floats) -> None:
    """The coordinates' velocity at x, with the velocity u of the point and the angular velocity w."""
    for i in range(3):
        out[i] = u[i]
    for j in range(3):
        a, b, c = arm(x, body.arm_m, j)
        i = 3 + 3 * j
        out[i] = w[1] * c - w[2] * b
        out[i + 1] = w[2] * a - w[0] * c
        out[i + 2] = w[0] * b - w[1] * a


@equation
def turn(body: RigidBody, dt: float, w: Reals) -> None:
    """The arms in the middle of a step of `dt` with the mean angular velocity w into `middle`, at its end into `ends`:
    ``Pm = (I - S(a))^-1 P = (P + a x P + a (a . P))/(1 + |a|^2)``, a = T w/2.
    """
    a0, a1, a2 = 0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2]
    share = 1.0 / (1.0 + a0 * a0 + a1 * a1 + a2 * a2)
    middle, ends, x, length = body.middle, body.ends, body.x, body.arm_m
    for j in range(3):
        p, q, r = arm(x, length, j)
        along = a0 * p + a1 * q + a2 * r
        i = 3 + 3 * j
        # add Pm - P, so that a body that does not turn keeps its arms bit for bit
        d0 = share * ((a1 * r - a2 * q) + a0 * along - (a0 * a0 + a1 * a1 + a2 * a2) * p)
        d1 = share * ((a2 * p - a0 * r) + a1 * along - (a0 * a0 + a1 * a1 + a2 * a2) * q)
        d2 = share * ((a0 * q - a1 * p) + a2 * along - (a0 * a0 + a1 * a1 + a2 * a2) * r)
        middle[i], middle[i + 1], middle[i + 2] = x[i] + d0, x[i + 1] + d1, x[i + 2] + d2
        ends[i], ends[i + 1], ends[i + 2] = x[i] + 2.0 * d0, x[i + 1] + 2.0 * d1, x[i + 2] + 2.0 * d2


@equation
def step(body: RigidBody, dt: float, push: Reals, y: Reals, planes: Touched) -> bool:
    """Move the body by a step of `dt` [s]; false: no step was found, and the body has not moved.

    push : constant force (12,) [N]. y : set-position (12,) of the spring that holds it [m].
    """
    u, w, rows = body.mean, body.w, body.rows
    body.begun[0], body.begun[1], body.begun[2] = momentum(body)
    w[0], w[1], w[2] = in_world(body.x, body.arm_m, body.spin)
    for i in range(3):
        u[i] = body.velocity[i]
    before, growths, body.rounds = inf, 0, 0
    for _ in range(ROUNDS):
        body.rounds += 1
        turn(body, dt, w)
        _balance(body, dt, push, y, planes)
        eliminate(DOF, 1, rows)
        change = size = 0.0
        for i in range(3):
            du, dw = rows[i][DOF] / rows[i][i], rows[3 + i][DOF] / rows[3 + i][3 + i]
            u[i], w[i] = u[i] + du, w[i] + dw
            change += du * du + body.arm_m * body.arm_m * dw * dw
            size += u[i] * u[i] + body.arm_m * body.arm_m * w[i] * w[i]
        if change <= _NONE * _NONE * size or (change >= before and change <= _SMALL * _SMALL * (size + _SLOW * _SLOW)):
            _arrive(body, dt)
            return True
        growths += 1 if change >= before else 0
        if growths == GROWTHS:
            return False
        before = change
    return False


@equation
def _balance(body: RigidBody, dt: float, push: Reals, y: Reals, planes: Touched) -> None:
    """Compute the residual of the equations of u and w, and its Jacobian, for `eliminate`."""
    x, u, w, rows, middle, reach = body.x, body.mean, body.w, body.rows, body.middle, body.arm_m
    gain, half, stiffness, damping = 2.0 / dt, 0.5 * dt, body.stiffness, body.damping
    for i in range(DOF):
        for j in range(DOF + 1):
            rows[i][j] = 0.0
    for i in range(3):
        rows[i][i] = gain * body.mass + damping + half * stiffness
        pulled = stiffness * (y[i] - x[i] - half * u[i]) - damping * u[i]
        rows[i][DOF] = gain * body.mass * (body.velocity[i] - u[i]) + push[i] + pulled
    # R1 I W1, and R1 I R0' as its derivative by W1
    _spin_on(body)
    body.ended[0] = body.ended[1] = body.ended[2] = 0.0
    for j in range(3):
        start, end, share = arm(x, reach, j), arm(body.ends, reach, j), body.inertia[j] / (reach * reach)
        for i in range(3):
            body.ended[i] = body.ended[i] + share * reach * body.spun[j] * end[i]
            for k in range(3):
                rows[3 + i][3 + k] = rows[3 + i][3 + k] + gain * share * end[i] * start[k]
    for i in range(3):
        rows[3 + i][DOF] = (body.begun[i] - body.ended[i]) / dt
    _addcross(rows, body.ended, -1.0)
    # spring, damper and push on the arms: the torque sum Pm x f
    stiffness, damping = body.arms_stiffness, body.arms_damping
    for j in range(3):
        rod, i = arm(middle, reach, j), 3 + 3 * j
        f = (
            push[i] + stiffness * (y[i] + (reach if j == 0 else 0.0)),
            push[i + 1] + stiffness * (y[i + 1] + (reach if j == 1 else 0.0)),
            push[i + 2] + stiffness * (y[i + 2] + (reach if j == 2 else 0.0)),
        )
        square = rod[0] * rod[0] + rod[1] * rod[1] + rod[2] * rod[2]
        across = rod[0] * w[0] + rod[1] * w[1] + rod[2] * w[2]
        along = half * (rod[0] * f[0] + rod[1] * f[1] + rod[2] * f[2]) + damping * square
        torque = cross(rod, f)
        for k in range(3):
            rows[3 + k][DOF] = rows[3 + k][DOF] + torque[k] - damping * (square * w[k] - across * rod[k])
            rows[3 + k][3 + k] = rows[3 + k][3 + k] + along
            for m in range(3):
                rows[3 + k][3 + m] = rows[3 + k][3 + m] - rod[k] * (half * f[m] + damping * rod[m])
    for k in range(planes.count):
        _touch(body, planes, k, dt)


@equation
def _spin_on(body: RigidBody) -> None:
    """W1 into `spun`: ``2 R0' w - W0``."""
    w = body.w
    for j in range(3):
        p, q, r = arm(body.x, body.arm_m, j)
        body.spun[j] = 2.0 * (w[0] * p + w[1] * q + w[2] * r) / body.arm_m - body.spin[j]


@equation
def _touch(body: RigidBody, planes: Touched, k: int, dt: float) -> None:
    """Add the part of a plane to `_balance`."""
    rows, u, w, n = body.rows, body.mean, body.w, planes.normals[k]
    r, half = in_world(body.middle, body.arm_m, planes.places[k]), 0.5 * dt
    turned, moved = cross(r, n), cross(w, r)
    speed = 0.0
    for i in range(3):
        speed += n[i] * (u[i] + moved[i])
    f, rate = push_of(planes.stiffnesses[k], planes.dampings[k], planes.depths[k], speed, dt)
    planes.pushes[k], drag = f, planes.drags[k]
    square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
    rate -= drag / square
    force = (
        f * n[0] - drag * (u[0] + moved[0] - speed * n[0] / square),
        f * n[1] - drag * (u[1] + moved[1] - speed * n[1] / square),
        f * n[2] - drag * (u[2] + moved[2] - speed * n[2] / square),
    )
    torque = cross(r, force)
    along = r[0] * force[0] + r[1] * force[1] + r[2] * force[2]
    size = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    for i in range(3):
        rows[i][DOF] = rows[i][DOF] + force[i]
        rows[3 + i][DOF] = rows[3 + i][DOF] + torque[i]
        rows[i][i] = rows[i][i] + drag
        rows[3 + i][3 + i] = rows[3 + i][3 + i] + drag * size + half * along
        for j in range(3):
            rows[i][j] = rows[i][j] + rate * n[i] * n[j]
            rows[i][3 + j] = rows[i][3 + j] + rate * n[i] * turned[j]
            rows[3 + i][j] = rows[3 + i][j] + rate * turned[i] * n[j]
            rows[3 + i][3 + j] = (
                rows[3 + i][3 + j] + rate * turned[i] * turned[j] - r[i] * (drag * r[j] + half * force[j])
            )
    for i in range(3):  # the drag's cross terms
        j, m = (i + 1) % 3, (i + 2) % 3
        rows[i][3 + j] = rows[i][3 + j] + drag * r[m]
        rows[i][3 + m] = rows[i][3 + m] - drag * r[j]
        rows[3 + i][j] = rows[3 + i][j] - drag * r[m]
        rows[3 + i][m] = rows[3 + i][m] + drag * r[j]


@equation
def _arrive(body: RigidBody, dt: float) -> None:
    """Set the state at the step's end."""
    x, u, w = body.x, body.mean, body.w
    turn(body, dt, w)
    _spin_on(body)
    for i in range(3):
        body.middle[i] = x[i] + 0.5 * dt * u[i]
        x[i] = x[i] + dt * u[i]
        body.velocity[i] = 2.0 * u[i] - body.velocity[i]
        body.spin[i] = body.spun[i]
    for i in range(9):
        x[3 + i] = body.ends[3 + i]
    moving(body, body.middle, u, w, body.mean)
    settle(body)


@equation
def _addcross(rows: FloatRows, a: Reals, sign: float) -> None:
    """Add S(a), with ``S(a) w = a x w``, to the part of the rows that belongs to w."""
    rows[3][4], rows[3][5] = rows[3][4] - sign * a[2], rows[3][5] + sign * a[1]
    rows[4][3], rows[4][5] = rows[4][3] + sign * a[2], rows[4][5] - sign * a[0]
    rows[5][3], rows[5][4] = rows[5][3] - sign * a[1], rows[5][4] + sign * a[0]
