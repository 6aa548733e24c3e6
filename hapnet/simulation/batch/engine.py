"""Runs many paired scenarios at once, from when they are loaded to their end, with one array for each quantity.

All servos tick together: the batch's clock starts at a tick of every scenario, so the devices advance in one call.
Events between two ticks (energy messages, timers, the world's steps) are handled in rounds. Each round takes every
scenario's earliest event, all of one kind together. A position needs no event: the device on its ticks and the world on
its steps look up the newest position that has arrived by then.

If the downlink's delay is never shorter than a few ticks, the worlds and the devices' wires may lag behind the servos
by as many ticks, because nothing they send could arrive earlier. This makes fewer and larger rounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hapnet.checks import Array
from hapnet.side.endpoint import NANO
from hapnet.simulation.batch.arrays import NEVER, Index, Whole, pick, place
from hapnet.simulation.batch.lines import shortest_ns
from hapnet.simulation.batch.scenario import Scenario
from hapnet.simulation.batch.state import BatchState

_LONGEST_LAG = 32  # ticks

Events = tuple[Whole, Callable[[Index, Whole], None]]
"""When the next event of a kind is due in each scenario, and the function that handles it."""


class Engine:
    """Runs `scenarios`: they are loaded and differ only in links and seeds. Each gets its state back at its end."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self._state = state = BatchState(scenarios)
        self._count = len(scenarios)
        self._period_ns = state.period_ns
        self._tick_s = max(self._period_ns * NANO, state.device_period_s)
        self._due_s = state.servo.due
        self._damping = np.array(state.servo.damping)[:, None]
        self._end_tick = state.end_ns // self._period_ns
        self._later = state.later_ns // self._period_ns
        self._alive = np.ones(self._count, dtype=np.bool_)
        self._all_alive = True
        self._lag = _lag(scenarios, self._period_ns)
        self._works: list[Array] = []
        self._rows: Array | None = None
        self._ticks_counted = np.zeros(self._count, dtype=np.int64)
        self._window = 0
        device, world = state.device_wire, state.world_wire
        self._on_device: tuple[Events, ...] = (
            (device.incoming.next_due_ns, device.on_energy),
            (device.channels.next_due_ns, device.on_timer),
        )
        self._deferred: tuple[Events, ...] = (
            (device.deferred_energy.next_due_ns, device.on_deferred_energy),
            (device.channels.next_due_ns, device.on_timer),
            (device.deferred_updates.next_due_ns, device.on_deferred_update),
        )
        self._on_world: tuple[Events, ...] = (
            (world.incoming.next_due_ns, world.on_energy),
            (world.channels.next_due_ns, world.on_timer),
            (state.steps.due_ns, self._step),
        )
        up, down = self._on_world[0], self._on_device[0]
        self._on_both: tuple[Events, ...] = (up, down, self._on_device[1], *self._on_world[1:])

    def run(self, progress: Callable[[float], None] | None = None) -> None:
        """Run every scenario to its last tick. `progress` is called with the simulated seconds."""
        tick = 0
        while self._alive.any():
            later = self._later[self._alive & (self._later > tick)]
            end = min(tick + max(1, self._lag), int(self._end_tick[self._alive].min()), int(later.min(initial=NEVER)))
            self._state.up.safe_ns = self._state.down.safe_ns = tick * self._period_ns - 1
            self._window = tick
            self._run_window(tick, end)
            if progress is not None and end // 500 != tick // 500:
                progress(end * self._period_ns * NANO)
            tick = end
            begun = (self._alive & (self._later == tick)).nonzero()[0]
            if begun.size:
                self._state.ports.begin(begun)
            ended = (self._alive & (self._end_tick <= tick)).nonzero()[0]
            if ended.size:
                self._write_back(ended, tick)

    def _run_window(self, start: int, end: int) -> None:
        """Run a window, from after tick `start` to after tick `end`."""
        wire = self._state.device_wire
        end_ns = end * self._period_ns
        # The first window may begin with credits that wait for its first tick.
        if self._lag and start and wire.defer(self._period_ns, start, end):
            for tick in range(start + 1, end + 1):
                wire.bring_credit(tick)
                self._tick(tick)
            wire.deferring = False
            self._drain(self._deferred, end_ns)
        else:
            for tick in range(start + 1, end + 1):
                self._drain(self._on_device if self._lag else self._on_both, tick * self._period_ns)
                self._tick(tick)
        if self._lag:
            self._drain(self._on_world, end_ns)
        self._fold_works()

    def _drain(self, kinds: tuple[Events, ...], until_ns: int) -> None:
        """Handle all events until `until_ns`; at the same nanosecond, in the order of `kinds`."""
        first = kinds[0][0]
        for due, _ in kinds[1:]:
            first = np.minimum(first, due)
        busy = (first <= until_ns).nonzero()[0]
        while busy.size:
            times = [due[busy] for due, _ in kinds]
            first = times[0]
            for at_ns in times[1:]:
                first = np.minimum(first, at_ns)
            open_ = first <= until_ns
            for (_, handle), at_ns in zip(kinds, times, strict=True):
                hit = (open_ & (at_ns == first)).nonzero()[0]
                if hit.size:
                    handle(busy[hit], first[hit])
                    open_[hit] = False
            busy = busy[first <= until_ns]

    # -- the device --------------------------------------------------------------------------------------------------

    def _tick(self, tick: int) -> None:
        state, wire = self._state, self._state.device_wire
        devices, couplings = state.devices, wire.couplings
        wire.hand_over(*state.device_positions.tick(tick))
        work = devices.advance(couplings.set_position)
        kinetic = devices.kinetic()
        potential = couplings.springs.potential(devices.position - couplings.set_position)
        couplings.ledgers.put_in_all(work, kinetic + potential, couplings.account)
        state.elapsed_s += self._tick_s
        due = state.elapsed_s >= self._due_s
        due |= couplings.has_sample
        if not self._all_alive:
            due &= self._alive
        at = due.nonzero()[0]
        if at.size:
            self._modulate(at, kinetic[at], tick * self._period_ns)
        self._works.append(couplings.ledgers.work)

    def _modulate(self, at: Index, kinetic: Array, now_ns: int) -> None:
        """Run PSPM in the devices `at`."""
        state, wire = self._state, self._state.device_wire
        devices, couplings = state.devices, wire.couplings
        x = pick(devices.position, at)
        travel = pick(devices.high, at) - pick(devices.low, at)
        place(devices.low, at, x)
        place(devices.high, at, x)
        by_range = self._damping * travel * travel
        dissipated = by_range[0] if len(by_range) == 1 else by_range.sum(axis=0)
        dissipated /= state.elapsed_s[at]
        limited = devices.limited[at]
        if limited.any():
            dissipated[limited] = devices.dissipated[at[limited]]
            devices.limited[at] = False
        devices.dissipated[at] = 0.0
        sent = couplings.update(at, x, dissipated)
        state.elapsed_s[at] = 0.0
        couplings.ledgers.observe(at, kinetic + couplings.potential(at, x), couplings.account[at])
        wire.on_update(at, np.full(len(at), now_ns), x, sent)

    # -- the world ---------------------------------------------------------------------------------------------------

    def _step(self, at: Index, now_ns: Whole) -> None:
        """In each scenario of `at` the running step ends and the next begins."""
        state, wire = self._state, self._state.world_wire
        masses, couplings = state.masses, wire.couplings
        wire.look(at, now_ns)
        dt = state.steps.end(at, now_ns)
        work, dissipated = masses.step(at, dt, pick(couplings.set_position, at))
        x, kinetic = pick(masses.position, at), masses.kinetic(at)
        ledgers = couplings.ledgers
        ledgers.put_in(at, work)
        ledgers.observe(at, kinetic + couplings.potential(at, x), couplings.account[at])
        sent = couplings.update(at, x, dissipated)
        ledgers.observe(at, kinetic + couplings.potential(at, x), couplings.account[at])
        self._observe_ports(at, now_ns)
        wire.on_update(at, now_ns, x, sent)

    # -- both ports --------------------------------------------------------------------------------------------------

    def _observe_ports(self, at: Index, now_ns: Whole) -> None:
        """`TwoPort.world`: the devices may be ahead by a window, but only their ticks before this step count."""
        ports = self._state.ports
        device_low, device = ports.device_low[at], ports.device[at]
        if self._works:
            passed = np.clip(-(-now_ns // self._period_ns) - 1 - self._window, 0, len(self._works))
            if self._rows is None:
                self._rows = np.array(self._works)
            works = self._rows[:, at]
            row = np.arange(len(works))[:, None]
            new = (row >= self._ticks_counted[at]) & (row < passed)
            device_low = np.minimum(device_low, np.where(new, works, np.inf).min(axis=0))
            device = np.where(passed > 0, works[np.maximum(passed - 1, 0), np.arange(len(at))], device)
            self._ticks_counted[at] = np.maximum(self._ticks_counted[at], passed)
        work, before = self._state.world_wire.couplings.ledgers.work[at], ports.world[at]
        ports.close(at, work)
        lowest = np.minimum(ports.lowest[at], np.minimum(device_low + before, device_low + work))
        ports.lowest[at], ports.world[at], ports.device_low[at] = lowest, work, device

    def _fold_works(self) -> None:
        """`TwoPort.device` for the window's ticks."""
        ports = self._state.ports
        ahead = bool(self._ticks_counted.any())
        for row, work in enumerate(self._works):
            new = np.where(self._ticks_counted <= row, work, np.inf) if ahead else work
            np.minimum(ports.device_low, new, out=ports.device_low)
        ports.device = self._works[-1] if self._works else ports.device
        self._works, self._rows = [], None
        if ahead:
            self._ticks_counted.fill(0)

    def _write_back(self, at: Index, tick: int) -> None:
        self._drain(self._on_both, tick * self._period_ns)
        self._state.write_back(at, tick)
        self._alive[at] = False
        self._all_alive = False
        for due in (kind[0] for kind in self._on_both):
            due[at] = NEVER


def _lag(scenarios: Sequence[Scenario], period_ns: int) -> int:
    """Number of ticks by which the worlds may lag behind the devices; 0: not at all."""
    ups = {scenario.up.profile for scenario in scenarios}
    downs = {scenario.down.profile for scenario in scenarios}
    if min(map(shortest_ns, ups)) == 0:
        return 0
    return min(min(map(shortest_ns, downs)) // period_ns, _LONGEST_LAG)
