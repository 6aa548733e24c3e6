"""The passive step of an arm in a simulated hand, and a tick of such steps.

    M(q) q'' + C(q, q') q' + g(q) = J' (F + f) + joints' own torques,    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

With ``M = L L'`` and the quasi-velocity ``z = L' q'`` the kinetic energy is |z|^2/2. All at the middle of the step,
``w = (q1 - q0)/h``:

    (2/h) L L' w + S w = (2/h) L z0 + J_d' F + ...,    S the skew part of C - L L.',    z1 = 2 L' w - z0

So ``|z1|^2/2 - |z0|^2/2 = h w . (torques)`` for any L, and ``h w . J_d' F = F . (x1 - x0)``: a step neither makes nor
loses energy. Terms that depend on the step's end are found by a fixed point, with the tangents of stops and brakes.

x are the port's axes: those of the tip, or the joints' angles with J_d = 1, f in Nm and the hand's M_h, B_h and K_h in
kg m^2, Nms/rad and Nm/rad. The hand's mass moves with the tip or with each joint, as a part of M. A force F is held
along these axes in a tick; if a motor's limit does not suffice, the motors render the largest multiple of F within all
limits. The account uses that force: `force` after a tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.ext.arms.chain import Chain, MatrixOfJoints, OfJoints, difference, gravity, height, matrices
from hapnet.records.record import Reals, Record, equation
from hapnet.records.vectors import copy, dot

ROUNDS = 40
"""The greatest number of rounds of a step's fixed point; 3 to 6 are usual."""

_STILL = 1e-13
"""The fixed point ends when no angle changes by more [rad]."""

TRIES = 8
"""The greatest number of tries of a tick whose torques exceed a motor's limit; in the last the force is 0."""

_WITHIN = 1.0 - 1e-9


class ArmPort(Record):
    """The port where hand and coupling act, between two postures; its `axes` are the tip's [m] or the joints' [rad].

    by_joints : whether the axes are the joints. origin : q where their positions are 0 [rad].

    Attributes
    ----------
    begin, end : the position at both postures. columns : J_d, a row for each joint.
    """

    axes: int
    by_joints: int
    origin: OfJoints
    begin: OfJoints
    end: OfJoints
    columns: MatrixOfJoints


class Arm(Record):
    """An arm and the hand that holds it, at its tip or joint by joint.

    period : of a tick [s]. h : length of a step [s]; steps : their number in a tick.
    damping [Nms/rad], friction [Nm] : of each joint; the friction is Coulomb's above `slip` [rad/s]. lower, upper :
    the stops [rad]; stop_stiffness [Nm/rad], stop_damping [Nms/rad^2] : of these. effort : the motors' greatest torque
    [Nm]; has_limits : whether any is finite. speed : above that [rad/s] the drive brakes with `brake` [Nms/rad].
    compensated : whether the motors carry the arm's weight. hand_mass [kg], hand_stiffness [N/m], hand_damping [Ns/m] :
        of the hand.
    port : where hand and force act; with joints as axes [m], [N] and so on are [rad], [Nm], ...

    Attributes
    ----------
    q [rad], z : of the state; rates : q' [rad/s]. x [m], v [m/s] : of the port.
    commanded : the force to hold [N]; force : the force held in the last tick. hand_force : its mean in that tick [N].
    lost : by damping, friction, brakes and stops since the start [J]. limited : whether the last tick's force was cut.
    rounds : of the longest fixed point so far; unsettled : how many did not converge.
    """

    chain: Chain
    port: ArmPort
    n: int
    steps: int
    period: float
    h: float
    damping: OfJoints
    friction: OfJoints
    slip: OfJoints
    lower: OfJoints
    upper: OfJoints
    stop_stiffness: OfJoints
    stop_damping: OfJoints
    effort: OfJoints
    speed: OfJoints
    brake: OfJoints
    compensated: int
    has_limits: int
    hand_mass: float
    hand_stiffness: float
    hand_damping: float
    q: OfJoints
    z: OfJoints
    rates: OfJoints
    x: OfJoints
    v: OfJoints
    commanded: OfJoints
    force: OfJoints
    hand_force: OfJoints
    lost: float
    limited: int
    rounds: int
    unsettled: int
    worst: float
    spent: float
    w: OfJoints
    middle: OfJoints
    end: OfJoints
    load: OfJoints
    torque: OfJoints
    drag: OfJoints
    stop_force: OfJoints
    stop_slope: OfJoints
    factor: MatrixOfJoints
    rate: MatrixOfJoints
    system: MatrixOfJoints
    aim: OfJoints
    pull: OfJoints
    begun_q: OfJoints
    begun_z: OfJoints
    begun_w: OfJoints
    begun_v: OfJoints


