"""The step of a rigid body that `hapnet.ext.tools.body` describes: Newton's method, and the friction of all its points.

A point that touches with the push N is rubbed by a force g against its mean velocity v across the normal:

    g = mu N min(1, (|v| - h)/(d mu N + h/4)),    0 if |v| < h

This is Coulomb's law with a small viscosity d for a point that rests. Here h is half the speed with which the point
began the step: a point that stops ends the step at a fifth of its speed or less, and so comes to rest in a few steps.
As friction never acts along v, no step gains energy by it.

The points act on one another through the body, and through their pushes, so all are solved together. For given pushes
the law is the gradient of a convex function of the body's velocities (Castro et al., IEEE T-RO 39(2), 2023), so along
Newton's direction the power rises steadily; a step that went too far is shortened to where that power vanishes.
"""

from __future__ import annotations

from math import inf, sqrt

from hapnet.ext.solids.friction import tangential
from hapnet.ext.tools.body import RigidBody, Touched, momentum, moving, settle, turn
from hapnet.mechanics.pose import DOF, arm, cross, in_world
from hapnet.plant.worlds.coupled import eliminate, force as push_of
from hapnet.records.record import FloatRows, Reals, equation
from hapnet.records.vectors import dot

ROUNDS = 60
"""The greatest number of Newton rounds in a step; 3 to 5 are usual."""

GROWTHS = 6
"""The number of rounds with a growing change after which a step counts as not found."""

_NONE, _SMALL, _LARGER, _CALM = 3e-16, 1e-14, 1e-13, 0.01
"""Changes below the first share of the velocities are rounding. Below the second share of them, or of the last [m/s],
changes should shrink; when rounding stops that, the step is found. If it stops that again and again, the third share is
enough."""

_SHRINKS = 0.25
"""The factor by which a change of a few roundings should shrink."""

_RAMP = 0.25
"""The range of speeds over which the friction of a point that stops grows, as a share of h."""

_SEARCHES = 40
"""The greatest number of halvings along Newton's direction."""

_FAR = 0.1
"""A step went too far if the power along it is above this share of that at its start."""


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
    rubbing = False
    for k in range(planes.count):
        rubbing = rubbing or planes.frictions[k] > 0.0
    before, growths, body.rounds = inf, 0, 0
    for _ in range(ROUNDS):
        body.rounds += 1
        turn(body, dt, w)
        _balance(body, dt, push, y, planes)
        if rubbing:
            _add_friction(body, planes, dt)
        eliminate(DOF, 1, rows)
        share = _share(body, planes, dt) if rubbing else 1.0
        change = size = 0.0
        for i in range(3):
            du, dw = share * rows[i][DOF] / rows[i][i], share * rows[3 + i][DOF] / rows[3 + i][3 + i]
            u[i], w[i] = u[i] + du, w[i] + dw
            change += du * du + body.arm_m * body.arm_m * dw * dw
            size += u[i] * u[i] + body.arm_m * body.arm_m * w[i] * w[i]
        calm = size + _CALM * _CALM
        growths += 1 if share == 1.0 and change >= before else 0  # a shortened step may be shorter than the next
        few = change <= 9.0 * _NONE * _NONE * calm and change >= _SHRINKS * before
        stopped = change <= _SMALL * _SMALL * calm and change >= before
        tired = change <= _LARGER * _LARGER * calm and growths == GROWTHS
        if few or stopped or tired or change <= _NONE * _NONE * size:
            _arrive(body, dt)
            return True
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
                rows[3 + i][3 + k] = rows[3 + i][3 + k] + body.gains[j] / dt * share * end[i] * start[k]
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
def _add_friction(body: RigidBody, planes: Touched, dt: float) -> None:
    """Add the friction of all planes to `_balance`; `smooth` keeps the equations without it."""
    rows = body.rows
    for i in range(DOF):
        for j in range(DOF + 1):
            body.smooth[i][j] = rows[i][j]
    for k in range(planes.count):
        if planes.frictions[k] > 0.0:
            _rub(body, planes, k, dt)


