"""The equations of the device's local contact model, and their state; contact_model.py explains the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from hapnet.checks import Vector
from hapnet.control.added_damping import AddedDamping, damp, wanted
from hapnet.control.contact_plane import ContactPlane, among, copy_flat, depth, most_known, now, withdrawn
from hapnet.control.friction_cone import RubbingProxy
from hapnet.control.plane_changes import follow_change
from hapnet.control.self_motion import SelfMotion
from hapnet.control.smoothing import FilteredVelocity, filter_velocity, low_pass
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.record import PLANES, Floats, MatrixOfAxes, OfAxes, OfPlanes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy, dot, equal, length, times

FORGET_S = 0.5
"""Time constant with which the planes' shift fades without contact [s]."""

SETTLED_MPS = 0.005
"""If the proxy moves faster along a normal [m/s], its force does not locate the plane: a wall's damper takes a part of
it, 17 um of depth at this speed in the default wall. With the default springs the proxy is seven times slower than the
hand in contact."""

SWEEPS = 32
"""The most Gauss-Seidel sweeps over the planes. Orthogonal planes need two; the second finds no change."""

SETTLED_N = 1e-4
"""A sweep that changes no force by more than this [N] is the last."""

PARALLEL = 1.0 - 1e-9
"""If the cosine between the normals of two planes is larger, they act as parallel springs."""

YIELDING_S = 3.0
"""Time constant with which the lead follows the level of the world's reservoir in free motion [s]."""


class Answer(Record):
    """The world's newest answer: its proxy's position and force, and `count` planes; below 0: it cannot send planes.

    pending : whether the next step must take it in. sent_s : time of sending [s]; age_s : its age on arrival [s].
    reach_m, level : as in `ProxySample`; below 0: not sent. before : y from the planes before, without lead and fading
    [m].
    """

    pending: int
    position: OfAxes
    force: OfAxes
    sent_s: float
    age_s: float
    reach_m: float
    level: float
    count: int
    planes: Annotated[Sequence[ContactPlane], (PLANES,)]
    before: OfAxes


class ContactState(Record):
    """The state of the contact model: the known planes, and its filters.

    Attributes
    ----------
    planes : the known planes, `count` of them. shifted : the displacement of all planes [m]; goal : the displacement
        that the last answer implies, if it `has_goal`. age : of that answer [s].
    kept, kept_goal : the share of the lead in use, and the value that it approaches. reports : whether the world sends
        planes; own, share_without_planes : for a world that does not, see `respond_without_planes`.
    freedom : 1 in free motion, 0 in contact. fading : the remaining compensation of a change of planes [m].
    lent_J : the energy that changes of a tool's planes have taken out of the spring, see plane_changes.py [J].
    earlier, earlier_s : the proxy's position in the answer before [m], and its time of sending [s]; `has_earlier`.
    start : y at the first step after a reset [m] (`starts`).
    bends : whether any plane has curvatures. seen : the tangent planes. rubbing : the proxy, if any plane has friction.
    acts : whether any surface has effects.
    is_isotropic : whether the springs have the same stiffness in all directions.
    made_x, made_s, made_fading, made_before, made_y : in the last step: x, s, fading, y without and with damping [m].
    s, touches : where the proxy rests [m], and whether it touches anything. forces : of the planes there [N].
    leading, before : temporary memory for vectors. in_use : always 1, except in unused records of compiled code.
    """

    in_use: int
    compliance: MatrixOfAxes
    lead: MatrixOfAxes
    velocity: FilteredVelocity
    added: AddedDamping
    own: SelfMotion
    share_without_planes: float
    reports: int
    fade_s: float
    shift_s: float
    yields_below: float
    remembers: int
    count: int
    planes: Annotated[Sequence[ContactPlane], (PLANES,)]
    seen: Annotated[Sequence[ContactPlane], (PLANES,)]
    bends: int
    acts: int
    rubbing: RubbingProxy
    is_isotropic: int
    shifted: OfAxes
    has_goal: int
    goal: OfAxes
    age: float
    kept: float
    kept_goal: float
    freedom: float
    fading: OfAxes
    lent_J: float
    has_earlier: int
    earlier: OfAxes
    earlier_s: float
    starts: int
    start: OfAxes
    made_x: OfAxes
    made_s: OfAxes
    made_fading: OfAxes
    made_before: OfAxes
    made_y: OfAxes
    s: OfAxes
    touches: int
    forces: OfPlanes
    leading: OfAxes
    before: OfAxes
    answer: Answer

    # The parts of a step that Python overrides. Compiled code uses those for flat planes, or for surfaces.

    def respond(self, n: int, dt: float, x: Vector, y: Floats) -> None:
        """Compute y, after the lead."""
        raise NotImplementedError

    def look(self, n: int, x: Vector) -> None:
        """Compute y from the known planes, without lead and fading, into `s` [m]."""
        raise NotImplementedError

    def compare(self, n: int) -> None:
        """Find the shift that the answer implies."""
        raise NotImplementedError

    def use_planes(self, n: int, count: int) -> None:
        """Use the planes of a new answer from now on; count : of its planes and the earlier planes that are kept."""
        raise NotImplementedError


