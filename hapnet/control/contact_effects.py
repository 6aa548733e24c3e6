"""Effects of the surfaces that the local contact model knows: they move y, so PSPM pays for them as for any other y.

    w_k = w - h(place)          the grain lifts the plane where the proxy is
    y += K'^-1 F_snap(gap) n    attraction before the surface
    y -= K'^-1 c v_t            drag along a surface that is touched, v_t across its normal

Sticking is in `hapnet.control.friction_cone`. Each tick of the servo makes them anew, whatever the link and the world's
step are. All forces are the proxy's: the hand feels K K'^-1 of them, as of any contact.
"""

from __future__ import annotations

from hapnet.control.contact_equations import ContactState, depth_now
from hapnet.records.record import Floats, Reals
from hapnet.records.vectors import dot, times


def lift(model: ContactState, x: Reals) -> None:
    """Each plane is as high as its grain: where the proxy rested before if that sticks, else at x [m]."""
    place = model.rubbing.place if model.rubbing.rubs else x
    for one in model.planes:
        grain = one.effects and one.effects.grain
        one.raised = grain.at(place) if grain else 0.0


def act(model: ContactState, n: int, x: Reals, y: Floats) -> None:
    """Add attraction and drag to y [m], once it is known where the proxy rests."""
    moved = [0.0] * n
    for one in model.planes:
        if (effects := one.effects) is None:
            continue
        gap = -depth_now(model, one, n, x)
        push = effects.attraction(gap)
        for i in range(n):
            moved[i] += push * one.response[i]
        if effects.viscosity and depth_now(model, one, n, model.s) > 0.0:
            v = model.velocity.velocity
            along, drag = dot(n, v, one.normal), [0.0] * n
            times(n, model.compliance, [effects.viscosity * (v[i] - along * one.normal[i]) for i in range(n)], drag)
            for i in range(n):
                moved[i] -= drag[i]
    for made in (y, model.made_s, model.made_before, model.made_y):
        for i in range(n):
            made[i] += moved[i]
