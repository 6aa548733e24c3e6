"""A running pair on ROS 2's topics: what is published of telemetry, and a whole run with a node that listens."""

import os
import signal
from typing import Any

import pytest

pytest.importorskip("rosbags.typesys")
pytest.importorskip("xxhash")

from hapnet import simulate
from hapnet.ext.page.ros2 import RosBridge
from hapnet.recording.samples import DeviceSample, Event, Recording, WorldSample
from hapnet.recording.telemetry import Status, decode, encode
from hapnet.transport.config import free_address
from hapnet.transport.ros2 import Types
from tests.support.processes import started
from tests.support.ros_node import POSE, BareNode, router

UTC_NS = 1_764_159_000_000_000_000


@pytest.fixture(scope="module")
def run() -> Recording:
    return simulate({"scene": "free", "dof": 2, "operator": "hand-21", "duration_s": 1.5}, 1).recording


def test_telemetry_becomes_messages_with_the_samples_own_times(run: Recording) -> None:
    found: list[tuple[str, str, Any]] = []
    bridge = RosBridge(Types().classes, lambda *one: found.append(one), "/left", lambda: UTC_NS + 5)
    samples = [one for one in run.samples() if isinstance(one, DeviceSample | WorldSample)]
    bridge.take(samples[0])
    bridge.publish_next(0.0)
    assert not found, "whoever does not know the axes' units publishes nothing"
    about = run.meta | {"origin_ns": 0, "utc_origin_ns": UTC_NS}
    for role in ("device", "world"):
        status = Status(role, 0, 1, True, False, "", about, {}, {})  # type: ignore[arg-type]
        bridge.take(decode(encode(status)))
    for sample in samples:
        bridge.take(sample)
        bridge.publish_next(0.0)
    bridge.take(Event(7, "stopped", "why", "error"))
    bridge.publish_next(0.0)
    poses = [message for topic, _, message in found if topic == "/left/device/pose"]
    device = run.device
    assert len(poses) == len(device["time_ns"]) == bridge.published["/left/device/pose"]
    for k in (0, 100, len(poses) - 1):
        stamp, at = poses[k].header.stamp, poses[k].pose.position
        assert stamp.sec * 10**9 + stamp.nanosec == UTC_NS + int(device["time_ns"][k])
        assert (at.x, at.y) == tuple(device["position_m"][k])
    diagnoses = [message.status[0] for topic, _, message in found if topic == "/diagnostics"]
    accounts = [one for one in diagnoses if one.name == "hapnet: account of the device"]
    assert len(accounts) == 2, "once a second"
    assert float(accounts[1].values[0].value) > 0.0
    assert (diagnoses[-1].name, diagnoses[-1].level) == ("hapnet: stopped", 2)


@pytest.mark.slow
def test_a_pair_that_runs_is_on_ros_and_follows_its_target() -> None:
    """A node publishes a target, a device without force follows it, and the node hears where the world's tool is."""
    ros, address = free_address(), free_address()
    with router(ros):
        node = BareNode(ros)
        node.listen(f"0/left/world/pose/{POSE}")
        node.stream("target_pose", 100.0)
        device = f"ros2:axes=x,router={ros}"
        try:
            with (
                started("world", "-l", address, "--no-files", "--scene", "free", "--dof", 1) as world,
                started("device", "-e", address, "--no-files", "--device", device, "--servo-hz", 100,
                        "--scene", "free", "--dof", 1) as hand,
                started("bridge", "ros2", "-e", address, "--router", ros, "--namespace", "/left") as bridge,
            ):  # fmt: skip
                bridge.until_line("session default of device device is on ROS 2's domain 0")
                bridge.until("the world's pose is on ROS", lambda: len(node.messages) > 60)
                for program in (bridge, hand, world):
                    os.kill(program.process.pid, signal.SIGINT)
                    assert program.end()[0] == 130, program.err
        finally:
            node.close()
    import struct

    places = [struct.unpack_from("<d", data, len(data) - 56)[0] for _, data, _ in node.messages]
    assert places[-1] > places[0] + 0.003, "the target moved by 10 mm a second"
