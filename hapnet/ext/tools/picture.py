"""The picture of a world with a rigid tool."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.solids.outlines import cuboid, cylinder
from hapnet.ext.solids.secant import friction_of
from hapnet.ext.solids.shapes import Cylinder
from hapnet.ext.solids.solids_picture import parts_of
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.tool import place
from hapnet.mechanics.pose import pose
from hapnet.plant.worlds.picture import Color, Part, StillDefaults, Touch, part, shared

TOOL: Color = (234, 88, 12, 230)


class ToolPicture(StillDefaults):
    """The solids at rest, and the tool where the last step left it."""

    def __init__(self, contacts: ToolContacts) -> None:
        self._contacts = contacts

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        tool = self._contacts.tool
        width, _, length = tool.size
        form = cylinder(Cylinder((0.0, 0.0, 0.0), width / 2.0, length)) if tool.round else cuboid(tool.size)
        return (part(*form, TOOL, 0), *parts_of(self._contacts.solids))

    def poses(self) -> Array:
        place, quaternion = pose(self._contacts.at, self._contacts.arm_m)
        return np.array([[*place, *quaternion]])

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """Where the tool is inside solids."""
        if not any(force) or len(position) != self._contacts.dof:
            return []
        found = []
        for distance, point, normal, solid in self._contacts.within(position, 0.0):
            x = place(position, point, self._contacts.arm_m)
            at = tuple([a + distance * n for a, n in zip(x, normal, strict=True)])
            found.append((at, tuple([-part for part in normal]), friction_of(solid, x)))
        return shared(tuple(force[:3]), found)
