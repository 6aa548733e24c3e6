"""A device and a robot behind ROS 2's topics, beside a node that was written from rmw_zenoh's layout."""

import contextlib
import math
import struct
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rosbags.typesys")
pytest.importorskip("xxhash")

from hapnet.assembly.user_device import UserDevice
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.robots.ros2 import Ros2
from hapnet.transport.config import free_address
from tests.support.processes import until
from tests.support.ros_node import JOINTS, POSE, WRENCH, BareNode, router

STATE, COMMAND = "/arm/current_pose", "/arm/target_wrench"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    found = free_address()
    with router(found):
        yield found


@pytest.fixture
def node(address: str) -> Iterator[BareNode]:
    made = BareNode(address)
    yield made
    made.close()


def moving(robot: Ros2) -> tuple[float, float]:
    """Position and velocity along x, of the next state that comes."""
    while True:
        try:
            (x, *_), (v, *_) = robot.read()
        except DeviceSilent:
            continue
        return x, v


def test_a_robot_is_read_commanded_and_seen_by_ros(node: BareNode, address: str) -> None:
    node.listen(f"0{COMMAND}/{WRENCH}")
    node.stream("arm/current_pose", 100.0)
    robot = Ros2(3, STATE, COMMAND, router=address)
    try:
        while moving(robot)[1] <= 0.0:
            pass
        before, first_s = moving(robot)[0], time.monotonic()
        for k in range(20):
            x, v = moving(robot)
            assert robot.apply((0.5, -0.25, 0.125 * k)) is None
        lasted_s = time.monotonic() - first_s
        assert x - before == pytest.approx(20 * 1e-4, abs=5e-4)
        assert v == pytest.approx((x - before) / lasted_s, rel=0.5)
        assert robot.orientation() == (1.0, 0.0, 0.0, 0.0)
        assert robot.acted() is None
        assert not robot.knows_force
        until(lambda: len(node.forces("target_wrench")) == 20)
        assert node.forces("target_wrench") == [(0.5, -0.25, 0.125 * k) for k in range(20)]
        attached = [one for _, _, one in node.messages]
        assert [number for number, *_ in attached] == list(range(1, 21))
        assert len({gid for *_, gid in attached}) == 1
        assert all(abs(at - time.time_ns()) < 60e9 for _, at, *_ in attached)
        until(lambda: len(node.tokens) == 3)
        kinds = {token.split("/")[5]: token.split("/") for token in node.tokens}
        assert kinds["NN"][-1] == "hapnet"
        assert kinds["MS"][9:11] == ["%arm%current_pose", POSE.split("/")[0]]
        assert kinds["MP"][9:] == ["%arm%target_wrench", *WRENCH.split("/"), "::,10:,:,:,,"]
    finally:
        robot.close()
    until(lambda: not node.tokens)


def wrench(frame: bytes, *force: float) -> bytes:
    """By the rules of CDR; numbers begin at multiples of 8."""
    data = struct.pack(f"<4sIII{len(frame) + 1}s", b"\0\1\0\0", 0, 0, len(frame) + 1, frame)
    return data + b"\0" * (-(len(data) - 4) % 8) + struct.pack("<6d", *force, 9.0, 9.0, 9.0)


