"""A device or a robot behind topics of ROS 2, over rmw_zenoh and without ROS. Its page is ros2.md beside it.

`read` waits for the next message on the state's topic. So there is one command for each state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapnet.checks import Vector
from hapnet.devices.driver import NO_FORCE, Driver
from hapnet.errors import InvalidParameter
from hapnet.ext.robots.ros2_positions import KINDS, Ros2Positions
from hapnet.ext.robots.ros2_topics import JOINTS, WRENCH, RosTopics, TopicNames, header
from hapnet.installing import install_command
from hapnet.transport.ros2 import ROUTER, RosNode, check_topic, missing

FORCES = {"WrenchStamped": WRENCH, "JointState": JOINTS}
"""The types of commands that are forces."""


class Ros2(Driver):
    """Positions come from one topic, forces go to another: ``ros2:/arm/current_pose,command=/arm/target_wrench``.

    state : topic of the positions, PoseStamped; with `joints`, JointState. command : topic on which the forces go out,
    WrenchStamped or JointState (its efforts); empty: none, a device without force. measured : topic of the
    force that the actuators made, of the command's type; empty: not known. contact : topic of the force of the
    surroundings on the robot, likewise; a wrench in the pose's frame. joints : names joined by +, the scene's axes;
    empty: a pose. axes : of a pose, as in `Axes`. rate : of the states [Hz]. router : of ROS 2. domain :
    ROS_DOMAIN_ID. frame : the command's frame_id. contact_rate : of the topic `contact` [Hz]; 0: as `rate`. type : of
    the command; with a type of `hapnet.ext.robots.ros2_positions.KINDS` the driver is a `Ros2Positions`.

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
        type: str = "",
    ) -> None:
        if command:
            check_topic("command", command)
        fits = "JointState" if joints else "WrenchStamped"
        if type not in ("", fits):
            raise InvalidParameter("type", type, f"{fits} {'with' if joints else 'without'} joints")
        self.dof = dof
        self.rate_hz: float | None = rate
        self.units: str = "rad" if joints else "m"
        self.knows_force: bool = bool(measured)
        if not command:
            self.force_limit, self.smallest_mass = NO_FORCE, 1.0
        self._command, self._frame = command, frame
        self._wait_s = 2.0 / rate
        names = TopicNames(state, measured, contact, joints, axes, rate, contact_rate)
        names.check(dof)
        self._topics = RosTopics(dof, names, RosNode("hapnet", domain=domain, router=router))

    @classmethod
    def class_for_options(cls, options: str) -> type[Any]:
        """The class of a device with these options: a robot that takes positions if `type` is one of their types.

        Raises InvalidParameter: there is no such type.
        """
        kind = next((entry[5:] for entry in options.split(",") if entry.startswith("type=")), "")
        if kind in KINDS:
            return Ros2Positions
        if kind and kind not in FORCES:
            raise InvalidParameter("type", kind, ", ".join((*FORCES, *KINDS)), (*FORCES, *KINDS))
        return cls

    @classmethod
    def missing(cls) -> str:
        return f"{' and '.join(missing().split())}: {install_command(missing())}" if missing() else ""

    def read(self) -> tuple[Vector, Vector]:
        return self._topics.wait(self._wait_s)

    def apply(self, force: Vector) -> Vector | None:
        if not self._command:
            return (0.0,) * self.dof
        topics = self._topics
        node, make = topics.node, topics.node.types.classes
        now = header(node, self._frame)
        if topics.axes is None:
            none = np.zeros(0)
            node.publish(self._command, JOINTS, make[JOINTS](now, topics.joints, none, none, np.array(force)))
            return None
        vector = make["geometry_msgs/msg/Vector3"]
        wrench = make["geometry_msgs/msg/Wrench"](vector(*topics.axes.spread(force)), vector(0.0, 0.0, 0.0))
        node.publish(self._command, WRENCH, make[WRENCH](now, wrench))
        return None

    def acted(self) -> Vector | None:
        return self._topics.acted()

    def contact_force(self) -> Vector | None:
        return self._topics.contact_force()

    def orientation(self) -> Vector | None:
        return self._topics.orientation() if self._topics.turns else None

    def close(self) -> None:
        self._topics.node.close()