@equation
def step(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """y [m] at the position x [m], `dt` seconds after the last step."""
    model.age += dt
    if model.starts:
        for i in range(n):
            model.fading[i] = model.start[i] - x[i]
        model.starts = 0
    if model.answer.pending:
        _take(model, n, x)
    _take_lead(model, n, dt, x)
    respond(model, n, dt, x, y)
    model.answer.pending = 0


@equation
def _take(model: ContactState, n: int, x: Reals) -> None:
    """Take in the answer. y does not jump: the difference fades."""
    answer = model.answer
    look(model, n, x)
    copy(n, model.s, answer.before)
    model.age = answer.age_s
    level = 1.0 if answer.level < 0.0 else answer.level
    model.kept_goal = min(1.0, level / model.yields_below) if model.yields_below > 0.0 else 1.0
    count = answer.count
    if count >= 0:
        _follow_proxy(model, n, answer.position, answer.sent_s)
        compare(model, n)
        copy(n, answer.position, model.earlier)
    if count >= 0 and model.remembers and answer.reach_m >= 0.0:
        for j in range(model.count):
            one = model.planes[j]
            is_withdrawn = withdrawn(one, answer.planes, answer.count, n, answer.position, answer.reach_m)
            if count < most_known(n) and not is_withdrawn:
                keep(answer, one, n, count)
                count += 1
    use_planes(model, n, count)
    look(model, n, x)
    if not equal(n, model.s, answer.before):
        for i in range(n):
            model.fading[i] = model.fading[i] + (answer.before[i] - model.s[i])


def _compiled_respond(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    look(model, n, x)
    finish(model, n, dt, x, y)


@compiled_as(_compiled_respond)
def respond(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    model.respond(n, dt, tuple(x), y)


def _compiled_look(model: ContactState, n: int, x: Reals) -> None:
    forget_forces(model)
    rest(model, model.planes, model.count, n, x)


@compiled_as(_compiled_look)
def look(model: ContactState, n: int, x: Reals) -> None:
    """Compute y from the known planes, without lead and fading: `ContactState.look`."""
    model.look(n, tuple(x))


def _compiled_compare(model: ContactState, n: int) -> None:
    compare_with(model, 0, model.answer.count, model.planes, n)


@compiled_as(_compiled_compare)
def compare(model: ContactState, n: int) -> None:
    model.compare(n)


def _compiled_keep(answer: Answer, one: ContactPlane, n: int, at: int) -> None:
    copy_flat(one, n, answer.planes[at])


@compiled_as(_compiled_keep)
def keep(answer: Answer, one: ContactPlane, n: int, at: int) -> None:
    """Keep an earlier plane, which the answer neither contains nor rules out, with the answer's planes."""
    planes: Any = answer.planes
    planes.append(one)


def _compiled_use_planes(model: ContactState, n: int, count: int) -> None:
    for k in range(count):
        copy_flat(model.answer.planes[k], n, model.planes[k])
    model.count = count


@compiled_as(_compiled_use_planes)
def use_planes(model: ContactState, n: int, count: int) -> None:
    """Use the planes of a new answer from now on: `ContactState.use_planes`."""
    model.use_planes(n, count)


@equation
def _take_lead(model: ContactState, n: int, dt: float, x: Reals) -> None:
    """Compute the lead of y in free motion, into `model.leading`."""
    filter_velocity(model.velocity, n, dt, x)
    model.kept += (0.0 if model.touches else dt / (YIELDING_S + dt)) * (model.kept_goal - model.kept)
    times(n, model.lead, model.velocity.velocity, model.leading)
    for i in range(n):
        model.leading[i] = model.kept * model.leading[i]


@equation
def finish(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """Compute y from the place where the proxy rests."""
    model.freedom = model.freedom + dt / (model.fade_s + dt) * ((0.0 if model.touches else 1.0) - model.freedom)
    _settle(model, n, dt)
    for i in range(n):
        y[i] = model.s[i] + model.freedom * model.leading[i]
    follow_change(model, n, dt, x, y)
    copy(n, x, model.made_x)
    copy(n, model.s, model.made_s)
    copy(n, model.fading, model.made_fading)
    copy(n, y, model.made_before)
    filter_velocity(model.added.velocity, n, dt, x)
    damp(model.added, n, wanted(model.added, model.age, model.freedom), y)
    copy(n, y, model.made_y)


@equation
def _follow_proxy(model: ContactState, n: int, position: Reals, sent_s: float) -> None:
    """Compute the proxy's velocity since the answer before, into `model.leading` [m/s]; zero for the first answer.

    `model.earlier` becomes the middle of its way, where the mean force of its step holds.
    """
    moved = model.has_earlier != 0 and sent_s > model.earlier_s
    span = sent_s - model.earlier_s
    for i in range(n):
        way = position[i] - model.earlier[i] if moved else 0.0
        model.leading[i] = way / span if moved else 0.0
        model.earlier[i] = position[i] - way / 2.0
    model.earlier_s, model.has_earlier = sent_s, 1


@equation
def compare_with(model: ContactState, first: int, count: int, earlier: Sequence[ContactPlane], n: int) -> None:
    """Find the shift with which the contact planes agree with the proxy's own position and force, if these suffice.

    The force is the mean of the completed step, so it belongs to the middle of the proxy's way, `model.earlier`. A
    plane that is new since then, or that the proxy has begun or ceased to touch on this way, cannot be compared. The
    proxy's velocity is in `model.leading`. first, count : of the answer's planes; earlier : the planes known before.
    """
    position, middle, force = model.answer.position, model.earlier, model.answer.force
    for i in range(n):
        model.before[i] = 0.0
    known, deepest = False, -1.0  # farther planes are not sent
    for k in range(first, first + count):
        deepest = max(deepest, depth(model.answer.planes[k], n, middle))
    for k in range(first, first + count):
        one = model.answer.planes[k]
        if parallel(model.answer.planes, first, k, n, one) >= 0:
            continue
        deep, end = depth(one, n, middle), depth(one, n, position)
        moving = abs(dot(n, one.normal, model.leading)) > SETTLED_MPS or (2.0 * deep > end) != (end > 0.0)
        if moving or not among(one, earlier, model.count, n, position):
            copy(n, model.shifted, model.goal)
            model.has_goal = 1
            return
        push = -dot(n, one.normal, force)
        if deep <= 0.0 and deep < deepest:
            continue  # the force is that of other planes
        if push > 0.0:
            stiffness = one.stiffness
            for j in range(model.answer.count):
                other = model.answer.planes[j]
                along, behind = dot(n, other.normal, one.normal), max(0.0, depth(other, n, middle))
                if j != k and behind > 0.0 and along > PARALLEL:
                    stiffness += other.stiffness
                    push -= other.stiffness * (behind - deep)
                elif j != k:
                    push -= other.stiffness * behind * along
            error = deep - push / stiffness  # the true planes are deeper by this
        elif deep > 0.0 and length(n, force) == 0.0:
            error = deep
        else:
            continue
        known = True
        for axis in range(n):
            model.before[axis] += one.normal[axis] * error
    model.has_goal = 1 if known else 0
    copy(n, model.before, model.goal)


@equation
def parallel(planes: Sequence[ContactPlane], first: int, stop: int, n: int, one: ContactPlane) -> int:
    """The index of the first of these planes that is parallel to `one`; -1: there is none."""
    for j in range(first, stop):
        if dot(n, planes[j].normal, one.normal) > PARALLEL:
            return j
    return -1


@equation
def _settle(model: ContactState, n: int, dt: float) -> None:
    """Let the shift approach the last answer's goal."""
    if not model.has_goal:
        for i in range(n):
            model.goal[i] = 0.0
    if not equal(n, model.goal, model.shifted):
        low_pass(n, dt, model.shift_s if model.has_goal else FORGET_S, model.shifted, model.goal)


@equation
def forget_forces(model: ContactState) -> None:
    """Let `rest` begin from zero forces."""
    for k in range(model.count):
        model.forces[k] = 0.0


@equation
def rest(model: ContactState, planes: Sequence[ContactPlane], count: int, n: int, x: Reals) -> None:
    """Compute where the proxy rests on flat planes, into `model.s`, starting from the forces of the last call."""
    s, forces = model.s, model.forces
    copy(n, x, s)
    model.touches = 0
    if count == 1:  # mostly
        one = planes[0]
        deep = depth_now(model, one, n, x)
        if deep > 0.0:
            force = deep / one.softness
            for i in range(n):
                s[i] = x[i] - force * one.response[i]
            model.touches = 1
        return
    for k in range(count):
        if forces[k] != 0.0:
            for i in range(n):
                s[i] = s[i] + -forces[k] * planes[k].response[i]
    for _ in range(SWEEPS):
        moved = False
        for k in range(count):
            one = planes[k]
            deep = depth_now(model, one, n, s)
            force = max(0.0, forces[k] + (deep - forces[k] / one.stiffness) / one.softness)
            if force != forces[k]:
                change = force - forces[k]
                forces[k] = force
                for i in range(n):
                    s[i] = s[i] - change * one.response[i]
                moved = moved or abs(change) > SETTLED_N
        if not moved:
            break
    for k in range(count):
        if forces[k] != 0.0:
            model.touches = 1


@equation
def depth_now(model: ContactState, one: ContactPlane, n: int, place: Reals) -> float:
    """The depth of `place` behind a plane in its present position [m]."""
    along = 0.0
    for i in range(n):
        along += one.normal[i] * (place[i] - model.shifted[i])
    return along - (now(one, model.age) - one.raised)


@equation
def share(model: ContactState, spring: Spring, x: Reals, ybar: Reals, of_planes: Floats, added: Floats) -> None:
    """The parts of the spring's force at x [N] from the planes and from the added damping of the last step; if the
    spring is saturated, its parts are scaled with it."""
    n, moved, damped = spring.dof, model.before, model.leading
    for i in range(n):
        moved[i] = x[i] - ybar[i]
    scale = springs.saturation(spring, moved)
    for i in range(n):
        moved[i] = model.made_s[i] - model.made_x[i] + model.made_fading[i]
        damped[i] = model.made_y[i] - model.made_before[i]
    times(n, spring.rows, moved, of_planes)
    times(n, spring.rows, damped, added)
    for i in range(n):
        of_planes[i], added[i] = scale * of_planes[i], scale * added[i]
