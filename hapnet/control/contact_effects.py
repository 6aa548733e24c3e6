"""Effects of the surfaces that the local contact model knows: they move y, so PSPM pays for them as for any other y.

    w_k = w - h(place)          the grain lifts the plane where the proxy is
    y += K'^-1 F_snap(gap) n    attraction before the surface
    y -= K'^-1 c v_t            drag along a surface that is touched, v_t across its normal

Sticking is in `hapnet.control.friction_cone`. Each tick of the servo makes them anew, whatever the link and the world's
step are. All forces are the proxy's: the hand feels K K'^-1 of them, as of any contact.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.contact_equations import ContactState, depth_now
from hapnet.mechanics.spring import Spring
from hapnet.records.record import Floats, Reals
from hapnet.records.vectors import dot, inner, times

FULL_DRAG_M = 5e-4
"""From this depth of the device the drag is whole [m]: it neither begins nor ends with a jump."""


def lift(model: ContactState, x: Reals) -> None:
    """Each plane is as high as its grain: where the proxy rested before if that sticks, else at x [m]."""
    place = model.rubbing.place if model.rubbing.rubs else x
    for one in model.planes:
        grain = one.effects and one.effects.grain
        one.raised = grain.at(place) if grain else 0.0


def pull(model: ContactState, n: int, x: Reals) -> tuple[Floats, Floats]:
    """Return the part of y from attraction and drag, and the part of y - x from grains [m], for a known resting
    proxy.
    """
    moved, by_grain, v = [0.0] * n, [0.0] * n, model.velocity.velocity
    seen = model.rubbing.seen if model.rubbing.rubs else model.seen if model.bends else model.planes
    for one, plane in zip(model.planes, seen, strict=False):  # the surface, and what it is from where the proxy is
        if (effects := one.effects) is None:
            continue
        push = effects.attraction(-depth_now(model, plane, n, x))
        for i in range(n):
            moved[i] += push * plane.response[i]
        deep = depth_now(model, plane, n, model.s)
        if deep > 0.0:
            deep *= plane.stiffness * plane.softness  # the device's
            for i in range(n):
                by_grain[i] -= one.raised / plane.softness * plane.response[i]
        # Without its grain: the drag does not come and go with each wave.
        c = effects.viscosity * min(max(0.0, deep - one.raised) / FULL_DRAG_M, 1.0)
        along, drag = dot(n, v, plane.normal), [0.0] * n
        times(n, model.compliance, [c * (v[i] - along * plane.normal[i]) for i in range(n)], drag)
        for i in range(n):
            moved[i] -= drag[i]
    return moved, by_grain


def act(model: ContactState, n: int, x: Reals, y: Floats) -> Vector:
    """Add attraction and drag to y [m]. Returns what of y - x grains make."""
    moved, by_grain = pull(model, n, x)
    for made in (y, model.made_s, model.made_before, model.made_y):
        for i in range(n):
            made[i] += moved[i]
    return tuple(by_grain)


def grain_force(model: ContactState, by_grain: Vector, spring: Spring) -> Vector:
    """The part of the spring's force that grains make [N]; none if no surface has effects."""
    return tuple([inner(row, by_grain) for row in spring.rows]) if model.acts else (0.0,) * spring.dof
