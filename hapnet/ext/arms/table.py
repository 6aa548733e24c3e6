"""An arm as a table of its joints and links, and its chain; also hapnet's built-in arm.

`omni` is a desktop arm like the Phantom Omni (now Touch): three motors, links of 0.134 and 0.1325 m. Lengths and stops
are those of github.com/fsuarez6/phantom_omni (omni_description); the force of 3.3 N is from the maker's data sheet, as
in CHAI3D's table of devices. The maker publishes no masses. Ours are two thin bars and a turning base, with moments of
inertia for which the tip's apparent mass at home is that of the data sheet, 45 g in all directions (`apparent_masses`).
They include the bars of the parallelogram and the motors: with a serial elbow M has the same form, cosines of the same
angles. Each motor's torque is that of 3.3 N at home across its own bar. The joints' damping at the tip at home is that
of the simulated point mass, 0.3 Ns/m, in the direction where it is smallest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.chain import JOINTS, Chain, difference, matrices, zero_chain
from hapnet.records.vectors import added

GRAVITY_MPS2 = 9.81

_ROUNDING = 1e-13
"""A value below this share of the whole counts as 0."""


@dataclass(frozen=True)
class Joint:
    """A joint that turns or slides, and the link that it moves, as in URDF.

    xyz, rpy : the joint's frame at q = 0 in the frame of the joint before, fixed angles roll, pitch, yaw [m], [rad].
    axis : in that frame. mass [kg], centre [m], inertia about the centre [kg m^2] (3, 3) : of the link, in the frame.
    lower, upper : the stops [rad]. effort : the motor's greatest torque [Nm]. speed : greatest q' [rad/s].
    damping [Nms/rad], friction : Coulomb's [Nm]. armature : what the motor's rotor adds to the inertia: its
    own times the square of the gear's ratio [kg m^2]. slides : whether the joint is prismatic, with m for rad, N for Nm
    and kg for kg m^2.
    leader : the joint that it mimics, by name: it is at multiplier q + offset [rad], with q of the leader, whose motor
    moves both. Empty: it moves freely.
    """

    name: str
    xyz: Vector
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    mass: float = 0.0
    centre: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[Vector, ...] = ((0.0,) * 3,) * 3
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    speed: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    slides: bool = False
    leader: str = ""
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def unit(self) -> str:
        """The unit of its coordinate q."""
        return "m" if self.slides else "rad"


@dataclass(frozen=True)
class ArmTable:
    """An arm: its joints from the base on, the tip in the last joint's frame [m], and a posture within its stops.

    home : q of the free joints there [rad], of a slide [m]; the tip is then at the origin of the device's positions.
    gamma : gravity [m/s^2].
    remarks : lines for the user on what its file has that is not used or looks wrong.
    """

    name: str
    joints: tuple[Joint, ...]
    tip: Vector
    home: Vector
    gamma: Vector = (0.0, 0.0, -GRAVITY_MPS2)
    remarks: tuple[str, ...] = ()

    @property
    def coordinates(self) -> list[tuple[int, float, float]]:
        """Of each joint the number of the free joint that moves it, multiplier and offset.

        Raises InvalidParameter: a joint mimics none of the free joints, or does not move with it.
        """
        names = [joint.name for joint in self.joints if not joint.leader]
        found, own = [], 0
        for joint in self.joints:
            if not joint.leader:
                found.append((own, 1.0, 0.0))
                own += 1
                continue
            if joint.leader not in names:
                why = f"its joint {joint.name} mimics {joint.leader}, which is no moving joint between base and tip"
                why += ": choose another tip, or delete its <mimic>"
                raise InvalidParameter("the arm", self.name, "", why=why)
            for what, value, holds in (
                ("multiplier", joint.multiplier, math.isfinite(joint.multiplier) and joint.multiplier != 0.0),
                ("offset", joint.offset, math.isfinite(joint.offset)),
            ):
                if not holds:
                    allowed = "a finite one" if what == "offset" else "a finite one, not 0 (a fixed joint stands still)"
                    raise InvalidParameter(f"the {what} of {self.name}'s mimic {joint.name}", value, allowed)
            found.append((names.index(joint.leader), joint.multiplier, joint.offset))
        return found

    @property
    def free(self) -> tuple[Joint, ...]:
        """The joints that mimic none, whose q are the arm's coordinates; each with the stops and the speed that its
        mimics have too, and with their damping and friction. Raises InvalidParameter: as `coordinates`."""
        found = [joint for joint in self.joints if not joint.leader]
        for joint, (k, share, offset) in zip(self.joints, self.coordinates, strict=True):
            if joint.leader:
                lead = found[k]
                lower, upper = sorted([(joint.lower - offset) / share, (joint.upper - offset) / share])
                found[k] = replace(
                    lead,
                    lower=max(lead.lower, lower),
                    upper=min(lead.upper, upper),
                    speed=min(lead.speed, joint.speed / abs(share)),
                    damping=lead.damping + share * share * joint.damping,
                    friction=lead.friction + abs(share) * joint.friction,
                )
        return tuple(found)

    @property
    def reaches(self) -> list[float]:
        """The greatest distance of each joint's axis from the tip [m]. Raises InvalidParameter: as `coordinates`."""
        free, lengths = self.free, []
        for joint, (k, share, offset) in zip(self.joints[1:], self.coordinates[1:], strict=True):
            ends = (share * free[k].lower + offset, share * free[k].upper + offset)
            lengths.append(float(np.linalg.norm(joint.xyz)) + (max(map(abs, ends)) if joint.slides else 0.0))
        lengths.append(float(np.linalg.norm(self.tip)))
        return [added(lengths[i:]) for i in range(len(lengths))]

    @property
    def levers(self) -> list[float]:
        """The greatest motion of the tip when a joint moves by its multiplier [m/rad]; by metres at a slide [m/m]."""
        return [
            abs(joint.multiplier) * (1.0 if joint.slides else reach)
            for joint, reach in zip(self.joints, self.reaches, strict=True)
        ]


