"""A side with its plant, an honest peer, a prompt network and integer time."""

import math
import random
from collections.abc import Callable

import numpy as np

from hapnet.assembly.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.checks import Vector
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.params import Params
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.side.world import WorldSide
from hapnet.wire.events import PositionReceived
from hapnet.wire.messages import Role
from hapnet.wire.session import Session
from tests.fuzzing.decoder import Broken, hold
from tests.fuzzing.invariants import Audited, Watch, check_control, check_coupling

US, MS = 1_000, 1_000_000
SILENCE_S, LONG_SILENCE_S = 0.05, 0.5  # shorter and longer than the longest pause
PATIENCE_NS = 3_000 * MS


def drawn_setup(target: str, rng: random.Random, silence_after_s: float) -> Setup:
    """Parameters of a storm: what bears on the way of a message, and of what it says, is drawn."""
    dof = rng.choice((1, 1, 2, 3))
    stiffness: object = rng.choice((100.0, 400.0, [90.0, 100.0, 150.0][:dof]))
    side: dict[str, object] = {
        "shuffle": rng.choice(("needed", "harvested", "all")),
        "smoothing_s": rng.choice((0.0, 0.0, 0.005)),
        "predict_s": rng.choice((0.0, 0.0, 0.02)),
        "on_silence": rng.choice(("hold", "release")),
        "silence_after_s": silence_after_s,
    }
    device = side | {"stiffness": stiffness, "servo": "continuous" if target == "continuous" else "sampled"}
    if target != "continuous":
        device |= {"resolution_m": rng.choice((0.0, 5e-5))}
    world = side | {"step_min_s": 0.001, "step_max_s": 0.004, "step_limit_N": 5.0}
    words = {f"device.{name}": value for name, value in device.items()}
    words |= {f"world.{name}": value for name, value in world.items()}
    words |= {
        "rendering": "paper", "scene": "box", "dof": dof,
        "operator": rng.choice(("rest", "sine")), "operator_model.frequency_hz": 2.0,
        "wire.accept_stale": rng.random() < 0.3, "wire.admission_W": rng.choice((0.05, 5.0, 100.0)),
        "wire.admission_burst_J": rng.choice((1e-3, 0.5)),
    }  # fmt: skip
    return prepare(Params().set(words), "sampled")


