"""The servo of each joint of an arm, from its table of links and a calibration file of hapnet or LeRobot.

hapnet's file is a JSON object with the joints' names, and for each joint its servo's ``id``, the count at angle 0
(``zero``), and whether its count falls where the angle grows (``reversed``). LeRobot's file has ``id``, ``drive_mode``,
``homing_offset``, ``range_min`` and ``range_max``: the joint is at 0 in the middle of its range, as LeRobot's degrees
are, and its range is its stops. The offset is in the servo itself. Joints beyond the tip are left out.

The last joint may be a jaw, if the tip is its moving finger. The axis of its opening is the last one.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from hapnet import checks
from hapnet.devices.driver import Axes
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.chain import Chain, difference, gravity, height
from hapnet.ext.arms.table import ArmTable, chain_of, omni
from hapnet.ext.arms.urdf import table_from
from hapnet.file_content import read_json, read_text
from hapnet.records.vectors import inner

COUNTS = 4096
"""Counts of a servo's encoder in a turn."""

COUNT_RAD = 2.0 * math.pi / COUNTS


class JointServo(NamedTuple):
    """A servo of a joint: its angle is ``sign (count - zero)`` counts; lower, upper : the joint's stops [rad]."""

    name: str
    servo: int
    zero: float = COUNTS / 2
    sign: int = 1
    lower: float = -math.inf
    upper: float = math.inf
    offset: int | None = None
    """The required homing offset in the servo's own register; None: any."""

    def angle(self, count: int) -> float:
        """The joint's angle [rad]."""
        return self.sign * (count - self.zero) * COUNT_RAD

    def count(self, angle: float) -> int:
        """The count nearest to an angle [rad]."""
        return round(self.zero + self.sign * angle / COUNT_RAD)


def arm_table(arm: str, tip: str) -> ArmTable:
    """The arm ``omni``, or the arm of a URDF file with the link `tip` as its tip. Raises InvalidParameter."""
    if arm == "omni":
        return omni()
    table = table_from(_text("arm", arm, "omni, or a URDF file that can be read"), Path(arm).name, tip)
    for joint in table.free:
        if joint.slides:
            raise InvalidParameter("arm", arm, f"an arm whose joints turn (its joint {joint.name} is prismatic)")
    return table


def joints_of(table: ArmTable, calibration: str, *, in_servo: bool) -> tuple[JointServo, ...]:
    """The servos of an arm's free joints, in its order; without a file servos 1, 2, ... with zeros at half a turn.

    in_servo : whether a servo itself reverses its counts, where LeRobot's ``drive_mode`` is set.

    Raises InvalidParameter: the file cannot be read, or lacks a joint.
    """
    if not calibration:
        return tuple(
            JointServo(joint.name, k, lower=joint.lower, upper=joint.upper) for k, joint in enumerate(table.free, 1)
        )
    text = _text("calibration", calibration, "a file of JSON that can be read")
    try:
        found = read_json(text)
        return tuple(_joint(joint.name, found[joint.name], joint.lower, joint.upper, in_servo) for joint in table.free)
    except ValueError as error:
        raise InvalidParameter("calibration", calibration, f"a file of JSON ({error})") from None
    except (KeyError, TypeError, AttributeError) as error:
        names = ", ".join(joint.name for joint in table.free)
        raise InvalidParameter(
            "calibration", calibration, f"one with the joints {names}, each with id and zero, or as LeRobot ({error})"
        ) from None


def _joint(name: str, given: dict[str, Any], lower: float, upper: float, in_servo: bool) -> JointServo:
    servo = checks.whole(f"id of {name}", given["id"], at_least=0)
    if "zero" in given:
        return JointServo(
            name, servo, float(given["zero"]), -1 if given.get("reversed", False) else 1, lower, upper, None
        )
    least, most = sorted((int(given["range_min"]), int(given["range_max"])))
    half = 0.5 * (most - least) * COUNT_RAD
    sign = -1 if given.get("drive_mode", 0) and not in_servo else 1
    return JointServo(name, servo, 0.5 * (least + most), sign, -half, half, int(given["homing_offset"]))