class JointFrame(NamedTuple):
    """A frame in another frame: rotation (3, 3) and place (3,) [m]."""

    turned: Array
    place: Array

    def then(self, inner: JointFrame) -> JointFrame:
        """The frame `inner`, given in this frame, in the outer one."""
        return JointFrame(self.turned @ inner.turned, self.place + self.turned @ inner.place)


SAME = JointFrame(np.eye(3), np.zeros(3))


def moved(axis: Vector, value: float, *, slides: bool) -> JointFrame:
    """The frame of a joint's link in the joint's frame: turned by a value [rad], or shifted by it [m], along an axis of
    any length (Rodrigues' formula)."""
    direction = np.array(axis) / (np.linalg.norm(axis) or 1.0)
    if slides:
        return JointFrame(np.eye(3), value * direction)
    x, y, z = direction
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return JointFrame(np.eye(3) + math.sin(value) * K + (1.0 - math.cos(value)) * K @ K, np.zeros(3))


def angles_of(R: Array) -> Vector:
    """Roll, pitch and yaw of a rotation; if the pitch is a quarter turn, yaw is 0."""
    across = math.hypot(R[0, 0], R[1, 0])
    if across < 1e-9:
        return math.copysign(1.0, -R[2, 0]) * math.atan2(R[0, 1], R[1, 1]), math.atan2(-R[2, 0], across), 0.0
    return math.atan2(R[2, 1], R[2, 2]), math.atan2(-R[2, 0], across), math.atan2(R[1, 0], R[0, 0])