class Plant:
    """The side under attack with what it drives: ticks or steps when they are due, checked after each."""

    def __init__(self, setup: Setup, role: Role, incarnation: int, rng: random.Random):
        self.setup, self.role = setup, role
        self.now_ns = 0
        self.ticks = 0
        self.side: DeviceSide | WorldSide
        self.endpoint: DeviceEndpoint | WorldEndpoint
        self._audited: Audited | None = None
        self.received = 0
        """Messages since the last tick."""
        params = setup.params
        if role == "device":
            self.endpoint = DeviceEndpoint(device_session(setup, incarnation))
            self.side = device_side(setup, self.endpoint, lambda: self.now_ns, lambda sample: None)
            self.force_limit: float | None = params.device.force_limit_N * params.device.spring_share
            self._ceiling, self._step_limit = params.device.ceiling_J, params.device.step_limit_N
        else:
            self.endpoint = WorldEndpoint(world_session(setup, incarnation))
            generator = np.random.default_rng(rng.getrandbits(32))
            self.side = world_side(setup, self.endpoint, generator, lambda sample: None)
            self.force_limit = None
            self._ceiling, self._step_limit = params.world.ceiling_J, params.world.step_limit_N
        wire = params.wire
        self.watch = Watch(
            self.endpoint, power_W=wire.admission_W, burst_J=wire.admission_burst_J, accept_stale=wire.accept_stale
        )
        self._due_ns = 0

    @property
    def coupling(self) -> SetPositionCoupling:
        return self.endpoint.coupling

    @property
    def max_step(self) -> float:
        """How far the set-position may step [m]: its force may step by the limit along the stiffest axis."""
        section = self.setup.params.device if self.role == "device" else self.setup.params.world
        K = np.atleast_1d(np.asarray(section.stiffness, dtype=float))
        return self._step_limit / float(max(K if K.ndim == 1 else np.linalg.eigvalsh(K)))

    def run(self, until_ns: int, say: Callable[[bytes], None]) -> None:
        """Tick or step up to a time; position messages go to `say`."""
        while self._due_ns <= until_ns:
            self.now_ns = max(self.now_ns, self._due_ns)
            self.tick(say)
        self.now_ns = until_ns

    def tick(self, say: Callable[[bytes], None]) -> None:
        """One tick or step, now."""
        side, started = self.side, self.endpoint.started
        check_control(self.endpoint, self.received)
        if isinstance(side, DeviceSide):
            message = side.tick(self.now_ns)
            self._due_ns = self.now_ns + MS
        else:
            message = side.step(self.now_ns)
            self._due_ns = self.now_ns + (side.next_step_ns() if message else MS)
        self.ticks += 1
        if started:
            self.received = 0
        if message is not None:
            say(message)
        if self.endpoint.started:
            self._check()

    @property
    def x(self) -> Vector:
        """The position of the device, or of the proxy [m]."""
        side = self.side
        if isinstance(side, SampledDeviceSide):
            return side.x
        return side.device.read()[0] if isinstance(side, DeviceSide) else side.mass.position

    def _check(self) -> None:
        side, coupling = self.side, self.coupling
        if self._audited is None:
            self._audited = Audited(coupling.modulator, self.max_step, self._ceiling)
            coupling.modulator = self._audited
        x = self.x
        if isinstance(side, SampledDeviceSide):
            force = math.hypot(*side.servo.force)
            hold(force <= self.setup.params.device.force_limit_N * (1.0 + 1e-12), "the servo asks for", force, "N")
        elif not isinstance(side, DeviceSide):
            hold(all(map(math.isfinite, side.mass.velocity)), "velocity", side.mass.velocity)
        check_coupling(coupling, x, self.force_limit)

    @property
    def updates(self) -> int:
        """How many updates of the modulator were checked."""
        return self._audited.updates if self._audited else 0