@equation
def weigh(arm: Arm, q: Reals, rates: Reals) -> None:
    """Compute M, with the hand's mass if the axes are the joints, and C."""
    matrices(arm.chain, q, rates)
    if arm.port.by_joints:
        for i in range(arm.n):
            arm.chain.inertia[i][i] += arm.hand_mass
    cholesky(arm)


@equation
def look_at_port(arm: Arm, q0: Reals, q1: Reals) -> None:
    """Compute the port at two postures, and J_d between them."""
    port, tip = arm.port, arm.chain.tip
    if port.by_joints:
        for i in range(arm.n):
            port.begin[i], port.end[i] = q0[i] - port.origin[i], q1[i] - port.origin[i]
    else:
        difference(arm.chain, tip, q0, q1)
        copy(3, tip.begin, port.begin)
        copy(3, tip.end, port.end)
        for i in range(arm.n):
            copy(3, tip.columns[i], port.columns[i])


@equation
def cholesky(arm: Arm) -> None:
    """Compute L and its rate into `factor` and `rate`, from M and ``M' = C + C'``."""
    n, L, R, M, C = arm.n, arm.factor, arm.rate, arm.chain.inertia, arm.chain.coriolis
    for j in range(n):
        square, change = M[j][j], 2.0 * C[j][j]
        for k in range(j):
            square -= L[j][k] * L[j][k]
            change -= 2.0 * L[j][k] * R[j][k]
        pivot = math.sqrt(square)
        L[j][j] = pivot
        R[j][j] = 0.5 * change / pivot
        for i in range(j + 1, n):
            value, change = M[i][j], C[i][j] + C[j][i]
            for k in range(j):
                value -= L[i][k] * L[j][k]
                change -= R[i][k] * L[j][k] + L[i][k] * R[j][k]
            L[i][j] = value / pivot
            R[i][j] = (change - L[i][j] * R[j][j]) / pivot


@equation
def _set_up(arm: Arm) -> None:
    """Set the left side ``(2/h) M + S`` and the right side ``(2/h) L z``, without the terms of joints and hand."""
    n, L, R, A, M, C, gain = arm.n, arm.factor, arm.rate, arm.system, arm.chain.inertia, arm.chain.coriolis, 2.0 / arm.h
    for i in range(n):
        A[i][i] = gain * M[i][i]
        total = 0.0
        for k in range(i + 1):
            total += L[i][k] * arm.z[k]
        arm.torque[i] = gain * total
        for j in range(i):
            one, other = C[i][j], C[j][i]
            for k in range(j + 1):
                one -= L[i][k] * R[j][k]
                other -= L[j][k] * R[i][k]
            skew = 0.5 * (one - other)
            A[i][j], A[j][i] = gain * M[i][j] + skew, gain * M[i][j] - skew


@equation
def _add_joints(arm: Arm) -> None:
    """Add damping, friction, brakes and stops of each joint, with the rates of the previous round."""
    h = arm.h
    for i in range(arm.n):
        w = arm.w[i]
        drag = arm.damping[i]
        if arm.friction[i] > 0.0:
            drag += arm.friction[i] / math.sqrt(w * w + arm.slip[i] * arm.slip[i])
        arm.drag[i] = drag
        arm.system[i][i] += drag
        arm.stop_force[i] = arm.stop_slope[i] = 0.0
        if arm.end[i] > arm.upper[i] or arm.q[i] > arm.upper[i]:
            _meet(arm, i, 1.0, arm.q[i] - arm.upper[i], arm.end[i] - arm.upper[i])
        elif arm.end[i] < arm.lower[i] or arm.q[i] < arm.lower[i]:
            _meet(arm, i, -1.0, arm.lower[i] - arm.q[i], arm.lower[i] - arm.end[i])
        if abs(w) > arm.speed[i]:
            arm.stop_force[i] += arm.brake[i] * (w - math.copysign(arm.speed[i], w))
            arm.stop_slope[i] += arm.brake[i] / h
        arm.system[i][i] += h * arm.stop_slope[i]
        arm.torque[i] -= arm.stop_force[i] - h * arm.stop_slope[i] * w


