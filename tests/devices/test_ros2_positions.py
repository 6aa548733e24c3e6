"""Robots that take positions behind a router, in real time: two at once, their commands, and wrong options."""

import asyncio
import signal
from collections.abc import Iterator
from itertools import groupby
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags.typesys")
pytest.importorskip("xxhash")

from hapnet import connect_device
from hapnet.assembly.device_class import FOLLOWER, load_class
from hapnet.devices.registry import options
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.robots.ros2 import Ros2
from hapnet.ext.robots.ros2_positions import KINDS, Ros2Positions
from hapnet.transport.config import free_address
from tests.support.processes import started, until
from tests.support.ros2_control import Controller, Network, RealNode, Servo, Trajectory
from tests.support.ros_node import router


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    found = free_address()
    with router(found):
        yield found


def leads(amplitude: float, hz: float) -> dict[str, object]:
    return {
        "operator": "sine", "operator_model.amplitude_m": amplitude, "operator_model.frequency_hz": hz,
        "operator_model.start_periods": 0.0, "dof": 2, "link.up": "ideal", "link.down": "ideal",
    }  # fmt: skip


def test_two_arms_on_one_router_follow_their_own_leaders(address: str) -> None:
    """Left takes poses, right joints. Each moves at the frequency of its own leader, and gets one node's messages."""
    left, right = RealNode(address, "left", Controller(2, 100.0)), RealNode(address, "right", Trajectory(2, 100.0))
    left_link, right_link = free_address(), free_address()
    far = {"link.up": "ideal", "link.down": "ideal", "dof": 2}
    arms = (
        (f"ros2:/left/state,command=/left/command,type=PoseStamped,router={address}", "free", left_link, "left"),
        (f"ros2:/right/state,command=/right/command,type=JointTrajectory,joints=j1+j2,ahead=0.05,router={address}",
         "joints", right_link, "right"),
    )  # fmt: skip
    hands = ((leads(0.02, 1.0), "free", left_link, "left"), (leads(0.02, 2.5), "joints", right_link, "right"))

    async def run() -> None:
        async with (
            connect_device(far, role="follower", device=arms[0][0], scene=arms[0][1], listen=arms[0][2], name="left"),
            connect_device(far, role="follower", device=arms[1][0], scene=arms[1][1], listen=arms[1][2], name="right"),
            connect_device(hands[0][0], scene=hands[0][1], connect=hands[0][2], name="left") as one,
            connect_device(hands[1][0], scene=hands[1][1], connect=hands[1][2], name="right") as other,
        ):
            await one.wait_paired()
            await other.wait_paired()
            await asyncio.sleep(2.5)

    try:
        asyncio.run(run())
        until(lambda: len(left.node.messages) > 100 and len(right.node.messages) > 70)
    finally:
        for node in (left, right):
            node.node.close()
    for node, own_hz, others_hz in ((left, 1.0, 2.5), (right, 2.5, 1.0)):
        assert len({gid for _, _, (*_, gid) in node.node.messages}) == 1
        led = np.array([(one.now_ns * 1e-9, one.position[0]) for one in node.controller.executed])
        moves = np.flatnonzero(np.diff(led[:, 1]))
        led = led[moves[-1] - 200 : moves[-1]]  # from there on it stands
        own, others = (unexplained(led, hz) for hz in (own_hz, others_hz))
        assert own < others
        assert np.abs(np.diff(node.controller.received, axis=0)).max() <= 0.01 + 1e-12


def unexplained(led: Any, hz: float) -> float:
    """The variance of a motion (times [s], places) beside a sine of `hz` and a drift."""
    t = 2.0 * np.pi * hz * (led[:, 0] - led[0, 0])
    parts = np.stack([np.ones_like(t), t, np.sin(t), np.cos(t)], axis=1)
    return float(np.var(led[:, 1] - parts @ np.linalg.lstsq(parts, led[:, 1], rcond=None)[0]))