@equation
def _spin_on(body: RigidBody) -> None:
    """W1 into `spun`: ``W0 + (R0' w - W0)/a``."""
    w = body.w
    for j in range(3):
        p, q, r = arm(body.x, body.arm_m, j)
        gain = body.gains[j]
        body.spun[j] = gain * (w[0] * p + w[1] * q + w[2] * r) / body.arm_m - (gain - 1.0) * body.spin[j]


@equation
def _touch(body: RigidBody, planes: Touched, k: int, dt: float) -> None:
    """Add the push of a plane to `_balance`."""
    rows, n = body.rows, planes.normals[k]
    r, half = in_world(body.middle, body.arm_m, planes.places[k]), 0.5 * dt
    turned = cross(r, n)
    speed = dot(3, n, _velocity(body, r))
    f, rate = push_of(planes.stiffnesses[k], planes.dampings[k], planes.depths[k], speed, dt)
    planes.pushes[k], planes.rates[k] = f, rate
    along = f * dot(3, r, n)
    for i in range(3):
        rows[i][DOF] = rows[i][DOF] + f * n[i]
        rows[3 + i][DOF] = rows[3 + i][DOF] + f * turned[i]
        rows[3 + i][3 + i] = rows[3 + i][3 + i] + half * along
        for j in range(3):
            rows[i][j] = rows[i][j] + rate * n[i] * n[j]
            rows[i][3 + j] = rows[i][3 + j] + rate * n[i] * turned[j]
            rows[3 + i][j] = rows[3 + i][j] + rate * turned[i] * n[j]
            rows[3 + i][3 + j] = rows[3 + i][3 + j] + rate * turned[i] * turned[j] - half * r[i] * f * n[j]


@equation
def _rub(body: RigidBody, planes: Touched, k: int, dt: float) -> None:
    """Add the friction at a plane to `_balance`."""
    rows, n, rub = body.rows, planes.normals[k], planes.rubs[k]
    r, half = in_world(body.middle, body.arm_m, planes.places[k]), 0.5 * dt
    v = tangential(_velocity(body, r), (n[0], n[1], n[2]))
    speed, size = sqrt(dot(3, v, v)), sqrt(dot(3, n, n))
    most = -planes.frictions[k] * planes.pushes[k] * size
    g, slope, grows = _law(planes, k, most, speed)
    rub[0] = rub[1] = rub[2] = 0.0
    if g == 0.0 and slope == 0.0:
        return
    pushed = planes.frictions[k] * planes.rates[k] * size * grows
    across = g / speed if speed > 0.0 else slope
    along = (v[0] / speed, v[1] / speed, v[2] / speed) if speed > 0.0 else (0.0, 0.0, 0.0)
    for i in range(3):
        rub[i] = -g * along[i]
    torque, lever = cross(r, rub), dot(3, r, rub)
    for i in range(3):
        rows[i][DOF] = rows[i][DOF] + rub[i]
        rows[3 + i][DOF] = rows[3 + i][DOF] + torque[i]
        rows[3 + i][3 + i] = rows[3 + i][3 + i] + half * lever
        for j in range(3):
            rows[3 + i][3 + j] = rows[3 + i][3 + j] - half * r[i] * rub[j]
    square = size * size
    for j in range(3):
        # a column of the derivative by the point's velocity, and its torque
        column = (
            (slope - across) * along[0] * along[j] - across * n[0] * n[j] / square + pushed * along[0] * n[j],
            (slope - across) * along[1] * along[j] - across * n[1] * n[j] / square + pushed * along[1] * n[j],
            (slope - across) * along[2] * along[j] - across * n[2] * n[j] / square + pushed * along[2] * n[j],
        )
        column = (
            column[0] + (across if j == 0 else 0.0),
            column[1] + (across if j == 1 else 0.0),
            column[2] + (across if j == 2 else 0.0),
        )
        turned = cross(r, column)
        # the point moves with u + w x r: d v_j/d w_m
        m, p = (j + 1) % 3, (j + 2) % 3
        for i in range(3):
            rows[i][j] = rows[i][j] + column[i]
            rows[3 + i][j] = rows[3 + i][j] + turned[i]
            rows[i][3 + m] = rows[i][3 + m] + column[i] * r[p]
            rows[i][3 + p] = rows[i][3 + p] - column[i] * r[m]
            rows[3 + i][3 + m] = rows[3 + i][3 + m] + turned[i] * r[p]
            rows[3 + i][3 + p] = rows[3 + i][3 + p] - turned[i] * r[m]