@equation
def _meet(arm: Arm, i: int, side: float, p0: float, p1: float) -> None:
    """Set a stop's torque against q, and its derivative by the step's end, for depths p0 at the begin and p1 at the end
    [rad]: the discrete gradient of its spring, and a damper that grows with the depth (Hunt and Crossley, J. Applied
    Mechanics 42, 1975), so that the torque never jumps; it never pulls."""
    k, b = arm.stop_stiffness[i], 0.5 * arm.stop_damping[i] / arm.h
    in0, in1 = max(0.0, p0), max(0.0, p1)
    share, slope = 1.0, 0.5 * k
    if p0 <= 0.0 or p1 <= 0.0:
        share = (in1 - in0) / (p1 - p0)
        outside = 1.0 - share
        slope *= share * share if p1 <= 0.0 else 1.0 - outside * outside
    force = (0.5 * k * share + b * (p1 - p0)) * (in0 + in1)
    if force > 0.0:
        slope += b * (in0 + in1 + (p1 - p0 if p1 > 0.0 else 0.0))
        arm.stop_force[i], arm.stop_slope[i] = side * force, max(0.0, slope)


@equation
def _add_forces(arm: Arm) -> None:
    """Add the torques of force, hand and weight."""
    n, columns, h, axes = arm.n, arm.port.columns, arm.h, arm.port.axes
    drag = arm.hand_damping + 0.5 * h * arm.hand_stiffness
    begin = arm.port.begin
    for r in range(axes):
        arm.pull[r] = arm.aim[r] - arm.hand_stiffness * begin[r] + arm.force[r]
    for i in range(n):
        arm.torque[i] += dot(axes, columns[i], arm.pull)
        if not arm.compensated:
            arm.torque[i] -= arm.load[i]
        if drag != 0.0:
            for j in range(n):
                arm.system[i][j] += drag * dot(axes, columns[i], columns[j])


@equation
def _solve(arm: Arm) -> float:
    """Solve for the rates `w` by elimination: the symmetric part is positive definite, so no pivot is small. Returns
    the largest change of an angle at the step's end [rad]."""
    n, A, b = arm.n, arm.system, arm.torque
    for k in range(n):
        for i in range(k + 1, n):
            share = A[i][k] / A[k][k]
            for j in range(k + 1, n):
                A[i][j] -= share * A[k][j]
            b[i] -= share * b[k]
    change = 0.0
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            b[i] -= A[i][j] * b[j]
        b[i] /= A[i][i]
        change = max(change, arm.h * abs(b[i] - arm.w[i]))
    copy(n, b, arm.w)
    for i in range(n):
        arm.middle[i] = arm.q[i] + 0.5 * arm.h * arm.w[i]
        arm.end[i] = arm.q[i] + arm.h * arm.w[i]
    return change


@equation
def step(arm: Arm) -> float:
    """Do a step. `aim` is the part of the hand's force that does not depend on the tip [N]. Returns the hand's work,
    without that of its mass [J]."""
    n, h, chain = arm.n, arm.h, arm.chain
    for i in range(n):
        arm.middle[i] = arm.q[i] + 0.5 * h * arm.w[i]
        arm.end[i] = arm.q[i] + h * arm.w[i]
    settled, rounds = False, 0
    while not settled and rounds < ROUNDS:
        weigh(arm, arm.middle, arm.w)
        _set_up(arm)
        look_at_port(arm, arm.q, arm.end)
        if not arm.compensated:
            gravity(chain, arm.q, arm.end, arm.load)
        _add_joints(arm)
        _add_forces(arm)
        for i in range(n):  # in the solution the stops' torque is linear in the step's end
            arm.begun_w[i] = arm.w[i]
        settled = _solve(arm) <= _STILL
        rounds += 1
    if not settled:
        arm.unsettled += 1
    arm.rounds = max(arm.rounds, rounds)
    for i in range(n):
        force = arm.stop_force[i] + h * arm.stop_slope[i] * (arm.w[i] - arm.begun_w[i])
        arm.spent += h * arm.w[i] * (arm.drag[i] * arm.w[i] + force) - (
            _pressed(arm, i, arm.end[i]) - _pressed(arm, i, arm.q[i])
        )
    for i in range(n - 1, -1, -1):
        total = 0.0
        for k in range(i, n):
            total += arm.factor[k][i] * arm.w[k]
        arm.z[i] = 2.0 * total - arm.z[i]
    look_at_port(arm, arm.q, arm.end)
    if arm.has_limits:
        _compare(arm)
    work, port = 0.0, arm.port
    for r in range(port.axes):
        moved = port.end[r] - port.begin[r]
        rate = arm.hand_damping / h + 0.5 * arm.hand_stiffness
        arm.pull[r] = arm.aim[r] - arm.hand_stiffness * port.begin[r] - rate * moved
        work += arm.pull[r] * moved
    copy(n, arm.end, arm.q)
    return work


