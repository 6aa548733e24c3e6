"""A step of a rigid body in the twelve coordinates of `hapnet.mechanics.pose`: exact in energy and in momentum.

With the arms P_j, the mean velocity u of the point, the mean angular velocity w and the arms in the middle of the step,
``Pm_j = (P_j(0) + P_j(1))/2``,

    m (v1 - v0)/T = F,    (R1 I W1 - R0 I W0)/T = sum Pm_j x f_j,    w = R0 (W0 + a (W1 - W0)),    R1 = cay(T w) R0

where W is the angular velocity in the body's axes, in which I is diagonal, cay the Cayley transform, for which
``P_j(1) - P_j(0) = T w x Pm_j`` holds exactly, and a a weight from 1/2 to 1 for each of the body's axes. As R1' w and
R0' w are the same, w times the second equation is

    (W1 . I W1 - W0 . I W0)/2 + (W1 - W0) . (a - 1/2) I (W1 - W0) = T sum f_j . (w x Pm_j) = f . (x1 - x0)

so a step makes no energy for any force f (12,), and what it loses is known; a free body keeps its angular momentum
R I W. With a = 1/2 it loses none (Simo, Wong, Int. J. Numer. Meth. Engng 31, 1991), but a damper that would stop the
spin within the step then reverses it instead, in every step. With z = b T/I, for a damper of b [Nms/rad], and

    a = 1/(1 - exp(-z)) - 1/z                                        1/2 + z/12 - ... , and nearly 1 - 1/z if z is large

the spin of a body that a damper and a constant torque act on is the exact one, ``W1 = exp(-z) W0 + ...``, and so is its
turn (exponential fitting: Liniger, Willoughby, SIAM J. Numer. Anal. 7, 1970). See `weigh`.

A spring K and a damper B along the coordinates act at the middle: ``f = push - K (xm - y) - B (x1 - x0)/T``. So do
planes that touch points of the body: a point moves as the coordinates do, ``p = c + sum a_j P_j/l``, so a plane's law
of its depth (`hapnet.plant.worlds.coupled`) is one of the coordinates.

The point c is the centre of mass, and the arms lie along the principal axes. Newton's method finds u and w; if it does
not converge, the caller should halve the step. The step itself stands in `body_step.py`.
"""

from __future__ import annotations

from math import expm1
from typing import Annotated

from hapnet import checks
from hapnet.checks import Vector
from hapnet.mechanics.pose import ARM_M, AXES, DOF, Of3, OfPose, arm, in_world
from hapnet.records.record import FloatRows, Floats, Reals, Record, equation

MOST = 128
"""The greatest number of planes in a step."""

_FEW = 0.01
"""Below, a series of `weight` is exact to rounding, and its formula would lose digits."""


class Touched(Record):
    """Planes that points of the body touch.

    places : a, the points in the body's axes [m]. normals : into the solid (3,), of any length. depths [m],
    stiffnesses [N/m], dampings [Ns/m] : as in `hapnet.plant.worlds.coupled.Coupled`. frictions : Coulomb's mu. least,
    creeps : h [m/s] and d [m/s per N] of the law of friction in `body_step.py`. pushes : along the normals, none above
    0 [N]; rates : of their change by the speed along the normals [Ns/m]. rubs : the forces of friction (3,) [N].
    """

    count: int
    places: Annotated[FloatRows, (MOST, 3)]
    normals: Annotated[FloatRows, (MOST, 3)]
    depths: Annotated[Floats, (MOST,)]
    stiffnesses: Annotated[Floats, (MOST,)]
    dampings: Annotated[Floats, (MOST,)]
    frictions: Annotated[Floats, (MOST,)]
    least: Annotated[Floats, (MOST,)]
    creeps: Annotated[Floats, (MOST,)]
    pushes: Annotated[Floats, (MOST,)]
    rates: Annotated[Floats, (MOST,)]
    rubs: Annotated[FloatRows, (MOST, 3)]


class RigidBody(Record):
    """A rigid body: its state, and the results of a step.

    mass : m [kg]. inertia : I about the arms' axes [kg m^2]. arm_m : l. x : the coordinates [m]. stiffness [N/m],
    damping [Ns/m] : K and B of the spring that holds it, along the point's coordinates; arms_... : along the arms'.
    velocity : of the point [m/s]. spin : W, in the body's axes [rad/s]. gains : 1/a for each axis, 2 by default.

    Attributes
    ----------
    v : velocity of the coordinates at x [m/s]. mean : their mean velocity in the last step [m/s].
    middle : of the coordinates in it [m]. w : the mean angular velocity [rad/s]. lost : energy that the spin lost in it
    beside what the forces took [J]. rounds : of the last step.
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
    gains: Of3
    v: OfPose
    mean: OfPose
    middle: OfPose
    w: Of3
    lost: float
    rounds: int
    ends: OfPose
    spun: Of3
    begun: Of3
    ended: Of3
    rows: Annotated[FloatRows, (DOF, DOF + 1)]
    smooth: Annotated[FloatRows, (DOF, DOF + 1)]

    def __init__(self, mass: float, inertia: Vector, x: Vector = (0.0,) * AXES, arm_m: float = ARM_M) -> None:
        super().__init__()
        self.mass = checks.positive("mass", mass)
        self.inertia = [checks.positive("inertia", moment) for moment in checks.vector("inertia", inertia, 3)]
        self.arm_m = checks.positive("arm_m", arm_m)
        self.x, self.middle = list(checks.vector("position", x, AXES)), list(x)
        self.gains = [2.0] * 3

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


def weigh(body: RigidBody, dt: float) -> None:
    """Choose the weights a of steps of `dt` [s] for the damper that holds the body now: the spin then never reverses
    because the damper is stiff."""
    per_inertia = 2.0 * body.arms_damping * body.arm_m * body.arm_m * dt
    body.gains[:] = [1.0 / weight(per_inertia / moment) for moment in body.inertia]


def weight(z: float) -> float:
    """``1/(1 - exp(-z)) - 1/z``, which grows from 1/2 to 1; z is 0 or above."""
    if z < _FEW:
        return 0.5 + z / 12.0 - z * z * z / 720.0  # the next term is z^5/30240
    return -1.0 / expm1(-z) - 1.0 / z


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
