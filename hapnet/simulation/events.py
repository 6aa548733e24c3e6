"""The events of a run: which comes next, and its effect. Plain and compiled runs share these functions.

Plain Python runs these functions over a `Simulation`, compiled code over a record of the whole run
(`hapnet.ext.compiled.simulation`). They use only the attributes of `Run`, which both have. The functions at the end
are those of plain Python; compiled code replaces them.

Events at the same nanosecond run in the order of their kinds. A timer that is past due runs at the present time.
"""

from __future__ import annotations

from typing import Annotated, Any, Protocol

from hapnet.control.two_port import TwoPort, begin, on_device, on_world
from hapnet.records.record import NEVER, Record, Wholes, compiled_as, equation

UP, DOWN, DEVICE_TIMER, WORLD_TIMER, STEP, TICK = range(6)
"""The kinds of events: a side's link changes or releases what it carries, a side's protocol is due, a step of the world
ends, a tick of the device is due."""

NO_EVENT = 6

DONE, STOPPED, NEEDS_MORE, IMPOSSIBLE = range(4)
"""The reasons for the end of a run: all is done; its user stopped it; a compiled run needs more draws, steps, ticks of
the hand's path or room for samples, or has reached an event that only plain Python can run."""


class Clock(Record):
    """The time, and when each kind of event is due [ns].

    tick_ns : the next tick to compute; in plain Python ticks before the due one may wait. later_ns : when the
    start ends. apart : whether the hand's and the actuator's port differ.
    """

    now_ns: int
    period_ns: int
    tick_ns: int
    later_ns: int
    apart: int
    due: Annotated[Wholes, (6,)]

    def __init__(self, period_ns: int, *, apart: bool) -> None:
        super().__init__()
        self.period_ns, self.apart = period_ns, int(apart)
        self.tick_ns, self.later_ns = period_ns, NEVER
        self.due = [NEVER, NEVER, 0, 0, 0, period_ns]


class Run(Protocol):
    """The attributes of a run that these functions use: both sides with their link ports, and both ports' accounts."""

    clock: Clock
    device: Any
    world: Any
    device_port: Any
    world_port: Any
    two_port: TwoPort
    hand_port: TwoPort


@equation
def run_to(run: Run, end_ns: int) -> int:
    """Run to `end_ns`; returns `DONE`, or why it stopped. `TwoPort.later` counts from the end of the start on."""
    clock = run.clock
    if clock.later_ns <= end_ns:
        why = _run_all(run, clock.later_ns)
        if why != DONE:
            return why
        clock.later_ns = NEVER
        begin(run.two_port)
        if clock.apart:
            begin(run.hand_port)
    return _run_all(run, end_ns)


@equation
def _run_all(run: Run, end_ns: int) -> int:
    why = run_events(run, end_ns)
    if why == DONE:
        catch_up(run, end_ns + 1)
        run.clock.now_ns = end_ns
    return why


@equation
def run_events(run: Run, end_ns: int) -> int:
    """Jump to the next due event and run it, until nothing is due by `end_ns`; returns `DONE`, or why it stopped."""
    clock, due = run.clock, run.clock.due
    kind = earliest(due)
    while due[kind] <= end_ns:
        why = hindrance(run, kind)
        if why != DONE:
            return why
        clock.now_ns = max(clock.now_ns, due[kind])
        happen(run, kind, clock.now_ns)
        kind = earliest(due)
    return hindrance(run, NO_EVENT)


@equation
def happen(run: Run, kind: int, now_ns: int) -> None:
    """Run the event of this kind."""
    if kind == TICK:
        _tick(run, now_ns)
    elif kind == STEP:
        _step(run, now_ns)
    elif kind == UP:
        _to_world(run, now_ns)
    elif kind == DOWN:
        _to_device(run, now_ns)
    elif kind == DEVICE_TIMER:
        poll(run.device_port, now_ns)
        heard_by_device(run)
        _to_world(run, now_ns)
    else:
        poll(run.world_port, now_ns)
        heard_by_world(run)
        _to_device(run, now_ns)


@equation
def _tick(run: Run, now_ns: int) -> None:
    """Run a tick of the device: its message goes to the uplink, its shuffled energy to its protocol."""
    clock, device, port = run.clock, run.device, run.device_port
    message = tick(run, now_ns)
    sends = is_there(message)
    crosses = offer(port, now_ns, message) if sends else False
    if collect(device, port):
        clock.due[DEVICE_TIMER] = protocol_due_ns(port)
    if has_started(device):
        on_device(run.two_port, device.coupling.ledger.work)
        if clock.apart:
            on_device(run.hand_port, device.hand.work)
    clock.tick_ns = now_ns + clock.period_ns
    clock.due[TICK] = clock.tick_ns + skippable_ticks(device) * clock.period_ns
    if crosses:
        receive(run, run.world_port, message, now_ns)
        heard_by_world(run)
    elif sends:
        _to_world(run, now_ns)


