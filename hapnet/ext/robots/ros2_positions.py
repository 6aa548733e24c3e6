"""A robot behind ROS 2 topics that takes positions or velocities, over rmw_zenoh and without ROS: ros2.md beside it.

| type | message | for | a late message |
|---|---|---|---|
| PoseStamped | the set-point, in the state's frame | cartesian controllers, MoveIt Servo | has its stamp |
| TwistStamped | a velocity | MoveIt Servo | has its stamp: `incoming_command_timeout` |
| JointTrajectory | one point, `ahead` after the stamp | joint_trajectory_controller | a past end is refused |
| Float64MultiArray | the set-points of the joints, in their order | forward_command_controller | cannot be told |

Sources: the makers' pages on control.ros.org (joint_trajectory_controller: "Trajectory representation";
forward_command_controller), and moveit_servo's `servo_parameters.yaml`, 2025.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from typing import Any

import numpy as np

from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, InvalidParameter
from hapnet.ext.robots.position_robot import WATCHDOG_S, PositionRobot, SetPointLimits
from hapnet.ext.robots.ros2_inbox import PERIODS
from hapnet.ext.robots.ros2_topics import POSE, RosTopics, TopicNames, header
from hapnet.records.vectors import distance
from hapnet.transport.ros2 import ROUTER, RosNode, check_topic

TWIST, TRAJECTORY, ARRAY = (
    "geometry_msgs/msg/TwistStamped",
    "trajectory_msgs/msg/JointTrajectory",
    "std_msgs/msg/Float64MultiArray",
)

KINDS = {"PoseStamped": POSE, "TwistStamped": TWIST, "JointTrajectory": TRAJECTORY, "Float64MultiArray": ARRAY}
"""The types of commands that are positions, or velocities towards a position."""

SHORTEST_S = 0.02
"""The robot is silent after three periods of its states, but not before this time, nor after the watchdog's [s]."""

SAME = 1e-9
"""The distance of two set-points that differ by rounding only [rad]."""

_OF_JOINTS = (TRAJECTORY, ARRAY)


