"""Equations of the local contact model for surfaces with curvature or friction; flat planes have simpler ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hapnet.control import friction_cone
from hapnet.control.contact_equations import (
    Answer,
    ContactState,
    compare,
    compare_with,
    finish,
    forget_forces,
    keep,
    look,
    parallel,
    respond,
    rest,
    use_planes,
)
from hapnet.control.contact_plane import ContactPlane, copy_bent, depth, see_from
from hapnet.control.friction_cone import ROUNDS
from hapnet.control.self_motion import respond_without_planes
from hapnet.records.record import AXES, Floats, Reals, equation
from hapnet.records.vectors import copy, length

SLIP_M = 5e-4
"""A step of a proxy with friction that exceeds the device's travel by more than this is spread over some ticks [m]."""


@equation
def compare_surfaces(model: ContactState, n: int) -> None:
    """Find the shift with which the contact planes agree with the proxy's own position and force."""
    answer, earlier = model.answer, model.planes
    first, count = 0, answer.count
    # friction on one plane may be along the normal of another, and points of one tool share its force
    if (model.rubbing.has_friction or n > AXES) and count > 1:
        touched = 0
        for k in range(answer.count):
            one = answer.planes[k]
            if depth(one, n, answer.position) > 0.0 and (n > AXES or parallel(answer.planes, first, k, n, one) < 0):
                first, touched = k, touched + 1
        if touched > 1:
            model.has_goal = 1
            copy(n, model.shifted, model.goal)
            return
        count = touched
    if model.bends:
        earlier = model.seen
        for k in range(model.count):
            see_from(model.planes[k], n, model.compliance, answer.position, 0.0, model.seen[k])
    compare_with(model, first, count, earlier, n)


@equation
def look_at_surfaces(model: ContactState, n: int, x: Reals) -> None:
    """Find where the proxy rests for the device at x [m], and whether it touches anything there."""
    rubbing, s = model.rubbing, model.s
    if rubbing.has_friction:
        model.touches = int(friction_cone.rest(rubbing, model.planes, n, x, model.shifted, model.age, s))
        return
    forget_forces(model)
    if not model.bends:
        rest(model, model.planes, model.count, n, x)
        return
    # With springs that are alike in all directions, the point of one surface nearest to x is nearest to s too.
    copy(n, x, s)
    for _ in range(1 if model.is_isotropic and model.count == 1 else ROUNDS):
        for i in range(n):
            rubbing.away[i] = s[i] - model.shifted[i]
        for k in range(model.count):
            see_from(model.planes[k], n, model.compliance, rubbing.away, model.age, model.seen[k])
        rest(model, model.seen, model.count, n, x)


@equation
def respond_among_surfaces(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """Compute y among planes of all kinds."""
    rubbing, before, fading = model.rubbing, model.before, model.fading
    friction_cone.agree(rubbing, model.planes, n, dt)
    copy(n, rubbing.place, before)
    look_at_surfaces(model, n, x)
    copy(n, model.s, rubbing.place)
    if rubbing.has_friction and not model.acts and not model.answer.pending:
        for i in range(n):
            before[i] = model.s[i] - before[i] - (x[i] - model.made_x[i])
        if length(n, before) > SLIP_M:  # it has slipped off something round
            for i in range(n):
                fading[i] = fading[i] - before[i]
    finish(model, n, dt, x, y)


@equation
def keep_surface(answer: Answer, one: ContactPlane, n: int, at: int) -> None:
    """Keep an earlier plane with the answer's planes; compiled in place of `keep`."""
    copy_bent(one, n, answer.planes[at])


@equation
def use_surface_planes(model: ContactState, n: int, count: int) -> None:
    """Use the planes of a new answer from now on; compiled in place of `use_planes`."""
    answer, model.bends, model.count = model.answer, 0, count
    for k in range(count):
        copy_bent(answer.planes[k], n, model.planes[k])
        if answer.planes[k].bends.count:
            model.bends = 1
    meet_planes(model, n)


@equation
def meet_planes(model: ContactState, n: int) -> None:
    """Pass the present planes, and the place where the world's proxy touched them, to the proxy with friction.

    The velocity of the world's proxy is in `model.leading`.
    """
    answer, travel = model.answer, length(n, model.leading) * model.age
    touched = False
    for i in range(n):
        touched = touched or answer.force[i] != 0.0
    friction_cone.take_planes(model.rubbing, model.planes, model.count, n, touched, answer.position, travel)


IN_PLACE_OF_FLAT_ONES: dict[Callable[..., Any], Callable[..., Any]] = {
    look: look_at_surfaces, respond: respond_among_surfaces, compare: compare_surfaces, keep: keep_surface,
    use_planes: use_surface_planes,
}  # fmt: skip
"""The functions to compile for surfaces with curvature or friction."""


@equation
def respond_in_any_world(model: ContactState, n: int, dt: float, x: Reals, y: Floats) -> None:
    """Compute y in a world with planes of all kinds, or without planes."""
    if model.reports:
        respond_among_surfaces(model, n, dt, x, y)
    else:
        respond_without_planes(model, n, dt, x, y)


IN_ANY_WORLD = IN_PLACE_OF_FLAT_ONES | {respond: respond_in_any_world}
"""The functions to compile for a device that does not know its world beforehand."""
