"""A virtual mass among rigid solids, in place of what sides.py does among walls."""

from __future__ import annotations

from typing import Any

from hapnet.control.prediction import Around
from hapnet.plant import integrator
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds import rigid_step
from hapnet.plant.worlds.rigid_step import SolidContact
from hapnet.plant.worlds.shapes import Triple
from hapnet.records.equation import equation
from hapnet.records.record import Reals


@equation
def _padded(n: int, vector: Reals) -> Triple:
    """A vector (n,) with three components."""
    return (vector[0], vector[1] if n > 1 else 0.0, vector[2] if n > 2 else 0.0)


@equation
def meet(mass: PassiveIntegrator, dt: float, contacts: SolidContact) -> None:
    """`PassiveIntegrator.respond` among solids."""
    n = mass.n
    integrator.solve(mass, mass.c, mass.vhat)
    inverse: Any = mass  # as compiled code has it
    force, vhat = rigid_step.react(contacts, inverse, dt, _padded(n, mass.x), _padded(n, mass.vhat))
    for i in range(n):
        mass.force[i], mass.vhat[i] = force[i], vhat[i]


@equation
def penetration(contacts: SolidContact, position: Reals) -> float:
    """`RigidContacts.penetration`."""
    return rigid_step.deepest(contacts, _padded(contacts.dof, position))


@equation
def stored(contacts: SolidContact, position: Reals) -> float:
    """`RigidContacts.stored_J`."""
    return contacts.energy_J


@equation
def see(contacts: SolidContact, position: Reals, reach_m: float, around: Around) -> None:
    """The planes that the world sends: none yet."""
    around.count = 0
