"""A scenario of a batch, before and after it is vectorised.

A scenario is loaded after both sides have started and the handshake is complete; it ends at its last tick. Before and
after that it is an ordinary `Simulation`, with the same result.
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Press, Recorded, Rest, Sine
from hapnet.plant.worlds.scene import Scene
from hapnet.recording.samples import Columns, MemoryRecorder, MotionSample, Sample
from hapnet.side.device import ContinuousDeviceSide, DeviceSide, Write
from hapnet.side.endpoint import NANO, Endpoint
from hapnet.side.packet import Packet
from hapnet.side.world import WorldSide
from hapnet.simulation.batch.lines import vectorisable
from hapnet.simulation.simulation import Simulation
from hapnet.summary import path
from hapnet.summary.run import Summary
from hapnet.wire.messages import Energy, Position, decode
from netem import Link

_LOOK = 3  # ticks between two checks of the handshake, plus one
_BURST_MOST_J = 4.0  # in aJ it must fit 63 bits


class SideState(NamedTuple):
    """One side at the end of its run; vectors have one element per axis."""

    position_m: Vector
    velocity_mps: Vector
    set_position_m: Vector
    reservoir_J: float
    deficit_J: float
    work_J: float
    credited_J: float
    sent_J: float


class BatchRun(NamedTuple):
    """The result of one scenario of a batch."""

    params: Params
    seed: int
    summary: Summary
    """As of a single run, but all values of `motion` and `path` are None, because nothing is recorded or timed."""
    device: SideState
    world: SideState
    vectorised: bool
    """False: the scenario was simulated alone, more slowly and with the same result, because of its parameters."""


class UnderWay(NamedTuple):
    """A message that is in flight when the scenario is loaded."""

    order: int
    due_ns: int
    sent_ns: int
    content: Position | Energy


class Nothing(MemoryRecorder):
    """Records nothing."""

    def write(self, sample: Sample | MotionSample) -> None:
        pass

    def extend(self, device: Columns, world: Columns) -> None:
        pass


class Scenario(Simulation):
    """A `Simulation` whose middle part an `Engine` can run."""

    end_ns: int

    def _writer(self) -> Write:
        self._recorder = Nothing({})
        return self._recorder.write

    def _path(self) -> path.Section:
        return path.unknown()

    @property
    def is_vectorised(self) -> bool:
        """Is everything in this scenario vectorised?"""
        params, setup, side = self.setup.params, self.setup, self.device
        return (
            isinstance(side, ContinuousDeviceSide)
            and setup.up_timeline is setup.down_timeline is None
            and isinstance(side.device, SimulatedDevice)
            and isinstance(side.device.operator, Rest | Sine | Press | Recorded)
            and isinstance(setup.scene, Scene)
            and type(setup.scene).next_step_s is Scene.next_step_s
            and not any(part.smoothing_s or part.predict_s for part in (params.device, params.world))
            and params.device.on_silence == params.world.on_silence == "hold"
            and not params.wire.accept_stale
            and not params.wire.deadband
            and params.wire.admission_burst_J <= _BURST_MOST_J
            and vectorisable(params, setup.dof, setup.up, setup.down)
        )

    def load(self) -> bool:
        """Run until right after a tick with the handshake complete. Returns False if the run's end came first."""
        start_ns = self.pair()
        self.end_ns = start_ns + round(self.setup.params.duration_s / NANO)
        while (tick_ns := self._tick_ns + _LOOK * self.period_ns) <= self.end_ns:
            self._until(tick_ns)
            if self.quiet:
                return True
        return False

    def run_on(self, *, vectorised: bool) -> BatchRun:
        """Run from the present state to the end.

        Raises
        ------
        NotCompiledError : the compiled kernel cannot run it to the end.
        """
        if self.not_compiled is None and not vectorised and self.quiet and self.now_ns < self.end_ns:
            kernel = self.compiled(self.end_ns)
            kernel.run_until(self.end_ns)
            kernel.write_back()
        self._until(self.end_ns)
        summary = self.close(self.end_ns)
        device, world = self.device, self.world
        assert isinstance(device, ContinuousDeviceSide) or not vectorised
        x, v = device.device.read()
        mass = world.mass
        return BatchRun(
            self.setup.params, self.seed, summary,
            _state(device, x, v), _state(world, mass.position, mass.velocity), vectorised,
        )  # fmt: skip


def hand_over(endpoint: Endpoint, now_ns: int) -> None:
    """Give the coupling the sample and energy that wait for the next tick."""
    assert not endpoint.has_shuffled
    endpoint.take(now_ns)


def under_way(link: Link[Packet]) -> Iterator[UnderWay]:
    """The messages in flight after the handshake, in the order in which they were sent."""
    for due_ns, order, packet, sent_ns, _ in sorted(link.queue, key=itemgetter(1)):
        content = decode(packet.data)
        assert isinstance(content, Position | Energy)
        yield UnderWay(order, due_ns, sent_ns, content)


def _state(side: DeviceSide | WorldSide, x: Vector, v: Vector) -> SideState:
    coupling, ledger = side.coupling, side.coupling.ledger
    return SideState(
        x, v, coupling.set_position, coupling.reservoir, coupling.deficit, ledger.work, ledger.credited, ledger.sent
    )


def walls(scenario: Scenario) -> Scene:
    """The world of a scenario whose world is vectorised."""
    assert isinstance(scenario.setup.scene, Scene)
    return scenario.setup.scene


def modulating(side: DeviceSide | WorldSide) -> SetPositionCoupling:
    """The coupling of a side whose coupling is vectorised."""
    assert isinstance(side.coupling, SetPositionCoupling)
    return side.coupling
