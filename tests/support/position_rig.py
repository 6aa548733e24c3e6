"""A leader, a link and a robot behind the mock of ros2_control, all in virtual time, with a link that can be cut."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hapnet.assembly.build import device_session, device_side, prepare, world_session, world_side
from hapnet.ext.robots.ros2_positions import Ros2Positions
from hapnet.params import Params
from hapnet.recording.samples import Event, Sample
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.link_port import LinkPort
from hapnet.side.sampled_device import SampledDeviceSide
from netem import Link
from tests.support.ros2_control import CONTROLLERS, NAMES, STORE, Controller, Network

MS = 1_000_000
SPEED = {"m": 0.25, "rad": 0.5}
"""The default limits of speed that the page says [m/s], [rad/s]."""


class Robot(Ros2Positions):
    """hapnet's robot on the mock's network."""

    now_ns = 0
    network: Network

    def __init__(self, dof: int, type: str = "PoseStamped", rate: float = 100.0) -> None:
        joints = "+".join(NAMES[:dof]) if type in ("JointTrajectory", "Float64MultiArray") else ""
        super().__init__(
            dof, "/state", "/command", type, joints=joints, rate=rate, handle=Robot.network, clock=lambda: Robot.now_ns
        )


class PositionRig:
    """A simulated hand leads a robot of one axis over 20 ms in each direction.

    amplitude : of the hand's sine of 0.9 Hz, [m] or [rad].
    """

    def __init__(self, kind: str, hz: float, seed: int = 0, amplitude: float = 0.0, **changes: object) -> None:
        joints = kind in ("JointTrajectory", "Float64MultiArray")
        self.now_ns = Robot.now_ns = 0
        self.controller: Controller = CONTROLLERS[kind](1, hz)
        self.network = Robot.network = Network(self.controller, lambda: self.now_ns)
        self.speed = SPEED["rad" if joints else "m"]
        self.step = 2.0 * self.speed / hz
        self.setup = prepare(
            Params().set({
                "scene": "joints" if joints else "free", "dof": 1, "operator": "sine",
                "operator_model.amplitude_m": amplitude or (0.3 if joints else 0.06),
                "operator_model.frequency_hz": 0.9, "operator_model.start_periods": 0.0,
                "device.servo": "sampled", "device.servo_hz": 200.0,
                "follower.robot": f"{__name__}:Robot,type={kind},rate={hz}",
                "link.up": "delay 20ms", "link.down": "delay 20ms", **changes,
            }),
            "sampled",
        )  # fmt: skip
        self.samples: list[Sample] = []
        self.far = WorldEndpoint(world_session(self.setup, 6))
        self.held = self.linked = True
        self.world = world_side(self.setup, self.far, np.random.default_rng(seed), self.samples.append)
        down = LinkPort(self.far, Link(self.setup.down, seed=seed + 1))
        self.ports = [down, down]
        self.begin_leader(5)
        self._due_ns = 0
        self.kept: list[tuple[Any, LinkPort]] = []

    def begin_leader(self, incarnation: int) -> None:
        """A process of a leader begins, in place of the last one."""
        self.leader = DeviceEndpoint(device_session(self.setup, incarnation))
        device = device_side(self.setup, self.leader, self._clock, self.samples.append)
        assert isinstance(device, SampledDeviceSide)
        device.is_held = lambda t: self.held
        self.device = device
        self.ports[0] = LinkPort(self.leader, Link(self.setup.up, seed=incarnation))

    def _clock(self) -> int:
        return self.now_ns

    def run(self, until_ms: int) -> None:
        up, down = self.ports
        while self.now_ns < until_ms * MS:
            self.now_ns += MS
            Robot.now_ns = now = self.now_ns
            self.network.run()
            if now % (5 * MS) == 0 and (message := self.device.tick(now)) is not None:
                self._deliver(up.send(now, message), down)
            if now >= self._due_ns:
                if (message := self.world.step(now)) is not None:
                    self._deliver(down.send(now, message), up)
                self._due_ns = now + (MS if self.world.origin_ns is None else self.world.next_step_ns())
            for port, other in ((up, down), (down, up)):
                self._deliver(port.pump(now).packets, other)

    def _deliver(self, packets: Any, port: LinkPort) -> None:
        for packet in packets:
            if self.linked:
                port.receive(self.now_ns, packet.data)
            else:
                self.kept.append((packet, port))

    def deliver_kept(self, count: int) -> None:
        """Deliver the first `count` packets of those that came while the link was cut."""
        for packet, port in self.kept[:count]:
            port.receive(self.now_ns, packet.data)

    def stall(self, ms: int) -> None:
        """Let hapnet's next step come so much later."""
        self._due_ns += ms * MS

    def events(self) -> list[str]:
        return [one.text for one in self.samples if isinstance(one, Event)]


SAME = 1e-9


class Cut(NamedTuple):
    """What was measured around a cut.

    step, sent : the largest step of the controller's commands, and of the set-points that hapnet sent [m] or [rad].
    stops_ms, sent_ms : the time from the cut until the controller's command stands, and the set-points that were sent.
    oldest_ms : the age of the oldest message that was executed. moved : how far it moved before the cut [m] or [rad].
    """

    step: float
    sent: float
    stops_ms: float
    sent_ms: float
    oldest_ms: float
    moved: float


def cut(rig: PositionRig, where: str, rng: np.random.Generator) -> Cut:
    """Let the robot move, cut a link for 5 ms to 0.7 s, and restore it. where : "leader", or a cut of `Network`."""
    controller = rig.controller
    begun = len(controller.executed)
    published = len(rig.network.published)
    rig.run(rig.now_ns // MS + int(rng.integers(100, 300)))
    rig.stall(int(rng.integers(20, 80)))
    rig.run(rig.now_ns // MS + int(rng.integers(100, 200)))
    if where == "leader":
        rig.linked = False
    else:
        rig.network.interrupt(where)
    cut_ns, before = rig.now_ns, len(controller.executed)
    rig.run(rig.now_ns // MS + int(rng.choice([rng.integers(5, 150), rng.integers(150, 700)])))
    silent = [(one.now_ns, one.position[0]) for one in controller.executed[before:]]
    rig.linked, rig.network.cut = True, ""
    restored_ns = rig.now_ns
    rig.run(rig.now_ns // MS + 150)
    executed = controller.executed[begun:]
    places = np.array([one.position for one in executed])
    messages = [(at_ns, STORE.deserialize_cdr(data, controller.kind)) for at_ns, data in rig.network.published]
    sent = [(at_ns, controller.asked(message)[0]) for at_ns, message in messages][published:]
    if controller.kind.endswith("TwistStamped"):
        steps = [(at_ns, v * controller.period_ns * 1e-9) for at_ns, v in sent]
    else:
        steps = [(two[0], two[1] - one[1]) for one, two in pairwise(sent)]
    moves = [at_ns for at_ns, step in steps if cut_ns < at_ns <= restored_ns and abs(step) > SAME]
    stands = [two[0] for one, two in pairwise(silent) if abs(two[1] - one[1]) > SAME]
    return Cut(
        float(np.abs(np.diff(places, axis=0)).max()), max(abs(step) for _, step in steps),
        (max(stands, default=cut_ns) - cut_ns) / MS, (max(moves, default=cut_ns) - cut_ns) / MS,
        max(one.age_ns for one in executed) / MS, float(np.ptp(places[: before - begun])),
    )  # fmt: skip
