"""A step of the device's local contact model, for a world whose planes are flat and smooth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.control import contact_equations as equations
from hapnet.control.contact_equations import ContactState
from hapnet.control.contact_plane import ContactPlane, understand, withdrawn
from hapnet.records.equation import equation
from hapnet.records.record import AXES, PLANES, Floats, OfAxes, Record
from hapnet.records.vectors import copy, equal


class Answer(Record):
    """The world's answer that the next step takes, if it is `pending`. A reach or level below 0 is not known."""

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


@equation
def step(model: ContactState, reported: Answer, n: int, dt: float, x: Floats, y: Floats) -> None:
    """`ContactModel.step`: into y."""
    equations.begin(model, n, dt, x)
    if reported.pending:
        _take(model, reported, n, x)
    equations.go_on(model, n, dt, x, y)


@equation
def _rest(model: ContactState, n: int, x: Floats) -> None:
    """`ContactModel._rest`."""
    equations.forget_forces(model, model.count)
    equations.rest(model, model.planes, model.count, n, x)


@equation
def _take(model: ContactState, reported: Answer, n: int, x: Floats) -> None:
    """`ContactModel._take`."""
    reported.pending = 0
    _rest(model, n, x)
    copy(n, model.s, reported.before)
    model.age = reported.age_s
    equations.yield_to(model, reported.level)
    for k in range(reported.count):
        understand(reported.planes[k], n, model.compliance)
    equations.follow_proxy(model, n, reported.position, reported.sent_s)
    equations.want_shift(
        model, reported.planes, reported.count, model.planes, model.count, n, reported.position, reported.force
    )
    _know(model, reported, n)
    _rest(model, n, x)
    if not equal(n, model.s, reported.before):
        for i in range(n):
            model.fading[i] = model.fading[i] + (reported.before[i] - model.s[i])


@equation
def _know(model: ContactState, reported: Answer, n: int) -> None:
    """`ContactModel._know`, of the contact planes and the remembered ones."""
    count = reported.count
    if model.remembers and reported.reach_m >= 0.0:
        for j in range(model.count):
            one = model.planes[j]
            if count < PLANES and not withdrawn(
                one, reported.planes, reported.count, n, reported.position, reported.reach_m
            ):
                _copy(one, reported.planes[count])
                count += 1
    for k in range(count):
        _copy(reported.planes[k], model.planes[k])
    model.count = count


@equation
def _copy(source: ContactPlane, target: ContactPlane) -> None:
    """Copy a plane."""
    copy(AXES, source.normal, target.normal)
    copy(AXES, source.response, target.response)
    target.offset, target.stiffness = source.offset, source.stiffness
    target.velocity, target.softness = source.velocity, source.softness
