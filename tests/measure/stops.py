"""A leader and a robot of each kind in virtual time, and what stops the robot.

``python -m tests.measure stops --times 20`` prints how far each kind moved after each cause, of so many random times.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hapnet.assembly.build import device_session, device_side, prepare, world_session, world_side
from hapnet.checks import Vector
from hapnet.ext.robots.robot_side import robot_side
from hapnet.params import Params
from hapnet.recording.samples import Sample
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.link_port import LinkPort
from hapnet.side.sampled_device import SampledDeviceSide
from netem import Link, LinkProfile

MS = 1_000_000
ONE_WAY_MS = 40
KINDS = ("simulated", "mujoco", "driver", "position arm", "lerobot", "ros 2", "takes positions")
CAUSES = ("dead-man", "remote stop", "closed page", "silent leader")

MODEL = """<mujoco><option gravity="0 0 0" timestep="0.001"/><worldbody><body name="tip">
<joint type="slide" axis="1 0 0" damping="1"/><geom type="sphere" size="0.01" mass="0.1"/></body></worldbody>
</mujoco>"""


class Arm:
    """A robot of 300 g with a driver, which a motor moves; nobody holds it."""

    dof, force_limit, resolution = 1, 10.0, 0.0
    now_ns = 0
    newest: Arm

    def __init__(self, dof: int) -> None:
        self.x = self.v = self.force = 0.0
        self._at_ns = Arm.now_ns
        Arm.newest = self

    def surroundings(self) -> float:
        """The force of its surroundings [N]."""
        return 0.0

    def read(self) -> tuple[Vector, Vector]:
        dt, self._at_ns = (Arm.now_ns - self._at_ns) * 1e-9, Arm.now_ns
        for _ in range(8):
            self.v += dt / 8 * (self.force + self.surroundings() - 4.0 * self.v) / 0.3
            self.x += dt / 8 * self.v
        return (self.x,), (self.v,)

    def apply(self, force: Vector) -> Vector:
        self.force = force[0]
        return force


class JawArm(Arm):
    """A jaw, open by 50 mm, and an object of 30 mm and 5000 N/m between its fingers."""

    jaw = True

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.x = 0.05

    def surroundings(self) -> float:
        return 5000.0 * max(0.0, 0.03 - self.x) - 20.0 * self.v * (self.x < 0.03)


class BehindTopics(Arm):
    """The same behind topics of ROS 2, 100 times a second: a command acts when the next one is sent."""

    rate_hz = 100.0

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self._sent: Vector = (0.0,)

    def apply(self, force: Vector) -> Vector:
        acts, self._sent = self._sent, force
        return super().apply(acts)


class TakesPositions:
    """An arm that goes to each position at once, 50 times a second; `ties` pulls the mass to it, as LeRobot's does."""

    dof, min_s, max_s, robot = 1, 0.02, 0.02, True
    ties = 0.0
    newest: TakesPositions

    def __init__(self) -> None:
        self.x = self.before = 0.0
        TakesPositions.newest = self

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        self.before, self.x = self.x, position[0]
        return (self.ties * (self.before - self.x) - 2.0 * velocity[0] * (self.ties > 0.0),)


class Tied(TakesPositions):
    ties = 200.0


class Follows:
    """A follower that takes positions, 100 times a second, and is 30 ms late."""

    simulated, rate_hz = True, 100.0
    newest: Follows

    def __init__(self, dof: int) -> None:
        self.dof, self.x = dof, 0.1
        Follows.newest = self

    def read(self) -> Vector:
        return (self.x,)

    def move(self, dt: float, position: Vector, velocity: Vector) -> None:
        self.x += (position[0] - self.x) * min(1.0, dt / 0.03)


