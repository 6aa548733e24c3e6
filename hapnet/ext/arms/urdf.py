"""An arm from a URDF description: the serial chain from its base to a tip, and the bodies that its links carry.

Links that are fixed to one another are one body. Branches of the chain, such as a gripper's jaw, are carried in their
posture at 0. An effort or velocity of 0 is no limit. `ArmTable.remarks` says what is left out and what looks wrong;
`hapnet.ext.arms.tags` lists all tags.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.home import open_home
from hapnet.ext.arms.table import SAME, ArmTable, Joint, JointFrame, angles_of, moved, rotation_of
from hapnet.ext.arms.tags import DRAKE, not_used

_MOVES = {"revolute", "continuous", "prismatic"}
_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_ZERO = (0.0, 0.0, 0.0)

_TURNED_RAD = 4.0 * math.pi
_FAR_RAD = 1e4
"""Stops between these angles are often degrees; stops that are farther stand for none."""

_GYRATION_M = 3.0
"""No link of an arm has a larger radius of gyration; one in kg mm^2 or g cm^2 by mistake has."""

_MOST = 1e6
"""No length, mass or moment of inertia is larger; squares of much larger numbers overflow."""

_ROUNDED = 1e-3
"""The share by which rounded moments of inertia may miss A + B >= C."""

_SHOWN = 4
"""The number of names in a remark."""


class _Body(NamedTuple):
    """A mass [kg], with first moment [kg m] and inertia [kg m^2] about the origin of its frame."""

    mass: float
    moment: Array
    inertia: Array


@lru_cache(maxsize=4)  # a run reads its arm several times
def table_from(text: str, name: str, tip: str = "", base: str = "", home: Vector = ()) -> ArmTable:
    """The arm that a URDF describes.

    text : of the file; name : for messages. tip, base : links; by default the only link without a child, and the
    link without a parent. home : q [rad]; by default `open_home`: the middle between each joint's stops, or a
    posture near it that is not singular.

    Raises InvalidParameter: the text is no URDF, or there is no arm between these links.
    """
    robot = _Robot(text, name)
    chain = robot.chain(base, tip)
    joints: list[Joint] = []
    pose, body = SAME, _Body(0.0, np.zeros(3), np.zeros((3, 3)))
    on_chain = {id(joint) for joint in chain}
    moving: ElementTree.Element | None = None
    placed = SAME
    for joint in chain:
        pose = pose.then(robot.origin(joint))
        if joint.get("type") == "fixed":
            if moving is not None:  # what is fixed to the base stands still
                body = _sum(body, robot.carried(robot.child(joint), pose, on_chain))
            continue
        if joint.get("type") not in _MOVES:
            allowed = "revolute, continuous, prismatic or fixed between base and tip"
            raise InvalidParameter(f"the type of {name}'s joint {joint.get('name')}", joint.get("type"), allowed)
        if moving is not None:
            joints.append(robot.joint(moving, placed, body))
        moving, placed = joint, pose
        pose, body = SAME, robot.carried(robot.child(joint), SAME, on_chain)
    if moving is None:
        raise InvalidParameter("the arm", name, "", why=f"no joint moves its tip, the link {tip}")
    joints.append(robot.joint(moving, placed, body))
    where: Vector = tuple(pose.place.tolist())
    table = ArmTable(name, tuple(joints), where, home, remarks=robot.remarks())
    return table if home else replace(table, home=open_home(table))


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
        self.rotors = self._rotors(root)
        self.said: dict[str, list[str]] = {"not used": not_used(root, name)}
        """For each remark the names that it is about."""
        self.links = self._by_name(root, "link")
        self.joints = list(self._by_name(root, "joint").values())
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
            if joint.get("type") not in _TYPES:
                whose = f"the type of {name}'s joint {joint.get('name')}"
                raise InvalidParameter(whose, joint.get("type"), ", ".join(_TYPES))
            self.after[self.parent(joint)].append(joint)
        self._check_tree()

    def _rotors(self, root: ElementTree.Element) -> dict[str, float]:
        """The inertia that rotors behind gears add to each joint, from Drake's tags of a transmission [kg m^2]."""
        found: dict[str, float] = {}
        for transmission in root.findall("transmission"):
            for actuator in transmission.findall("actuator"):
                inertia, ratio = (actuator.find(DRAKE + tag) for tag in ("rotor_inertia", "gear_ratio"))
                turns = self._number(ratio, "value", 1.0)
                added = self._number(inertia, "value", 0.0) * turns * turns
                for joint in transmission.findall("joint"):
                    name = str(joint.get("name"))
                    found[name] = found.get(name, 0.0) + added
        return found

    def _by_name(self, root: ElementTree.Element, tag: str) -> dict[str, ElementTree.Element]:
        """The links or joints. Raises InvalidParameter: one has no name, or that of another."""
        found: dict[str, ElementTree.Element] = {}
        for element in root.findall(tag):
            key = element.get("name", "")
            if not key or found.setdefault(key, element) is not element:
                why = f"it has two {tag}s named {key!r}" if key else f"a {tag} has no name"
                raise InvalidParameter("the arm", self.name, "", why=why)
        return found

    def _check_tree(self) -> None:
        """Raise InvalidParameter if the links are not one tree."""
        roots = [link for link in self.links if link not in self.before]
        if len(roots) > 1:
            allowed = "one link without a parent: all others hang on it by joints"
            raise InvalidParameter(f"the roots of {self.name}", _names(roots), allowed)
        reached = list(roots)
        for link in reached:
            reached += [self.child(joint) for joint in self.after[link]]
        if roots and len(reached) < len(self.links):
            raise self._goes_round(next(link for link in self.links if link not in set(reached)))

    def remarks(self) -> tuple[str, ...]:
        """A line for each thing that is left out or looks wrong."""
        return tuple([f"{self.name}: {what}: {_names(names)}" for what, names in self.said.items() if names])

    def _say(self, what: str, name: object) -> None:
        names = self.said.setdefault(what, [])
        if str(name) not in names:
            names.append(str(name))

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

    def origin(self, element: ElementTree.Element) -> JointFrame:
        """An element's <origin>."""
        found = element.find("origin")
        if found is None:
            return SAME
        return JointFrame(rotation_of(self._vector(found, "rpy", _ZERO)), np.array(self._vector(found, "xyz", _ZERO)))

    def carried(self, link: str, pose: JointFrame, on_chain: set[int]) -> _Body:
        """A link and all its branches, as one body in the frame in which the link is at `pose`."""
        body = self._body(self.links[link], pose)
        for joint in self.after[link]:
            if id(joint) not in on_chain:
                if joint.get("type") != "fixed":
                    self._say("carried in their posture at 0, joints", joint.get("name"))
                at = pose.then(self.origin(joint)).then(self._resting(joint))
                body = _sum(body, self.carried(self.child(joint), at, on_chain))
        return body

    def _led(self, joint: ElementTree.Element) -> tuple[str, float, float]:
        """The joint that a joint follows, which mimics none, with multiplier and offset; empty: it mimics none."""
        value, share, mimic = 0.0, 1.0, joint.find("mimic")
        passed = [joint]
        while mimic is not None:
            value += share * self._number(mimic, "offset", 0.0)
            share *= self._number(mimic, "multiplier", 1.0)
            leader = next((one for one in self.joints if one.get("name") == mimic.get("joint")), None)
            if leader is None or leader in passed:
                what = "which does not exist" if leader is None else "which mimics it in turn"
                what = "itself" if leader is passed[-1] else f"the joint {mimic.get('joint')}, {what}"
                why = f"its joint {passed[-1].get('name')} mimics {what}"
                raise InvalidParameter("the arm", self.name, "", why=why)
            passed.append(leader)
            mimic = leader.find("mimic")
        return str(passed[-1].get("name")) if len(passed) > 1 else "", share, value

    def _resting(self, joint: ElementTree.Element) -> JointFrame:
        """The frame of a carried joint's link in the joint's frame: at 0, or at a mimic's offset from that."""
        _, _, value = self._led(joint)
        if value == 0.0:
            return SAME
        if not math.isfinite(value):
            raise InvalidParameter(f"the offset of {self.name}'s mimic {joint.get('name')}", value, "a finite one")
        return moved(self._axis(joint), value, slides=joint.get("type") == "prismatic")

    def _axis(self, joint: ElementTree.Element) -> Vector:
        axis = joint.find("axis")
        return (1.0, 0.0, 0.0) if axis is None else self._vector(axis, "xyz", (1.0, 0.0, 0.0))

    def joint(self, joint: ElementTree.Element, placed: JointFrame, body: _Body) -> Joint:
        """The joint that moves `body`, with its frame at `placed` in the previous joint's frame."""
        if body.mass <= 0.0:
            why = f"the link {self.child(joint)}, which joint {joint.get('name')} moves, has no mass: add an <inertial>"
            raise InvalidParameter("the arm", self.name, "", why=why)
        centre = body.moment / body.mass
        inertia = body.inertia - body.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        dynamics = joint.find("dynamics")
        lower, upper = self._stops(joint)
        leader, multiplier, offset = self._led(joint)
        effort = self._most(joint, "effort")
        if leader and effort < math.inf:
            self._say(
                "the effort of a joint with <mimic> is not used, its leader's motor moves both, joints",
                joint.get("name"),
            )
        a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in (inertia + inertia.T) / 2.0)
        return Joint(
            str(joint.get("name")),
            tuple(placed.place.tolist()),
            angles_of(placed.turned),
            self._axis(joint),
            body.mass,
            tuple(centre.tolist()),
            (a, b, c),
            lower=lower,
            upper=upper,
            effort=math.inf if leader else effort,
            speed=self._most(joint, "velocity"),
            damping=self._number(dynamics, "damping", 0.0),
            friction=self._number(dynamics, "friction", 0.0),
            armature=self._number(dynamics, "armature", 0.0) + self.rotors.get(str(joint.get("name")), 0.0),
            slides=joint.get("type") == "prismatic",
            leader=leader,
            multiplier=multiplier,
            offset=offset,
        )

    def _most(self, joint: ElementTree.Element, key: str) -> float:
        """A joint's greatest effort or velocity; infinite if it is not given, or 0."""
        value = self._number(joint.find("limit"), key, math.inf)
        if value == 0.0:
            self._say(f"the {key} of 0 is taken for no limit, joints", joint.get("name"))
        return value or math.inf

    def _stops(self, joint: ElementTree.Element) -> tuple[float, float]:
        """A joint's stops, and those of a safety controller's soft limits within them [rad], of a slide [m]."""
        name, limit, safety = joint.get("name"), joint.find("limit"), joint.find("safety_controller")
        turns = joint.get("type") != "prismatic"
        unit = "rad" if turns else "m"
        soft = safety is not None and self._number(safety, "k_position", 0.0) > 0.0
        if joint.get("type") == "continuous":
            if soft or any(limit is not None and limit.get(side) is not None for side in ("lower", "upper")):
                self._say("a continuous joint has no stops, its limits are not used, joints", name)
            return -math.inf, math.inf
        found: list[float] = []
        for side, default in (("lower", -math.inf), ("upper", math.inf)):
            found.append(self._number(limit, side, default))
            if limit is None or limit.get(side) is None:
                self._say(f"no {side} stop, which URDF requires: free there, joints", name)
            if turns and _TURNED_RAD < abs(found[-1]) < _FAR_RAD:
                self._say("stops beyond two turns (are these degrees? URDF has rad), joints", f"{name} {found[-1]:g}")
        if soft:
            ends = [self._number(safety, f"soft_{side}_limit", found[i]) for i, side in enumerate(("lower", "upper"))]
            if not max(ends[0], found[0]) < min(ends[1], found[1]):
                allowed = f"a range within its stops, {found[0]:g} to {found[1]:g} {unit}"
                shown = f"{ends[0]:g} to {ends[1]:g} {unit}"
                raise InvalidParameter(f"the safety_controller's range of {self.name}'s joint {name}", shown, allowed)
            return max(ends[0], found[0]), min(ends[1], found[1])
        return found[0], found[1]

    def _body(self, link: ElementTree.Element, pose: JointFrame) -> _Body:
        found = link.find("inertial")
        if found is None:
            return _Body(0.0, np.zeros(3), np.zeros((3, 3)))
        own = found.find("inertia")
        mass = self._number(found.find("mass"), "value", 0.0)
        xx, xy, xz, yy, yz, zz = (self._number(own, key, 0.0) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self._check_body(str(link.get("name")), mass, inertia)
        at = pose.then(self.origin(found))
        inertia = at.turned @ inertia @ at.turned.T
        c = at.place
        return _Body(mass, mass * c, inertia + mass * (c @ c * np.eye(3) - np.outer(c, c)))

    def _check_body(self, link: str, mass: float, inertia: Array) -> None:
        """Raise InvalidParameter for a mass or inertia that is no number; say which are no body's."""
        if not 0.0 <= mass <= _MOST:
            raise InvalidParameter(f"the mass of {self.name}'s link {link}", mass, f"0 to {_MOST:g} kg")
        if not np.abs(inertia).max() <= _MOST:
            shown, allowed = inertia.tolist(), f"numbers of at most {_MOST:g} kg m^2"
            raise InvalidParameter(f"the inertia of {self.name}'s link {link}", shown, allowed)
        a, b, c = np.linalg.eigvalsh(inertia).tolist()
        shown = f"{link} ({a:.3g}, {b:.3g}, {c:.3g})"
        if a < -_ROUNDED * c or c * (1.0 - _ROUNDED) > a + b:
            self._say("moments of inertia that no body has, as A + B < C or A < 0 [kg m^2], links", shown)
        if mass == 0.0 < c:
            self._say("inertia without mass, links", link)
        elif c > mass * _GYRATION_M**2:
            self._say("moments of inertia very large for the mass (are these kg m^2?), links", shown)
        if c == 0.0 < mass:
            self._say("mass without inertia is taken for a point's, links", link)

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
        if len(value) != 3 or not all(abs(number) <= _MOST for number in value):
            raise InvalidParameter(f"{key} in {self.name}", text, f"three numbers, of at most {_MOST:g}")
        return value


def _names(names: Iterable[str]) -> str:
    """The first few names, and how many more there are."""
    shown = list(names)
    more = f" and {len(shown) - _SHOWN} more" if len(shown) > _SHOWN else ""
    return ", ".join(shown[:_SHOWN]) + more


def _sum(one: _Body, other: _Body) -> _Body:
    return _Body(one.mass + other.mass, one.moment + other.moment, one.inertia + other.inertia)
