"""A device or a robot behind topics of ROS 2, over rmw_zenoh and without ROS. Its page is ros2.md beside it.

`read` waits for the next message on the state's topic. So there is one command for each state, and the account counts
each force over the interval between two positions in which it acted.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from hapnet.checks import Vector
from hapnet.devices.driver import NO_FORCE, Axes, Driver
from hapnet.errors import BadMessage, DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices.timed_velocity import TimedVelocity
from hapnet.ext.robots.ros2_inbox import PERIODS, Inbox
from hapnet.installing import install_command
from hapnet.transport.ros2 import ROUTER, RosNode, check_topic, missing

T = TypeVar("T")

POSE, WRENCH, JOINTS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/WrenchStamped",
    "sensor_msgs/msg/JointState",
)

NOISE = 1e-4
"""Peak-to-peak noise of positions at the times of their receipt [m] or [rad], for the fit of a velocity."""

_START_S = 10.0
_NS = 1e-9


@dataclass(slots=True)
class _Newest:
    """The newest orientation, the force that acted, and the force of the surroundings with its time [ns]."""

    quaternion: Vector | None = None
    acted: Vector | None = None
    touched: tuple[Vector, int] | None = None
    frame: str = ""
    """The frame_id of the pose."""


class Ros2(Driver):
    """Positions come from one topic, forces go to another: ``ros2:/arm/current_pose,command=/arm/target_wrench``.

    state : topic of the positions, PoseStamped; with `joints`, JointState. command : topic on which the forces go out,
    WrenchStamped or JointState (its efforts); empty: none, a device without force. measured : topic of the
    force that the actuators made, of the command's type; empty: not known. contact : topic of the force of the
    surroundings on the robot, likewise; a wrench in the pose's frame. joints : names joined by +, the scene's axes;
    empty: a pose. axes : of a pose, as in `Axes`. rate : of the states [Hz]. router : of ROS 2. domain :
    ROS_DOMAIN_ID. frame : the command's frame_id. contact_rate : of the topic `contact` [Hz]; 0: as `rate`.

    Raises InvalidParameter: an option is not allowed. MissingLibrary: the extra `ros2` is not installed. HapnetError:
    there is no router, or no message comes on the state's topic.
    """

    about = "a device or robot behind ROS 2 topics (rmw_zenoh), without ROS"
    tested = "tested with rmw_zenoh's layout, not with ROS"
    blocking = True

    def __init__(
        self,
        dof: int,
        state: str = "/target_pose",
        command: str = "",
        measured: str = "",
        contact: str = "",
        joints: str = "",
        axes: str = "",
        rate: float = 100.0,
        router: str = ROUTER,
        domain: int = 0,
        frame: str = "base_link",
        contact_rate: float = 0.0,
    ) -> None:
        for name, topic in (("state", state), ("command", command), ("measured", measured), ("contact", contact)):
            if topic or name == "state":
                check_topic(name, topic)
        if not 10.0 <= rate <= 1000.0:
            raise InvalidParameter("rate", rate, "10 to 1000 Hz")
        if contact_rate and not 1.0 <= contact_rate <= 1000.0:
            raise InvalidParameter("contact_rate", contact_rate, "1 to 1000 Hz, or 0: as rate")
        names = joints.split("+") if joints else []
        if names and (len(names) != dof or len(set(names)) != dof or not all(names)):
            raise InvalidParameter("joints", joints, f"{dof} names of joints, one for each axis of the scene")
        self.dof = dof
        self.rate_hz: float | None = rate
        self.units: str = "rad" if names else "m"
        self.knows_force: bool = bool(measured)
        if not command:
            self.force_limit, self.smallest_mass = NO_FORCE, 1.0
        self._names, self._axes = names, None if names else Axes(axes, dof)
        self._turns = axes in ("", "xyz")
        self._state, self._command, self._frame = state, command, frame
        self._wait_s = 2.0 / rate
        self._velocity = [TimedVelocity(math.inf, NOISE) for _ in range(dof)]
        self._newest = _Newest()
        self._node = RosNode("hapnet", domain=domain, router=router)
        self._states = Inbox(self._position, 1.0 / rate, time.monotonic_ns)
        self._measured = Inbox(self._force, 1.0 / rate, time.monotonic_ns)
        contact_s = 1.0 / (contact_rate or rate)
        self._contacts = Inbox(self._contact, contact_s, time.monotonic_ns)
        self._contact_ends_s = PERIODS * contact_s
        self._node.open()
        self._node.subscribe(state, JOINTS if names else POSE, self._states.take)
        self._first(self._states, state)
        for topic, inbox in ((measured, self._measured), (contact, self._contacts)):
            if topic:
                self._node.subscribe(topic, JOINTS if names else WRENCH, inbox.take)
        if contact:
            self._first(self._contacts, contact)  # the first message is always used, later ones only in time
            why = f", or slower than {1.0 / contact_s:g} Hz: contact_rate"
            self._newest.touched = self._first(self._contacts, contact, why)

    @classmethod
    def missing(cls) -> str:
        return f"{' and '.join(missing().split())}: {install_command(missing())}" if missing() else ""

    def read(self) -> tuple[Vector, Vector]:
        if (newest := self._states.next(self._wait_s)) is None:
            for velocity in self._velocity:
                velocity.restart()
            unused = self._states.unused
            raise DeviceSilent(f"nothing new on {self._state}" + (f" ({unused} so far)" if unused else ""))
        (x, self._newest.quaternion), came_ns = newest
        at_s = came_ns * _NS
        force = self._measured.next()
        self._newest.acted = None if force is None else force[0]
        self._newest.touched = self._contacts.next() or self._newest.touched
        return x, tuple([velocity.update(at_s, at_s, axis) for velocity, axis in zip(self._velocity, x, strict=True)])

    def apply(self, force: Vector) -> Vector | None:
        if not self._command:
            return (0.0,) * self.dof
        make = self._node.types.classes
        seconds, rest = divmod(self._node.wall_ns(), 1_000_000_000)
        header = make["std_msgs/msg/Header"](make["builtin_interfaces/msg/Time"](seconds, rest), self._frame)
        if self._axes is None:
            none = np.zeros(0)
            message = make[JOINTS](header, self._names, none, none, np.array(force))
            self._node.publish(self._command, JOINTS, message)
            return None
        vector = make["geometry_msgs/msg/Vector3"]
        wrench = make["geometry_msgs/msg/Wrench"](vector(*self._axes.spread(force)), vector(0.0, 0.0, 0.0))
        self._node.publish(self._command, WRENCH, make[WRENCH](header, wrench))
        return None

    def acted(self) -> Vector | None:
        return self._newest.acted

    def contact_force(self) -> Vector | None:
        if self._newest.touched is None or (time.monotonic_ns() - self._newest.touched[1]) * _NS > self._contact_ends_s:
            return None
        return self._newest.touched[0]

    def orientation(self) -> Vector | None:
        return self._newest.quaternion if self._turns else None

    def close(self) -> None:
        self._node.close()

    def _first(self, inbox: Inbox[T], topic: str, why: str = "") -> tuple[T, int]:
        """The next value on this topic, at the start. Raises HapnetError: none comes. why : a reason, for it."""
        if (found := inbox.next(_START_S)) is None:
            self.close()
            but = f" but {inbox.unused}" if inbox.unused else ""
            raise HapnetError(f"nothing on {topic} within {_START_S:g} s{but}{why}")
        return found

    def _position(self, data: bytes) -> tuple[Vector, Vector | None]:
        """Position and orientation in a message; joints have no orientation."""
        if self._axes is None:
            return self._of_joints(data, "position"), None
        stamped = self._node.types.decode(POSE, data)
        pose, self._newest.frame = stamped.pose, stamped.header.frame_id
        at, turned = pose.position, pose.orientation
        quaternion = _finite(turned.w, turned.x, turned.y, turned.z)
        if (size := math.hypot(*quaternion)) < 0.5:
            raise BadMessage("orientation", f"a quaternion of length {size:.2g}")
        return self._axes.take(_finite(at.x, at.y, at.z)), tuple([part / size for part in quaternion])

    def _force(self, data: bytes) -> Vector:
        if self._axes is None:
            return self._of_joints(data, "effort")
        force = self._node.types.decode(WRENCH, data).wrench.force
        return self._axes.take(_finite(force.x, force.y, force.z))

    def _contact(self, data: bytes) -> Vector:
        """As `_force`, but refuse a wrench in another frame than the pose's, whose direction is not known."""
        if self._axes is not None:
            frame = self._node.types.decode(WRENCH, data).header.frame_id
            if frame != self._newest.frame:
                raise BadMessage("frame_id", f"{frame!r}; allowed: {self._newest.frame!r}, that of {self._state}")
        return self._force(data)

    def _of_joints(self, data: bytes, part: str) -> Vector:
        message = self._node.types.decode(JOINTS, data)
        values = dict(zip(message.name, getattr(message, part), strict=False))
        try:
            return _finite(*[values[name] for name in self._names])
        except KeyError as error:
            raise BadMessage("joints", f"no {part} of {error}") from None


def _finite(*values: Any) -> Vector:
    found = tuple(map(float, values))
    if not all(map(math.isfinite, found)):
        raise BadMessage("number", f"{found}")
    return found
