"""The complete world's side of a run: endpoint, virtual mass, scene and recording; either runtime drives it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingState, WaveSample, WorldCoupling, vector_of
from hapnet.control.held_steps import FollowerServo, HeldSteps
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.errors import HapnetError
from hapnet.loading import failure
from hapnet.mechanics.contacts import Mass, Step
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.protocol import World
from hapnet.recording.drawing import SceneWriter
from hapnet.recording.samples import Event, WorldSample
from hapnet.records.record import Record, equation
from hapnet.side.device import Write
from hapnet.side.endpoint import NANO, WorldControl
from hapnet.side.notices import signal_text
from hapnet.wire.fields import Signal
from hapnet.wire.signals import LEADS, STOP


class Steps(Record):
    """The number of the world's steps so far, and the durations of all together, the longest and the last [s].

    began_ns : when the current step began.
    """

    count: int
    all_s: float
    longest_s: float
    last_s: float
    began_ns: int


class WorldSide:
    """A virtual mass among the contacts of a scene, and its endpoint.

    endpoint, mass, scene : the parts of this side.
    make_coupling : makes the coupling when control starts, from position [m], kinetic energy [J], and whether the
        reservoir is empty.
    rng : draws the lengths of the steps. write : records each sample. name : the user's name for the scene.
    """

    def __init__(
        self,
        endpoint: WorldControl,
        mass: Mass,
        scene: World,
        make_coupling: Callable[[Vector, float, bool], WorldCoupling],
        *,
        rng: np.random.Generator,
        write: Write,
        name: str,
    ) -> None:
        self.endpoint = endpoint
        self.mass = mass
        self.scene = scene
        self.origin_ns: int | None = None
        self.stepped: Steps = Steps()
        self.moved: Step
        """The result of the mass's last step."""
        self.environment: EnvironmentAccount | None = None
        """The environment's own account; None before control starts."""
        self.paused = False
        """True: the virtual mass stands still and nothing is recorded; all else continues."""
        self.releases = False
        """True: a robot renders no force while its leader does not lead. False: it holds its set-position."""
        self._stands_still = self._released = False
        self._make_coupling = make_coupling
        self.rng: Final = rng
        self._name = name
        self._write = write
        self._sent_signals: dict[str, Signal] = {}
        self._scene_writer: SceneWriter | None = None

    @property
    def coupling(self) -> CouplingState:
        return self.endpoint.coupling

    @property
    def steps(self) -> int:
        """The number of steps so far."""
        return self.stepped.count

    def step(self, now_ns: int) -> bytes | None:
        """End the current step, however long it took, and begin the next; returns the message to send, if any.

        Before control starts (`origin_ns` is None) there are no steps and no messages.
        """
        endpoint, mass = self.endpoint, self.mass
        self._exchange_signals(now_ns)
        if self.origin_ns is None:
            if not endpoint.paired:
                return None
            # a restarted world has no energy for a move to the device, so it begins at the device's first position
            if endpoint.restarted or mass.waits:
                if (sample := endpoint.arrived) is None:
                    return None
                if not isinstance(sample, WaveSample):  # a wave contains no position
                    mass.place(self.scene.towards(vector_of(sample)))
            self._world = self._make_coupling(mass.position, mass.kinetic_J, endpoint.restarted)
            endpoint.start(self._world)
            self.environment = self.scene.environment_account(self.scene.contacts, mass.position)
            self.origin_ns = self.stepped.began_ns = now_ns
            if (servo := self.servo) is not None:
                servo.released = self._released
            self._scene_writer = self._drawn(now_ns)
            return endpoint.step(now_ns, 0.0, mass.position, mass.kinetic_J, 0.0, 0.0)
        if self.paused or (self._stands_still and not isinstance(endpoint.coupling, SetPositionCoupling)):
            dt = (now_ns - self.stepped.began_ns) * NANO
            self.stepped.began_ns = now_ns
            return endpoint.step(now_ns, dt, mass.position, mass.kinetic_J, 0.0, 0.0)
        if self.scene.robot:
            used = endpoint.in_use
            self.scene.heard(now_ns, used.came_ns, used.took_ns)
        message: bytes | None = step(self, endpoint, now_ns)
        self._record(now_ns)
        return message

    def advance(self, dt: float) -> None:
        """Move the mass through a step of `dt` seconds."""
        self.mass.limit_energy(self.coupling.account)
        self.moved = self._world.advance(self.mass, dt, self.scene.contacts)

    def settle(self) -> None:
        """Count the step in the environment's account."""
        assert self.environment is not None, "made with the coupling"
        self.environment.observe(self.mass.port_J(self.coupling.ledger.work), self.moved.position)

    def _record(self, now_ns: int) -> None:
        done, mass, endpoint, coupling = self.moved, self.mass, self.endpoint, self.coupling
        ledger = coupling.ledger
        age_s, transit_s = endpoint.used(now_ns)
        self._write(
            WorldSample(
                time_ns=now_ns, step_s=self.stepped.last_s,
                position_m=done.position, velocity_mps=mass.velocity, set_position_m=coupling.set_position,
                target_m=coupling.target, coupling_force_N=done.coupling_force, contact_force_N=done.force,
                penetration_m=done.penetration_m, reservoir_J=coupling.reservoir,
                potential_J=coupling.potential(done.position),
                sent_J=ledger.sent, credited_J=ledger.credited, margin_J=ledger.margin, slack_J=ledger.slack,
                bound_J=ledger.bound, work_J=ledger.work, stored_J=ledger.stored, account_J=ledger.reservoir,
                age_s=age_s, transit_s=transit_s,
            )
        )  # fmt: skip
        self.draw(now_ns, done.position, done.force)

    def draw(self, now_ns: int, position: Vector, force: Vector) -> None:
        """Record a picture of the scene after a step, if one is due; arguments as in `drawing.observe`."""
        if self._scene_writer is not None:
            self._scene_writer.step(now_ns, position, force)

    def _drawn(self, now_ns: int) -> SceneWriter | None:
        """Return the writer of the scene's picture; None: the scene cannot be drawn.

        Raises HapnetError: the picture is not valid.
        """
        result: object = None
        try:
            result = picture = self.scene.picture()
            return None if picture is None else SceneWriter(picture, self._write, now_ns)
        except HapnetError:
            raise
        except BaseException as error:  # see `loading.failure`
            wrong = f"picture() gave {result!r:.120}, not what can be drawn ({failure(error)})"
            raise HapnetError(f"the scene {self._name} failed: {wrong}") from error

    def _exchange_signals(self, now_ns: int) -> None:
        """Pass received signals to the scene, and send the scene's changed signals to the device."""
        try:
            for name, value in self.endpoint.signals():
                if self.scene.robot:
                    self._let_go(now_ns, name, value)
                self.scene.signal(name, value)
            for name, value in self.scene.signals().items():
                if self._sent_signals.get(name, self) != value:
                    self._sent_signals[name] = value
                    self.endpoint.report(name, value)
                    self._write(Event(now_ns, "signal", signal_text(name, value)))
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self._name} failed: its signals raised {failure(error)}") from error

    def _let_go(self, now_ns: int, name: str, value: Signal) -> None:
        """Stop the robot, release it, or lead it again, as the signal requests."""
        if name == STOP and isinstance(value, str):
            self.endpoint.stand_still()
            self._stands_still, self._released = True, self.releases
            does = "renders no force" if self.releases and self.servo is not None else "holds its set-position"
            self._write(Event(now_ns, "stopped", f"the robot {does} from now on: {value}"))
        elif name == LEADS and isinstance(value, bool) and not self._stands_still:
            self._released = self.releases and not value
            self.endpoint.lead(value)
        if (servo := self.servo) is not None:
            servo.released = self._released

    @property
    def servo(self) -> FollowerServo | None:
        """The servo of a robot whose force is held; None: there is no such robot."""
        return self._world.servo if self.origin_ns is not None and isinstance(self._world, HeldSteps) else None

    def place(self, position: Vector) -> None:
        """Begin as near to `position` [m] as the walls allow. Call it before control starts."""
        assert self.origin_ns is None, "control has started"
        self.mass.place(self.scene.towards(position))

    def held_forces(self) -> dict[str, Any]:
        """The summary's entries about a robot's forces that are held from tick to tick; empty without a robot."""
        servo = self.servo
        return {} if servo is None else {"quantisation_J": servo.quantisation, **servo.figures()}

    def next_step_ns(self) -> int:
        """The length of the step that has begun, from the scene [ns]. Raises HapnetError: the scene fails."""
        try:
            return max(1, round(self.scene.next_step_s(self.rng) / NANO))
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the scene {self._name} failed: next_step_s() raised {failure(error)}") from error


