"""The topics on which a robot or a device of ROS 2 publishes its positions, its orientation and its forces.

`wait` gives the next state. So a driver can answer each state with one command, and the account counts each force
over the interval between two positions in which it acted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from hapnet.checks import Vector
from hapnet.devices.driver import Axes
from hapnet.errors import BadMessage, DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices.timed_velocity import TimedVelocity
from hapnet.ext.robots.ros2_inbox import PERIODS, Inbox
from hapnet.transport.ros2 import RosNode, check_topic

T = TypeVar("T")

POSE, WRENCH, JOINTS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/JointState",
)

NOISE = 1e-4
"""Peak-to-peak noise of positions at the times of their receipt [m] or [rad], for the fit of a velocity."""

START_S = 10.0
"""The longest wait for the first message of a topic [s]."""

_NS = 1e-9


class TopicNames(NamedTuple):
    """The topics that come, and their rates, as `hapnet.ext.robots.ros2.Ros2` takes them."""

    state: str
    measured: str
    contact: str
    joints: str
    axes: str
    rate: float
    contact_rate: float

    def check(self, dof: int) -> list[str]:
        """The joints' names; none for a pose. Raises InvalidParameter."""
        for name in ("state", "measured", "contact"):
            topic = getattr(self, name)
            if topic or name == "state":
                check_topic(name, topic)
        if not 10.0 <= self.rate <= 1000.0:
            raise InvalidParameter("rate", self.rate, "10 to 1000 Hz")
        if self.contact_rate and not 1.0 <= self.contact_rate <= 1000.0:
            raise InvalidParameter("contact_rate", self.contact_rate, "1 to 1000 Hz, or 0: as rate")
        names = self.joints.split("+") if self.joints else []
        if names and (len(names) != dof or len(set(names)) != dof or not all(names)):
            raise InvalidParameter("joints", self.joints, f"{dof} names of joints, one for each axis of the scene")
        return names


@dataclass(slots=True)
class _Newest:
    """The newest orientation, the force that acted, and the force of the surroundings with its time [ns]."""

    quaternion: Vector | None = None
    acted: Vector | None = None
    touched: tuple[Vector, int] | None = None
    frame: str = ""
    """The frame_id of the pose."""
    place: Vector = ()
    """The pose's three coordinates."""


