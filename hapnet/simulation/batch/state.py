"""The state of many scenarios as arrays: read from their `Simulation`s, and written back at their ends.

The batch's clock shows 0 at the tick at which each scenario is loaded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array
from hapnet.side.device import ContinuousDeviceSide
from hapnet.side.packet import Packet
from hapnet.simulation.batch.arrays import NEVER, Index, Whole, vectors
from hapnet.simulation.batch.arrivals import EnergyQueue, Positions, TickedPositions
from hapnet.simulation.batch.channels import Channels
from hapnet.simulation.batch.couplings import Couplings
from hapnet.simulation.batch.devices import Devices
from hapnet.simulation.batch.links import ENERGY, Links
from hapnet.simulation.batch.masses import Masses
from hapnet.simulation.batch.scenario import Scenario, hand_over, modulating, under_way, walls
from hapnet.simulation.batch.sizes import Sizes
from hapnet.simulation.batch.steps import WorldSteps
from hapnet.simulation.batch.wires import Wire
from hapnet.simulation.two_port import TwoPort, TwoPortState
from hapnet.wire.messages import Energy, Position, encode
from hapnet.wire.peer_monitor import PeerMonitor
from hapnet.wire.session import Session


class Ports:
    """`TwoPort` of each scenario."""

    def __init__(self, ports: list[TwoPort]) -> None:
        # NaN: none
        sums: list[Array] = list(vectors([tuple(np.nan if x is None else x for x in port.state()) for port in ports]))
        self.lowest, self.device, self.device_low, self.world, self.before, self.open = sums

    def begin(self, at: Index) -> None:
        """`TwoPort.begin`."""
        self.before[at] = np.minimum(self.lowest[at], self.device_low[at] + self.world[at])
        self.open[at] = self.device_low[at]
        self.lowest[at], self.device_low[at] = np.inf, self.device[at]

    def close(self, at: Index, work: Array) -> None:
        """The part of `TwoPort.world` that ends the start."""
        self.before[at] = np.fmin(self.before[at], self.open[at] + work)
        self.open[at] = np.nan

    def write_back(self, i: int, port: TwoPort) -> None:
        """Give scenario i's state back."""
        lowest, device, device_low, world, before, open_ = (
            float(x[i]) for x in (self.lowest, self.device, self.device_low, self.world, self.before, self.open)
        )
        begun = None if math.isnan(before) else before, None if math.isnan(open_) else open_
        port.restore(TwoPortState(lowest, device, device_low, world, *begun))


class BatchState:
    """The parts of all scenarios, as arrays."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self.scenarios = scenarios
        first = scenarios[0]
        self.period_ns = first.period_ns
        self._sides = sides = [_continuous(scenario) for scenario in scenarios]
        worlds = [scenario.world for scenario in scenarios]
        self.servo, self.device_period_s = sides[0].servo, sides[0].device.period
        for scenario in scenarios:
            hand_over(scenario.device_endpoint, scenario.now_ns)
            hand_over(scenario.world_endpoint, scenario.now_ns)
        shift = self._shift_ns = np.array([scenario.now_ns for scenario in scenarios])
        self.end_ns = np.array([scenario.end_ns for scenario in scenarios]) - shift
        self.later_ns = np.array([min(scenario.later_ns, NEVER) for scenario in scenarios]) - shift
        self.devices = Devices([side.device for side in sides], sides[0].device.operator.reference)
        self.elapsed_s: Array = np.array([side.servo.elapsed for side in sides])
        self.masses = Masses([world.mass for world in worlds], walls(first).contacts)
        self.steps = WorldSteps(scenarios, shift)
        self.ports = Ports([scenario.two_port for scenario in scenarios])
        count, dof = len(scenarios), first.setup.dof
        self._devices = [scenario.device_endpoint.session for scenario in scenarios]
        self._worlds = [scenario.world_endpoint.session for scenario in scenarios]
        at_worlds = [session.monitor for session in self._worlds]
        at_devices = [session.monitor for session in self._devices]
        self.up = Links([scenario.up for scenario in scenarios], shift, at_worlds)
        self.down = Links([scenario.down for scenario in scenarios], shift, at_devices)
        self.device_positions = TickedPositions(count, dof, _newest(at_devices), self.period_ns)
        self.device_wire = Wire(
            Channels([session.channel for session in self._devices], shift),
            EnergyQueue(count),
            self.device_positions,
            Couplings([modulating(side) for side in sides]),
            self.up,
            Sizes(self._devices, dof),
            np.array([session.positions.next_sequence for session in self._devices]),
        )
        self.world_wire = Wire(
            Channels([session.channel for session in self._worlds], shift),
            EnergyQueue(count),
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

    def write_back(self, at: Index, tick: int) -> None:
        """Write the state of the scenarios `at` back; everything up to this tick is done."""
        now_ns = tick * self.period_ns
        self.world_wire.look(at, np.full(len(at), now_ns))
        self.up.fold(at, now_ns)
        self.down.fold(at, now_ns)
        for i in at.tolist():
            self._write_back(i, tick)

    def _write_back(self, i: int, tick: int) -> None:
        scenario, side = self.scenarios[i], self._sides[i]
        world = scenario.world
        now_ns = int(self._shift_ns[i]) + tick * self.period_ns
        side.resume(now_ns, tick)
        side.servo.elapsed = float(self.elapsed_s[i])
        self.device_wire.couplings.write_back(i, modulating(side))
        self.devices.write_back(i, side.device, side.coupling.set_position)
        self.world_wire.couplings.write_back(i, modulating(world))
        self.masses.write_back(i, world.mass)
        self.steps.write_back(i)
        self.ports.write_back(i, scenario.two_port)
        self._write_back_session(i, self._devices[i], self.device_wire, self.world_wire)
        self._write_back_session(i, self._worlds[i], self.world_wire, self.device_wire)
        scenario.resume(now_ns, int(self.steps.due_ns[i] + self._shift_ns[i]), now_ns + self.period_ns)

    def _write_back_session(self, i: int, session: Session, wire: Wire, peer: Wire) -> None:
        """Write back one side's session, and the link that it sends on."""
        wire.channels.write_back(i, session.channel)
        session.positions.next_sequence = int(wire.next_number[i])
        if peer.links.stale[i]:
            session.dropped["stale"] += int(peer.links.stale[i])
        me, other = session.identity.incarnation, session.peer
        assert other is not None

        def packet(order: int, note: int, sent_ns: int) -> Packet:
            if note != ENERGY:
                return Packet("position", encode(Position(me, note, sent_ns, peer.positions.position(i, note))))
            return Packet("energy", encode(Energy(me, other.incarnation, *peer.incoming.find(i, order))))

        wire.links.write_back(i, packet)

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
                wire.peer.incoming.put(at, np.array([order]), due, total, acked)


def _continuous(scenario: Scenario) -> ContinuousDeviceSide:
    side = scenario.device
    assert isinstance(side, ContinuousDeviceSide)
    return side


def _newest(monitors: list[PeerMonitor]) -> Whole:
    return np.array([monitor.numbers.newest for monitor in monitors])
