"""The leader's arm as a device of hapnet: one reading for each action of LeRobot."""

from __future__ import annotations

import math
import threading
import time

from hapnet.devices import DeviceSilent

SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""The names of SO-100's and SO-101's joints in LeRobot."""

DEGREE_RAD = 0.017453292519943295

STALE_S = 0.5
"""Longest time without an action; after it the device is silent, and the other side applies its `on_silence`."""

_PATIENCE = 1.5
"""A reading waits for the next action for this many periods of LeRobot's loop, then the last place is read again."""

_RENDERED_S = 0.004
"""The longest time in which the force of a new action comes [s]; after it the force of the previous action holds."""

_MOST_MEASURED = 1.9
"""A measured torque counts up to this many times the force limit: a servo that a hand turns fast brakes harder, and
work that it takes out is then counted too low, never too high. hapnet refuses more than twice the limit."""

Vector = tuple[float, ...]


class Hand:
    """The device. speed : the greatest, of all axes together [rad/s]. fps : of LeRobot's loop.

    Attributes
    ----------
    felt : the force for the hand [Nm]. zero : the remote robot's position, in LeRobot's units, where the mass is at 0;
    None: not known. joints : the remote robot's, as a text; empty: not known, or the peer is not LeRobot.
    """

    units = "rad"
    resolution = 0.0
    blocking = True

    def __init__(self, dof: int, speed: float, fps: float, force_limit: float) -> None:
        self.dof = dof
        self.greatest_speed = 1.01 * speed
        self.force_limit = force_limit
        self.zero: Vector | None = None
        self.joints = ""
        self.felt = self._none = (0.0,) * dof
        self._x = self._goal = self._none
        self._speed, self._period_s = speed, 1.0 / fps
        self._turn = threading.Condition()
        self._is_new = self._is_felt = False
        self._measured: Vector | None = None
        self._acted: Vector | None = None
        self._read_s = time.monotonic()
        self._dt = 0.0
        self._action_s: float | None = None

    def go(self, goal: Vector, measured: Vector | None = None) -> Vector:
        """Move to an action's place [rad]; returns the force for the hand there [Nm].

        measured : the motors' mean torque since the previous action [Nm]; None: the leader has no force.
        """
        most = _MOST_MEASURED * self.force_limit
        if measured is not None:
            measured = tuple(max(-most, min(most, one)) for one in measured)
        with self._turn:
            self._goal, self._measured, self._action_s = goal, measured, time.monotonic()
            self._is_new, self._is_felt = True, False
            self._turn.notify_all()
            if measured is not None:
                self._turn.wait_for(lambda: self._is_felt, _RENDERED_S)
            return self.felt

    def read(self) -> tuple[Vector, Vector]:
        with self._turn:
            is_new = self._turn.wait_for(lambda: self._is_new, _PATIENCE * self._period_s)
            self._is_new = False
            now, goal = time.monotonic(), self._goal
            if self._action_s is not None and now - self._action_s > STALE_S:
                raise DeviceSilent(f"no action for {STALE_S:g} s")
            # a repeated place has not moved, so no work is counted before the next action
            self._acted = self._measured if is_new else self._none
        self._dt, self._read_s = now - self._read_s, now
        left = tuple(g - x for g, x in zip(goal, self._x, strict=True))
        far, most = math.hypot(*left), self._speed * self._dt
        share = 1.0 if far <= most else most / far
        moved = tuple(share * one for one in left)
        self._x = tuple(x + m for x, m in zip(self._x, moved, strict=True))
        return self._x, tuple(m / self._dt if self._dt > 0.0 else 0.0 for m in moved)

    def apply(self, force: Vector) -> Vector:
        with self._turn:
            self.felt, self._is_felt = force, True
            self._turn.notify_all()
            return self._none if self._measured is None else force

    def acted(self) -> Vector | None:
        return self._none if self._acted is None else self._acted

    def interval(self) -> float | None:
        return self._dt or None

    def signal(self, name: str, value: object) -> None:
        """Take what LeRobot's side with the robot says: the robot's joints, and its position at the mass's 0."""
        if name == "joints" and isinstance(value, str):
            self.joints = value
        elif name == "zero" and isinstance(value, tuple | list):
            self.zero = tuple(float(one) for one in value)