@equation
def _law(planes: Touched, k: int, most: float, speed: float) -> tuple[float, float, float]:
    """g [N] at this speed across the normal [m/s], and its derivatives by the speed and by `most`, mu N [N]."""
    over = speed - planes.least[k]
    if not (most > 0.0 and over >= 0.0):
        return 0.0, 0.0, 0.0
    ramp = planes.creeps[k] * most + _RAMP * planes.least[k]
    if over > ramp:
        return most, 0.0, 1.0
    return most * over / ramp, most / ramp, over * _RAMP * planes.least[k] / (ramp * ramp)


@equation
def _share(body: RigidBody, planes: Touched, dt: float) -> float:
    """The share of Newton's step that is taken: where the power along it vanishes, or all of it."""
    rows, smooth = body.rows, body.smooth
    slope = linear = 0.0
    for i in range(DOF):
        d = rows[i][DOF] / rows[i][i]
        slope -= d * smooth[i][DOF]
        for j in range(DOF):
            linear += d * smooth[i][j] * rows[j][DOF] / rows[j][j]
    start = slope - _friction_power(body, planes, dt, 0.0)
    if not (start < 0.0 and slope + linear - _friction_power(body, planes, dt, 1.0) > -_FAR * start):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_SEARCHES):
        share = 0.5 * (low + high)
        power = slope + share * linear - _friction_power(body, planes, dt, share)
        if abs(power) <= -_FAR * start:
            return share
        if power < 0.0:
            low = share
        else:
            high = share
    return high


@equation
def _friction_power(body: RigidBody, planes: Touched, dt: float, share: float) -> float:
    """The power of friction after a share of Newton's step, for a motion as that step [W]."""
    rows = body.rows
    du = (rows[0][DOF] / rows[0][0], rows[1][DOF] / rows[1][1], rows[2][DOF] / rows[2][2])
    dw = (rows[3][DOF] / rows[3][3], rows[4][DOF] / rows[4][4], rows[5][DOF] / rows[5][5])
    power = 0.0
    for k in range(planes.count):
        if not planes.frictions[k] > 0.0:
            continue
        n = planes.normals[k]
        normal = (n[0], n[1], n[2])
        r = in_world(body.middle, body.arm_m, planes.places[k])
        now, turned = _velocity(body, r), cross(dw, r)
        change = (du[0] + turned[0], du[1] + turned[1], du[2] + turned[2])
        there = (now[0] + share * change[0], now[1] + share * change[1], now[2] + share * change[2])
        push, _ = push_of(planes.stiffnesses[k], planes.dampings[k], planes.depths[k], dot(3, n, there), dt)
        v = tangential(there, normal)
        speed, most = sqrt(dot(3, v, v)), -planes.frictions[k] * push * sqrt(dot(3, n, n))
        if speed > 0.0:
            power -= _law(planes, k, most, speed)[0] / speed * dot(3, v, change)
    return power


@equation
def _velocity(body: RigidBody, r: Reals) -> tuple[float, float, float]:
    """The mean velocity of the body's point at r [m/s]."""
    u, moved = body.mean, cross(body.w, r)
    return (u[0] + moved[0], u[1] + moved[1], u[2] + moved[2])


@equation
def _arrive(body: RigidBody, dt: float) -> None:
    """Set the state at the step's end."""
    x, u, w = body.x, body.mean, body.w
    turn(body, dt, w)
    _spin_on(body)
    body.lost = 0.0
    for i in range(3):
        more, gain = body.spun[i] - body.spin[i], body.gains[i]
        body.lost += (1.0 / gain - 0.5) * body.inertia[i] * more * more
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