class Rig:
    """A plant, its honest peer (a session that says positions and shuffles energy), and a prompt network."""

    def __init__(self, target: str, rng: random.Random, setup: Setup | None = None, incarnation: int = 0) -> None:
        self.rng = rng
        self.setup = setup or drawn_setup(target, rng, SILENCE_S)
        role: Role = "world" if target == "world" else "device"
        self.plant = Plant(self.setup, role, incarnation or rng.getrandbits(64) | 1, rng)
        self.watch, self.session = self.plant.watch, self.plant.endpoint.session
        self.dof = self.setup.dof
        self.peer_role: Role = "device" if role == "world" else "world"
        self.honest = self._new_peer(rng.getrandbits(64) | 1)
        self.overheard: Callable[[bytes], None] = lambda frame: None
        self.restarts = 0
        self.positions = 0
        """Positions of the present honest peer that this side took."""

    @property
    def now_ns(self) -> int:
        return self.plant.now_ns

    def _new_peer(self, incarnation: int) -> Session:
        make = device_session if self.peer_role == "device" else world_session
        return make(self.setup, incarnation)

    def restart(self, incarnation: int = 0) -> None:
        """The honest peer's process dies and starts anew."""
        self.honest = self._new_peer(incarnation or self.rng.getrandbits(64) | 1)
        self.restarts += 1
        self.positions = 0

    @property
    def paired(self) -> bool:
        """Do the two honest sides take each other for their peers?"""
        mine, theirs = self.session.peer, self.honest.peer
        if mine is None or theirs is None:
            return False
        own, honest = self.session.identity.incarnation, self.honest.identity.incarnation
        return (mine.incarnation, theirs.incarnation) == (honest, own)

    def run(self, duration_ns: int) -> None:
        """Let time pass, with ticks and steps, and then all that the two sides have to say."""
        self.plant.run(self.plant.now_ns + duration_ns, self._to_honest)
        self.talk()

    def talk(self) -> None:
        """What is due to be said now, in both directions, until both are silent."""
        now_ns = self.now_ns
        for _ in range(20):
            said = False
            if (due_ns := self.plant.endpoint.next_due_ns) is not None and due_ns <= now_ns:
                self.plant.received += 1  # time, too, may bring a credit
                for _, data in self.watch.poll(now_ns):
                    self._to_honest(data)
                    said = True
            if (due_ns := self.honest.next_due_ns) is not None and due_ns <= now_ns:
                for _, data in self.honest.poll(now_ns)[0]:
                    self.attack(data)
                    self.overheard(data)
                    said = True
            if not said:
                return
        raise Broken("the two sides do not stop talking")

    def honest_position(self) -> None:
        """The honest peer moves."""
        phase = self.now_ns * 1e-9 * math.tau
        data = self.honest.position(self.now_ns, [0.02 * math.sin(phase + axis) for axis in range(self.dof)])
        self.overheard(data)
        events = self.attack(data)
        self.positions += any(isinstance(event, PositionReceived) for event in events)

    def attack(self, data: bytes) -> tuple[object, ...]:
        """A frame arrives at the side under attack."""
        self.plant.received += 1
        return self.watch.receive(self.now_ns, data)

    def _to_honest(self, data: bytes) -> None:
        self.overheard(data)
        self.honest.receive(self.now_ns, data)

    def recover(self) -> None:
        """The attack is over: within 3 s the pair works, to the nanojoule, unless somebody lied in the peer's name.

        Who listens in can end a pair or claim energy that was never sent; then the honest peer's process is started
        anew, as its user would, and a new incarnation must get through.
        """
        self._quiet(PATIENCE_NS // 3)
        session, honest = self.session, self.honest
        forged = (
            not self.paired
            or self.watch.claimed_nJ > honest.sent_nJ
            or self.watch.numbers.newest >= honest.positions.next_sequence
        )
        if forged:
            self.restart()
        self._quiet(PATIENCE_NS)
        honest = self.honest
        hold(self.paired, "not paired again:", session.peer, honest.peer, session.dropped)
        taken, first = self.positions, honest.positions.next_sequence
        acked, abandoned, credited, before = session.acked_nJ, session.abandoned_nJ, session.credited_nJ, honest.sent_nJ
        in_flight, uncredited = session.in_flight_nJ, honest.in_flight_nJ
        theirs = honest.credited_nJ
        honest.shuffle(1e-4)
        session.shuffle(1e-4)
        self._quiet(PATIENCE_NS)
        hold(
            self.positions - taken == honest.positions.next_sequence - first, "positions were dropped", session.dropped
        )
        hold(session.abandoned_nJ == abandoned, "energy was abandoned within a pair")
        hold(honest.acked_nJ <= session.credited_nJ, "acknowledged and not credited")
        self._settle()
        hold(honest.settled, honest.in_flight_nJ, "nJ not acknowledged")
        given = honest.sent_nJ - before
        hold(given >= 99_999 and session.credited_nJ - credited == given + uncredited, given, "nJ sent")
        mine = session.acked_nJ - acked
        hold(session.settled and mine >= 99_999 + in_flight, in_flight, "nJ in flight,", mine, "acknowledged")
        hold(honest.credited_nJ - theirs <= mine, "credited twice:", theirs, honest.credited_nJ, mine)
        hold(honest.credited_nJ == session.acked_nJ - self._acked_before(), "the accounts of the pair differ")

    def _acked_before(self) -> int:
        """What was acknowledged by peers before the present one [nJ]."""
        return self.session._past.acked

    def _settle(self) -> None:
        """Wait for what is in flight; a slow bucket may take its time."""
        for _ in range(60_000):
            if self.honest.settled and self.session.settled:
                return
            self.plant.now_ns += 10 * MS  # the plants rest, or they would go on harvesting
            self.talk()

    def _quiet(self, duration_ns: int) -> None:
        end_ns = self.now_ns + duration_ns
        while self.now_ns < end_ns:
            self.honest_position()
            self.run(5 * MS)
