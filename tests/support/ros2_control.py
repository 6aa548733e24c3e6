"""A mock of ros2_control and of MoveIt Servo, written from the makers' pages; messages by `rosbags`, none by hapnet.

Each controller is updated at its rate, and its joints or its tool follow the command 30 ms late.

* forward_command_controller: `Float64MultiArray`, the values in the order of its joints; another number is refused. The
  newest message is the command, for ever: it has no time.
* joint_trajectory_controller: a header's stamp of 0 means now; a trajectory whose end is past is refused, and so is one
  with other joints. The command goes on a line from the present one to the point, and stays there.
* MoveIt Servo: a `TwistStamped` older than `incoming_command_timeout` (0.1 s) stops it; else its tool moves with it.
* a cartesian motion controller: the newest `PoseStamped` in its own frame is the command.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
UTC_NS = 1_700_000_000_000_000_000
LATE_S = 0.03
TIMEOUT_NS = 100_000_000
FRAME, NAMES = "base", ["j1", "j2"]
NS = 1e-9


class Executed(NamedTuple):
    """What a controller commanded in an update, and the age of the message that it was from [ns]."""

    now_ns: int
    position: tuple[float, ...]
    age_ns: int


class Controller:
    """dof : of its positions. hz : its rate, and that of its states."""

    kind = state_kind = "geometry_msgs/msg/PoseStamped"

    def __init__(self, dof: int, hz: float, at: float = 0.3) -> None:
        self.period_ns = round(1e9 / hz)
        self.commanded = np.full(dof, at)
        self.position = self.commanded.copy()
        self.executed: list[Executed] = []
        self.received: list[tuple[float, ...]] = []
        self.refused = 0
        self._newest: tuple[Any, int] | None = None
        self._before_ns: int | None = None

    def take(self, data: bytes, attachment: bytes, now_ns: int) -> None:
        _, sent_ns, size, _ = struct.unpack("<qqB16s", attachment)
        assert size == 16
        message = STORE.deserialize_cdr(data, self.kind)
        if self.accepts(message, now_ns + UTC_NS):
            self.received.append(self.asked(message))
            self._newest = message, sent_ns
        else:
            self.refused += 1

    def accepts(self, message: Any, utc_ns: int) -> bool:
        return bool(message.header.frame_id == FRAME)

    def asked(self, message: Any) -> tuple[float, ...]:
        at = message.pose.position
        assert (message.pose.orientation.w, message.pose.orientation.x) == (1.0, 0.0)
        return (at.x, at.y, at.z)[: len(self.commanded)]

    def command(self, message: Any, dt: float, utc_ns: int) -> bool:
        """Change the command by this message; False: it does not act any more."""
        self.commanded[:] = self.asked(message)
        return True

    def update(self, now_ns: int) -> None:
        dt = 0.0 if self._before_ns is None else (now_ns - self._before_ns) * NS
        self._before_ns = now_ns
        age_ns, before = 0, self.commanded.copy()
        if self._newest is not None:
            message, sent_ns = self._newest
            acts = self.command(message, dt, now_ns + UTC_NS)
            if acts and (self.commanded != before).any():
                age_ns = now_ns + UTC_NS - sent_ns
        self.executed.append(Executed(now_ns, tuple(self.commanded.tolist()), age_ns))
        self.position += (self.commanded - self.position) * min(1.0, dt / LATE_S)

    def state(self, now_ns: int) -> bytes:
        types = STORE.types
        x, y, z = (*self.position, 0.5, 0.7, 0.9)[:3]
        pose = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](x, y, z), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        )
        kind = "geometry_msgs/msg/PoseStamped"
        return bytes(STORE.serialize_cdr(types[kind](header(now_ns), pose), kind))


class Servo(Controller):
    kind = "geometry_msgs/msg/TwistStamped"

    def asked(self, message: Any) -> tuple[float, ...]:
        assert message.twist.angular.x == message.twist.angular.y == message.twist.angular.z == 0.0
        v = message.twist.linear
        return (v.x, v.y, v.z)[: len(self.commanded)]

    def command(self, message: Any, dt: float, utc_ns: int) -> bool:
        if utc_ns - stamp_ns(message) > TIMEOUT_NS:
            return False
        self.commanded += dt * np.array(self.asked(message))
        return True


class Forward(Controller):
    kind, state_kind = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"

    def accepts(self, message: Any, utc_ns: int) -> bool:
        return len(message.data) == len(self.commanded)

    def asked(self, message: Any) -> tuple[float, ...]:
        return tuple(message.data.tolist())

    def state(self, now_ns: int) -> bytes:
        kind, none = "sensor_msgs/msg/JointState", np.zeros(0)
        names = NAMES[: len(self.position)]
        message = STORE.types[kind](header(now_ns), names[::-1], self.position[::-1].copy(), none, none)
        return bytes(STORE.serialize_cdr(message, kind))


class Trajectory(Forward):
    kind = "trajectory_msgs/msg/JointTrajectory"

    def __init__(self, dof: int, hz: float, at: float = 0.3) -> None:
        super().__init__(dof, hz, at)
        self._from: tuple[Any, np.ndarray, int] | None = None

    def accepts(self, message: Any, utc_ns: int) -> bool:
        return sorted(message.joint_names) == NAMES[: len(self.commanded)] and self._ends(message, utc_ns) >= utc_ns

    def asked(self, message: Any) -> tuple[float, ...]:
        values = dict(zip(message.joint_names, message.points[-1].positions.tolist(), strict=True))
        return tuple([values[name] for name in NAMES[: len(self.commanded)]])

    def command(self, message: Any, dt: float, utc_ns: int) -> bool:
        if self._from is None or self._from[0] is not message:
            self._from = message, self.commanded.copy(), utc_ns - round(dt / NS)
        _, begin, begin_ns = self._from
        share = (utc_ns - begin_ns) / max(1, self._ends(message, begin_ns) - begin_ns)
        self.commanded[:] = begin + min(1.0, share) * (np.array(self.asked(message)) - begin)
        return share <= 1.0

    @staticmethod
    def _ends(message: Any, now_ns: int) -> int:
        after = message.points[-1].time_from_start
        return (stamp_ns(message) or now_ns) + after.sec * 1_000_000_000 + after.nanosec


CONTROLLERS = {
    "PoseStamped": Controller, "TwistStamped": Servo, "JointTrajectory": Trajectory, "Float64MultiArray": Forward,
}  # fmt: skip


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def header(now_ns: int) -> Any:
    seconds, rest = divmod(now_ns + UTC_NS, 1_000_000_000)
    return STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](seconds, rest), FRAME)


Take = Callable[[bytes, bytes], object]


class Network:
    """The network between hapnet and a controller in virtual time, 1 ms long; hapnet's node of it.

    cut : "": none; "lost": messages are lost; "late": they are delivered all at once afterwards; "stale": only those of
    the first 10 ms are, as of a queue that was full then.
    """

    DELAY_NS = 1_000_000

    def __init__(self, controller: Controller, clock: Callable[[], int]) -> None:
        from hapnet.transport.ros2 import Types

        self.types = Types()
        self.controller, self.cut = controller, ""
        self.published: list[tuple[int, bytes]] = []
        self.closed = False
        self._clock = clock
        self._take: Take = lambda data, attachment: None
        self._under_way: list[tuple[int, bool, bytes, bytes]] = []
        self._counts, self._since_ns = [0, 0], 0

    def wall_ns(self) -> int:
        return self._clock() + UTC_NS

    def open(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True

    def subscribe(self, topic: str, kind: str, take: Take) -> None:
        assert topic == "/state"
        self._take = take
        take(self.controller.state(self._clock()), self._attached(0))

    def publish(self, topic: str, kind: str, message: object) -> None:
        assert (topic, kind) == ("/command", self.controller.kind)
        data = self.types.encode(kind, message)
        self.published.append((self._clock(), data))
        self._send(1, data)

    def interrupt(self, cut: str) -> None:
        self.cut, self._since_ns = cut, self._clock()
        if cut == "lost":
            self._under_way.clear()

    def run(self) -> None:
        """Deliver what is due, and update the controller if its period is over."""
        now_ns = self._clock()
        due = [one for one in self._under_way if one[0] <= now_ns] if not self.cut else []
        self._under_way = [one for one in self._under_way if one not in due]
        for _, to_robot, data, attachment in due:
            if to_robot:
                self.controller.take(data, attachment, now_ns)
            else:
                self._take(data, attachment)
        if now_ns % self.controller.period_ns == 0:
            self.controller.update(now_ns)
            self.send_state()

    def send_state(self) -> None:
        self._send(0, self.controller.state(self._clock()))

    def _send(self, to_robot: int, data: bytes) -> None:
        attachment = self._attached(to_robot)
        is_full = self.cut == "stale" and self._clock() - self._since_ns > 10_000_000
        if self.cut != "lost" and not is_full:
            self._under_way.append((self._clock() + self.DELAY_NS, bool(to_robot), data, attachment))

    def _attached(self, to_robot: int) -> bytes:
        self._counts[to_robot] += 1
        return struct.pack("<qqB16s", self._counts[to_robot], self.wall_ns(), 16, b"the mock's topic")


class RealNode:
    """A controller in real time, behind the node of `tests.support.ros_node`; its topics are below `/<name>`.

    It begins with its first state. Each message that comes below `/<name>` is kept in `node.messages`.
    """

    def __init__(self, address: str, name: str, controller: Controller) -> None:
        from tests.support.ros_node import BareNode

        self.node, self.controller, self.silent = BareNode(address), controller, False
        self._key = f"{name}/state/{key_of(controller.state_kind)}"
        self.node.listen(f"0/{name}/command/**")
        self.node.stream(self._key, 1e9 / controller.period_ns, self._state)
        self._taken = 0

    def _state(self) -> bytes:
        now_ns = time.time_ns() - UTC_NS
        messages = self.node.messages
        while self._taken < len(messages):
            key, data, (number, sent_ns, size, gid) = messages[self._taken]
            assert key.split("/", 3)[3] == key_of(self.controller.kind), "the topic's type and hash"
            self.controller.take(data, struct.pack("<qqB16s", number, sent_ns, size, gid), now_ns)
            self._taken += 1
        self.controller.update(now_ns)
        return self.controller.state(now_ns)


def key_of(kind: str) -> str:
    """A type as a key of rmw_zenoh has it, with its hash."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_/{STORE.hash_rihs01(kind)}"