@equation
def _compare(arm: Arm) -> None:
    """Update `worst`, the largest share that a motor uses of its limit, less its part of the weight."""
    if arm.compensated:
        gravity(arm.chain, arm.q, arm.end, arm.load)
    for i in range(arm.n):
        room = arm.effort[i] - (abs(arm.load[i]) if arm.compensated else 0.0)
        torque = abs(dot(arm.port.axes, arm.port.columns[i], arm.force))
        if torque > 0.0:
            arm.worst = max(arm.worst, torque / room if room > 0.0 else math.inf)


@equation
def _pressed(arm: Arm, i: int, q: float) -> float:
    """The energy in a joint's stop [J]."""
    beyond = max(0.0, q - arm.upper[i], arm.lower[i] - q)
    return 0.5 * arm.stop_stiffness[i] * beyond * beyond


@equation
def tick(arm: Arm, path: Sequence[Reals], at: int) -> float:
    """Do a tick, while the hand's reference goes from path[at] to the next point [m]. Returns the hand's work [J]."""
    n, axes = arm.n, arm.port.axes
    copy(n, arm.q, arm.begun_q)
    copy(n, arm.z, arm.begun_z)
    copy(axes, arm.v, arm.begun_v)
    copy(n, arm.rates, arm.w)
    share, work, done = 1.0, 0.0, False
    for tried in range(TRIES):
        if not done:
            if tried == TRIES - 1:
                share = 0.0
            for r in range(axes):
                arm.force[r] = share * arm.commanded[r]
            arm.worst = arm.spent = 0.0
            work = _steps(arm, path[at], path[at + 1])
            done = arm.worst <= 1.0
            if not done:
                share *= _WITHIN / arm.worst
                copy(n, arm.begun_q, arm.q)
                copy(n, arm.begun_z, arm.z)
                copy(n, arm.rates, arm.w)
    arm.limited = 1 if share < 1.0 else 0
    arm.lost += arm.spent
    look(arm)
    kick = 0.0
    for r in range(axes):
        kick += (arm.v[r] - arm.begun_v[r]) * (arm.v[r] + arm.begun_v[r])
        arm.hand_force[r] = arm.pull[r] - arm.hand_mass * (arm.v[r] - arm.begun_v[r]) / arm.period
    return work - 0.5 * arm.hand_mass * kick


@equation
def _steps(arm: Arm, begin: Reals, end: Reals) -> float:
    work = 0.0
    for k in range(arm.steps):
        for r in range(arm.port.axes):
            rate = (end[r] - begin[r]) / arm.period
            middle = begin[r] + rate * (k + 0.5) * arm.h
            arm.aim[r] = arm.hand_stiffness * middle + arm.hand_damping * rate
        work += step(arm)
    return work


@equation
def look(arm: Arm) -> None:
    """Compute the port, its velocity, and the joints' rates from the state."""
    n, port, L = arm.n, arm.port, arm.factor
    weigh(arm, arm.q, arm.rates)
    for i in range(n - 1, -1, -1):
        total = arm.z[i]
        for k in range(i + 1, n):
            total -= L[k][i] * arm.rates[k]
        arm.rates[i] = total / L[i][i]
    look_at_port(arm, arm.q, arm.q)
    for r in range(port.axes):
        arm.x[r], arm.v[r] = port.begin[r], 0.0
        for i in range(n):
            arm.v[r] += port.columns[i][r] * arm.rates[i]


@equation
def kinetic(arm: Arm) -> float:
    """The arm's kinetic energy, without that of the hand's mass [J]."""
    return 0.5 * (dot(arm.n, arm.z, arm.z) - arm.hand_mass * dot(arm.port.axes, arm.v, arm.v))


@equation
def potential(arm: Arm) -> float:
    """The energy in the stops, and of the weight if the motors do not carry it [J]."""
    total = 0.0 if arm.compensated else height(arm.chain, arm.q)
    for i in range(arm.n):
        total += _pressed(arm, i, arm.q[i])
    return total
