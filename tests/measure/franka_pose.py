"""How closely an FR3 follows a hand that moves and turns a tool over 4g, in virtual time, with the link pulled.

The driver, the robot's side and the leader's side are those of a run. The robot is the tests' stand-in of the maker's
library: its kinematics, each joint a mass by itself.

``python -m tests.measure franka_pose --hand hand-23 --seconds 60 --cut-at 30``
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import numpy as np

from hapnet.assembly.build import device_session, device_side, prepare, world_session
from hapnet.checks import Vector
from hapnet.ext.robots import franka, franka_interface
from hapnet.ext.robots.robot_side import robot_side
from hapnet.mechanics.pose import ARM_M
from hapnet.params import Params
from hapnet.recording.samples import DeviceSample, Sample, WorldSample
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.link_port import LinkPort
from netem import Link, LinkProfile
from tests.conftest import ROOT
from tests.support import franka_stand_in

MS = 1_000_000
PARAMS = ROOT / "examples" / "fr3_six_axes.toml"


class Stepped(franka.Franka):
    """The driver with the options of the page, on the clock of this program. It remembers what it was sent."""

    now_ns = 0
    wrenches: list[tuple[Vector, Vector]]

    def __init__(self, dof: int) -> None:
        super().__init__(dof, "robot", force=100.0, wrist=100.0, speed=1.7, clock=lambda: Stepped.now_ns * 1e-9)
        Stepped.wrenches = []

    def apply_wrench(self, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        wrench = super().apply_wrench(force, torque)
        self.wrenches.append(wrench)
        return wrench


@dataclass
class Followed:
    """What was recorded of a run. The numbers leave out the first 2 s, and the time from the cut until 1 s after it."""

    device: list[DeviceSample] = field(default_factory=list)
    robot: list[WorldSample] = field(default_factory=list)
    wrenches: list[tuple[Vector, Vector]] = field(default_factory=list)
    cut_s: tuple[float, float] | None = None

    def error_deg(self, delay_s: float) -> float:
        """The angle between the tool and the hand as it was turned `delay_s` ago, rms [degrees]."""
        angles, counted = self._angles(delay_s)
        return float(np.degrees(np.sqrt(np.mean(angles[counted] ** 2))))

    def error_mm(self, delay_s: float) -> float:
        """The distance between the tool's point and the hand's `delay_s` ago, rms [mm]."""
        place, hand, times = self._places(delay_s)
        away = np.linalg.norm((place - hand)[self._counted(times), :3], axis=1)
        return float(1e3 * np.sqrt(np.mean(away**2)))

    @property
    def largest_step_N(self) -> float:
        """Of the force at the robot's tool from one tick to the next, over the whole run."""
        return _largest_step([force for force, _ in self.wrenches])

    @property
    def largest_step_Nm(self) -> float:
        """Of the torque at the robot's tool, likewise."""
        return _largest_step([torque for _, torque in self.wrenches])

    @property
    def least_margin_J(self) -> float:
        return min(min(one.margin_J for one in side) for side in (self.device, self.robot))

    @property
    def least_slack_J(self) -> float:
        return min(min(one.slack_J for one in side) for side in (self.device, self.robot))

    def _angles(self, delay_s: float) -> tuple[Any, Any]:
        place, hand, times = self._places(delay_s)
        theirs, ours = (np.eye(3) + x[:, 3:].reshape(-1, 3, 3) / ARM_M for x in (place, hand))
        cosine = 0.5 * (np.einsum("nij,nij->n", theirs, ours) - 1.0)
        return np.arccos(np.clip(cosine, -1.0, 1.0)), self._counted(times)

    def _places(self, delay_s: float) -> tuple[Any, Any, Any]:
        times = np.array([one.time_ns for one in self.robot]) * 1e-9
        when = np.array([one.time_ns for one in self.device]) * 1e-9
        hand = np.array([one.position_m for one in self.device])
        then = np.column_stack([np.interp(times - delay_s, when, axis) for axis in hand.T])
        return np.array([one.position_m for one in self.robot]), then, times

    def _counted(self, times: Any) -> Any:
        begin, end = self.cut_s or (np.inf, np.inf)
        return (times > 2.0) & ((times < begin) | (times > end + 1.0))


@contextmanager
def stand_in_for_the_library() -> Iterator[None]:
    with (
        mock.patch.dict(sys.modules, {"pylibfranka": franka_stand_in}),
        mock.patch.object(franka, "find_spec", return_value=True),
        mock.patch.object(franka_interface, "require_answer"),
        mock.patch("time.sleep"),
    ):
        yield


def follow(hand: str, seconds: float, cut_s: tuple[float, float] | None, **changes: object) -> Followed:
    """A hand and the robot for so long; the link is down between the two times of `cut_s` [s]."""
    given: dict[str, object] = {
        "operator": hand, "device.servo": "sampled", "follower.robot": f"{__name__}:Stepped", "link.up": "4g",
        "link.down": "4g", "record_hz": 100.0, **changes,
    }  # fmt: skip
    setup = prepare(Params().load(PARAMS).set(given), "sampled")
    found = Followed(cut_s=cut_s)

    def take(sample: Sample) -> None:
        if isinstance(sample, DeviceSample):
            found.device.append(sample)
        elif isinstance(sample, WorldSample):
            found.robot.append(sample)

    def clock() -> int:
        return Stepped.now_ns

    Stepped.now_ns = 0
    with stand_in_for_the_library():
        ends = DeviceEndpoint(device_session(setup, 5)), DeviceEndpoint(world_session(setup, 6))
        sides = device_side(setup, ends[0], clock, take), robot_side(setup, ends[1], clock, take)
        ports = LinkPort(ends[0], Link(setup.up, seed=1)), LinkPort(ends[1], Link(setup.down, seed=2))
        down = LinkProfile.parse("loss 100%")
        for tick in range(1, round(1000 * seconds)):
            now_ns = Stepped.now_ns = tick * MS
            for at_s, up_and_down in zip(cut_s or (), ((down, down), (setup.up, setup.down)), strict=False):
                if tick == round(1000 * at_s):
                    for port, profile in zip(ports, up_and_down, strict=True):
                        port.change(now_ns, profile)
            for side, port, other in zip(sides, ports, ports[::-1], strict=True):
                if (message := side.tick(now_ns)) is not None:
                    _deliver(port.send(now_ns, message), other, now_ns)
            for port, other in zip(ports, ports[::-1], strict=True):
                _deliver(port.pump(now_ns).packets, other, now_ns)
    found.wrenches = Stepped.wrenches
    return found


def main(hand: str = "hand-23", seconds: float = 60.0, cut_at: float = 0.0, cut_s: float = 5.0) -> None:
    """Of the hand that moves the leader; --cut-at pulls the link for --cut-s seconds."""
    found = follow(hand, seconds, (cut_at, cut_at + cut_s) if cut_at else None)
    for delay_s in (0.0, 0.05, 0.1):
        print(
            f"hand {delay_s:4.2f} s ago: {found.error_deg(delay_s):5.2f} degrees, {found.error_mm(delay_s):5.2f} mm rms"
        )
    print(f"largest steps {found.largest_step_N:.3f} N, {found.largest_step_Nm:.3f} Nm")
    print(f"least margin {found.least_margin_J:.3g} J, least slack {found.least_slack_J:.2g} J")


def _largest_step(wrenches: list[Vector]) -> float:
    return float(np.linalg.norm(np.diff(np.array(wrenches), axis=0), axis=1).max())


def _deliver(packets: Any, port: LinkPort, now_ns: int) -> None:
    for packet in packets:
        port.receive(now_ns, packet.data)
