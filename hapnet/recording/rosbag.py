"""Writes a recording as a rosbag2 for ``ros2 bag play``, without ROS: `rosbags` serialises messages (extra `ros2`).

| topic | type | content |
|---|---|---|
| `/device/pose`, `/world/pose` | `geometry_msgs/PoseStamped` | position, and the orientation of a tool that turns |
| `/device/set_position`, `/world/set_position` | `geometry_msgs/PoseStamped` | ybar |
| `/device/twist`, `/world/twist` | `geometry_msgs/TwistStamped` | velocity |
| `/device/wrench`, `/world/wrench` | `geometry_msgs/WrenchStamped` | the coupling's force |
| `/world/contact` | `geometry_msgs/WrenchStamped` | force of the surroundings on the virtual mass |
| `/device/joint_states`, `/world/joint_states` | `sensor_msgs/JointState` | an arm's angles, or axes in radians |
| `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | each side's account, once a second, and the events |

Missing axes are 0. All stamps are UTC if it is known, else they count from the recording's start.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.errors import MissingLibrary, RecordingError
from hapnet.recording.frames import AXES, table
from hapnet.recording.samples import Columns, Recording, utc_less_clock_ns

FRAME = "hapnet"
_SIDES = {"device": "force_N", "world": "coupling_force_N"}
_LEVELS = {"info": 0, "warning": 1, "error": 2}
ACCOUNT_EVERY_NS = 1_000_000_000
_ACCOUNT = ("margin_J", "slack_J", "reservoir_J", "sent_J", "credited_J")


class BagMessage(NamedTuple):
    """One message: its topic, type, time [ns] and content."""

    topic: str
    kind: str
    time_ns: int
    content: Any


def write(recording: Recording, path: Path) -> None:
    """Write the recording as a rosbag2, the directory `path`.

    Raises MissingLibrary: `rosbags` is not installed. RecordingError: the directory exists, or cannot be written.
    """
    try:
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingLibrary("--format rosbag2", "rosbags", "ros2") from error
    if path.exists():
        raise RecordingError(f"{path} already exists: a rosbag2 needs its own directory")
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent) as room:  # it appears only when it is complete
            made = Path(room) / path.name
            with Writer(made, version=8) as bag:
                connections: dict[str, Any] = {}
                for topic, kind, time_ns, content in messages(recording, store.types):
                    if topic not in connections:
                        connections[topic] = bag.add_connection(topic, kind, typestore=store)
                    bag.write(connections[topic], time_ns, store.serialize_cdr(content, kind))
            os.replace(made, path)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from None


def messages(recording: Recording, types: Any) -> Iterator[BagMessage]:
    """Yield all messages of a recording, topic by topic. types : the classes of messages by their names."""
    make = Messages(types)
    for side in _SIDES:
        if getattr(recording, side) is not None:
            yield from make.of_side(recording, side)
            yield from make.account(recording, side)
    yield from make.events(recording)


class Messages:
    """Makes the messages of a recording. types : as for `messages`."""

    def __init__(self, types: Any) -> None:
        self._types = types

    def of_side(self, recording: Recording, side: str) -> Iterator[BagMessage]:
        """Yield the samples of one side as messages, topic by topic."""
        columns, force = table(recording, side), _SIDES[side]
        times = columns["time_ns"] + utc_less_clock_ns(recording.meta)
        yield from self._poses(f"/{side}/pose", times, columns, "position")
        yield from self._poses(f"/{side}/set_position", times, columns, "set_position")
        yield from self._pairs(f"/{side}/twist", "Twist", times, columns, "velocity_mps", "velocity_radps")
        yield from self._wrenches(f"/{side}/wrench", times, columns, force)
        if side == "world":
            yield from self._wrenches("/world/contact", times, columns, "contact_force_N")
        yield from self._joints(f"/{side}/joint_states", times, columns, force)

    def account(self, recording: Recording, side: str) -> Iterator[BagMessage]:
        """Yield the account once a second, with the level error if the margin is below zero."""
        columns: Columns = getattr(recording, side)
        times = columns["time_ns"] + utc_less_clock_ns(recording.meta)
        since = (times - times[0]) // ACCOUNT_EVERY_NS
        for k in np.flatnonzero(np.diff(since, prepend=-1)).tolist():
            known = {name: float(columns[name][k]) for name in _ACCOUNT if name in columns}
            level = 2 if known.get("margin_J", 0.0) < 0.0 else 0
            yield self._diagnosis(int(times[k]), level, f"hapnet: account of the {side}", "", known)

    def events(self, recording: Recording) -> Iterator[BagMessage]:
        """Yield the events."""
        more = utc_less_clock_ns(recording.meta)
        for event in recording.events:
            level = _LEVELS.get(event.level, 0)
            yield self._diagnosis(event.time_ns + more, level, f"hapnet: {event.kind}", event.text, {})

    def _poses(self, topic: str, times: Array, columns: Columns, name: str) -> Iterator[BagMessage]:
        kind = "geometry_msgs/msg/PoseStamped"
        points = _vectors(columns, f"{name}_m")
        if points is None:
            return
        names = [f"{name}_quaternion_{axis}" for axis in "xyzw"]
        none = [np.zeros(len(times))] * 3 + [np.ones(len(times))]
        turns = np.column_stack([columns[one] for one in names] if names[0] in columns else none)
        for time_ns, point, turn in zip(times.tolist(), points.tolist(), turns.tolist(), strict=True):
            place = self._make("geometry_msgs/msg/Point", *point)
            pose = self._make("geometry_msgs/msg/Pose", place, self._make("geometry_msgs/msg/Quaternion", *turn))
            yield BagMessage(topic, kind, time_ns, self._make(kind, self._header(time_ns), pose))

    def _wrenches(self, topic: str, times: Array, columns: Columns, name: str) -> Iterator[BagMessage]:
        torque = name.replace("force_N", "torque_Nm")
        yield from self._pairs(topic, "Wrench", times, columns, name, torque)

    def _joints(self, topic: str, times: Array, columns: Columns, force: str) -> Iterator[BagMessage]:
        """Yield the angles of an arm that is coupled at its tip, or of axes that are joints."""
        kind = "sensor_msgs/msg/JointState"
        names = [name for name in columns if name.startswith("joint_") and name.endswith(("_rad", "_m"))]
        rates, efforts = [], []
        if not names:
            axes = [axis for axis in columns if axis.startswith("position_rad_")]
            names = axes
            rates = [f"velocity_radps_{axis.rpartition('_')[2]}" for axis in axes]
            efforts = [f"{force.replace('force_N', 'force_Nm')}_{axis.rpartition('_')[2]}" for axis in axes]
        if not names:
            return
        called = [name.removesuffix("_rad").removesuffix("_m").replace("position_rad_", "joint_") for name in names]
        angles, speeds, torques = (_rows(columns, group, len(times)) for group in (names, rates, efforts))
        for k, time_ns in enumerate(times.tolist()):
            if not np.isnan(angles[k]).any():
                content = self._make(kind, self._header(time_ns), called, angles[k], speeds[k], torques[k])
                yield BagMessage(topic, kind, time_ns, content)

    def _pairs(
        self, topic: str, word: str, times: Array, columns: Columns, first: str, second: str
    ) -> Iterator[BagMessage]:
        kind = f"geometry_msgs/msg/{word}Stamped"
        along, about = _vectors(columns, first), _vectors(columns, second)
        if along is None:
            return
        about = np.zeros_like(along) if about is None else about
        for time_ns, one, two in zip(times.tolist(), along.tolist(), about.tolist(), strict=True):
            both = [self._make("geometry_msgs/msg/Vector3", *part) for part in (one, two)]
            content = self._make(f"geometry_msgs/msg/{word}", *both)
            yield BagMessage(topic, kind, time_ns, self._make(kind, self._header(time_ns), content))

    def _diagnosis(self, time_ns: int, level: int, name: str, text: str, values: dict[str, float]) -> BagMessage:
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        pairs = [self._make("diagnostic_msgs/msg/KeyValue", key, f"{value:.9g}") for key, value in values.items()]
        status = self._make("diagnostic_msgs/msg/DiagnosticStatus", level, name, text, FRAME, pairs)
        return BagMessage("/diagnostics", kind, time_ns, self._make(kind, self._header(time_ns), [status]))

    def _header(self, time_ns: int) -> Any:
        seconds, rest = divmod(time_ns, 1_000_000_000)
        return self._make("std_msgs/msg/Header", self._make("builtin_interfaces/msg/Time", seconds, rest), FRAME)

    def _make(self, kind: str, *fields: Any) -> Any:
        return self._types[kind](*fields)


def _vectors(columns: Columns, name: str) -> Array | None:
    """The vectors (N, 3) of this name; None: there are none."""
    names = [f"{name}_{axis}" for axis in AXES]
    if names[0] not in columns:
        return None
    length = len(columns[names[0]])
    return np.column_stack([columns[one] if one in columns else np.zeros(length) for one in names])


def _rows(columns: Columns, names: list[str], length: int) -> Array:
    """These columns as a matrix; missing columns are left out."""
    found = [columns[one] for one in names if one in columns]
    return np.column_stack(found) if found else np.zeros((length, 0))