def _text(name: str, path: str, allowed: str) -> str:
    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidParameter(name, path, f"{allowed} ({getattr(error, 'strerror', None) or error})") from None


class Jaw(NamedTuple):
    """The last joint as a jaw, closed at an angle [rad]. lever : its opening per radian [m/rad], negative if it closes
    as the angle grows; 1 or -1 with the joints as axes."""

    closed: float
    lever: float

    @classmethod
    def of(cls, joint: JointServo, lever: float) -> Jaw:
        """The jaw that is closed at its joint's stop; at angle 0 without a stop."""
        stop = joint.lower if lever > 0.0 else joint.upper
        return cls(stop if math.isfinite(stop) else 0.0, lever)


class Posture:
    """An arm's kinematics and weight in a given posture. axes : those of its tip; None: its axes are the joints.
    jaw : the last joint as a jaw; None: it is none.

    Attributes
    ----------
    q : the joints' angles [rad]. x : the axes' position, from home. levers : how each joint moves the tip, J'.
    weight : the torques that carry the arm [Nm]. stored_J : the potential of its weight.
    """

    def __init__(self, table: ArmTable, axes: Axes | None, jaw: Jaw | None = None) -> None:
        self._chain: Chain = chain_of(table)
        self._home, self._axes, self._jaw = table.home, axes, jaw
        n = len(table.home)
        self._loads = [0.0] * n
        self.x: tuple[float, ...] = ()
        self.levers: list[list[float]] = [[float(i == k) for k in range(n)] for i in range(n)]
        difference(self._chain, self._chain.tip, list(self._home), list(self._home))
        self._origin = tuple(self._chain.tip.begin)
        self.look(self._home)

    def look(self, q: tuple[float, ...]) -> None:
        """Take this posture."""
        chain, self.q = self._chain, q
        angles = list(q)
        if self._axes is None:
            self.x = tuple([angle - home for angle, home in zip(q, self._home, strict=True)])
        else:
            difference(chain, chain.tip, angles, angles)
            self.x = self._axes.take(
                tuple([here - home for here, home in zip(chain.tip.begin, self._origin, strict=True)])
            )
            self.levers = [list(column) for column in chain.tip.columns[: chain.n]]
        if (jaw := self._jaw) is not None:
            opening = jaw.lever * (q[-1] - jaw.closed)
            if self._axes is None:
                self.x = (*self.x[:-1], opening)
                self.levers[-1][-1] = jaw.lever
            else:
                self.x = (*self.x, opening)
                self.levers = [[*lever, 0.0] for lever in self.levers[:-1]] + [[*self.levers[-1], jaw.lever]]
        gravity(chain, angles, angles, self._loads)
        self.weight = tuple(self._loads)
        self.stored_J = height(chain, angles)

    def torques(self, force: tuple[float, ...]) -> tuple[float, ...]:
        """The joints' torques of a force, J'F [Nm]."""
        whole = self._spread(force)
        return tuple([inner(lever, whole) for lever in self.levers])

    def parts(self, force: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        """The parts of a force that are limited each by itself: that of the jaw, then the rest."""
        if self._jaw is None:
            return (force,)
        return (*(0.0,) * (len(force) - 1), force[-1]), (*force[:-1], 0.0)

    def velocity(self, rates: tuple[float, ...]) -> tuple[float, ...]:
        """The velocity along the axes, J q'."""
        whole = tuple(
            [
                sum(lever[r] * rate for lever, rate in zip(self.levers, rates, strict=True))
                for r in range(len(self.levers[0]))
            ]
        )
        if self._axes is None:
            return whole
        return self._axes.take(whole[:3]) + whole[3:]

    def _spread(self, force: tuple[float, ...]) -> tuple[float, ...]:
        """The force along all axes of the levers."""
        if self._axes is None:
            return force
        if self._jaw is None:
            return self._axes.spread(force)
        return (*self._axes.spread(force[:-1]), force[-1])
