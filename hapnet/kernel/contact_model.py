"""The device's local contact model, for a world that tells its planes: `hapnet.control.contact_model`."""

from __future__ import annotations

from typing import Annotated

from hapnet.control import contact_model as reference
from hapnet.control import told_plane
from hapnet.control.added_damping import AddedDamping, damp, wanted
from hapnet.control.smoothing import FilteredVelocity, filter_velocity, low_pass
from hapnet.records.equation import equation
from hapnet.records.record import AXES, PLANES, Floats, MatrixOfAxes, OfAxes, OfPlanes, Record, VectorsOfPlanes
from hapnet.records.vectors import copy, dot, equal, length, times

_FORGET_S, _SETTLED_MPS, _YIELDING_S = reference.FORGET_S, reference.SETTLED_MPS, reference.YIELDING_S
_SAME_M, _SAME_COSINE, _SAME_STIFFNESS = told_plane.SAME_M, told_plane.SAME_COSINE, told_plane.SAME_STIFFNESS
_SWEEPS, _SETTLED_N = reference.SWEEPS, reference.SETTLED_N
_LONGEST_EXTRAPOLATION_S = told_plane.LONGEST_EXTRAPOLATION_S


class Planes(Record):
    """A set of planes as told, with what follows from K': `ToldPlane` of each."""

    count: int
    normal: VectorsOfPlanes
    offset: OfPlanes
    stiffness: OfPlanes
    velocity: OfPlanes
    response: VectorsOfPlanes
    softness: OfPlanes


class ContactModel(Record):
    """The attributes of `ContactModel`.

    in_use : does the device have one? has_wanted : is a shift wanted? has_earlier : is an earlier answer known?
    starts : is this the first step after a reset? pending : the answer that the next step takes is in `told_...`, with
    a reach and a level below 0 where they are not told.
    """

    in_use: int
    compliance: MatrixOfAxes
    lead: MatrixOfAxes
    fade_s: float
    shift_s: float
    yields_below: float
    remembers: int
    kept: float
    kept_goal: float
    shift: OfAxes
    fading: OfAxes
    has_wanted: int
    wanted_shift: OfAxes
    has_earlier: int
    earlier: OfAxes
    earlier_s: float
    age: float
    freedom: float
    starts: int
    start: OfAxes
    pending: int
    told_position: OfAxes
    told_force: OfAxes
    told_sent_s: float
    told_age_s: float
    told_reach_m: float
    told_level: float
    made_x: OfAxes
    made_s: OfAxes
    made_fading: OfAxes
    made_before: OfAxes
    made_y: OfAxes
    touches: int
    s: OfAxes
    before: OfAxes
    leading: OfAxes
    forces: Annotated[Floats, (PLANES,)]


@equation
def step(
    model: ContactModel,
    planes: Planes,
    told: Planes,
    velocity: FilteredVelocity,
    added: AddedDamping,
    n: int,
    dt: float,
    x: Floats,
    y: Floats,
) -> None:
    """`ContactModel.step`: into y."""
    model.age += dt
    if model.starts:
        for i in range(n):
            model.fading[i] = model.start[i] - x[i]
        model.starts = 0
    if model.pending:
        _take(model, planes, told, n, x)
    filter_velocity(velocity, n, dt, x)
    gain = dt / (_YIELDING_S + dt)
    model.kept = model.kept + gain * (model.kept_goal - model.kept)
    times(n, model.lead, velocity.velocity, model.leading)
    for i in range(n):
        model.leading[i] = model.kept * model.leading[i]
    _rest(model, planes, n, x)
    gain = dt / (model.fade_s + dt)
    model.freedom = model.freedom + gain * ((0.0 if model.touches else 1.0) - model.freedom)
    _settle(model, n, dt)
    for i in range(n):
        y[i] = model.s[i] + model.freedom * model.leading[i]
    _fade(model, n, dt, y)
    copy(n, x, model.made_x)
    copy(n, model.s, model.made_s)
    copy(n, model.fading, model.made_fading)
    copy(n, y, model.made_before)
    filter_velocity(added.velocity, n, dt, x)
    damp(added, n, wanted(added, model.age, model.freedom), y)
    copy(n, y, model.made_y)


@equation
def understand(model: ContactModel, told: Planes, n: int) -> None:
    """`_Told`: what follows from K' for the planes that were told."""
    for i in range(told.count):
        times(n, model.compliance, told.normal[i], told.response[i])
        told.softness[i] = 1.0 / told.stiffness[i] + dot(n, told.normal[i], told.response[i])


@equation
def _take(model: ContactModel, planes: Planes, told: Planes, n: int, x: Floats) -> None:
    """`ContactModel._take`: the told planes take the place of the present ones."""
    model.pending = 0
    _rest(model, planes, n, x)
    copy(n, model.s, model.before)
    model.age = model.told_age_s
    level = 1.0 if model.told_level < 0.0 else model.told_level
    model.kept_goal = min(1.0, level / model.yields_below) if model.yields_below else 1.0
    understand(model, told, n)
    _want_shift(model, planes, told, n)
    _remember(model, planes, told, n)
    copy_planes(told, planes)
    _rest(model, planes, n, x)
    if not equal(n, model.s, model.before):
        for i in range(n):
            model.fading[i] = model.fading[i] + (model.before[i] - model.s[i])


@equation
def copy_planes(source: Planes, target: Planes) -> None:
    """Copy a set of planes."""
    target.count = source.count
    for i in range(source.count):
        copy_plane(source, i, target, i)


