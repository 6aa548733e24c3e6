"""The state of many scenarios as arrays: read from their `Simulation`s, and written back at their ends.

The batch's clock shows 0 at the tick at which each scenario is loaded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.side.device import ContinuousDeviceSide
from hapnet.side.endpoint import NANO
from hapnet.side.packet import Packet
from hapnet.simulation.batch.arrivals import Mailbox, Positions, TickedPositions
from hapnet.simulation.batch.channels import NEVER, Channels, Whole
from hapnet.simulation.batch.couplings import Couplings, Index
from hapnet.simulation.batch.devices import Devices
from hapnet.simulation.batch.links import ENERGY, Links
from hapnet.simulation.batch.masses import Masses
from hapnet.simulation.batch.scenario import Scenario, hand_over, modulating, under_way, walls
from hapnet.simulation.batch.sizes import Sizes
from hapnet.simulation.batch.wires import Wire
from hapnet.simulation.simulation import _STEP, TwoPort
from hapnet.wire.messages import Energy, Position, encode
from hapnet.wire.peer_monitor import PeerMonitor
from hapnet.wire.session import Session


class Ports:
    """`TwoPort` of each scenario."""

    def __init__(self, ports: list[TwoPort]) -> None:
        self.lowest = np.array([port._lowest for port in ports])
        self.device = np.array([port._device for port in ports])
        self.device_low = np.array([port._device_low for port in ports])
        self.world = np.array([port._world for port in ports])
        self.before, self.open = (
            np.array([np.nan if value is None else value for value in values])  # NaN: none
            for values in ([port._before for port in ports], [port._open for port in ports])
        )

    def begin(self, at: Index) -> None:
        """`TwoPort.begin`."""
        self.before[at] = np.minimum(self.lowest[at], self.device_low[at] + self.world[at])
        self.open[at] = self.device_low[at]
        self.lowest[at], self.device_low[at] = np.inf, self.device[at]

    def close(self, at: Index, work: Array) -> None:
        """The part of `TwoPort.world` that ends the start."""
        self.before[at] = np.fmin(self.before[at], self.open[at] + work)
        self.open[at] = np.nan

    def land(self, i: int, port: TwoPort) -> None:
        """Give scenario i's state back."""
        port._lowest, port._device = float(self.lowest[i]), float(self.device[i])
        port._device_low, port._world = float(self.device_low[i]), float(self.world[i])
        port._before, port._open = (None if np.isnan(x[i]) else float(x[i]) for x in (self.before, self.open))


