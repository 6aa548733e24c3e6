"""Virtual time: both sides and both links in one process, deterministic under one seed, faster than real time.

Each side uses the same link port as in real time (`hapnet.side.link_port`). The clock jumps to the next due event;
`hapnet.simulation.events` finds and runs it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, cast

import numpy as np

from hapnet import checks
from hapnet.assembly.build import Setup, device_session, device_side, prepare, world_session, world_side
from hapnet.assembly.memory import bytes_a_second, require_room
from hapnet.assembly.operators import LIVE
from hapnet.assembly.own_parts import named_failures
from hapnet.assembly.simulated_device import described
from hapnet.control.two_port import TwoPort
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.installing import versions
from hapnet.loading import extension, has_extension
from hapnet.params import Params, as_params, is_arm, is_real_robot, is_simulated
from hapnet.processes.system import collector_paused
from hapnet.recording.samples import MemoryRecorder
from hapnet.records.machine_code import NotCompiledError, WholeRun, no_compiler
from hapnet.records.record import NEVER
from hapnet.side.device import DeviceSide, Write
from hapnet.side.endpoint import NANO, DeviceEndpoint, WorldEndpoint
from hapnet.side.link_port import LinkPort, Packet
from hapnet.side.world import WorldSide
from hapnet.simulation import events
from hapnet.simulation.events import DEVICE_TIMER, DONE, DOWN, STEP, STOPPED, TICK, UP, WORLD_TIMER, Clock
from hapnet.simulation.result import Result as Result
from hapnet.summary import path
from hapnet.summary.from_samples import START_S, motion
from hapnet.summary.run import Summary, combine, device_summary, with_wire, world_summary
from hapnet.units import POSE
from netem import Link

PAIRING_LIMIT_NS = 60_000_000_000
LINGER_NS = 10_000_000_000
"""For this time after the end the links may deliver shuffled energy, so that the accounts can be closed [ns]."""

_CHECK_TICKS = 3
"""Ticks between two checks whether the handshake is over."""

_REPORT_NS = 500_000_000
"""Simulated time between two reports of progress [ns]."""

_EVENT_METHODS = ("hindrance", "tick", "step", "receive")
"""The methods that `events` calls: if a subclass overrides one of these, compiled code cannot run it."""


class Simulation:
    """One run in virtual time.

    params : the parameters of the run. seed : of all random draws.
    setup : the result of `prepare` for these parameters, if it exists already.
    motion_only : record only the device's motion, for metrics (`MetricSample`).
    kernel : True: run compiled code where possible (hapnet/ext/compiled); False: never; None: where its machine code
        exists; during a very long run it is compiled in the background, and the run then goes on compiled.

    Raises InvalidParameter, netem.NetemError: the parameters are not valid for a run.
    """

    def __init__(
        self,
        params: Params,
        seed: int = 0,
        setup: Setup | None = None,
        *,
        motion_only: bool = False,
        kernel: bool | None = None,
    ) -> None:
        if not is_simulated(params.hardware):
            allowed = "simulated, omni or arm:FILE.urdf: a real device does not run in virtual time"
            raise InvalidParameter("hardware", params.hardware, allowed)
        if is_real_robot(params) and not extension("robots").runs_in_virtual_time(params):
            raise InvalidParameter("follower.robot", params.follower.robot, "none or simulated in virtual time")
        self.seed = seed
        if params.operator == LIVE:
            raise InvalidParameter(
                "operator", LIVE, "", why="nobody can lead a hand in virtual time: hapnet play, or another"
            )
        self.setup: Setup = setup or prepare(params, "continuous")
        why_not = no_compiler() if has_extension("compiled") else "hapnet.ext.compiled is not installed"
        if why_not is None and (is_arm(params.hardware) or self.setup.params.units == POSE):
            self.setup = replace(self.setup, ends=extension("compiled").device_ends(self.setup))
        self._motion_only = motion_only
        self._awaits_code = False  # True: this run could be compiled, but its machine code does not exist yet
        self._begin()
        if kernel is False:
            why_not = "it is switched off"
        elif any(getattr(type(self), name) is not getattr(Simulation, name) for name in _EVENT_METHODS):
            why_not = f"{type(self).__name__} watches the events"
        elif why_not is None:
            why_not, self._awaits_code = extension("compiled").chosen(self.setup, kernel)
        self.not_compiled: str | None = why_not  #: why compiled code does not run it; None: it does

    def _begin(self) -> None:
        """Make both sides and both links, at the time 0."""
        self.two_port: TwoPort = TwoPort()
        self.hand_port: TwoPort = self.two_port if self.setup.servo == "continuous" else TwoPort()
        period_ns = round(1e9 / self.setup.params.device.servo_hz)
        clock = self.clock = Clock(period_ns, apart=self.hand_port is not self.two_port)
        self._done: Callable[[], bool] | None = None  # whether to stop before the next event
        up, down, steps, names = np.random.SeedSequence(self.seed).spawn(4)
        incarnations = np.random.default_rng(names).integers(1, 2**63, size=2).tolist()
        write = self._writer()
        write_motion = self._recorder.write if self._motion_only else None
        self.device_endpoint: DeviceEndpoint = DeviceEndpoint(device_session(self.setup, incarnations[0]))
        self.world_endpoint: WorldEndpoint = WorldEndpoint(world_session(self.setup, incarnations[1]))
        self.device: DeviceSide = device_side(
            self.setup, self.device_endpoint, lambda: clock.now_ns, write, write_motion
        )
        self.world: WorldSide = world_side(self.setup, self.world_endpoint, np.random.default_rng(steps), write)
        self.up: Link[Packet] = Link(self.setup.up, seed=up)
        self.down: Link[Packet] = Link(self.setup.down, seed=down)
        self.device_port: LinkPort = LinkPort(self.device_endpoint, self.up)
        self.world_port: LinkPort = LinkPort(self.world_endpoint, self.down)

    @property
    def now_ns(self) -> int:
        """The time."""
        return self.clock.now_ns

    def _writer(self) -> Write:
        """Make the recording with its metadata, and return the function that records samples."""
        setup = self.setup
        duration_s = setup.params.duration_s
        require_room("duration_s", duration_s, duration_s, bytes_a_second(setup.params, setup.dof), "recorded seconds")
        self.about: dict[str, Any] = {
            **described(setup, self.seed),
            "role": "both",
            "clock": "virtual",
            "origin_ns": 0,
            "utc_origin_ns": 0,
            "utc_clock": "virtual",  # its time 0 counts as the beginning of 1970
            "links": {"up": str(setup.up), "down": str(setup.down)},
            "versions": versions(),
        }
        self._recorder = MemoryRecorder(self.about)
        return self._recorder.write

    @collector_paused()
    def run(self, progress: Callable[[float], None] | None = None) -> Result:
        """Run to the end, then let the links deliver what is in flight.

        `progress` is called from time to time with the simulated seconds since pairing.

        Raises HapnetError: the sides did not find each other, or the duration is unlimited.
        """
        with named_failures(self.setup.params):
            try:
                return self._run_whole(progress)
            except NotCompiledError as error:
                self.not_compiled, self._awaits_code = str(error), False
                self._begin()
            return self._run_whole(progress)

    def _run_whole(self, progress: Callable[[float], None] | None) -> Result:
        start_ns = self.pair()
        end_ns = start_ns + round(self.setup.params.duration_s / NANO)
        with extension("compiled").beside(self.setup) if self._awaits_code else nullcontext() as compiling:
            kernel = self._on_kernel(end_ns) if self.not_compiled is None else None
            while self.now_ns < end_ns:
                if kernel is None and compiling is not None and compiling.is_done:
                    kernel, self.not_compiled = self._on_kernel(end_ns), None
                until_ns = min(end_ns, start_ns + ((self.now_ns - start_ns) // _REPORT_NS + 1) * _REPORT_NS)
                if kernel is None:
                    self._until(until_ns)
                else:
                    kernel.run_until(end_ns if progress is None else until_ns)
                if progress is not None:
                    progress((self.now_ns - start_ns) * NANO)
        if kernel is not None:
            kernel.write_back()
        return self.result(end_ns)

    def result(self, end_ns: int) -> Result:
        """The result of a run that has come to its end, after its links have delivered what is in flight."""
        summary = self.close(end_ns)
        self.device.write_waiting()
        recording = self._recorder.recording(summary)
        summary["motion"] = motion(recording)
        return Result(summary, recording, self.device, self.world, self.setup.warnings, self.hand_port)

    def _on_kernel(self, end_ns: int) -> WholeRun | None:
        """Complete the handshake, and run the rest on the kernel; None: the run ends before that."""
        while self.now_ns < end_ns:
            self._until(min(end_ns, self.now_ns + _CHECK_TICKS * self.clock.period_ns))
            if self.quiet:
                return cast(WholeRun, extension("compiled runs").CompiledRun(self, self._recorder, end_ns))
        return None

    @property
    def quiet(self) -> bool:
        """Whether no message of the handshake is waiting to be sent or on a link."""
        endpoints = (self.device_endpoint, self.world_endpoint)
        return all(endpoint.session.handshake_over for endpoint in endpoints) and not any(
            entry[2].kind == "control" for link in (self.up, self.down) for entry in link.queue
        )

    def pair(self) -> int:
        """Run until both sides have started. Returns the start time [ns]. Raises HapnetError as `run` does."""
        if self.setup.params.duration_s <= 0.0:
            raise HapnetError("a simulation needs a duration above 0 s")
        self._run(PAIRING_LIMIT_NS, lambda: self.started)
        return self.begin(self.now_ns)

    @property
    def started(self) -> bool:
        """Whether control of both sides has started."""
        return self.device_endpoint.started and self.world_endpoint.started

    def begin(self, now_ns: int) -> int:
        """Begin the run's time, and its timelines, now; returns that time. Raises HapnetError: it is not `started`."""
        if not self.started:
            raise HapnetError(f"the two sides did not find each other within {PAIRING_LIMIT_NS * NANO:.0f} s: "
                              f"uplink {self.up.profile}, downlink {self.down.profile}")  # fmt: skip
        clock = self.clock
        ports = ((UP, self.device_port, self.setup.up_timeline), (DOWN, self.world_port, self.setup.down_timeline))
        for kind, port, timeline in ports:
            if timeline is not None:
                port.play(timeline, now_ns)
                clock.due[kind] = events.release_due_ns(port)
        clock.later_ns = (now_ns + round(START_S / NANO)) // clock.period_ns * clock.period_ns
        self.about["origin_ns"] = self.about["utc_origin_ns"] = now_ns
        self.about["device_origin_ns"] = self.device.origin_ns
        return now_ns

    def resume(self) -> None:
        """Continue after compiled code has computed everything until now and written the state back."""
        for kind, port in ((UP, self.device_port), (DOWN, self.world_port)):
            self.clock.due[kind] = events.release_due_ns(port)
        for kind, port in ((DEVICE_TIMER, self.device_port), (WORLD_TIMER, self.world_port)):
            self.clock.due[kind] = events.protocol_due_ns(port)

    def close(self, end_ns: int) -> Summary:
        """After the end: let the links deliver what is in flight, and return the summary without its motion."""
        clock = self.clock
        clock.due[STEP] = clock.due[TICK] = clock.tick_ns = NEVER
        sessions = (self.device_endpoint.session, self.world_endpoint.session)
        self._run(end_ns + LINGER_NS, lambda: all(session.settled for session in sessions))
        return self._summary(end_ns)

    def _summary(self, end_ns: int) -> Summary:
        params = self.setup.params
        device, world = (end.session.path.figures() for end in (self.device_endpoint, self.world_endpoint))
        return combine(
            with_wire(device_summary(self.device, params.coupling), self.device_endpoint.session, end_ns),
            with_wire(world_summary(self.world, params.coupling), self.world_endpoint.session, end_ns),
            {"up": self.up.stats.as_dict(), "down": self.down.stats.as_dict()},
            seed=self.seed,
            duration_s=params.duration_s,
            coupling=params.coupling,
            units=self.setup.units,
            two_port_J=self.two_port.lowest,
            hand_two_port_J=self.hand_port.lowest,
            two_port_end_J=self.two_port.now,
            two_port_later_J=self.two_port.later,
            tuning=self.setup.tuned,
            felt=self.setup.felt,
            path=path.of_both(path.of_side("device", device), path.of_side("world", world)),
        )

    def _until(self, end_ns: int) -> None:
        """Run to `end_ns`."""
        events.run_to(self, end_ns)

    def _run(self, end_ns: int, done: Callable[[], bool]) -> None:
        """Run the events until nothing is due by `end_ns`, or the run is `done`."""
        self._done = done
        events.run_events(self, end_ns)
        self._done = None

    # -- called by the events: see hapnet/simulation/events.py --------------------------------------------------------

    def hindrance(self, kind: int) -> int:
        """The reason why the next event may not run; `DONE`: it may."""
        return STOPPED if self._done is not None and self._done() else DONE

    def tick(self, now_ns: int) -> Packet | None:
        """Compute a tick that may not wait, after all ticks that waited; returns its message."""
        self.catch_up(now_ns, then_tick=True)
        message = self.device.tick(now_ns)
        return None if message is None else self.device_port.outward(message)

    def step(self, now_ns: int) -> Packet | None:
        """Compute the world's step; returns its message."""
        message = self.world.step(now_ns)
        return None if message is None else self.world_port.outward(message)

    def receive(self, port: LinkPort, packets: Iterable[Packet]) -> None:
        """Pass the messages that the other side's link has released to the side of this port."""
        for packet in packets:
            port.receive(self.now_ns, packet.data)

    def catch_up(self, until_ns: int, *, then_tick: bool = False) -> None:
        """Compute the ticks before `until_ns` that could wait. `then_tick`: a tick that may not wait follows.

        Nothing depends on these ticks before the device's next message, or the world's next step, whose work is paired
        with theirs.
        """
        clock = self.clock
        ticks = -((clock.tick_ns - until_ns) // clock.period_ns)
        if ticks > 0:
            self.device.rest(clock.tick_ns, ticks, self._observe, then_tick=then_tick)
            clock.tick_ns += ticks * clock.period_ns

    def _observe(self, work: float, hand_work: float) -> None:
        """Record the energy put in so far at the port of the device's account, and by the hand [J]."""
        self.two_port.device(work)
        if self.clock.apart:
            self.hand_port.device(hand_work)

    def wake(self) -> None:
        """Let no tick wait if a message has arrived for the device."""
        clock = self.clock
        if self.device_endpoint.has_news and clock.tick_ns != NEVER:
            self.catch_up(self.now_ns)
            clock.due[TICK] = clock.tick_ns


def simulate(
    params: Params | Mapping[str, object] | None = None, seed: int = 0, *, kernel: bool | None = None
) -> Result:
    """Run both sides and both links in virtual time; see `Simulation`.

    params : a `Params`, or changes to the defaults by dotted names, such as ``{"link.up": "4g", "link.down": "4g"}``.

    Raises InvalidParameter, netem.NetemError: `params` is neither, or not valid for a run; `seed` is below 0.
    """
    chosen = Params() if params is None else as_params(params)
    return Simulation(chosen, checks.whole("seed", seed, at_least=0), kernel=kernel).run()