@equation
def copy_plane(source: Planes, i: int, target: Planes, k: int) -> None:
    """Copy plane i of one set to the place k of another."""
    copy(AXES, source.normal[i], target.normal[k])
    copy(AXES, source.response[i], target.response[k])
    target.offset[k] = source.offset[i]
    target.stiffness[k] = source.stiffness[i]
    target.velocity[k] = source.velocity[i]
    target.softness[k] = source.softness[i]


@equation
def _remember(model: ContactModel, earlier: Planes, told: Planes, n: int) -> None:
    """`ContactModel._remembered`: adds to the told planes."""
    if not model.remembers or model.told_reach_m < 0.0:
        return
    reach_m, count, position = model.told_reach_m, told.count, model.told_position
    if count >= PLANES:
        return
    for j in range(earlier.count):
        if told.count == PLANES:
            return
        depth = dot(n, earlier.normal[j], position) - earlier.offset[j]
        if earlier.velocity[j] or -depth <= reach_m or _among(earlier, j, told, count, n, position):
            continue
        copy_plane(earlier, j, told, told.count)
        told.count += 1


@equation
def _want_shift(model: ContactModel, earlier: Planes, told: Planes, n: int) -> None:
    """`ContactModel._shift_wanted`, with `_proxy_velocity`."""
    moved = model.has_earlier != 0 and model.told_sent_s > model.earlier_s
    span = model.told_sent_s - model.earlier_s
    for i in range(n):
        model.leading[i] = (model.told_position[i] - model.earlier[i]) / span if moved else 0.0
        model.earlier[i] = model.told_position[i]
        model.s[i] = 0.0
    model.earlier_s, model.has_earlier = model.told_sent_s, 1
    known = False
    for i in range(told.count):
        moving = abs(dot(n, told.normal[i], model.leading)) > _SETTLED_MPS
        if moving or not _among(told, i, earlier, earlier.count, n, model.told_position):
            copy(n, model.shift, model.wanted_shift)
            model.has_wanted = 1
            return
        depth = dot(n, told.normal[i], model.told_position) - told.offset[i]
        force = -dot(n, told.normal[i], model.told_force)
        if force > 0.0:
            error = depth - force / told.stiffness[i]
        elif depth > 0.0 and length(n, model.told_force) == 0.0:
            error = depth
        else:
            continue
        known = True
        for axis in range(n):
            model.s[axis] += told.normal[i][axis] * error
    model.has_wanted = 1 if known else 0
    copy(n, model.s, model.wanted_shift)


@equation
def _among(one: Planes, i: int, others: Planes, count: int, n: int, position: Floats) -> bool:
    """Is plane i the same surface as any of the first `count` others?"""
    found = False
    for j in range(count):
        found = found or _same(one, i, others, j, n, position)
    return found


@equation
def _same(one: Planes, i: int, other: Planes, j: int, n: int, position: Floats) -> bool:
    """`ToldPlane.same`."""
    here = dot(n, one.normal[i], position) - one.offset[i]
    apart = here - (dot(n, other.normal[j], position) - other.offset[j])
    alike = 1.0 / _SAME_STIFFNESS < one.stiffness[i] / other.stiffness[j] < _SAME_STIFFNESS
    return alike and abs(apart) < _SAME_M and dot(n, one.normal[i], other.normal[j]) > _SAME_COSINE


@equation
def _settle(model: ContactModel, n: int, dt: float) -> None:
    """`ContactModel._settle`."""
    if not model.has_wanted:
        for i in range(n):
            model.wanted_shift[i] = 0.0
    if not equal(n, model.wanted_shift, model.shift):
        low_pass(n, dt, model.shift_s if model.has_wanted else _FORGET_S, model.shift, model.wanted_shift)


@equation
def _rest(model: ContactModel, planes: Planes, n: int, x: Floats) -> None:
    """`ContactModel._rest`: where the proxy rests into `model.s`, and whether it touches anything there."""
    s, forces = model.s, model.forces
    copy(n, x, s)
    model.touches = 0
    if planes.count == 1:
        depth = _depth(model, planes, 0, n, x)
        if depth > 0.0:
            force = depth / planes.softness[0]
            for i in range(n):
                s[i] = x[i] - force * planes.response[0][i]
            model.touches = 1
        return
    for k in range(planes.count):
        forces[k] = 0.0
    for _ in range(_SWEEPS):
        moved = False
        for k in range(planes.count):
            depth = _depth(model, planes, k, n, s)
            force = max(0.0, forces[k] + (depth - forces[k] / planes.stiffness[k]) / planes.softness[k])
            if force != forces[k]:
                change = force - forces[k]
                forces[k] = force
                for i in range(n):
                    s[i] = s[i] - change * planes.response[k][i]
                moved = moved or abs(change) > _SETTLED_N
        if not moved:
            break
    for k in range(planes.count):
        if forces[k] != 0.0:
            model.touches = 1


@equation
def _depth(model: ContactModel, planes: Planes, k: int, n: int, place: Floats) -> float:
    """How deep `place` is behind plane k as it is now [m]."""
    along = 0.0
    for i in range(n):
        along += planes.normal[k][i] * (place[i] - model.shift[i])
    if planes.velocity[k] == 0.0:
        return along - float(planes.offset[k])
    ahead = min(max(model.age, 0.0), _LONGEST_EXTRAPOLATION_S)
    return along - float(planes.offset[k] + planes.velocity[k] * ahead)


@equation
def _fade(model: ContactModel, n: int, dt: float, y: Floats) -> None:
    """`ContactModel._faded`: adds to y what is left of a change of planes."""
    if length(n, model.fading) == 0.0:
        return
    share = model.fade_s / (model.fade_s + dt)
    for i in range(n):
        model.fading[i] = share * model.fading[i]
        y[i] = y[i] + model.fading[i]
    if not length(n, model.fading) > 1e-9:
        for i in range(n):
            model.fading[i] = 0.0
