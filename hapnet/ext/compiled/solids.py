"""A virtual mass among rigid solids: replaces the functions of sides.py for walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hapnet.checks import MOST_CURVATURE_PER_M
from hapnet.control import contact_surfaces
from hapnet.control.contact_plane import ContactPlane, stand_on
from hapnet.control.predicted_device import Around
from hapnet.ext.compiled import endpoint, link, sides
from hapnet.ext.compiled.endpoint import Endpoint
from hapnet.ext.compiled.link import MessageSlot
from hapnet.ext.solids import rigid_step, sight
from hapnet.ext.solids.rigid_contacts import SEARCHED_M
from hapnet.ext.solids.rigid_step import SolidContact
from hapnet.ext.solids.shapes import Triple, put_bend, triple
from hapnet.mechanics import sliding
from hapnet.mechanics.curvature import copy_bends
from hapnet.mechanics.plane import FOLDED
from hapnet.plant import integrator
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds import walls
from hapnet.records.record import AXES, POINT_PLANES, Floats, Reals, equation
from hapnet.records.vectors import copy, dot

Choices = dict[Callable[..., Any], Callable[..., Any]]

FLOAT_BYTES = 9
"""A float in msgpack."""


@equation
def _padded(n: int, vector: Reals) -> Triple:
    """A vector (n,) with three components."""
    return (vector[0], vector[1] if n > 1 else 0.0, vector[2] if n > 2 else 0.0)


@equation
def meet(mass: PassiveIntegrator, dt: float, contacts: SolidContact) -> None:
    """Solve a step of the mass in contact with solids: `PassiveIntegrator.respond`."""
    n = mass.n
    integrator.solve(mass, mass.c, mass.vhat)
    inverse: Any = mass  # as compiled code has it
    force, vhat = rigid_step.react(contacts, inverse, dt, _padded(n, mass.x), _padded(n, mass.vhat))
    for i in range(n):
        mass.force[i], mass.vhat[i] = force[i], vhat[i]


@equation
def penetration(contacts: SolidContact, position: Reals) -> float:
    """The deepest penetration into the solids at a position [m]: `RigidContacts.penetration`."""
    return rigid_step.deepest(contacts, _padded(contacts.dof, position))


@equation
def slide(contacts: SolidContact, x: Reals, gap_m: float, way: Floats, pull: Floats) -> bool:
    """No way along solids is known that does no work: `Surroundings.slide`."""
    return False


@equation
def stays(contacts: SolidContact, x: Reals, place: Reals) -> bool:
    """No contact with solids is known to stay as it is: `Surroundings.stays`."""
    return False


@equation
def clearance(contacts: SolidContact, position: Reals) -> float:
    """The distance from the nearest solid [m]: `RigidContacts.clearance`. Solids with effects are not compiled."""
    x = _padded(contacts.dof, position)
    if sight.see_all(contacts.secants, contacts.count, contacts.dof, x, SEARCHED_M, contacts.sights, contacts.order):
        return -contacts.sights[contacts.order[0]].depth
    return SEARCHED_M


@equation
def stored(contacts: SolidContact, position: Reals) -> float:
    """The energy stored in the contacts [J]: `RigidContacts.stored_J`."""
    return contacts.energy_J


@equation
def see(contacts: SolidContact, position: Reals, reach_m: float, around: Around, message: MessageSlot) -> None:
    """Put the planes of the solids within reach into `around` and the message: `RigidContacts.planes`. Bends too near
    to the surface's centre of curvature are left out: `Plane.unfolded`."""
    n = contacts.dof
    x = _padded(n, position)
    count = sight.see_all(contacts.secants, contacts.count, n, x, reach_m, contacts.sights, contacts.order)
    around.count = min(count, POINT_PLANES)
    for k in range(around.count):
        one, bends = contacts.sights[contacts.order[k]], message.bends[k]
        copy(n, one.normal, around.normal[k])
        around.offset[k], around.stiffness[k], around.velocity[k] = one.offset, one.stiffness, 0.0
        message.friction[k], bends.count = one.friction, 0
        depth = dot(n, one.normal, position) - one.offset
        for j in range(one.bends.count):
            if one.bends.per_m[j] * depth < FOLDED:
                put_bend(bends, triple(one.bends.directions[j]), one.bends.per_m[j])


@equation
def surface_bytes(own: Endpoint, message: MessageSlot) -> int:
    """The bytes that curvature and friction of the solids' planes add to a message."""
    bends, has_friction = 0, False
    for k in range(message.planes):
        bends += message.bends[k].count
        has_friction = has_friction or message.friction[k] != 0.0
        for j in range(message.bends[k].count):
            if not abs(message.bends[k].per_m[j]) <= MOST_CURVATURE_PER_M:
                own.impossible = 1
    octets = 0
    if bends:
        octets += own.bends_bytes + message.planes + bends * own.bend_bytes
    if has_friction:
        octets += own.friction_bytes + message.planes * FLOAT_BYTES
    return octets


@equation
def copy_surfaces(source: MessageSlot, target: MessageSlot) -> None:
    """Copy curvature and friction of the planes."""
    for k in range(source.planes):
        target.friction[k] = source.friction[k]
        copy_bends(AXES, source.bends[k], target.bends[k])


@equation
def understand_surface(one: ContactPlane, n: int, sample: MessageSlot, k: int) -> None:
    """Take the plane's curvature and friction from the message."""
    one.friction = sample.friction[k]
    copy_bends(n, sample.bends[k], one.bends)
    stand_on(one, n, sample.position)


AMONG_SOLIDS: Choices = {
    integrator.respond: meet, sides.see: see, walls.penetration: penetration, walls.stored: stored,
    sliding.clearance: clearance, sliding.slide: slide, sliding.stays: stays,
    endpoint.surface_bytes: surface_bytes, link.copy_surfaces: copy_surfaces,
    sides.understand_surface: understand_surface, **contact_surfaces.IN_PLACE_OF_FLAT_ONES,
}  # fmt: skip
"""The functions that are compiled in place of others among solids."""