class BatchState:
    """The parts of all scenarios, as arrays."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self.scenarios = scenarios
        first = scenarios[0]
        self.period_ns = first._period_ns
        self._sides = sides = [_continuous(scenario) for scenario in scenarios]
        worlds = [scenario.world for scenario in scenarios]
        self.servo, self.device_period_s = sides[0]._servo, sides[0]._simulated.period
        for scenario in scenarios:
            hand_over(scenario.device_endpoint)
            hand_over(scenario.world_endpoint)
        shift = self._shift_ns = np.array([scenario.now_ns for scenario in scenarios])
        self.end_ns = np.array([scenario.end_ns for scenario in scenarios]) - shift
        self.later_ns = np.array([min(scenario._later_ns, NEVER) for scenario in scenarios]) - shift
        self.devices = Devices([side._simulated for side in sides], sides[0]._simulated.operator.reference)
        self.elapsed_s: Array = np.array([side._servo._elapsed for side in sides])
        self.masses = Masses([world.mass for world in worlds], walls(first).contacts)
        self.step_ns: Whole = np.array([scenario._due[_STEP] for scenario in scenarios]) - shift
        self.last_step_ns: Whole = np.array([world._last_ns for world in worlds]) - shift
        self.steps = np.array([world.steps for world in worlds])
        self.stepped_s = np.array([world.stepped_s for world in worlds])
        self.longest_step_s = np.array([world.longest_step_s for world in worlds])
        self._before_draw: dict[int, Mapping[str, Any]] = {}
        self.ports = Ports([scenario.two_port for scenario in scenarios])
        count, dof = len(scenarios), first.setup.dof
        self._devices = [scenario.device_endpoint.session for scenario in scenarios]
        self._worlds = [scenario.world_endpoint.session for scenario in scenarios]
        at_worlds = [session._monitor for session in self._worlds]
        at_devices = [session._monitor for session in self._devices]
        self.up = Links([scenario.up for scenario in scenarios], shift, at_worlds)
        self.down = Links([scenario.down for scenario in scenarios], shift, at_devices)
        self.device_positions = TickedPositions(count, dof, _newest(at_devices), self.period_ns)
        self.device_wire = Wire(
            Channels([session._channel for session in self._devices], shift),
            Mailbox(count),
            self.device_positions,
            Couplings([modulating(side) for side in sides]),
            self.up,
            Sizes(self._devices, dof),
            np.array([session.positions.next_sequence for session in self._devices]),
        )
        self.world_wire = Wire(
            Channels([session._channel for session in self._worlds], shift),
            Mailbox(count),
            Positions(count, dof, _newest(at_worlds)),
            Couplings([modulating(world) for world in worlds]),
            self.down,
            Sizes(self._worlds, dof),
            np.array([session.positions.next_sequence for session in self._worlds]),
        )
        self.device_wire.peer, self.world_wire.peer = self.world_wire, self.device_wire
        for i, scenario in enumerate(scenarios):
            self._gather(i, scenario, self.device_wire)
            self._gather(i, scenario, self.world_wire)

    def draw_steps(self, i: int, count: int) -> Whole:
        """Draw the lengths of scenario i's next steps [ns]; `return_steps` undoes the draws that are not used."""
        scene, rng = walls(self.scenarios[i]), self.scenarios[i].world._rng
        self._before_draw[i] = rng.bit_generator.state
        seconds = np.minimum(scene.max_s, scene.min_s + (scene.max_s - scene.min_s) * rng.random(count))
        return np.maximum(1, np.rint(seconds / NANO).astype(np.int64))

    def return_steps(self, i: int, used: int) -> None:
        """Undo all but the first `used` draws of scenario i's last `draw_steps`."""
        if i in self._before_draw:
            rng = self.scenarios[i].world._rng
            rng.bit_generator.state = self._before_draw.pop(i)
            rng.random(used)

    def land(self, at: Index, tick: int) -> None:
        """Write the state of the scenarios `at` back; everything up to this tick is done."""
        now_ns = tick * self.period_ns
        self.world_wire.look(at, np.full(len(at), now_ns))
        self.up.fold(at, now_ns)
        self.down.fold(at, now_ns)
        for i in at.tolist():
            self._land(i, tick)

    def _land(self, i: int, tick: int) -> None:
        scenario, side = self.scenarios[i], self._sides[i]
        world = scenario.world
        now_ns = scenario.now_ns = int(self._shift_ns[i]) + tick * self.period_ns
        side._last_ns = side._expected_ns = now_ns
        side.ticks += tick
        side.longest_ns = max(side.longest_ns, self.period_ns)
        side._servo._elapsed = float(self.elapsed_s[i])
        self.device_wire.couplings.land(i, modulating(side))
        self.devices.land(i, side._simulated, side.coupling.set_position)
        self.world_wire.couplings.land(i, modulating(world))
        self.masses.land(i, world.mass)
        world._last_ns = int(self.last_step_ns[i] + self._shift_ns[i])
        world.steps, world.stepped_s = int(self.steps[i]), float(self.stepped_s[i])
        world.longest_step_s = float(self.longest_step_s[i])
        self.ports.land(i, scenario.two_port)
        scenario._later_ns = NEVER if scenario.two_port.later is not None else scenario._later_ns
        self._land_session(i, self._devices[i], self.device_wire, self.world_wire)
        self._land_session(i, self._worlds[i], self.world_wire, self.device_wire)
        scenario.resume(int(self.step_ns[i] + self._shift_ns[i]), now_ns + self.period_ns)

    def _land_session(self, i: int, session: Session, wire: Wire, peer: Wire) -> None:
        """Write back one side's session, and the link that it sends on."""
        wire.channels.land(i, session._channel)
        session.positions.next_sequence = int(wire.next_number[i])
        if peer.links.stale[i]:
            session.dropped["stale"] += int(peer.links.stale[i])
        me, other = session.identity.incarnation, session.peer
        assert other is not None

        def packet(order: int, note: int, sent_ns: int) -> Packet:
            if note != ENERGY:
                return Packet("position", encode(Position(me, note, sent_ns, peer.positions.position(i, note))))
            return Packet("energy", encode(Energy(me, other.incarnation, *peer.mailbox.find(i, order))))

        wire.links.land(i, packet)

    def _gather(self, i: int, scenario: Scenario, wire: Wire) -> None:
        """Read the messages in flight from one side of scenario i."""
        at, shift = np.array([i]), int(self._shift_ns[i])
        link = scenario.up if wire is self.device_wire else scenario.down
        for order, due_ns, sent_ns, content in under_way(link):
            due = np.array([due_ns - shift])
            if isinstance(content, Position):
                wire.links.under_way(i, order, due_ns - shift, sent_ns - shift, content.sequence)
                x = np.array(content.position)[:, None]
                wire.peer.positions.put(at, np.array([content.sequence]), due, x)
            else:
                wire.links.under_way(i, order, due_ns - shift, sent_ns - shift, ENERGY)
                total, acked = np.array([content.total_nJ]), np.array([content.acked_nJ])
                wire.peer.mailbox.put(at, np.array([order]), due, total, acked)


def _continuous(scenario: Scenario) -> ContinuousDeviceSide:
    side = scenario.device
    assert isinstance(side, ContinuousDeviceSide)
    return side


def _newest(monitors: list[PeerMonitor]) -> Whole:
    return np.array([monitor.numbers.newest for monitor in monitors])
