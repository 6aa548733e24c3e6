"""Runs a simulation on the kernel, from the end of the handshake on."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.control.two_port import TwoPort
from hapnet.couplings.rendering import RenderingTuning
from hapnet.ext.compiled import kinds
from hapnet.ext.compiled.kinds import choices, scenario
from hapnet.ext.compiled.memory import bare, give_back, load, new, plain, store
from hapnet.ext.compiled.names import Kind
from hapnet.ext.compiled.simulation import STEPS, Scenario, enter
from hapnet.ext.compiled.twins import ready
from hapnet.ext.compiled.whole_runs import coverage, sides, wire
from hapnet.ext.compiled.whole_runs.coverage import OUT_OF_RANGE
from hapnet.ext.compiled.whole_runs.link import CompiledLink
from hapnet.ext.solids.rigid import RigidScene
from hapnet.plant.device import TICKS, SimulatedDevice
from hapnet.plant.operator import hand_path
from hapnet.plant.worlds.scene import Scene
from hapnet.recording.samples import VECTORS, Columns, DeviceSample, MemoryRecorder, MetricSample, WorldSample
from hapnet.records.machine_code import NotCompiledError
from hapnet.side.endpoint import NANO
from hapnet.simulation.events import DONE, IMPOSSIBLE, TICK

if TYPE_CHECKING:
    from hapnet.simulation.simulation import Simulation


@cache
def make_ready(kind: Kind) -> Callable[[Scenario, int], int]:
    """Return the function that runs a scenario's events until a time [ns]. Loads or makes the machine code, once in a
    process.
    """
    record = new(scenario(kind))
    run: Callable[[Scenario, int], int] = ready(
        enter, kind.name, choices(kind), bare(record), -1
    )  # nothing is due then
    give_back(record, scenario(kind))
    return run


class CompiledRun:
    """The part of a simulation that the kernel runs, up to `end_ns`.

    Both sides have started, the handshake is over, and none of its messages is in flight.
    """

    def __init__(self, simulation: Simulation, recorder: MemoryRecorder, end_ns: int) -> None:
        self._simulation, self._recorder = simulation, recorder
        side = simulation.device
        assert isinstance(side.device, SimulatedDevice)
        self._side, self._device = side, side.device
        self._ticks = max(0, (end_ns - simulation.clock.tick_ns) // simulation.clock.period_ns + 1)
        self._rng = simulation.world.rng.bit_generator
        self._rng_state, self._steps_used = self._rng.state, 0
        tuning = simulation.setup.tuning
        self._kind: type[DeviceSample | MetricSample] = (
            DeviceSample if side.drive.write_motion is None else MetricSample
        )
        kind = coverage.kind_of(simulation.setup.params, simulation.setup.scene)
        assert kind is not None, "it is covered"
        self._record_kind = kinds.scenario(kind)
        scenario = self._scenario = new(self._record_kind)
        self._up, self._down = (
            CompiledLink(scenario.device_port.link, simulation.up),
            CompiledLink(scenario.world_port.link, simulation.down),
        )
        clock, at_world = scenario.clock, scenario.world
        scenario.device.last_ns, scenario.device.ticks = side.last_ns, side.ticks
        if isinstance(tuning, RenderingTuning):
            at_world.reach_m, at_world.reach_mps = tuning.reach_m, tuning.reach_speed_mps
        store(clock, simulation.clock)
        clock.due[TICK] = clock.tick_ns  # no tick waits
        scenario.steps.used = STEPS
        scenario.rows.every = side.drive.record_every
        sides.read_device(scenario.device, side)
        sides.read_world(scenario.world, simulation.world)
        sends = simulation.setup.coupling.sends
        wire.read_wire(scenario.device_port.wire, simulation.device_endpoint, sends("device", simulation.setup.params))
        wire.read_wire(scenario.world_port.wire, simulation.world_endpoint, sends("world", simulation.setup.params))
        for record, port in self._ports():
            store(record, port)
        self._provide()
        self._run_events = make_ready(kind)

    def run_until(self, end_ns: int) -> None:
        """Run every event until `end_ns`.

        Raises NotCompiledError: only the reference can continue the run.
        """
        with np.errstate(all="ignore"):
            while (why := self._run_events(bare(self._scenario), end_ns)) != DONE:
                if why == IMPOSSIBLE:
                    raise NotCompiledError(OUT_OF_RANGE)
                self._provide()
        self._simulation.clock.now_ns = end_ns

    def _ports(self) -> list[tuple[TwoPort, TwoPort]]:
        """Both ports, in the kernel and in the simulation; only one pair if the two ports are the same."""
        simulation, scenario = self._simulation, self._scenario
        ports = [(scenario.two_port, simulation.two_port), (scenario.hand_port, simulation.hand_port)]
        return ports[: 1 + int(scenario.clock.apart)]

    def write_back(self) -> None:
        """Copy the state back to the simulation, to be closed; samples that wait for a tick or step are omitted."""
        simulation, scenario, side = self._simulation, self._scenario, self._side
        steps, hand = scenario.steps, scenario.hand
        self._flush()
        made = int(scenario.device.ticks) - side.ticks
        reference = tuple(plain(hand.path[hand.at][: self._device.dof]))
        sides.write_device(scenario.device, side, reference)
        side.resume(int(scenario.device.last_ns), made)
        sides.write_world(scenario.world, simulation.world)
        self._rng.state = self._rng_state
        self._rng.advance(self._steps_used + int(steps.used) - STEPS)  # type: ignore[attr-defined]
        sessions = simulation.device_endpoint.session, simulation.world_endpoint.session
        self._up.write_back(sessions[0], scenario.device_port.wire.endpoint.kind)
        self._down.write_back(sessions[1], scenario.world_port.wire.endpoint.kind)
        wire.write_wire(scenario.device_port.wire, simulation.device_endpoint)
        wire.write_wire(scenario.world_port.wire, simulation.world_endpoint)
        for record, port in self._ports():
            load(port, record)
        load(simulation.clock, scenario.clock)
        simulation.resume()
        give_back(scenario, self._record_kind)

    def _provide(self) -> None:
        """Provide draws, lengths of steps, the hand's path, and room for samples."""
        self._flush()
        self._up.refill()
        self._down.refill()
        steps, hand = self._scenario.steps, self._scenario.hand
        if steps.used == STEPS:
            scene, rng = self._simulation.setup.scene, self._simulation.world.rng
            assert isinstance(scene, Scene | RigidScene)
            steps.ns[:] = np.maximum(1, np.rint(scene.next_steps_s(rng, STEPS) / NANO))
            steps.used = 0
            self._steps_used += STEPS
        if hand.at == hand.known and self._ticks:
            n, device, begun = self._device.dof, self._device, int(self._scenario.device.plant.ticks)
            count = min(TICKS, self._ticks)
            hand.path[0][:n] = device.references[-1] if not hand.known else hand.path[hand.known][:n]
            times = np.arange(begun + 1, begun + count + 1, dtype=float) * device.period
            path: Any = hand.path
            path[1 : count + 1, :n] = hand_path(device.operator, times)
            hand.at, hand.known = 0, count
            self._ticks -= count

    def _flush(self) -> None:
        """Pass the samples so far to the recorder."""
        rows, n = self._scenario.rows, self._simulation.setup.dof
        of_device, of_world = int(rows.device_rows), int(rows.world_rows)
        rows.device_rows = rows.world_rows = 0
        steps = _columns(rows.at_world, of_world, n, WorldSample)
        self._recorder.extend(_columns(rows.at_device, of_device, n, self._kind), steps)
        shown = (steps[name].tolist() for name in ("time_ns", "position_m", "contact_force_N"))
        for time_ns, position, force in zip(*shown, strict=True):
            self._simulation.world.draw(time_ns, tuple(position), tuple(force))


def _columns(rows: Any, count: int, n: int, kind: type[DeviceSample | MetricSample | WorldSample]) -> Columns:
    """The first `count` rows, as columns of the recorder."""
    found = rows.structures[:count]
    return {name: (found[name][:, :n] if name in VECTORS else found[name]).copy() for name in kind._fields}
