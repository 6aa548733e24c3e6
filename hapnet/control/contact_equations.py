"""The equations of the device's local contact model, and their state; contact_model.py says what they are for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.control.added_damping import AddedDamping, damp, wanted
from hapnet.control.contact_plane import ContactPlane, among, depth, now
from hapnet.control.smoothing import FilteredVelocity, filter_velocity, low_pass
from hapnet.records.equation import equation
from hapnet.records.record import PLANES, Floats, MatrixOfAxes, OfAxes, OfPlanes, Reals, Record
from hapnet.records.vectors import copy, dot, equal, length, times

FORGET_S = 0.5
"""Time constant with which that shift goes when there is no contact [s]."""

SETTLED_MPS = 0.02
"""A proxy that moves faster along a normal says nothing about the plane [m/s]: its force is the mean over a step, its
position the step's end. In contact it moves seven times slower than the hand, with the default springs."""

SWEEPS = 32
"""The most Gauss-Seidel sweeps over the planes. Orthogonal ones need one, and one more to see it."""

SETTLED_N = 1e-4
"""A sweep that changes no force by more than this [N] is the last."""

YIELDING_S = 0.3
"""Time constant with which the lead follows the level of the world's reservoir [s]: the hand must not notice."""


class ContactState(Record):
    """What the contact model knows of the world, and its filters.

    Attributes
    ----------
    planes : those that are known, `count` of them. shifted : by how much all are moved [m]; goal : the shift that the
        last answer asks for, if it `has_goal`. age : of that answer [s].
    kept, kept_goal : the share of the lead that has not yielded, and where that goes.
    freedom : 1 in free motion, 0 in contact. fading : what is left of a change of planes [m].
    earlier, earlier_s : the proxy's position in the answer before [m], and when it was sent [s]; `has_earlier`.
    start : where y begins [m], at the first step after a reset (`starts`).
    made_x, made_s, made_fading, made_before, made_y : of the last step: x, s, fading, y without and with damping [m].
    s, touches : where the proxy rests [m], and whether it touches anything. forces : of the planes there [N].
    leading, before : room for vectors. in_use : always, but for the records of compiled code.
    """

    in_use: int
    compliance: MatrixOfAxes
    lead: MatrixOfAxes
    velocity: FilteredVelocity
    added: AddedDamping
    fade_s: float
    shift_s: float
    yields_below: float
    remembers: int
    count: int
    planes: Annotated[Sequence[ContactPlane], (PLANES,)]
    shifted: OfAxes
    has_goal: int
    goal: OfAxes
    age: float
    kept: float
    kept_goal: float
    freedom: float
    fading: OfAxes
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


@equation
def begin(model: ContactState, n: int, dt: float, x: Reals) -> None:
    """A step of `dt` seconds begins, at x [m]."""
    model.age += dt
    if model.starts:
        for i in range(n):
            model.fading[i] = model.start[i] - x[i]
        model.starts = 0


@equation
def take_lead(model: ContactState, n: int, dt: float, x: Reals) -> None:
    """By how much y leads in free motion, into `model.leading`."""
    filter_velocity(model.velocity, n, dt, x)
    model.kept = model.kept + dt / (YIELDING_S + dt) * (model.kept_goal - model.kept)
    times(n, model.lead, model.velocity.velocity, model.leading)
    for i in range(n):
        model.leading[i] = model.kept * model.leading[i]


