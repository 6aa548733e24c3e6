"""Walls around the virtual mass: `hapnet.plant.worlds.walls`; a face's force is computed by its own functions."""

from __future__ import annotations

from typing import Annotated

from hapnet.kernel.contact_model import Planes
from hapnet.plant.worlds.walls import Face, entering, leaving
from hapnet.records.equation import equation
from hapnet.records.record import AXES, PLANES, FloatRows, Floats, Record, Wholes
from hapnet.records.vectors import copy, dot

MOST = 8
"""The most walls, and axes of walls, of a scene."""


class Contacts(Record):
    """`Contacts`: each axis with the faces at its ends, and each wall."""

    axes: int
    normal: Annotated[FloatRows, (MOST, AXES)]
    upper_at: Annotated[Floats, (MOST,)]
    upper_stiffness: Annotated[Floats, (MOST,)]
    upper_damping: Annotated[Floats, (MOST,)]
    lower_at: Annotated[Floats, (MOST,)]
    lower_stiffness: Annotated[Floats, (MOST,)]
    lower_damping: Annotated[Floats, (MOST,)]
    walls: int
    wall_normal: Annotated[FloatRows, (MOST, AXES)]
    wall_offset: Annotated[Floats, (MOST,)]
    wall_stiffness: Annotated[Floats, (MOST,)]
    taken: Annotated[Wholes, (MOST,)]


@equation
def force(contacts: Contacts, k: int, q: float, w: float, a: float, dt: float) -> float:
    """`Axis.force` of axis k."""
    upper = Face(contacts.upper_at[k], contacts.upper_stiffness[k], contacts.upper_damping[k])
    lower = Face(contacts.lower_at[k], contacts.lower_stiffness[k], contacts.lower_damping[k])
    found: float = 0.0
    if q > upper.at:
        found = -leaving(upper, lower, q - upper.at, upper.at - lower.at, -w, a, dt)
    elif q < lower.at:
        found = leaving(lower, upper, lower.at - q, upper.at - lower.at, w, a, dt)
    elif w > 0.0:
        found = -entering(upper, upper.at - q, w, a, dt)
    else:
        found = entering(lower, q - lower.at, -w, a, dt)
    return found


@equation
def penetration(contacts: Contacts, n: int, x: Floats) -> float:
    """`Contacts.penetration`."""
    deepest = 0.0
    for k in range(contacts.axes):
        q = dot(n, contacts.normal[k], x)
        if q - contacts.upper_at[k] > deepest:
            deepest = q - contacts.upper_at[k]
        elif contacts.lower_at[k] - q > deepest:
            deepest = contacts.lower_at[k] - q
    return deepest


@equation
def stored(contacts: Contacts, n: int, x: Floats) -> float:
    """`Contacts.stored_J`."""
    total = 0.0
    for k in range(contacts.axes):
        q = dot(n, contacts.normal[k], x)
        above, below = max(0.0, q - contacts.upper_at[k]), max(0.0, contacts.lower_at[k] - q)
        total += 0.5 * (contacts.upper_stiffness[k] * above * above + contacts.lower_stiffness[k] * below * below)
    return total


@equation
def tell(contacts: Contacts, n: int, x: Floats, reach_m: float, planes: Planes) -> None:
    """`Contacts.planes`: the deepest first, into `planes`."""
    planes.count = 0
    for k in range(contacts.walls):
        contacts.taken[k] = 0
    for _ in range(min(PLANES, contacts.walls)):
        nearest, least = -1, 0.0
        for k in range(contacts.walls):
            if not contacts.taken[k]:
                away = -(dot(n, contacts.wall_normal[k], x) - contacts.wall_offset[k])
                if nearest < 0 or away < least:
                    nearest, least = k, away
        contacts.taken[nearest] = 1
        if least <= reach_m:
            at = planes.count
            copy(AXES, contacts.wall_normal[nearest], planes.normal[at])
            planes.offset[at] = contacts.wall_offset[nearest]
            planes.stiffness[at] = contacts.wall_stiffness[nearest]
            planes.velocity[at] = 0.0
            planes.count = at + 1
