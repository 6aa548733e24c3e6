"""A whole run after the handshake as a record, and the compiled functions for its events.

The order of the events is that of `hapnet.simulation.events`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from hapnet.control.two_port import TwoPort
from hapnet.ext.compiled import link as links
from hapnet.ext.compiled.endpoint import PortRecord, has_room, receive, send_due
from hapnet.ext.compiled.link import NOTHING, MessageSlot
from hapnet.ext.compiled.samples import Rows, have_room, record_step, record_tick
from hapnet.ext.compiled.sides import DeviceSideRecord, WorldSideRecord
from hapnet.plant.device import Hand
from hapnet.records.record import Record, Wholes, equation
from hapnet.side import device, world
from hapnet.simulation import events
from hapnet.simulation.events import DONE, IMPOSSIBLE, NEEDS_MORE, STEP, TICK, Clock
from hapnet.wire import energy_channel as channels

STEPS = 256
"""The number of the world's step lengths that are drawn at once."""


class StepLengths(Record):
    """The lengths of the world's next steps [ns], and the number of those already used."""

    ns: Annotated[Wholes, (STEPS,)]
    used: int


class Scenario(Record):
    """The record of a whole run, in place of an `events.Run`."""

    clock: Clock
    device: DeviceSideRecord
    world: WorldSideRecord
    device_port: PortRecord
    world_port: PortRecord
    two_port: TwoPort
    hand_port: TwoPort
    rows: Rows
    hand: Hand
    steps: StepLengths


@equation
def _tick(run: Scenario, now_ns: int) -> MessageSlot:
    message: MessageSlot = device.control(run.device, run.device_port, run.hand, now_ns)
    if run.device.ticks % run.rows.every == 0:
        record_tick(run.rows, run.device, run.device_port.wire, run.hand, now_ns)
    return message


@equation
def _step(run: Scenario, now_ns: int) -> MessageSlot:
    message: MessageSlot = world.step(run.world, run.world_port, now_ns)
    record_step(run.rows, run.world, run.world_port.wire, now_ns)
    return message


@equation
def _is_there(message: MessageSlot) -> bool:
    return message.kind != NOTHING


@equation
def _has_started(side: DeviceSideRecord | WorldSideRecord) -> bool:
    return True


@equation
def _offer(port: PortRecord, now_ns: int, message: MessageSlot) -> bool:
    if links.passes(port.link):
        return True
    links.send(port.link, now_ns, message)
    return False


@equation
def _collect(side: DeviceSideRecord | WorldSideRecord, port: PortRecord) -> bool:
    if side.coupling.shuffled > 0.0:
        channels.send(port.wire.channel, side.coupling.shuffled)
        return True
    return False


@equation
def _poll(port: PortRecord, now_ns: int) -> None:
    send_due(port.wire, port.link, now_ns)


@equation
def _receive(run: Scenario, port: PortRecord, message: MessageSlot, now_ns: int) -> None:
    receive(port.wire, message, now_ns)


@equation
def _release(run: Scenario, sender: PortRecord, receiver: PortRecord, now_ns: int) -> None:
    slot = links.take(sender.link, now_ns)
    while slot >= 0:
        receive(receiver.wire, sender.link.messages[slot], now_ns)
        slot = links.take(sender.link, now_ns)


@equation
def _release_due_ns(port: PortRecord) -> int:
    return links.next_due_ns(port.link)


@equation
def _protocol_due_ns(port: PortRecord) -> int:
    return channels.next_due_ns(port.wire.channel)


@equation
def _next_step_ns(run: Scenario) -> int:
    run.steps.used += 1
    return run.steps.ns[run.steps.used - 1]


@equation
def _skippable_ticks(device: DeviceSideRecord) -> int:
    return 0


@equation
def _catch_up(run: Scenario, until_ns: int) -> None:
    """Do nothing: compiled ticks never wait."""


@equation
def _wake(run: Scenario) -> None:
    """Do nothing: compiled ticks never wait."""


@equation
def _hindrance(run: Scenario, kind: int) -> int:
    impossible = run.device_port.wire.endpoint.impossible + run.world_port.wire.endpoint.impossible
    overflow = run.device_port.link.overflow + run.world_port.link.overflow
    if impossible + overflow + run.device.plant.model.coupling.unsolved > 0:
        return IMPOSSIBLE
    if kind == TICK and run.hand.at == run.hand.known:
        return NEEDS_MORE
    if kind == STEP and run.steps.used == STEPS:
        return NEEDS_MORE
    if kind == events.NO_EVENT:
        return DONE
    has_draws = has_room(run.device_port.link) and has_room(run.world_port.link)
    return DONE if has_draws and have_room(run.rows) else NEEDS_MORE


CHOICES: dict[Callable[..., Any], Callable[..., Any]] = {
    events.hindrance: _hindrance, events.tick: _tick, events.step: _step, events.is_there: _is_there,
    events.has_started: _has_started, events.offer: _offer, events.collect: _collect, events.poll: _poll,
    events.receive: _receive, events.release: _release, events.release_due_ns: _release_due_ns,
    events.protocol_due_ns: _protocol_due_ns, events.next_step_ns: _next_step_ns,
    events.skippable_ticks: _skippable_ticks, events.catch_up: _catch_up, events.wake: _wake,
}  # fmt: skip
"""The functions that are compiled in place of functions of `hapnet.simulation.events`."""


def enter(run: Scenario, until_ns: int) -> int:
    """Run every event until `until_ns` [ns]; returns the reason for the stop. The entry to the compiled code."""
    return events.run_to(run, until_ns)