def test_its_contact_force_is_a_topics_in_the_frame_of_its_pose(
    node: BareNode, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [wrench(b"", 1.0, 2.0, -3.0)]
    node.stream("arm/current_pose", 100.0)
    node.stream(f"arm/contact/{WRENCH}", 100.0, lambda: found[0])
    robot = Ros2(2, STATE, contact="/arm/contact", axes="z-x", router=address)
    try:
        moving(robot)
        assert robot.contact_force() == (-3.0, -1.0)
        found[0] = wrench(b"tool", 7.0, 7.0, 7.0)
        until(lambda: moving(robot) is not None and robot.contact_force() is None)
    finally:
        robot.close()
    monkeypatch.setattr("hapnet.ext.robots.ros2_topics.START_S", 0.5)
    with pytest.raises(HapnetError, match=r"nothing on /arm/contact within 0.5 s but .*bad"):
        Ros2(2, STATE, contact="/arm/contact", router=address)


def test_a_contact_topic_that_is_slower_than_the_states_says_its_rate(
    node: BareNode, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [wrench(b"", 1.0, 2.0, -3.0)]
    node.stream("arm/current_pose", 100.0)
    node.stream(f"arm/contact/{WRENCH}", 5.0, lambda: found[0])
    robot = Ros2(3, STATE, contact="/arm/contact", contact_rate=5.0, router=address)
    try:
        began_ns = time.monotonic_ns()
        found[0] = wrench(b"", 4.0, 5.0, 6.0)
        until(lambda: moving(robot) is not None and robot.contact_force() == (4.0, 5.0, 6.0))
        for at_ns, stands in ((began_ns + 590_000_000, True), (time.monotonic_ns() + 610_000_000, False)):
            with monkeypatch.context() as later:  # it came between the two, and stands for 0.6 s
                later.setattr(robot._topics, "_clock", lambda at_ns=at_ns: at_ns)
                assert (robot.contact_force() is not None) == stands
    finally:
        robot.close()
    monkeypatch.setattr("hapnet.ext.robots.ros2_topics.START_S", 1.0)
    with pytest.raises(HapnetError, match=r"within 1 s but .*late, or slower than 100 Hz: contact_rate$"):
        Ros2(3, STATE, contact="/arm/contact", router=address)
    with pytest.raises(InvalidParameter, match=r"contact_rate is 0\.5; allowed: 1 to 1000 Hz"):
        Ros2(3, STATE, contact="/arm/contact", contact_rate=0.5, router=address)


def joint_state(positions: tuple[float, float], efforts: tuple[float, ...]) -> bytes:
    """Of the joints a and b, by the rules of CDR; velocities there are none."""
    data = struct.pack("<4sIIIx3x", b"\0\1\0\0", 0, 0, 1) + struct.pack("<II2s2xI2s2x", 2, 2, b"a", 2, b"b")
    data += struct.pack("<I2dI", 2, *positions, 0)
    return data + struct.pack(f"<I{len(efforts)}d", len(efforts), *efforts)


def test_joints_are_read_by_name_with_their_measured_efforts(node: BareNode, address: str) -> None:
    node.listen(f"0/commands/{JOINTS}")
    data = joint_state((0.25, -0.5), (1.5, -2.0))
    node.stream(f"joint_states/{JOINTS}", 100.0, lambda: data)
    robot = Ros2(2, "/joint_states", "/commands", "/joint_states", joints="b+a", router=address)
    try:
        assert robot.units == "rad"
        assert robot.knows_force
        assert moving(robot)[0] == -0.5
        until(lambda: (robot.acted() or moving(robot)) == (-2.0, 1.5))
        robot.apply((0.75, 0.5))
        until(lambda: len(node.messages) == 1)
        assert node.messages[0][1].endswith(struct.pack("<I2d", 2, 0.75, 0.5))
        data = joint_state((math.nan, -0.5), ())
        for _ in range(3):  # what came before that
            with contextlib.suppress(DeviceSilent):
                robot.read()
        with pytest.raises(DeviceSilent, match="bad"):
            robot.read()
    finally:
        robot.close()


def test_a_target_moves_a_device_without_force_until_it_is_silent(node: BareNode, address: str) -> None:
    node.stream("target_pose", 100.0)
    device = UserDevice(f"ros2:/target_pose,axes=x,router={address}", 1)
    try:
        assert device.force_limit == 1e-6
        assert device.apply((1.0,)) == (0.0,)
        node.close()
        with contextlib.suppress(DeviceSilent):
            device.read()  # the last one, if it came late
        with pytest.raises(DeviceSilent, match="nothing new on /target_pose"):
            device.read()
    finally:
        device.close()


def test_what_does_not_fit_is_one_line(address: str) -> None:
    for name, options in {"state": {"state": "target"}, "rate": {"rate": 5.0}, "joints": {"joints": "a+b"}}.items():
        with pytest.raises(InvalidParameter, match=name):
            Ros2(3, **options)  # type: ignore[arg-type]
    with pytest.raises(HapnetError, match="no router of ROS 2 at tcp"):
        Ros2(3, router="tcp/127.0.0.1:1")


def test_rate_is_the_servos(node: BareNode, address: str) -> None:
    from hapnet.params import DeviceParams

    node.stream("target_pose", 100.0)
    with pytest.raises(InvalidParameter, match="--servo-hz 100"):
        UserDevice(f"ros2:axes=x,router={address}", 1, DeviceParams(servo_hz=1000.0))
