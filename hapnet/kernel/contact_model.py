"""A step of the device's local contact model, for a world whose planes are flat and smooth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.control import contact_equations as equations
from hapnet.control.contact_equations import ContactState
from hapnet.control.told_plane import ToldPlane, understand, withdrawn
from hapnet.records.equation import equation
from hapnet.records.record import AXES, PLANES, Floats, OfAxes, Record
from hapnet.records.vectors import copy, equal


class Answer(Record):
    """The world's answer that the next step takes, if it is `pending`. A reach or level below 0 is not told."""

    pending: int
    position: OfAxes
    force: OfAxes
    sent_s: float
    age_s: float
    reach_m: float
    level: float
    count: int
    planes: Annotated[Sequence[ToldPlane], (PLANES,)]
    before: OfAxes


@equation
def step(model: ContactState, told: Answer, n: int, dt: float, x: Floats, y: Floats) -> None:
    """`ContactModel.step`: into y."""
    equations.begin(model, n, dt, x)
    if told.pending:
        _take(model, told, n, x)
    equations.take_lead(model, n, dt, x)
    _rest(model, n, x)
    equations.answer(model, n, dt, x, y)


@equation
def _rest(model: ContactState, n: int, x: Floats) -> None:
    """`ContactModel._rest`."""
    equations.forget_forces(model, model.count)
    equations.rest(model, model.planes, model.count, n, x)


@equation
def _take(model: ContactState, told: Answer, n: int, x: Floats) -> None:
    """`ContactModel._take`."""
    told.pending = 0
    _rest(model, n, x)
    copy(n, model.s, told.before)
    model.age = told.age_s
    equations.yield_to(model, told.level)
    for k in range(told.count):
        understand(told.planes[k], n, model.compliance)
    equations.follow_proxy(model, n, told.position, told.sent_s)
    equations.want_shift(model, told.planes, told.count, model.planes, model.count, n, told.position, told.force)
    _know(model, told, n)
    _rest(model, n, x)
    if not equal(n, model.s, told.before):
        for i in range(n):
            model.fading[i] = model.fading[i] + (told.before[i] - model.s[i])


@equation
def _know(model: ContactState, told: Answer, n: int) -> None:
    """`ContactModel._know`, of the told planes and the remembered ones."""
    count = told.count
    if model.remembers and told.reach_m >= 0.0:
        for j in range(model.count):
            one = model.planes[j]
            if count < PLANES and not withdrawn(one, told.planes, told.count, n, told.position, told.reach_m):
                _copy(one, told.planes[count])
                count += 1
    for k in range(count):
        _copy(told.planes[k], model.planes[k])
    model.count = count


@equation
def _copy(source: ToldPlane, target: ToldPlane) -> None:
    """Copy a plane."""
    copy(AXES, source.normal, target.normal)
    copy(AXES, source.response, target.response)
    target.offset, target.stiffness = source.offset, source.stiffness
    target.velocity, target.softness = source.velocity, source.softness