class Ros2Positions(PositionRobot):
    """A robot that takes positions: ``ros2:/arm/current_pose,command=/arm/target_pose,type=PoseStamped``.

    state, contact, joints, axes, rate, router, domain, contact_rate : as for `hapnet.ext.robots.ros2.Ros2`. command :
    the topic on which set-points go out; one goes out in each period of `rate`. type : of `KINDS`. speed [m/s] or
    [rad/s], step, lag [m] or [rad], tie [N/m] or [Nm/rad], watchdog [s] : as in `PositionRobot`; empty: its default.
    gain : of the position loop of TwistStamped [1/s]. ahead : the time from the stamp of a JointTrajectory to its point
    [s]; 0: two periods. stamped : whether a JointTrajectory has the time now as its stamp; else 0, "start now". frame :
    the command's frame_id; empty: the state's. handle, clock : of tests.

    Raises InvalidParameter: an option is not allowed. MissingLibrary: the extra `ros2` is not installed. HapnetError:
    there is no router, or no message comes on the state's topic.
    """

    def __init__(
        self,
        dof: int,
        state: str = "/joint_states",
        command: str = "",
        type: str = "JointTrajectory",
        contact: str = "",
        joints: str = "",
        axes: str = "",
        rate: float = 100.0,
        speed: str = "",
        step: str = "",
        lag: str = "",
        tie: str = "",
        watchdog: float = 0.1,
        gain: float = 2.0,
        ahead: float = 0.0,
        stamped: bool = True,
        router: str = ROUTER,
        domain: int = 0,
        frame: str = "",
        contact_rate: float = 0.0,
        handle: Any = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        check_topic("command", command)
        kind = KINDS[type]
        if (kind in _OF_JOINTS) != bool(joints):
            allowed = "names of joints joined by +" if kind in _OF_JOINTS else "left out"
            raise InvalidParameter("joints", joints, f"{allowed} with type={type}")
        names = TopicNames(state, "", contact, joints, axes, rate, contact_rate)
        names.check(dof)
        low, high = WATCHDOG_S
        if not max(low, 2.0 / rate) <= watchdog <= high:
            raise InvalidParameter("watchdog", watchdog, f"{max(low, 2.0 / rate):g} to {high:g} s with rate={rate:g}")
        if not 0.0 < gain <= 0.5 * rate:
            raise InvalidParameter("gain", gain, f"above 0, and at most half the rate: {0.5 * rate:g} 1/s")
        if ahead and not 1.0 / rate <= ahead <= watchdog:
            raise InvalidParameter("ahead", ahead, f"{1.0 / rate:g} to {watchdog:g} s, or 0: two periods")
        self.dof = dof
        self.units = "rad" if joints else "m"
        self.rate_hz, self.watchdog_s = rate, watchdog
        self.speed_limit, self.step_limit = _amount("speed", speed), _amount("step", step)
        self.lag_limit, self.tie_stiffness = _amount("lag", lag), _amount("tie", tie)
        self._most = SetPointLimits.of(self)
        self._gain, self._clock = gain, clock
        self._silence_s = min(watchdog, max(SHORTEST_S, PERIODS / rate))
        node = RosNode("hapnet", domain=domain, router=router) if handle is None else handle
        self._topics = topics = RosTopics(dof, names, node, clock)
        self._x, self._came_ns = topics.first
        if frame and topics.axes is not None and frame != topics.frame:
            node.close()
            raise InvalidParameter("frame", frame, f"left out, or that of {state}: {topics.frame}")
        frame = topics.frame if topics.axes is not None else frame
        self._out = _Out(topics, command, kind, ahead_s=ahead or 2.0 / rate, stamped=stamped, frame=frame)

    def read(self) -> Vector:
        if (newest := self._topics.next(0.0)) is not None:
            self._x, self._came_ns = newest
        elif (self._clock() - self._came_ns) * 1e-9 > self._silence_s:
            raise DeviceSilent(self._topics.silence)
        return self._x

    def contact_force(self) -> Vector | None:
        return self._topics.contact_force()

    def move(self, dt: float, position: Vector, velocity: Vector) -> None:
        if self._out.kind == TWIST:
            wanted = tuple([
                v + self._gain * (to - x) for v, to, x in zip(velocity, position, self._x, strict=True)
            ])  # fmt: skip
            size = self._most.size(wanted)
            share = min(1.0, self._most.speed / size) if size else 1.0
            self._out.twist(tuple([share * part for part in wanted]))
        else:
            self._out.position(position)

    def hold(self, dt: float, position: Vector) -> None:
        if self._out.kind == TWIST:
            self._out.twist((0.0,) * self.dof)
        else:
            self._out.hold(position)

    def close(self) -> None:
        self._topics.node.close()


class _Out:
    """Publishes set-points.

    topics : of the robot, whose node publishes. topic : of the commands. kind : one of `KINDS`, in full. ahead_s,
    stamped : of a trajectory. frame : the frame_id.
    """

    def __init__(self, topics: RosTopics, topic: str, kind: str, *, ahead_s: float, stamped: bool, frame: str) -> None:
        self.kind: str = kind
        self._topics, self._topic = topics, topic
        self._ahead_s, self._stamped, self._frame = ahead_s, stamped, frame
        self._pose: tuple[Vector, Vector] | None = None
        self._goes_to: Vector = ()

    def position(self, position: Vector) -> None:
        make = self._topics.node.types.classes
        if self.kind == POSE:
            self._publish(self._whole_pose(position))
        elif self.kind == TRAJECTORY:
            stamp = self._header()
            if not self._stamped:
                stamp.stamp.sec = stamp.stamp.nanosec = 0
            seconds, rest = divmod(round(self._ahead_s * 1e9), 1_000_000_000)
            after, none = make["builtin_interfaces/msg/Duration"](seconds, rest), np.zeros(0)
            point = make["trajectory_msgs/msg/JointTrajectoryPoint"](np.array(position), none, none, none, after)
            self._goes_to = position
            self._publish(make[TRAJECTORY](stamp, self._topics.joints, [point]))
        else:
            layout = make["std_msgs/msg/MultiArrayLayout"]([], 0)
            self._publish(make[ARRAY](layout, np.array(position)))

    def hold(self, position: Vector) -> None:
        """Publish the set-point again. A trajectory that ends there is not begun again: it would take longer."""
        goes = self._goes_to
        if not goes or distance(len(position), position, goes) > SAME:
            self.position(position)

    def twist(self, velocity: Vector) -> None:
        make, axes = self._topics.node.types.classes, self._topics.axes
        assert axes is not None, "a twist has no joints"
        vector = make["geometry_msgs/msg/Vector3"]
        twist = make["geometry_msgs/msg/Twist"](vector(*axes.spread(velocity)), vector(0.0, 0.0, 0.0))
        self._publish(make[TWIST](self._header(), twist))

    def _whole_pose(self, position: Vector) -> Any:
        """The set-point as a pose. Other axes and the orientation stay as they were at the first set-point."""
        topics = self._topics
        make, axes = topics.node.types.classes, topics.axes
        if self._pose is None:
            turned = topics.orientation()
            assert turned is not None, "a pose has an orientation"
            self._pose = topics.place, turned
        (place, (w, x, y, z)) = self._pose
        assert axes is not None, "a pose has no joints"
        led = axes.spread((1.0,) * len(position))
        whole = [to if part else stays for to, part, stays in zip(axes.spread(position), led, place, strict=True)]
        pose = make["geometry_msgs/msg/Pose"](
            make["geometry_msgs/msg/Point"](*whole), make["geometry_msgs/msg/Quaternion"](x, y, z, w)
        )
        return make[POSE](self._header(), pose)

    def _header(self) -> Any:
        return header(self._topics.node, self._frame)

    def _publish(self, message: Any) -> None:
        self._topics.node.publish(self._topic, self.kind, message)


def _amount(name: str, text: str) -> float | None:
    """An amount above 0; None: empty. Raises InvalidParameter."""
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < inf:
        raise InvalidParameter(name, text, f"a positive number, such as {name}=0.1")
    return value