@equation
def step(side: Any, endpoint: Any, now_ns: int) -> Any:
    """End the world's current step, and begin the next; returns the message to send, if there is one.

    side, endpoint : a `WorldSide` and its endpoint, or their records in compiled code. The functions below are the
    parts that differ between the two.
    """
    stepped = side.stepped
    dt = (now_ns - stepped.began_ns) * NANO
    stepped.began_ns = now_ns
    advance(side, dt)
    take(side, endpoint, now_ns)
    message = answer(side, endpoint, now_ns, dt)
    stepped.count += 1
    stepped.all_s += dt
    stepped.longest_s = max(stepped.longest_s, dt)
    stepped.last_s = dt
    settle(side)
    return message


def advance(side: Any, dt: float) -> None:
    """Move the mass through a step of `dt` seconds."""
    side.advance(dt)


def take(side: Any, endpoint: Any, now_ns: int) -> None:
    """Pass the samples and credits that arrived since the last step to the coupling."""
    endpoint.take(now_ns)


def answer(side: Any, endpoint: Any, now_ns: int, dt: float) -> Any:
    """Run the law at the onset of the next step; returns the message to send, if any."""
    done = side.moved
    return endpoint.answer(now_ns, dt, done.position, side.mass.kinetic_J, done.work_J, done.dissipated_J)


def settle(side: Any) -> None:
    """Count the step in the environment's account."""
    side.settle()
