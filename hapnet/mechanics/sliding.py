"""The space around a proxy: where nothing touches it, and along which walls it slides without any work.

Flat walls have no friction, so a proxy that touches them can be carried along them as through free space
(`hapnet.control.carrying`). The first functions call the methods of the surroundings; ext/compiled has others.
"""

from __future__ import annotations

from typing import Any

from hapnet.mechanics.contacts import Surroundings
from hapnet.records.record import Floats, Reals, equation
from hapnet.records.vectors import dot

_RIGHT_ANGLE = 1e-9
"""Walls are at a right angle if the cosine between their normals is at most this."""

_SAME_M = 1e-15
"""A wall's contact stays the same if its depth changes by less than this [m]: rounding."""


def clearance(contacts: Surroundings, position: Reals) -> float:
    """Call the surroundings' `clearance` [m]."""
    return contacts.clearance(tuple(position))


def slide(contacts: Surroundings, position: Reals, gap_m: float, way: Floats, pull: Floats) -> bool:
    """Call the surroundings' `slide`."""
    return contacts.slide(position, gap_m, way, pull)


def stays(contacts: Surroundings, position: Reals, place: Reals) -> bool:
    """Call the surroundings' `stays`."""
    return contacts.stays(position, place)


# -- among flat walls: `hapnet.plant.worlds.walls.Contacts` -----------------------------------------------------------


@equation
def slide_along_walls(contacts: Any, position: Reals, gap_m: float, way: Floats, pull: Floats) -> bool:
    """`Surroundings.slide`: for walls at right angles."""
    n: int = contacts.dof
    beside = 0
    for k in range(contacts.faces):
        normal: Reals = contacts.normals[k]
        if contacts.offsets[k] - dot(n, normal, position) <= gap_m:
            for j in range(k):
                is_beside = contacts.offsets[j] - dot(n, contacts.normals[j], position) <= gap_m
                if is_beside and abs(dot(n, normal, contacts.normals[j])) > _RIGHT_ANGLE:
                    return False
            into, off = dot(n, normal, way), dot(n, normal, pull)
            for i in range(n):
                way[i] = way[i] - into * normal[i]
                pull[i] = pull[i] - off * normal[i]
            beside += 1
    share = 1.0
    for k in range(contacts.faces):
        away = contacts.offsets[k] - dot(n, contacts.normals[k], position) - gap_m
        towards = dot(n, contacts.normals[k], way)
        if away > 0.0 and towards > away:
            share = min(share, away / towards)
    for i in range(n):
        way[i] = share * way[i]
    return 0 < beside < n


@equation
def stays_in_walls(contacts: Any, position: Reals, place: Reals) -> bool:
    """`Surroundings.stays`."""
    n: int = contacts.dof
    for k in range(contacts.faces):
        before = max(0.0, dot(n, contacts.normals[k], position) - contacts.offsets[k])
        after = max(0.0, dot(n, contacts.normals[k], place) - contacts.offsets[k])
        if abs(after - before) > _SAME_M:
            return False
    return True