@equation
def _step(run: Run, now_ns: int) -> None:
    """End a step of the world, and begin the next."""
    clock, world, port = run.clock, run.world, run.world_port
    message = step(run, now_ns)
    if not has_started(world):
        clock.due[STEP] = now_ns + clock.period_ns  # not paired yet
        return
    sends = is_there(message)
    crosses = offer(port, now_ns, message) if sends else False
    if collect(world, port):
        heard_by_world(run)
    clock.due[STEP] = now_ns + next_step_ns(run)
    catch_up(run, now_ns)
    on_world(run.two_port, world.coupling.ledger.work)
    if clock.apart:
        on_world(run.hand_port, world.coupling.ledger.work)
    if crosses:
        receive(run, run.device_port, message, now_ns)
        heard_by_device(run)
    elif sends:
        _to_device(run, now_ns)


@equation
def _to_world(run: Run, now_ns: int) -> None:
    """Pass the messages that the uplink releases by now to the world."""
    release(run, run.device_port, run.world_port, now_ns)
    run.clock.due[UP] = release_due_ns(run.device_port)
    heard_by_world(run)


@equation
def _to_device(run: Run, now_ns: int) -> None:
    """Pass the messages that the downlink releases by now to the device."""
    release(run, run.world_port, run.device_port, now_ns)
    run.clock.due[DOWN] = release_due_ns(run.world_port)
    heard_by_device(run)


@equation
def heard_by_world(run: Run) -> None:
    """After an event of the world's protocol: find when it is due next."""
    run.clock.due[WORLD_TIMER] = protocol_due_ns(run.world_port)


@equation
def heard_by_device(run: Run) -> None:
    """After an event of the device's protocol: find when it is due next; no tick may wait any more."""
    run.clock.due[DEVICE_TIMER] = protocol_due_ns(run.device_port)
    wake(run)


def _compiled_earliest(due: Wholes) -> int:
    first = 0
    for kind in range(1, 6):
        if due[kind] < due[first]:
            first = kind
    return first


@compiled_as(_compiled_earliest)
def earliest(due: Wholes) -> int:
    """The kind of the event that is due next."""
    return due.index(min(due))


# -- replaced in compiled code ----------------------------------------------------------------------------------------


def hindrance(run: Any, kind: int) -> int:
    """The reason why the event of this kind may not run; `DONE`: it may."""
    return int(run.hindrance(kind))


def tick(run: Any, now_ns: int) -> Any:
    """Make the device's tick, after those that could wait; returns its message, if it sends one (`is_there`)."""
    return run.tick(now_ns)


def step(run: Any, now_ns: int) -> Any:
    """Make the world's step; returns its message, if it sends one (`is_there`)."""
    return run.step(now_ns)


def is_there(message: Any) -> bool:
    """Whether a tick or a step sends a message."""
    return message is not None


def has_started(side: Any) -> bool:
    """Whether control of a side has started."""
    return side.origin_ns is not None


def offer(port: Any, now_ns: int, message: Any) -> bool:
    """Offer control's message to the port's link. True: the link does not delay it, so the other side receives it
    now."""
    return bool(port.offer(now_ns, message))


def collect(side: Any, port: Any) -> bool:
    """Pass control's output for the protocol to the protocol; returns whether there was any."""
    if not port.wire.uncollected:
        return False
    port.collect()
    return True


def poll(port: Any, now_ns: int) -> None:
    """Offer the protocol's due messages to the port's link."""
    port.send_due(now_ns)


def receive(run: Any, port: Any, message: Any, now_ns: int) -> None:
    """Pass a message to the side of this port."""
    run.receive(port, (message,))


def release(run: Any, sender: Any, receiver: Any, now_ns: int) -> None:
    """Pass the messages that the sender's link releases by now to the receiver."""
    packets, _ = sender.release(now_ns)
    run.receive(receiver, packets)


def release_due_ns(port: Any) -> int:
    """The time when the port's link next releases a message, or changes."""
    return or_never(port.release_due_ns)


def protocol_due_ns(port: Any) -> int:
    """The time when the port's protocol is due next."""
    return or_never(port.wire.next_due_ns)


def or_never(due_ns: int | None) -> int:
    """The time, or the latest possible time for None."""
    return NEVER if due_ns is None else due_ns


def next_step_ns(run: Any) -> int:
    """The length of the world's next step."""
    return int(run.world.next_step_ns())


def skippable_ticks(device: Any) -> int:
    """The number of the device's next ticks that may wait; compiled code computes each when it is due."""
    return int(device.skippable_ticks)


def catch_up(run: Any, until_ns: int) -> None:
    """Compute the waiting ticks before `until_ns`."""
    run.catch_up(until_ns)


def wake(run: Any) -> None:
    """Let no tick wait if a message has arrived for the device."""
    run.wake()