def rotation_of(rpy: Vector) -> Array:
    """The rotation of fixed angles roll, pitch, yaw [rad] (3, 3)."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def chain_of(table: ArmTable, tip_mass: float = 0.0) -> Chain:
    """The chain of a table; its joints turn about z or slide along it, so frames with another axis are rotated.

    tip_mass : of an additional body fixed to the tip [kg].

    Raises InvalidParameter: the table describes no movable arm, or its home is not within its stops.
    """
    n = len(table.joints)
    if not 1 <= n <= JOINTS:
        raise InvalidParameter(f"the joints of {table.name}", n, f"1 to {JOINTS}")
    for joint in table.joints:
        _check_joint(table.name, joint)
    free = table.free
    if len(table.home) != len(free):
        which = "each joint" if len(free) == n else f"each of {', '.join(joint.name for joint in free)}"
        raise InvalidParameter(f"home of {table.name}", table.home, f"{len(free)} angles, one for {which}")
    for joint, angle in zip(free, table.home, strict=True):
        _check_range(table.name, joint, angle)
    chain = zero_chain(n)
    chain.n = len(free)
    for link, led in zip(chain.links[1:], table.coordinates, strict=False):
        link.coordinate, link.multiplier, link.addend = led
    chain.tip_mass, chain.gamma[:] = tip_mass, table.gamma
    own = np.eye(3)  # the rotation of the chain's frame in the table's, for the previous link
    behind = 0.0
    moments: list[Array] = [np.zeros(3)]
    turns = [own]
    for link, joint in zip(chain.links[1:], table.joints, strict=True):
        turn = _to_z(table.name, joint)
        inertia, centre = np.array(joint.inertia), np.array(joint.centre)
        _check_body(table.name, joint, inertia)
        about = inertia + joint.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        second = 0.5 * np.trace(about) * np.eye(3) - about
        link.slides, link.armature = int(joint.slides), joint.armature
        link.rotation = (own.T @ rotation_of(joint.rpy) @ turn).tolist()
        link.offset = (own.T @ np.array(joint.xyz)).tolist()
        link.mass, link.moment = joint.mass, (joint.mass * turn.T @ centre).tolist()
        link.second = (turn.T @ second @ turn).tolist()
        own = turn
        turns.append(turn)
        moments.append(np.array(link.moment))
    chain.tip.arms[n][:] = (own.T @ np.array(table.tip)).tolist()
    for i in range(n, 0, -1):
        behind += chain.links[i].mass
        chain.tip.shifted[i - 1], chain.weight.shifted[i - 1] = 1.0, behind
        chain.tip.arms[i - 1][:] = chain.links[i].offset
        chain.weight.arms[i - 1][:] = (behind * np.array(chain.links[i].offset) + moments[i - 1]).tolist()
    chain.weight.arms[n][:] = moments[n].tolist()
    return chain


def _to_z(name: str, joint: Joint) -> Array:
    """A rotation whose third column is the joint's axis."""
    axis = np.array(joint.axis, dtype=float)
    length = float(np.linalg.norm(axis))
    if not 0.0 < length < math.inf:
        raise InvalidParameter(f"the axis of {name}'s joint {joint.name}", joint.axis, "a direction")
    z = axis / length
    if z[2] == 1.0:
        return np.eye(3)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def _check_range(name: str, joint: Joint, home: float) -> None:
    """Raise InvalidParameter if a free joint and its mimics have no range in common, or if home is outside of it."""
    of = f"of {name}'s joint {joint.name}"
    stops = f"{joint.lower:g} to {joint.upper:g} {joint.unit}"
    for what, value, allowed, holds in (
        ("the range", stops, "one that its mimics' stops leave to it", joint.lower < joint.upper),
        ("the range", stops, "finite for a slide", not joint.slides or math.isfinite(joint.upper - joint.lower)),
        ("home", home, f"within its stops, {stops}", math.isfinite(home) and joint.lower <= home <= joint.upper),
    ):
        if not holds:
            raise InvalidParameter(f"{what} {of}", value, allowed)


def _check_joint(name: str, joint: Joint) -> None:
    """Raise InvalidParameter if a limit or a loss would make energy."""
    of = f"of {name}'s joint {joint.name}"
    unit, force = joint.unit, "N" if joint.slides else "Nm"
    for what, value, allowed, holds in (
        ("the lower stop", joint.lower, f"below the upper one, {joint.upper:g} {unit}", joint.lower < joint.upper),
        ("the effort", joint.effort, f"above 0 {force}", joint.effort > 0.0),
        ("the speed", joint.speed, f"above 0 {unit}/s", joint.speed > 0.0),
        ("the damping", joint.damping, "a finite one, 0 or above", 0.0 <= joint.damping < math.inf),
        ("the friction", joint.friction, "a finite one, 0 or above", 0.0 <= joint.friction < math.inf),
        ("the armature", joint.armature, "a finite one, 0 or above", 0.0 <= joint.armature < math.inf),
    ):
        if not holds:
            raise InvalidParameter(f"{what} {of}", value, allowed)


def _check_body(name: str, joint: Joint, inertia: Array) -> None:
    """Raise InvalidParameter if the body's mass or moments of inertia are negative, or not finite."""
    numbers = np.isfinite(inertia).all() and math.isfinite(joint.mass)
    if not numbers or joint.mass < 0.0 or np.linalg.eigvalsh((inertia + inertia.T) / 2.0)[0] < -1e-12:
        has = f"{joint.mass:g} kg and {inertia.tolist()} kg m^2"
        why = f"the link that joint {joint.name} moves has {has}, as no body can have"
        raise InvalidParameter("the arm", name, "", why=why)


def home_of(joints: Sequence[Joint]) -> Vector:
    """The middle between each joint's stops; without two stops, the allowed angle nearest to 0 [rad]."""
    return tuple(
        0.5 * (joint.lower + joint.upper)
        if math.isfinite(joint.upper - joint.lower)
        else min(max(0.0, joint.lower), joint.upper)
        for joint in joints
    )


def apparent_masses(table: ArmTable) -> Vector:
    """The tip's apparent masses at home along the principal axes of ``(J M^-1 J')^-1`` [kg], ascending; infinite where
    the arm cannot move it."""
    J, M = at_home(table)
    mobility = np.linalg.eigvalsh(J @ np.linalg.solve(M, J.T))
    return tuple([float(1.0 / one) if one > 1e-9 * mobility[-1] else math.inf for one in mobility[::-1]])