def test_the_type_of_the_command_chooses_the_class() -> None:
    made = load_class("ros2:/s,command=/c,type=TwistStamped,axes=x", FOLLOWER)
    assert made.func is Ros2Positions  # type: ignore[attr-defined]
    assert all(Ros2.class_for_options(f"command=/c,type={kind}") is Ros2Positions for kind in KINDS)
    assert Ros2.class_for_options("command=/c") is Ros2.class_for_options("type=WrenchStamped") is Ros2
    with pytest.raises(InvalidParameter, match=r"type is 'Twist'; allowed: WrenchStamped, .*Float64MultiArray"):
        Ros2.class_for_options("command=/c,type=Twist")
    with pytest.raises(InvalidParameter, match=r"takes positions, so it can only follow: --follower"):
        load_class("ros2:/s,command=/c,type=TwistStamped")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("/s,type=PoseStamped", r"command is ''; allowed: a name of ROS"),
        ("s,command=/c,type=PoseStamped", r"state is 's'; allowed: a name of ROS"),
        ("/s,command=/c,type=JointTrajectory", r"joints is ''; allowed: names of joints joined by \+ with type="),
        ("/s,command=/c,type=Float64MultiArray,joints=a", r"joints is 'a'; allowed: 2 names of joints"),
        ("/s,command=/c,type=PoseStamped,joints=a+b", r"joints is 'a\+b'; allowed: left out with type=PoseStamped"),
        ("/s,command=/c,type=PoseStamped,speed=0", r"speed is '0'; allowed: a positive number, such as speed=0\.1"),
        ("/s,command=/c,type=PoseStamped,step=-1", r"step is '-1'; allowed: a positive number"),
        ("/s,command=/c,type=PoseStamped,lag=far", r"lag is 'far'; allowed: a positive number"),
        ("/s,command=/c,type=PoseStamped,watchdog=5", r"watchdog is 5\.0; allowed: 0\.02 to 1 s with rate=100"),
        ("/s,command=/c,type=PoseStamped,rate=20,watchdog=0.05", r"watchdog is 0\.05; allowed: 0\.1 to 1 s with rate"),
        ("/s,command=/c,type=TwistStamped,gain=90", r"gain is 90\.0; allowed: above 0, and at most half the rate: 50"),
        ("/s,command=/c,type=JointTrajectory,joints=a+b,ahead=1", r"ahead is 1\.0; allowed: 0\.01 to 0\.1 s, or 0"),
        ("/s,command=/c,type=PoseStamped,frame=map", r"frame is 'map'; allowed: left out, or that of /state: base"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(text: str, message: str) -> None:
    given = options("ros2", Ros2Positions, text)
    if "frame" in given:
        given["state"] = "/state"
        given["clock"] = lambda: 10**9
        given["handle"] = Network(Controller(2, 100.0), given["clock"])
    with pytest.raises(InvalidParameter, match=message):
        Ros2Positions(2, **given)


def test_without_a_router_it_says_so() -> None:
    with pytest.raises(HapnetError, match="no router of ROS 2 at tcp"):
        Ros2Positions(2, "/s", "/c", "PoseStamped", router="tcp/127.0.0.1:1")


def test_a_twist_leads_to_the_set_point_within_the_limit() -> None:
    now_ns = [10**9]
    network = Network(Servo(1, 100.0), lambda: now_ns[0])
    robot = Ros2Positions(
        1, "/state", "/command", "TwistStamped", speed="0.2", gain=2.0, handle=network, clock=lambda: now_ns[0]
    )
    network.controller.update(now_ns[0])
    for _ in range(300):
        robot.move(0.01, (0.35,), (0.0,))
        now_ns[0] += 10**7
        network.run()
        now_ns[0] += 10**6
        network.run()
        now_ns[0] -= 10**6
        robot.read()
    speeds = [abs(one[0]) for one in network.controller.received]
    assert max(speeds) <= 0.2 + 1e-12
    assert network.controller.commanded[0] == pytest.approx(0.35, abs=1e-3)


@pytest.mark.slow
def test_a_whole_run_with_cuts_ends_with_a_twist_of_zero(address: str) -> None:
    """Two processes and a mock in real time; the leader's link is down three times for a second each."""
    arm = RealNode(address, "servo", Servo(1, 100.0))
    robot = f"ros2:/servo/state,command=/servo/command,type=TwistStamped,router={address}"
    timeline = "at 2s: down; at 3s: up; at 4s: down; at 5s: up; at 6s: down; at 7s: up"
    with started(
        "run", "--follower", robot, "--scene", "free", "--dof", 1, "--operator", "sine", "--up-timeline", timeline,
        "--link", "delay 20ms", "--duration", 0, "--no-files", "--json", "-",
    ) as program:  # fmt: skip
        try:
            program.until("it has run", lambda: len(arm.node.messages) > 850)
            program.process.send_signal(signal.SIGINT)
            summary = program.summary(130)
        finally:
            arm.node.close()
    assert summary["verdict"]["passive"] is True
    speeds = np.array([one[0] for one in arm.controller.received])
    assert np.abs(speeds).max() <= 0.25 + 1e-12
    assert np.abs(speeds).max() > 0.05
    assert speeds[-1] == 0.0
    spans = [len(list(run)) for still, run in groupby(speeds == 0.0) if still]
    assert sum(50 < span < 150 for span in spans) == 3, "it holds for 0.9 s three times, 100 times a second"
