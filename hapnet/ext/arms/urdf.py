"""An arm from a URDF description: the serial chain from its base to a tip, and the bodies that its links carry.

Links that are fixed to one another are one body. Branches of the chain, such as a gripper's jaw, are carried in their
posture at 0. An effort or velocity of 0 is no limit.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.table import ArmTable, Joint, home_of, rotation_of

_TURNS = {"revolute", "continuous"}
_ZERO = (0.0, 0.0, 0.0)


class _Pose(NamedTuple):
    """A frame in another frame: rotation (3, 3) and place (3,) [m]."""

    turned: Array
    place: Array

    def then(self, inner: _Pose) -> _Pose:
        """The frame `inner`, given in this frame, in the outer one."""
        return _Pose(self.turned @ inner.turned, self.place + self.turned @ inner.place)


_SAME = _Pose(np.eye(3), np.zeros(3))


class _Body(NamedTuple):
    """A mass [kg], with first moment [kg m] and inertia [kg m^2] about the origin of its frame."""

    mass: float
    moment: Array
    inertia: Array


@lru_cache(maxsize=4)  # a run reads its arm several times
def table_from(text: str, name: str, tip: str = "", base: str = "", home: Vector = ()) -> ArmTable:
    """The arm that a URDF describes.

    text : of the file; name : for messages. tip, base : links; by default the only link without a child, and the
    link without a parent. home : q [rad]; by default the middle between each joint's stops.

    Raises InvalidParameter: the text is no URDF, or there is no arm of hinges between these links.
    """
    robot = _Robot(text, name)
    chain = robot.chain(base, tip)
    joints: list[Joint] = []
    pose, body = _SAME, _Body(0.0, np.zeros(3), np.zeros((3, 3)))
    on_chain = {id(joint) for joint in chain}
    moving: ElementTree.Element | None = None
    placed = _SAME
    for joint in chain:
        pose = pose.then(robot.origin(joint))
        if joint.get("type") == "fixed":
            body = _sum(body, robot.carried(robot.child(joint), pose, on_chain))
            continue
        if joint.get("type") not in _TURNS:
            allowed = "revolute, continuous or fixed between base and tip"
            raise InvalidParameter(f"the type of {name}'s joint {joint.get('name')}", joint.get("type"), allowed)
        if moving is not None:
            joints.append(robot.joint(moving, placed, body))
        moving, placed = joint, pose
        pose, body = _SAME, robot.carried(robot.child(joint), _SAME, on_chain)
    if moving is None:
        raise InvalidParameter("the arm", name, "", why=f"no joint moves its tip, the link {tip}")
    joints.append(robot.joint(moving, placed, body))
    where: Vector = tuple(pose.place.tolist())
    return ArmTable(name, tuple(joints), where, home or home_of(joints))


class _Robot:
    """A URDF's links and joints."""

    def __init__(self, text: str, name: str) -> None:
        self.name = name
        if "<!DOCTYPE" in text:  # only a DTD can expand a few bytes to many
            raise InvalidParameter("the arm", name, "", why="it has a <!DOCTYPE ...>, which a URDF must not have")
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise InvalidParameter("the arm", name, "", why=f"it is not a URDF: its XML is broken ({error})") from None
        if root.tag != "robot":
            why = f"its root is <{root.tag}>; that of a URDF is <robot> (is it xacro?)"
            raise InvalidParameter("the arm", name, "", why=why)
        self.links = {str(link.get("name")): link for link in root.findall("link")}
        self.joints = [joint for joint in root.findall("joint") if joint.find("child") is not None]
        self.before: dict[str, ElementTree.Element] = {}
        for joint in self.joints:
            if self.before.setdefault(self.child(joint), joint) is not joint:
                why = f"the link {self.child(joint)} is the child of two joints, {self._named(joint)}"
                raise InvalidParameter("the arm", name, "", why=why)
        self.after: dict[str, list[ElementTree.Element]] = {link: [] for link in self.links}
        for joint in self.joints:
            for end in (self.parent(joint), self.child(joint)):
                if end not in self.links:
                    why = f"its joint {joint.get('name')} names the link {end!r}, which the file does not have"
                    raise InvalidParameter("the arm", name, "", why=why)
            self.after[self.parent(joint)].append(joint)

    def parent(self, joint: ElementTree.Element) -> str:
        found = joint.find("parent")
        return "" if found is None else str(found.get("link"))

    def child(self, joint: ElementTree.Element) -> str:
        found = joint.find("child")
        return "" if found is None else str(found.get("link"))

    def chain(self, base: str, tip: str) -> list[ElementTree.Element]:
        """The joints from the base to the tip."""
        ends = [link for link, after in self.after.items() if not after and link in self.before]
        if not tip and len(ends) == 1:
            tip = ends[0]
        if tip not in self.before:
            allowed = f"?tip=LINK of {', '.join(sorted(self.before)) or 'a file with joints'}"
            raise InvalidParameter(f"the tip of {self.name}", tip, allowed, self.before)
        if base and base not in self.links:
            raise InvalidParameter(f"the base of {self.name}", base, "a link of the file", self.links)
        found: list[ElementTree.Element] = []
        link, whole = tip, -1
        while link in self.before:
            if len(found) > len(self.joints):
                raise self._goes_round(tip)
            found.append(self.before[link])
            link = self.parent(found[-1])
            if link == base:
                whole = len(found)
        if base and whole < 0:
            why = f"the link {base}, its base, does not lie between the first link and the tip {tip}"
            raise InvalidParameter("the arm", self.name, "", why=why)
        return found[::-1] if whole < 0 else found[:whole][::-1]

    def _goes_round(self, link: str) -> InvalidParameter:
        return InvalidParameter("the arm", self.name, "", why=f"its joints go round in a loop at the link {link}")

    def _named(self, joint: ElementTree.Element) -> str:
        """The names of a joint and of the one before it with the same child; both may have the same name."""
        first, second = self.before[self.child(joint)].get("name"), joint.get("name")
        return f"{first} and {second}" if first != second else f"both called {first}"

    def origin(self, element: ElementTree.Element) -> _Pose:
        """An element's <origin>."""
        found = element.find("origin")
        if found is None:
            return _SAME
        return _Pose(rotation_of(self._vector(found, "rpy", _ZERO)), np.array(self._vector(found, "xyz", _ZERO)))

    def carried(self, link: str, pose: _Pose, on_chain: set[int]) -> _Body:
        """A link and all its branches, as one body in the frame in which the link is at `pose`."""
        body = self._body(self.links[link], pose)
        for joint in self.after[link]:
            if id(joint) not in on_chain:
                body = _sum(body, self.carried(self.child(joint), pose.then(self.origin(joint)), on_chain))
        return body

    def joint(self, joint: ElementTree.Element, placed: _Pose, body: _Body) -> Joint:
        """The joint that moves `body`, with its frame at `placed` in the previous joint's frame."""
        if body.mass <= 0.0:
            why = f"the link {self.child(joint)}, which joint {joint.get('name')} moves, has no mass: add an <inertial>"
            raise InvalidParameter("the arm", self.name, "", why=why)
        centre = body.moment / body.mass
        inertia = body.inertia - body.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        axis = joint.find("axis")
        limit = joint.find("limit")
        dynamics = joint.find("dynamics")
        ends = limit if joint.get("type") == "revolute" else None
        a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in (inertia + inertia.T) / 2.0)
        return Joint(
            str(joint.get("name")),
            tuple(placed.place.tolist()),
            _angles(placed.turned),
            (1.0, 0.0, 0.0) if axis is None else self._vector(axis, "xyz", (1.0, 0.0, 0.0)),
            body.mass,
            tuple(centre.tolist()),
            (a, b, c),
            lower=self._number(ends, "lower", -math.inf),
            upper=self._number(ends, "upper", math.inf),
            effort=self._number(limit, "effort", math.inf) or math.inf,
            speed=self._number(limit, "velocity", math.inf) or math.inf,
            damping=self._number(dynamics, "damping", 0.0),
            friction=self._number(dynamics, "friction", 0.0),
        )

    def _body(self, link: ElementTree.Element, pose: _Pose) -> _Body:
        found = link.find("inertial")
        if found is None:
            return _Body(0.0, np.zeros(3), np.zeros((3, 3)))
        mass = self._number(found.find("mass"), "value", 0.0)
        own = found.find("inertia")
        xx, xy, xz, yy, yz, zz = (self._number(own, key, 0.0) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        at = pose.then(self.origin(found))
        inertia = at.turned @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ at.turned.T
        c = at.place
        return _Body(mass, mass * c, inertia + mass * (c @ c * np.eye(3) - np.outer(c, c)))

    def _number(self, element: ElementTree.Element | None, key: str, default: float) -> float:
        text = None if element is None else element.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isnan(value):
            raise InvalidParameter(f"{key} in {self.name}", text, "a number")
        return value

    def _vector(self, element: ElementTree.Element, key: str, default: Vector) -> Vector:
        text = element.get(key)
        if text is None:
            return default
        try:
            value = tuple(map(float, text.split()))
        except ValueError:
            value = ()
        if len(value) != 3 or not all(map(math.isfinite, value)):
            raise InvalidParameter(f"{key} in {self.name}", text, "three numbers")
        return value


def _sum(one: _Body, other: _Body) -> _Body:
    return _Body(one.mass + other.mass, one.moment + other.moment, one.inertia + other.inertia)


def _angles(R: Array) -> Vector:
    """Roll, pitch and yaw of a rotation; if the pitch is a quarter turn, yaw is 0."""
    across = math.hypot(R[0, 0], R[1, 0])
    if across < 1e-9:
        return math.copysign(1.0, -R[2, 0]) * math.atan2(R[0, 1], R[1, 1]), math.atan2(-R[2, 0], across), 0.0
    return math.atan2(R[2, 1], R[2, 2]), math.atan2(-R[2, 0], across), math.atan2(R[1, 0], R[0, 0])
