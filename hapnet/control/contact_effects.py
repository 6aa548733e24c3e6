"""Effects of the surfaces in the local contact model: they move y, so PSPM pays for them as for any other y.

    w_k = w - h(place)          the grain lifts the plane at the proxy
    y += K'^-1 F_snap(gap) n    attraction in front of the surface
    y -= K'^-1 c v_t            drag along a touched surface, v_t perpendicular to its normal

Sticking is in `hapnet.control.friction_cone`. Each tick of the servo computes the effects, independently of the link
and the world's step. All forces act on the proxy: the hand feels K K'^-1 of them, as of any contact.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.contact_equations import ContactState, depth_now
from hapnet.mechanics.spring import Spring
from hapnet.records.record import Floats, Reals
from hapnet.records.vectors import dot, inner, times

FULL_DRAG_M = 5e-4
"""The device's depth at which the drag reaches its full value [m], so that it does not begin or end with a jump."""


def lift(model: ContactState, x: Reals) -> None:
    """Lift each plane by its grain's height at the proxy: at its last place if a plane has friction, else at x [m]."""
    place = model.rubbing.place if model.rubbing.has_friction else x
    for plane in model.planes:
        grain = plane.effects and plane.effects.grain
        plane.raised = grain.at(place) if grain else 0.0


def pull(model: ContactState, n: int, x: Reals) -> tuple[Floats, Floats]:
    """Return the part of y from attraction and drag, and the part of y - x from grains [m]; `model.s` is the proxy's
    resting place.
    """
    moved, by_grain, v = [0.0] * n, [0.0] * n, model.velocity.velocity
    seen = model.rubbing.seen if model.rubbing.has_friction else model.seen if model.bends else model.planes
    for surface, plane in zip(model.planes, seen, strict=False):  # the surface, and its tangent plane at the proxy
        if (effects := surface.effects) is None:
            continue
        push = effects.attraction(-depth_now(model, plane, n, x))
        for i in range(n):
            moved[i] += push * plane.response[i]
        deep = depth_now(model, plane, n, model.s)
        if deep > 0.0:
            deep *= plane.stiffness * plane.softness  # the device's
            for i in range(n):
                by_grain[i] -= surface.raised / plane.softness * plane.response[i]
        # The depth without the grain, so that the drag does not change with each wave.
        c = effects.viscosity * min(max(0.0, deep - surface.raised) / FULL_DRAG_M, 1.0)
        along, drag = dot(n, v, plane.normal), [0.0] * n
        times(n, model.compliance, [c * (v[i] - along * plane.normal[i]) for i in range(n)], drag)
        for i in range(n):
            moved[i] -= drag[i]
    return moved, by_grain


def act(model: ContactState, n: int, x: Reals, y: Floats) -> Vector:
    """Add attraction and drag to y [m]. Returns the part of y - x from grains."""
    moved, by_grain = pull(model, n, x)
    for target in (y, model.made_s, model.made_before, model.made_y):
        for i in range(n):
            target[i] += moved[i]
    return tuple(by_grain)


def grain_force(model: ContactState, by_grain: Vector, spring: Spring) -> Vector:
    """The part of the spring's force from grains [N]; zero if no surface has effects."""
    return tuple([inner(row, by_grain) for row in spring.rows]) if model.acts else (0.0,) * spring.dof
