"""The picture of an arm, with a capsule from joint to joint.

A recording's description has the arm's frames, so a viewer does not need its file. If the axes are joints, positions
are the posture. If they are the tip's, the joints' angles are recorded, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.chain import difference, place
from hapnet.ext.arms.table import ArmTable, Joint, chain_of
from hapnet.ext.solids.outlines import ball
from hapnet.mechanics.curvature import across
from hapnet.mechanics.pose import quaternions
from hapnet.plant.worlds.picture import RESTS, Color, Part, part

_LINK: Color = (71, 105, 150, 200)
_BASE: Color = (148, 163, 184, 200)
_SLENDER, _THINNEST_M, _THICKEST_M = 0.07, 0.006, 0.03
"""A link's radius over its length, and the smallest and largest radius [m]."""


def described(table: ArmTable, by_joints: bool) -> dict[str, Any]:
    """The arm's frames for a recording's description: of each joint xyz, rpy and axis; tip, home; the
    numbers of the free joints that slide, if any do; of each mimic its number among all joints, that of its leader
    among the free ones, multiplier, offset, and whether it slides."""
    frames = [[list(joint.xyz), list(joint.rpy), list(joint.axis)] for joint in table.joints]
    slides = [i for i, joint in enumerate(table.free) if joint.slides]
    led = enumerate(zip(table.joints, table.coordinates, strict=True))
    mimics = [[i, *found, joint.slides] for i, (joint, found) in led if joint.leader]
    found = {"joints": frames, "tip": list(table.tip), "home": list(table.home), "by_joints": by_joints}
    return {**found, **({"slides": slides} if slides else {}), **({"mimics": mimics} if mimics else {})}


class ArmPicture:
    """The picture of an arm that was `described`; places are in metres, from the tip at home.

    Raises InvalidParameter, LookupError, TypeError, ValueError: the description is of no arm.
    """

    def __init__(self, described: Mapping[str, Any]) -> None:
        frames = [[_floats(vector) for vector in frame] for frame in described["joints"]]
        tip, home = _floats(described["tip"]), _floats(described["home"])
        joints = [Joint(str(i), xyz, rpy, axis) for i, (xyz, rpy, axis) in enumerate(frames)]
        mimics = {int(i): led for i, *led in described.get("mimics", ())}
        free = [i for i in range(len(joints)) if i not in mimics]
        for k in map(int, described.get("slides", ())):  # a slide has stops, which no picture shows
            joints[free[k]] = replace(joints[free[k]], lower=home[k] - 1.0, upper=home[k] + 1.0, slides=True)
        for i, (k, share, offset, slides) in mimics.items():
            joints[i] = replace(
                joints[i], slides=bool(slides), leader=str(free[int(k)]), multiplier=float(share), offset=float(offset)
            )
        self.by_joints = bool(described["by_joints"])
        self._table = ArmTable("arm", tuple(joints), tip, home)
        self._chain = chain_of(self._table)
        difference(self._chain, self._chain.tip, home, home)
        self._origin = np.array(self._chain.tip.begin)
        self._chain.tip.arms[0][:] = [a - b for a, b in zip(self._chain.tip.arms[0], self._origin, strict=True)]

    @staticmethod
    def of(description: Mapping[str, Any]) -> ArmPicture | None:
        """The picture in a recording's description, or a side's; None: there is none."""
        with suppress(InvalidParameter, LookupError, TypeError, ValueError, AttributeError):
            return ArmPicture(description["arm"])
        return None

    @property
    def parts(self) -> tuple[Part, ...]:
        """The base at rest, and each link in its own frame."""
        chain = self._chain
        ends = [link.offset for link in chain.links[2:]] + [chain.tip.arms[chain.bodies]]
        lengths = [float(np.linalg.norm(end)) for end in (chain.links[1].offset, *ends)]
        radius = min(max(_SLENDER * max(lengths), _THINNEST_M), _THICKEST_M)
        base = _capsule(chain.links[1].offset, 1.5 * radius, _BASE, RESTS)
        return (
            base._replace(vertices=(base.vertices - self._origin).astype(np.float32)),
            *(_capsule(end, radius, _LINK, i) for i, end in enumerate(ends)),
        )

    @property
    def at_home(self) -> Array:
        """All vertices at home (N, 3) [m]."""
        poses = self.poses(self._table.home)
        turns = [np.array(link.turned) for link in self._chain.links[1:]]
        return np.concatenate([
            one.vertices if one.body == RESTS else one.vertices @ turns[one.body].T + poses[one.body, :3]
            for one in self.parts
        ])  # fmt: skip

    def angles(self, position: Sequence[float], posture: Vector) -> Vector:
        """The free joints' angles q [rad], from `position` or the recorded posture; at home if neither has them."""
        if self.by_joints:
            return tuple([home + angle for home, angle in zip(self._table.home, position, strict=True)])
        return posture if len(posture) == self._chain.n else self._table.home

    def poses(self, q: Sequence[float]) -> Array:
        """The links' poses with the free joints at q [rad]: place and quaternion w, x, y, z, a row for each link."""
        chain = self._chain
        place(chain, q, (0.0,) * chain.n)
        links = chain.links[1 : chain.bodies + 1]
        places = np.array([link.place for link in links]) - self._origin
        return np.hstack([places, quaternions(np.array([link.turned for link in links]))])

    def tip(self, position: Sequence[float]) -> Vector:
        """The place of the tip [m]."""
        if not self.by_joints:
            return tuple(position)
        q = self.angles(position, ())
        difference(self._chain, self._chain.tip, q, q)
        return tuple(self._chain.tip.begin)


def _floats(values: Iterable[float]) -> Vector:
    return tuple(map(float, values))


def _capsule(end: Sequence[float], radius: float, color: Color, body: int) -> Part:
    """A capsule from the origin to `end` [m]."""
    along = np.array(end)
    length = float(np.linalg.norm(along))
    vertices, triangles = ball(24, length / radius)
    if length > 0.0:
        unit = along / length
        vertices = vertices @ np.array([*across(tuple(unit.tolist())), unit])
    return part(radius * vertices + 0.5 * along, triangles, color, body, smooth=True)