@equation
def go_on(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """The rest of a step among flat planes, once what came is known: y."""
    take_lead(model, n, dt, x)
    forget_forces(model, model.count)
    rest(model, model.planes, model.count, n, x)
    answer(model, n, dt, x, y)


@equation
def answer(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """y, for the place where the proxy rests."""
    model.freedom = model.freedom + dt / (model.fade_s + dt) * ((0.0 if model.touches else 1.0) - model.freedom)
    _settle(model, n, dt)
    for i in range(n):
        y[i] = model.s[i] + model.freedom * model.leading[i]
    fade(model, n, dt, y)
    copy(n, x, model.made_x)
    copy(n, model.s, model.made_s)
    copy(n, model.fading, model.made_fading)
    copy(n, y, model.made_before)
    filter_velocity(model.added.velocity, n, dt, x)
    damp(model.added, n, wanted(model.added, model.age, model.freedom), y)
    copy(n, y, model.made_y)


@equation
def yield_to(model: ContactState, level: float) -> None:
    """The world's reservoir has this level; below 0: it does not report one."""
    reported = 1.0 if level < 0.0 else level
    model.kept_goal = min(1.0, reported / model.yields_below) if model.yields_below > 0.0 else 1.0


@equation
def follow_proxy(model: ContactState, n: int, position: Reals, sent_s: float) -> None:
    """The proxy's velocity since the answer before, into `model.leading` [m/s]; zero with the first."""
    moved = model.has_earlier != 0 and sent_s > model.earlier_s
    span = sent_s - model.earlier_s
    for i in range(n):
        model.leading[i] = (position[i] - model.earlier[i]) / span if moved else 0.0
        model.earlier[i] = position[i]
    model.earlier_s, model.has_earlier = sent_s, 1


@equation
def want_shift(
    model: ContactState, reported: Sequence[ContactPlane], count: int, earlier: Sequence[ContactPlane],
    earlier_count: int, n: int, position: Reals, force: Reals,
) -> None:  # fmt: skip
    """The shift with which the contact planes agree with the proxy's own position and force; if nothing is known, none.

    The force is of the step that has ended, so a plane that was not there before it proves nothing yet. The proxy's
    velocity is in `model.leading`.
    """
    for i in range(n):
        model.before[i] = 0.0
    known = False
    for k in range(count):
        one = reported[k]
        moving = abs(dot(n, one.normal, model.leading)) > SETTLED_MPS
        if moving or not among(one, earlier, earlier_count, n, position):
            copy(n, model.shifted, model.goal)
            model.has_goal = 1
            return
        deep = depth(one, n, position)
        push = -dot(n, one.normal, force)
        if push > 0.0:
            error = deep - push / one.stiffness  # the plane is really so much deeper
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
def _settle(model: ContactState, n: int, dt: float) -> None:
    """Let the shift approach what the last answer asks for."""
    if not model.has_goal:
        for i in range(n):
            model.goal[i] = 0.0
    if not equal(n, model.goal, model.shifted):
        low_pass(n, dt, model.shift_s if model.has_goal else FORGET_S, model.shifted, model.goal)


@equation
def forget_forces(model: ContactState, count: int) -> None:
    """Let `rest` begin from nothing."""
    for k in range(count):
        model.forces[k] = 0.0


@equation
def rest(model: ContactState, planes: Sequence[ContactPlane], count: int, n: int, x: Reals) -> None:
    """Where the proxy rests on flat planes, into `model.s`; from the forces that were found before."""
    s, forces = model.s, model.forces
    copy(n, x, s)
    model.touches = 0
    if count == 1:  # mostly
        one = planes[0]
        deep = _depth_now(model, one, n, x)
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
            deep = _depth_now(model, one, n, s)
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
def _depth_now(model: ContactState, one: ContactPlane, n: int, place: Reals) -> float:
    """How deep `place` is behind a plane as it is now [m]."""
    along = 0.0
    for i in range(n):
        along += one.normal[i] * (place[i] - model.shifted[i])
    return along - now(one, model.age)


@equation
def fade(model: ContactState, n: int, dt: float, y: Floats) -> None:
    """Add to y what is left of a change of planes."""
    if length(n, model.fading) == 0.0:
        return
    share = model.fade_s / (model.fade_s + dt)
    for i in range(n):
        model.fading[i] = share * model.fading[i]
        y[i] = y[i] + model.fading[i]
    if not length(n, model.fading) > 1e-9:
        for i in range(n):
            model.fading[i] = 0.0