def felt_damping(table: ArmTable) -> float:
    """The joints' smallest damping at the tip at home in any direction [Ns/m]; infinite if the tip does not move."""
    b = np.array([joint.damping for joint in table.free])
    if not (b > 0.0).all():
        return 0.0
    J, _ = at_home(table)
    return float(1.0 / most) if (most := np.linalg.eigvalsh((J / b) @ J.T)[-1]) > 0.0 else math.inf


def at_home(table: ArmTable) -> tuple[Array, Array]:
    """J (3, n) and M (n, n) at home. Raises InvalidParameter: as `chain_of`, or a joint turns nothing there."""
    chain, home = chain_of(table), list(table.home)
    matrices(chain, home, [0.0] * chain.n)
    difference(chain, chain.tip, home, home)
    J, M = np.array(chain.tip.columns)[: chain.n].T, np.array(chain.inertia)[: chain.n, : chain.n]
    if np.abs(J).max() <= _ROUNDING * max(table.reaches):
        J[:] = 0.0
    least, directions = np.linalg.eigh(M)
    bodies = added(
        [joint.mass * np.dot(joint.centre, joint.centre) + np.trace(joint.inertia) for joint in table.joints]
    )
    if not least[0] > _ROUNDING * max(least[-1], bodies):
        joint = table.free[int(np.argmax(np.abs(directions[:, 0])))]
        verb, unit = ("moves", "kg") if joint.slides else ("turns", "kg m^2")
        name = f"the inertia that {table.name}'s joint {joint.name} {verb} at home [{unit}]"
        raise InvalidParameter(name, 0.0, "above 0, from an <inertia> or from a mass off the joint's axis")
    return J, M


UPPER_M, FORE_M = 0.134, 0.1325
FORCE_N = 3.3
_UPPER_KG, _FORE_KG = 0.04, 0.03
_UPPER_CENTRE_M, _FORE_CENTRE_M = 0.05, 0.04
_BASE_KGM2, _UPPER_KGM2, _FORE_KGM2 = 6.369e-4, 2.6934e-4, 7.9003e-4
_BASE_KG, _ALONG_KGM2 = 0.1, 1e-6
_HOME = (0.0, 0.8, 1.5 - math.pi / 2.0)
"""The bars are at right angles."""

_DAMPING_NSPM = 0.3
_PLANE_NSPM = 0.778
"""The damping across the bars, where shoulder and elbow both move with the tip."""


def _bar(about_end: float, mass: float, centre: float) -> tuple[tuple[float, float, float], ...]:
    """The inertia of a thin bar along y about its centre, from that about its joint."""
    inertia = about_end - mass * centre * centre
    return (inertia, 0.0, 0.0), (0.0, _ALONG_KGM2, 0.0), (0.0, 0.0, inertia)


def omni() -> ArmTable:
    """The built-in arm."""
    reach = UPPER_M * math.cos(_HOME[1]) + FORE_M * math.sin(_HOME[1])
    levers = (reach, UPPER_M, FORE_M)
    efforts = [FORCE_N * lever for lever in levers]
    damping = [b * lever * lever for b, lever in zip((_DAMPING_NSPM, _PLANE_NSPM, _PLANE_NSPM), levers, strict=True)]
    turning = ((_BASE_KGM2, 0.0, 0.0), (0.0, _BASE_KGM2, 0.0), (0.0, 0.0, _BASE_KGM2))
    x = (1.0, 0.0, 0.0)
    upper, fore = _bar(_UPPER_KGM2, _UPPER_KG, _UPPER_CENTRE_M), _bar(_FORE_KGM2, _FORE_KG, _FORE_CENTRE_M)
    joints = (
        Joint("waist", (0.0, 0.0, 0.09), mass=_BASE_KG, inertia=turning, lower=-0.98, upper=0.98),
        Joint("shoulder", (0.0, 0.0, 0.035), axis=x, mass=_UPPER_KG, centre=(0.0, _UPPER_CENTRE_M, 0.0), inertia=upper,
              lower=0.0, upper=1.75),
        Joint("elbow", (0.0, UPPER_M, 0.0), (-1.5, 0.0, 0.0), x, _FORE_KG, (0.0, _FORE_CENTRE_M, 0.0), fore, -0.81,
              1.25),
    )  # fmt: skip
    moved = [
        replace(joint, effort=effort, damping=b) for joint, effort, b in zip(joints, efforts, damping, strict=True)
    ]
    return ArmTable("omni", tuple(moved), (0.0, FORE_M, 0.0), _HOME)
