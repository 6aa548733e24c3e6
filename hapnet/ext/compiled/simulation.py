"""The events of a whole scenario in their order: `hapnet.simulation.simulation`, after the handshake.

A timer that is past due runs at the present time. Of what is due at the same nanosecond, the first kind runs first.
"""

from __future__ import annotations

from typing import Annotated

from hapnet.control.two_port import TwoPort, on_device, on_world
from hapnet.ext.compiled import link as links, sides
from hapnet.ext.compiled.endpoint import Wire, has_room, poll, receive
from hapnet.ext.compiled.link import Link
from hapnet.ext.compiled.samples import Rows, have_room, record_step, record_tick
from hapnet.ext.compiled.sides import Counts, DeviceSide, WorldSide
from hapnet.plant.device import Hand
from hapnet.records.record import Record, Wholes, equation
from hapnet.wire import energy_channel as channels

UP, DOWN, DEVICE_TIMER, WORLD_TIMER, STEP, TICK = range(6)
"""The kinds of events, in the order in which they run at the same nanosecond."""

DONE, NEEDS_MORE, IMPOSSIBLE = range(3)
"""Why `run` returns: all is done; more draws, steps, ticks of the hand's path or room for samples are needed; the
scenario does something that the kernel cannot."""

STEPS = 256
"""So many lengths of the world's steps are known at once."""


class Clock(Record):
    """The time, and when each kind of event is due; the lengths of the world's next steps, and how many were used.

    apart : are the hand's and the actuator's ports different ones?
    """

    now_ns: int
    period_ns: int
    due: Annotated[Wholes, (6,)]
    steps_ns: Annotated[Wholes, (STEPS,)]
    steps_used: int
    apart: int


class Scenario(Record):
    """A whole scenario."""

    clock: Clock
    counts: Counts
    at_device: DeviceSide
    at_world: WorldSide
    device_wire: Wire
    world_wire: Wire
    up: Link
    down: Link
    two_port: TwoPort
    hand_port: TwoPort
    rows: Rows
    hand: Hand


@equation
def _earliest(clock: Clock) -> int:
    """The kind of the event that is due next."""
    first = 0
    for kind in range(1, 6):
        if clock.due[kind] < clock.due[first]:
            first = kind
    return first


@equation
def _tick(scenario: Scenario, now_ns: int) -> None:
    """`Simulation._tick`."""
    clock, side, wire, link = scenario.clock, scenario.at_device, scenario.device_wire, scenario.up
    message = links.spare(link, 0)
    passes = False
    if sides.tick(side, wire, scenario.counts, scenario.hand, now_ns, message):
        passes = links.passes(link)
        if not passes:
            links.send(link, now_ns, message)
        clock.due[UP] = links.next_due_ns(link)
    if side.coupling.shuffled > 0.0:
        channels.send(wire.channel, side.coupling.shuffled)
        clock.due[DEVICE_TIMER] = channels.next_due_ns(wire.channel)
    if scenario.counts.ticks % scenario.rows.every == 0:
        record_tick(scenario.rows, side, wire, scenario.hand, now_ns)
    on_device(scenario.two_port, side.coupling.ledger.work)
    if clock.apart:
        on_device(scenario.hand_port, side.hand.work)
    clock.due[TICK] = now_ns + clock.period_ns
    if passes:
        receive(scenario.world_wire, message, now_ns)
    else:
        _to_world(scenario, now_ns)


@equation
def _step(scenario: Scenario, now_ns: int) -> None:
    """`Simulation._step`."""
    clock, side, wire, link = scenario.clock, scenario.at_world, scenario.world_wire, scenario.down
    message = links.spare(link, 0)
    sides.step(side, wire, scenario.counts, now_ns, message)
    record_step(scenario.rows, side, wire, scenario.counts, now_ns)
    passes = links.passes(link)
    if not passes:
        links.send(link, now_ns, message)
    if side.coupling.shuffled > 0.0:
        channels.send(wire.channel, side.coupling.shuffled)
    clock.due[STEP] = now_ns + clock.steps_ns[clock.steps_used]
    clock.steps_used += 1
    clock.due[DOWN], clock.due[WORLD_TIMER] = links.next_due_ns(link), channels.next_due_ns(wire.channel)
    on_world(scenario.two_port, side.coupling.ledger.work)
    if clock.apart:
        on_world(scenario.hand_port, side.coupling.ledger.work)
    if passes:
        receive(scenario.device_wire, message, now_ns)
    else:
        _to_device(scenario, now_ns)


@equation
def _deliver(link: Link, wire: Wire, now_ns: int) -> None:
    """The link's receiver takes what is released by now."""
    slot = links.take(link, now_ns)
    while slot >= 0:
        receive(wire, link.messages[slot], now_ns)
        slot = links.take(link, now_ns)


@equation
def _to_world(scenario: Scenario, now_ns: int) -> None:
    """The world receives what the uplink releases by now."""
    _deliver(scenario.up, scenario.world_wire, now_ns)
    scenario.clock.due[UP] = links.next_due_ns(scenario.up)
    scenario.clock.due[WORLD_TIMER] = channels.next_due_ns(scenario.world_wire.channel)


@equation
def _to_device(scenario: Scenario, now_ns: int) -> None:
    """The device receives what the downlink releases by now."""
    _deliver(scenario.down, scenario.device_wire, now_ns)
    scenario.clock.due[DOWN] = links.next_due_ns(scenario.down)
    scenario.clock.due[DEVICE_TIMER] = channels.next_due_ns(scenario.device_wire.channel)


@equation
def _run(scenario: Scenario, until_ns: int) -> int:
    """Run every event until `until_ns`, as far as possible."""
    clock, due = scenario.clock, scenario.clock.due
    while True:
        kind = _earliest(clock)
        if due[kind] > until_ns:
            return DONE
        if not _is_provided(scenario, kind):
            return NEEDS_MORE
        now_ns = clock.now_ns = max(clock.now_ns, due[kind])
        if kind == TICK:
            _tick(scenario, now_ns)
        elif kind == STEP:
            _step(scenario, now_ns)
        elif kind == UP:
            _to_world(scenario, now_ns)
        elif kind == DOWN:
            _to_device(scenario, now_ns)
        elif kind == DEVICE_TIMER:
            poll(scenario.device_wire, scenario.up, now_ns)
            due[DEVICE_TIMER] = channels.next_due_ns(scenario.device_wire.channel)
            _to_world(scenario, now_ns)
        else:
            poll(scenario.world_wire, scenario.down, now_ns)
            due[WORLD_TIMER] = channels.next_due_ns(scenario.world_wire.channel)
            _to_device(scenario, now_ns)
        if _impossible(scenario):
            return IMPOSSIBLE


@equation
def _is_provided(scenario: Scenario, kind: int) -> bool:
    """Whether there is enough of everything for one more event of this kind."""
    if kind == TICK and scenario.hand.at == scenario.hand.known:
        return False
    if kind == STEP and scenario.clock.steps_used == STEPS:
        return False
    return has_room(scenario.up) and has_room(scenario.down) and have_room(scenario.rows)


@equation
def _impossible(scenario: Scenario) -> bool:
    """Whether something has happened that the kernel cannot do."""
    wires = scenario.device_wire.endpoint.impossible + scenario.world_wire.endpoint.impossible
    return wires + scenario.up.overflow + scenario.down.overflow + scenario.at_device.plant.model.coupling.unsolved > 0


def enter(scenario: Scenario, until_ns: int) -> int:
    """Run every event until `until_ns` [ns]; returns why it stopped. Compiled code is entered by this."""
    return _run(scenario, until_ns)
