"""Devices of a simulated graph whose processes are killed, and start again in the same seat."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hapnet.assembly.build import device_session, device_side
from hapnet.ext.many.run import GraphSimulation
from hapnet.records.record import NEVER
from hapnet.side.endpoint import NANO, DeviceEndpoint
from hapnet.side.link_port import LinkPort
from hapnet.simulation import events
from hapnet.simulation.simulation import Simulation


class _Nobody:
    """The wire half of a process that has been killed."""

    next_due_ns = None
    uncollected = False


class _DeadPort(LinkPort):
    """What is left of a killed process: its messages that are under way."""

    def __init__(self, port: LinkPort) -> None:
        super().__init__(_Nobody(), port.link)  # type: ignore[arg-type]

    def receive(self, now_ns: int, data: bytes) -> tuple[()]:
        return ()


class Device:
    """The device of a pair of this simulation, over all its processes.

    ledgers : of the processes that were killed.
    """

    def __init__(self, simulation: GraphSimulation, name: str) -> None:
        self._simulation = simulation
        self.pair: Simulation = simulation.pairs[name]
        self.ledgers: list[Any] = []
        self._hand = self.pair.setup.hand
        self._incarnation = 1

    def kill(self) -> None:
        """End the process without a word."""
        pair = self.pair
        self.ledgers.append(pair.device_endpoint.coupling.ledger)
        pair.clock.tick_ns = pair.clock.due[events.TICK] = pair.clock.due[events.DEVICE_TIMER] = NEVER
        pair.device_port = _DeadPort(pair.device_port)

    def start(self) -> None:
        """Start a new process in the same seat; its hand goes on with its motion."""
        pair, now_ns = self.pair, self._simulation.now_ns
        self._incarnation += 1
        setup = replace(pair.setup, hand=_Later(self._hand, now_ns * NANO))
        endpoint = DeviceEndpoint(device_session(setup, self._incarnation))
        pair.device_endpoint = endpoint
        pair.device = device_side(setup, endpoint, lambda: pair.clock.now_ns, lambda sample: None)
        pair.device_port = LinkPort(endpoint, pair.up)
        period = pair.clock.period_ns
        pair.clock.tick_ns = pair.clock.due[events.TICK] = (now_ns // period + 1) * period
        pair.clock.due[events.DEVICE_TIMER] = now_ns


class _Later:
    """A hand whose motion goes on from a time [s]."""

    def __init__(self, hand: Any, from_s: float) -> None:
        self.impedance, self._hand, self._from_s = hand.impedance, hand, from_s

    def reference(self, t: float) -> Any:
        return self._hand.reference(t + self._from_s)