class RosTopics:
    """The topics of one robot: subscribed from the start, with the first state and contact force received.

    names : see `TopicNames`. node : not open yet. clock : monotonic [ns].

    Raises InvalidParameter: a name is not allowed. HapnetError: there is no router, or nothing comes on a topic.
    """

    def __init__(
        self, dof: int, names: TopicNames, node: RosNode, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.joints: list[str] = names.check(dof)
        self.axes: Axes | None = None if self.joints else Axes(names.axes, dof)
        self.node: RosNode = node
        self.turns: bool = names.axes in ("", "xyz")
        self._state, self._clock = names.state, clock
        self._velocity = [TimedVelocity(math.inf, NOISE) for _ in range(dof)]
        self._newest = _Newest()
        self._states = Inbox(self._position, 1.0 / names.rate, clock)
        self._measured = Inbox(self._force, 1.0 / names.rate, clock)
        contact_s = 1.0 / (names.contact_rate or names.rate)
        self._contacts = Inbox(self._contact, contact_s, clock)
        self._contact_ends_s = PERIODS * contact_s
        node.open()
        node.subscribe(names.state, JOINTS if self.joints else POSE, self._states.take)
        (x, self._newest.quaternion), came_ns = self._first(self._states, names.state)
        self.first: tuple[Vector, int] = x, came_ns  #: the first position, and when it came [ns]
        for topic, inbox in ((names.measured, self._measured), (names.contact, self._contacts)):
            if topic:
                node.subscribe(topic, JOINTS if self.joints else WRENCH, inbox.take)
        if names.contact:
            self._first(self._contacts, names.contact)  # the first message is always used, later ones only in time
            why = f", or slower than {1.0 / contact_s:g} Hz: contact_rate"
            self._newest.touched = self._first(self._contacts, names.contact, why)

    @property
    def frame(self) -> str:
        """The frame_id of the newest pose."""
        return self._newest.frame

    @property
    def place(self) -> Vector:
        """All three coordinates of the newest pose [m]; empty for joints."""
        return self._newest.place

    def wait(self, wait_s: float) -> tuple[Vector, Vector]:
        """The next position and its velocity, waiting at most `wait_s`. Raises DeviceSilent: none came."""
        if (newest := self.next(wait_s)) is None:
            for velocity in self._velocity:
                velocity.restart()
            raise DeviceSilent(self.silence)
        x, came_ns = newest
        at_s = came_ns * _NS
        return x, tuple([velocity.update(at_s, at_s, axis) for velocity, axis in zip(self._velocity, x, strict=True)])

    def next(self, wait_s: float) -> tuple[Vector, int] | None:
        """The next position and when it came [ns], waiting at most `wait_s`; None: none came."""
        if (newest := self._states.next(wait_s)) is None:
            return None
        (x, self._newest.quaternion), came_ns = newest
        force = self._measured.next()
        self._newest.acted = None if force is None else force[0]
        self._newest.touched = self._contacts.next() or self._newest.touched
        return x, came_ns

    @property
    def silence(self) -> str:
        """A text that names the silent topic, with the counts of unused messages."""
        unused = self._states.unused
        return f"nothing new on {self._state}" + (f" ({unused} so far)" if unused else "")

    def acted(self) -> Vector | None:
        """The force that the actuators made, as of the last state; None: it is not known."""
        return self._newest.acted

    def contact_force(self) -> Vector | None:
        """The force of the surroundings on the robot; None: none came for three of its periods."""
        touched = self._newest.touched
        if touched is None or (self._clock() - touched[1]) * _NS > self._contact_ends_s:
            return None
        return touched[0]

    def orientation(self) -> Vector | None:
        """The orientation of the newest pose, a unit quaternion w, x, y, z; None: it is not known."""
        return self._newest.quaternion

    def _first(self, inbox: Inbox[T], topic: str, why: str = "") -> tuple[T, int]:
        """The next value on this topic, at the start. Raises HapnetError: none comes. why : a reason, for it."""
        if (found := inbox.next(START_S)) is None:
            self.node.close()
            but = f" but {inbox.unused}" if inbox.unused else ""
            raise HapnetError(f"nothing on {topic} within {START_S:g} s{but}{why}")
        return found

    def _position(self, data: bytes) -> tuple[Vector, Vector | None]:
        """Position and orientation in a message; joints have no orientation."""
        if self.axes is None:
            return self._of_joints(data, "position"), None
        stamped = self.node.types.decode(POSE, data)
        pose, self._newest.frame = stamped.pose, stamped.header.frame_id
        at, turned = pose.position, pose.orientation
        quaternion = _finite(turned.w, turned.x, turned.y, turned.z)
        if (size := math.hypot(*quaternion)) < 0.5:
            raise BadMessage("orientation", f"a quaternion of length {size:.2g}")
        self._newest.place = place = _finite(at.x, at.y, at.z)
        return self.axes.take(place), tuple([part / size for part in quaternion])

    def _force(self, data: bytes) -> Vector:
        if self.axes is None:
            return self._of_joints(data, "effort")
        force = self.node.types.decode(WRENCH, data).wrench.force
        return self.axes.take(_finite(force.x, force.y, force.z))

    def _contact(self, data: bytes) -> Vector:
        """As `_force`, but refuse a wrench in another frame than the pose's, whose direction is not known."""
        if self.axes is not None:
            frame = self.node.types.decode(WRENCH, data).header.frame_id
            if frame != self._newest.frame:
                raise BadMessage("frame_id", f"{frame!r}; allowed: {self._newest.frame!r}, that of {self._state}")
        return self._force(data)

    def _of_joints(self, data: bytes, part: str) -> Vector:
        message = self.node.types.decode(JOINTS, data)
        values = dict(zip(message.name, getattr(message, part), strict=False))
        try:
            return _finite(*[values[name] for name in self.joints])
        except KeyError as error:
            raise BadMessage("joints", f"no {part} of {error}") from None


def header(node: RosNode, frame: str) -> Any:
    """A header with the time now, in UTC."""
    make = node.types.classes
    seconds, rest = divmod(node.wall_ns(), 1_000_000_000)
    return make["std_msgs/msg/Header"](make["builtin_interfaces/msg/Time"](seconds, rest), frame)


def _finite(*values: Any) -> Vector:
    found = tuple(map(float, values))
    if not all(map(math.isfinite, found)):
        raise BadMessage("number", f"{found}")
    return found