class Rig:
    """A leader that a simulated hand moves, its robot, and an ideal clock of 1 ms."""

    def __init__(self, kind: str, folder: Path, seed: int = 0, **changes: object) -> None:
        scenes = {"mujoco": f"mujoco:{folder / 'arm.xml'}?proxy=tip",
                  "position arm": f"{__name__}:TakesPositions", "lerobot": f"{__name__}:Tied"}  # fmt: skip
        robots = {
            "driver": f"{__name__}:Arm", "ros 2": f"{__name__}:BehindTopics", "position arm": "none", "lerobot": "none",
            "takes positions": f"{__name__}:Follows",
        }  # fmt: skip
        (folder / "arm.xml").write_text(MODEL, encoding="utf-8")
        self.now_ns = Arm.now_ns = 0
        self.setup = prepare(
            Params().set({
                "scene": scenes.get(kind, "free"), "dof": 0 if kind in scenes else 1, "operator": "sine",
                "operator_model.amplitude_m": 0.06, "device.servo": "sampled", "operator_model.start_periods": 0.0,
                "operator_model.frequency_hz": 0.6, "follower.robot": robots.get(kind, "simulated"),
                "link.up": f"delay {ONE_WAY_MS}ms", "link.down": f"delay {ONE_WAY_MS}ms",
                **({"follower.servo_hz": BehindTopics.rate_hz} if kind == "ros 2" else {}), **changes,
            }),
            "sampled",
        )  # fmt: skip
        self.leader, self.robot = DeviceEndpoint(device_session(self.setup, 5)), None
        self.samples: list[Sample] = []
        device = device_side(self.setup, self.leader, self._clock, self.samples.append)
        assert isinstance(device, SampledDeviceSide)
        self.device = device
        self.held, self.alive = True, True
        device.is_held = lambda t: self.held
        self._step: Callable[[int], bytes | None]
        if kind in ("driver", "ros 2"):
            session = world_session(self.setup, 6)
            self.far: DeviceEndpoint | WorldEndpoint = DeviceEndpoint(session)
            self._step = robot_side(self.setup, self.far, self._clock, lambda sample: None).tick
            self.place: Callable[[], float] = lambda: Arm.newest.x
            self._every = round(1000 / self.setup.params.follower.servo_hz)
        else:
            self.far = WorldEndpoint(world_session(self.setup, 6))
            side = world_side(self.setup, self.far, np.random.default_rng(seed), lambda sample: None)
            self._step = side.step
            takes = kind in ("position arm", "lerobot")
            self.place = (lambda: TakesPositions.newest.x) if takes else (lambda: side.mass.position[0])
            self._every = 20 if takes else 1
            if kind == "takes positions":
                side.scene.open()
                self.place, self._every = (lambda: Follows.newest.x), 10
        self.ports = [
            LinkPort(self.leader, Link(self.setup.up, seed=seed)),
            LinkPort(self.far, Link(self.setup.down, seed=seed + 1)),
        ]  # fmt: skip

    def _clock(self) -> int:
        return self.now_ns

    def run(self, until_ms: int) -> list[tuple[int, float]]:
        """Times [ms] and places of the robot [m]."""
        places = []
        while self.now_ns < until_ms * MS:
            self.now_ns += MS
            Arm.now_ns = now = self.now_ns
            up, down = self.ports
            if self.alive and (message := self.device.tick(now)) is not None:
                self._deliver(up.send(now, message), down)
            if (now // MS) % self._every == 0 and (message := self._step(now)) is not None:
                self._deliver(down.send(now, message), up)
            for port, other in ((up, down), (down, up)):
                if self.alive or port is down:
                    self._deliver(port.pump(now).packets, other)
            places.append((now // MS, self.place()))
        return places

    def _deliver(self, packets: object, port: LinkPort) -> None:
        for packet in packets:  # type: ignore[attr-defined]
            if self.alive or port is self.ports[1]:
                port.receive(self.now_ns, packet.data)

    def stop(self, cause: str, variant: int = 0) -> None:
        """variant : 0 or 1, which of two ways: at the leader's side or the robot's; its network or its process."""
        if cause == "dead-man":
            self.held = False
        elif cause == "remote stop":
            (self.leader, self.far)[variant].stop_force("a test stops it")
        elif cause == "closed page":
            self.device.let_go = "the page is closed"
        elif variant:
            self.alive = False
        else:
            self.ports[0].change(self.now_ns, LinkProfile.parse("loss 100%"))

    def resume(self, cause: str) -> None:
        self.held, self.alive, self.device.let_go = True, True, ""
        self.ports[0].change(self.now_ns, self.setup.up)


def moved_mm(kind: str, cause: str, folder: Path, seed: int, **changes: object) -> tuple[float, float]:
    """How far the robot moved in the 0.4 s before the cause, and from 0.2 s and one way after it on, for 0.5 s [mm]."""
    rng = np.random.default_rng([seed, KINDS.index(kind), CAUSES.index(cause)])
    rig, at_ms = Rig(kind, folder, seed, **changes), int(rng.integers(500, 900))
    before = rig.run(at_ms)
    rig.stop(cause, int(rng.integers(2)))
    after = rig.run(at_ms + 200 + ONE_WAY_MS + 500)
    late = [x for t, x in after if t > at_ms + 200 + ONE_WAY_MS]
    return 1e3 * float(np.ptp([x for t, x in before if t > at_ms - 400])), 1e3 * float(np.ptp(late))


def main(times: int = 20) -> None:
    with TemporaryDirectory() as folder:
        for kind, cause in product(KINDS, CAUSES):
            found = [moved_mm(kind, cause, Path(folder), seed) for seed in range(times)]
            before, after = np.median(found, axis=0)[0], np.max(found, axis=0)[1]
            print(f"{kind:13} {cause:13} before {before:5.1f} mm, after at most {after:7.4f} mm", flush=True)
