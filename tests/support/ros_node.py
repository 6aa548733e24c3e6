"""A node of ROS 2 that was written from rmw_zenoh's layout, of plain Zenoh and struct; it knows nothing of hapnet.

Like rmw_zenoh's own sessions it is a peer that dials the router, and it drops a message without an attachment.
"""

import contextlib
import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

POSE = "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
WRENCH = (
    "geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
)
JOINTS = "sensor_msgs::msg::dds_::JointState_/RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"


def opened(**config: Any) -> zenoh.Session:
    made = zenoh.Config()
    for key, value in {"scouting/multicast/enabled": False, **config}.items():
        made.insert_json5(key, json.dumps(value))
    return zenoh.open(made)


@contextlib.contextmanager
def router(address: str) -> Iterator[None]:
    """What `ros2 run rmw_zenoh_cpp rmw_zenohd` is to its nodes."""
    session = opened(mode="router", **{"listen/endpoints": [address]})
    try:
        yield
    finally:
        session.close()  # type: ignore[no-untyped-call]


class BareNode:
    """Publishes poses and keeps what comes."""

    def __init__(self, address: str) -> None:
        self.session = opened(mode="peer", **{"connect/endpoints": [address], "listen/endpoints": ["tcp/127.0.0.1:0"]})
        self.messages: list[tuple[str, bytes, tuple[Any, ...]]] = []
        self.tokens: set[str] = set()
        self._count = 0
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        self._kept: list[Any] = [
            self.session.liveliness().declare_subscriber(
                "@ros2_lv/0/**", zenoh.handlers.Callback(self._token, indirect=False), history=True
            )
        ]

    def listen(self, key: str) -> None:
        self._kept.append(self.session.declare_subscriber(key, zenoh.handlers.Callback(self._take, indirect=False)))

    def publish_pose(self, topic: str, x: float, y: float, z: float) -> None:
        header = struct.pack("<4sIIIx3x", b"\0\1\0\0", 0, 0, 1)  # an empty frame; numbers begin at multiples of 8
        self.publish(f"{topic}/{POSE}", header + struct.pack("<7d", x, y, z, 0, 0, 0, 1))

    def publish(self, key: str, data: bytes) -> None:
        self._count += 1
        attachment = struct.pack("<qqB16s", self._count, time.time_ns(), 16, b"the test's poses")
        self.session.put(f"0/{key}", data, attachment=attachment)

    def stream(self, topic: str, hz: float, make: Callable[[], bytes] | None = None) -> None:
        """Publish poses that move along x, or what `make` gives on the key `topic`, until `close`."""

        def run() -> None:
            while not self._stop.wait(1.0 / hz):
                if make is None:
                    self.publish_pose(topic, 1e-4 * self._count, 0.0, 0.0)
                else:
                    self.publish(topic, make())

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        self._threads.append(thread)

    def forces(self, topic: str) -> list[tuple[float, float, float]]:
        """The forces of the WrenchStamped that came."""
        return [struct.unpack_from("<3d", data, len(data) - 48) for key, data, _ in self.messages if topic in key]

    def close(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self.session.close()  # type: ignore[no-untyped-call]

    def _take(self, sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            attached = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            self.messages.append((str(sample.key_expr), sample.payload.to_bytes(), attached))

    def _token(self, sample: zenoh.Sample) -> None:
        change = self.tokens.add if sample.kind == zenoh.SampleKind.PUT else self.tokens.discard
        change(str(sample.key_expr))
