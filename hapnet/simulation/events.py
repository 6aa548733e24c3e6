"""Which event of a run comes next, and what each does: the one description of both the plain and the compiled run.

Plain Python runs these functions over a `Simulation`, compiled code over a record of the whole run
(`hapnet.ext.compiled.simulation`). They use only what both have, the attributes of `Run`. The functions at the end do
what each does in its own way; compiled code has others in their place.

Events at the same nanosecond run in a fixed order, that of their kinds. A timer that is past due runs at the present
time.
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
"""Why a run stops: all is done; its user wants no more; a compiled run needs more draws, steps, ticks of the hand's
path or room for samples, or has come to what only plain Python can do."""


class Clock(Record):
    """The time, and when each kind of event is due [ns].

    tick_ns : the next tick to compute; in plain Python those before the one that is due may wait. later_ns : when the
    start ends. apart : whether the hand's and the actuator's port are different ones.
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
    """A run as these functions see it: both sides, each with its port to the link, and the accounts of both ports."""

    clock: Clock
    device: Any
    world: Any
    device_port: Any
    world_port: Any
    two_port: TwoPort
    hand_port: TwoPort


@equation
def run_to(run: Run, end_ns: int) -> int:
    """Run to `end_ns`; returns `DONE`, or why not. If the start ends before, `TwoPort.later` begins to count there."""
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
        now_ns = clock.now_ns = max(clock.now_ns, due[kind])
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
        kind = earliest(due)
    return hindrance(run, NO_EVENT)


@equation
def _tick(run: Run, now_ns: int) -> None:
    """A tick of the device: its message goes to the uplink, its shuffled energy to its protocol."""
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
    """A step of the world ends, and the next begins."""
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
    """The world receives what the uplink releases by now."""
    release(run, run.device_port, run.world_port, now_ns)
    run.clock.due[UP] = release_due_ns(run.device_port)
    heard_by_world(run)


@equation
def _to_device(run: Run, now_ns: int) -> None:
    """The device receives what the downlink releases by now."""
    release(run, run.world_port, run.device_port, now_ns)
    run.clock.due[DOWN] = release_due_ns(run.world_port)
    heard_by_device(run)


@equation
def heard_by_world(run: Run) -> None:
    """Something has happened to the world's protocol: find when it is due next."""
    run.clock.due[WORLD_TIMER] = protocol_due_ns(run.world_port)


@equation
def heard_by_device(run: Run) -> None:
    """Something has happened to the device's protocol: find when it is due next, and no tick may wait any more."""
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


# -- what compiled code does otherwise --------------------------------------------------------------------------------


def hindrance(run: Any, kind: int) -> int:
    """Why the event of this kind may not run; `DONE`: it may."""
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
    """Offer control's message to the port's link. True: nothing delays it, so it is not on the link, and is received
    now."""
    return bool(port.offer(now_ns, message))


def collect(side: Any, port: Any) -> bool:
    """Give what control has for the protocol to the protocol; returns whether there was anything."""
    if not port.wire.uncollected:
        return False
    port.collect()
    return True


def poll(port: Any, now_ns: int) -> None:
    """Offer the protocol's messages that are due to the port's link."""
    port.send_due(now_ns)


def receive(run: Any, port: Any, message: Any, now_ns: int) -> None:
    """A side receives a message."""
    run.receive(port, (message,))


def release(run: Any, sender: Any, receiver: Any, now_ns: int) -> None:
    """A side receives what the other's link releases by now."""
    packets, _ = sender.release(now_ns)
    run.receive(receiver, packets)


def release_due_ns(port: Any) -> int:
    """When the port's link releases something, or changes."""
    return or_never(port.release_due_ns)


def protocol_due_ns(port: Any) -> int:
    """When the port's protocol has something to do."""
    return or_never(port.wire.next_due_ns)


def or_never(due_ns: int | None) -> int:
    """A time that may be None for never."""
    return NEVER if due_ns is None else due_ns


def next_step_ns(run: Any) -> int:
    """How long the world's next step lasts."""
    return int(run.world.next_step_ns())


def skippable_ticks(device: Any) -> int:
    """How many of the device's next ticks may wait; compiled code makes each when it is due."""
    return int(device.skippable_ticks)


def catch_up(run: Any, until_ns: int) -> None:
    """Make the ticks before `until_ns` that have waited."""
    run.catch_up(until_ns)


def wake(run: Any) -> None:
    """The device's next tick may not wait if something has arrived for it."""
    run.wake()
