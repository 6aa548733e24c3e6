"""An energy account of a simulated run that shares nothing with the one it checks.

A `Witness` watches a simulation from outside: where the device and the virtual mass were, which forces were asked of
the actuators and which they gave, and what energy crossed the wire. `account` makes the energy at both ports of that:

* the actuator: the force that it gave times the way, ``-tau . dx``;
* the hand: its force by its own law (mass, damper and spring on the way to where it wants to be) times the way. With
  one substep a tick the mean velocity is ``dx/h`` and the velocities follow by recursion: positions say it all;
* the world: the walls' law, between the positions before and after a step; nothing of the coupling is needed.

Nothing here may know `hapnet.control`: that is what is checked.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hapnet.assembly.operators import operator
from hapnet.checks import Array, Vector
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation

NANO = 1e-9


class Jump(NamedTuple):
    """The spring's end went from one place to another [m] while the device was at `x` [m]."""

    x: Vector
    before: Vector
    after: Vector


class WorldStep(NamedTuple):
    """A step of the virtual mass that ended then, at `position` [m], the spring's other end at `set_position` [m].

    begun : where it began [m]. From where the step before ended it was carried there, through free space.
    """

    ended_ns: int
    step_s: float
    set_position: Vector
    begun: Vector
    position: Vector


class Crossing:
    """Energy that came over the wire to one side and went from it, and between which of its ticks (or steps).

    What has come is in the side's hands from its next tick on.
    """

    def __init__(self) -> None:
        self.credited_nJ = 0
        self.given_J = 0.0
        self._pending_nJ = 0
        self._credits: dict[int, float] = {}
        self._gifts: dict[int, float] = {}

    def credit(self, credited_nJ: int) -> None:
        self.credited_nJ += credited_nJ
        self._pending_nJ += credited_nJ

    def take(self, tick: int) -> None:
        self._credits[tick] = self._credits.get(tick, 0.0) + self._pending_nJ * NANO
        self._pending_nJ = 0

    def shuffle(self, tick: int, energy: float) -> None:
        self.given_J += energy
        self._gifts[tick] = self._gifts.get(tick, 0.0) + energy

    def net(self, ticks: int) -> tuple[Array, Array]:
        """Credited less sent [J] before and after what crossed at each of the ticks 0 to `ticks`."""
        change = np.zeros(ticks + 1)
        for tick, energy in self._credits.items():
            change[tick] += energy
        for tick, energy in self._gifts.items():
            change[tick] -= energy
        after = np.cumsum(change)
        return after - change, after


class Witness:
    """All that can be seen of a simulation without looking into its accounts; to be made before it runs."""

    def __init__(self, simulation: Simulation) -> None:
        self.params: Params = simulation.setup.params
        self.servo = simulation.setup.servo
        self.hand = operator(self.params, simulation.setup.scene)
        device: Any = simulation.device.device
        mass = simulation.world.mass
        self.start: Vector = mass.position
        self.positions: list[Vector] = [device.position]
        """Of the device, at the start and after each tick [m]."""
        self.readings: list[Vector] = []
        """The same as the encoders said."""
        self.commanded: list[Vector] = []
        """Forces that were asked of the actuators [N], after each tick."""
        self.applied: list[Vector] = []
        """Forces that they gave."""
        self.jumps: list[Jump] = []
        self.steps: list[WorldStep] = []
        self.device, self.world = Crossing(), Crossing()
        self.least_gap_nJ = 0
        """The least of what one side had given less what the other had been credited, at any time."""
        self._simulation = simulation
        self._watch_device(simulation, device)
        self._watch_world(simulation, mass)

    @property
    def origin_ns(self) -> int:
        """When the device's control started."""
        return self._simulation.device.origin_ns or 0

    @property
    def ticks(self) -> int:
        return len(self.positions) - 1

    @property
    def stopped(self) -> Vector:
        """Where the mass is now [m]."""
        return self._simulation.world.mass.position

    def _watch_device(self, simulation: Simulation, device: Any) -> None:
        run, advance, read = device.run, device.advance, device.read
        apply, move = device.apply, device.move_set_position
        couple = device.couple
        tied: list[Vector] = []

        def watched_run(ticks: int) -> Any:
            results = run(ticks)
            self.positions.extend(one[1] for one in results)
            return results

        def watched_advance() -> float:
            seen = len(self.positions)
            work: float = advance()
            if len(self.positions) == seen:  # without `run`
                self.positions.append(device.position)
            return work

        def watched_read() -> tuple[Vector, Vector]:
            seen: tuple[Vector, Vector] = read()
            self._put(self.readings, seen[0], self.ticks)
            return seen

        def watched_apply(force: Vector) -> Vector | None:
            given: Vector | None = apply(force)
            self._put(self.commanded, force, self.ticks - 1)
            self._put(self.applied, self._actuators(force) if given is None else given, self.ticks - 1)
            return given

        def watched_couple(stiffness: Any, damping: Any, set_position: Vector, *limits: Any, **more: Any) -> None:
            tied[:] = [set_position]
            couple(stiffness, damping, set_position, *limits, **more)

        def watched_move(set_position: Vector) -> None:
            self.jumps.append(Jump(device.position, tied[0], set_position))
            tied[0] = set_position
            move(set_position)

        device.run, device.advance = watched_run, watched_advance
        device.read, device.apply = watched_read, watched_apply
        device.couple, device.move_set_position = watched_couple, watched_move
        endpoint: Any = simulation.device_endpoint
        for name in ("tick_continuous", "tick_sampled"):
            setattr(endpoint, name, _before(getattr(endpoint, name), lambda: self.device.take(self.ticks)))
        self._watch_wire(endpoint, self.device, self.world, lambda: self.ticks)

    def _watch_world(self, simulation: Simulation, mass: Any) -> None:
        step = mass.step

        def watched_step(dt: float, set_position: Vector, *rest: Any) -> Any:
            begun = mass.position
            done = step(dt, set_position, *rest)
            self.steps.append(WorldStep(simulation.now_ns, dt, set_position, begun, done.position))
            return done

        mass.step = watched_step
        endpoint: Any = simulation.world_endpoint
        endpoint.take = _before(endpoint.take, lambda: self.world.take(len(self.steps)))
        self._watch_wire(endpoint, self.world, self.device, lambda: len(self.steps))

    def _watch_wire(self, endpoint: Any, here: Crossing, there: Crossing, now: Callable[[], int]) -> None:
        credit, give = endpoint.credit, endpoint.session.shuffle

        def watched_credit(credited_nJ: int) -> None:
            here.credit(credited_nJ)
            self.least_gap_nJ = min(self.least_gap_nJ, math.floor(there.given_J * 1e9 + 1e-3) - here.credited_nJ)
            credit(credited_nJ)

        def watched_give(energy: float) -> None:
            here.shuffle(now(), energy)
            give(energy)

        endpoint.credit, endpoint.session.shuffle = watched_credit, watched_give

    @staticmethod
    def _put(values: list[Vector], value: Vector, index: int) -> None:
        """The last of a tick counts."""
        if index >= 0:
            values[index:] = [value]

    def _actuators(self, force: Vector) -> Vector:
        """What actuators give that reach their limit."""
        limit, length = self.params.device.force_limit_N, math.hypot(*force)
        return tuple(c * limit / length for c in force) if 0.0 < limit < length else force


@dataclass(frozen=True)
class Account:
    """What the energies at the ports come to [J]; None where positions do not say it."""

    device: Array | None
    """Margin at the device's port after each of its ticks: the actuator's of a sampled servo, else the hand's."""
    world: Array
    """Margin at the world's port after each of its steps."""
    device_min: float | None
    """Least over time, the start included, and before and after what crossed the wire at a tick counts."""
    world_least: float
    both_least: float | None
    """Of both ports together, with d^2."""
    hand_and_world_least: float | None
    """The same with the hand's port, whatever the servo."""
    unseen: float
    """Most energy that the actuators gave by true positions and, by the encoders' counts, did not."""
    coupling_force: Array | None
    """Of a continuous servo: mean force on the device over each tick [N], by the balance of its momentum."""


def account(witness: Witness) -> Account:
    """The account of a run that has ended; the hand's port needs one substep a tick."""
    params = witness.params
    hand = tau = None
    if params.device.substeps == 1:
        hand, tau = _hand(witness)
    sampled = witness.servo == "sampled"
    work, unseen = hand, 0.0
    if sampled:
        work = _actuator(witness, witness.readings, params.device.resolution_m)
        unseen = float(np.max(work - _actuator(witness, witness.positions, 0.0)))
    device = device_min = None
    if work is not None:
        device, device_min = _margin(work, params.device.ceiling_J, witness.device)
    environment = _environment(witness)
    world, world_least = _margin(environment, params.world.ceiling_J, witness.world)
    bound = params.device.ceiling_J + params.world.ceiling_J
    both, whole = (None if port is None else bound + _both(witness, port, environment) for port in (work, hand))
    return Account(device, world, device_min, world_least, both, whole, unseen, None if sampled else tau)


def _margin(work: Array, reservoir: float, crossing: Crossing) -> tuple[Array, float]:
    """(after each tick, the least over time): all start at rest with the spring slack, so that V(0) = 0."""
    before, after = crossing.net(len(work) - 1)
    return (work + reservoir + after)[1:], reservoir + float(min(0.0, np.min(work + np.minimum(before, after))))


def _running(power: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(power)])


def _actuator(witness: Witness, positions: Sequence[Vector], count: float) -> Array:
    """Energy put in at the actuator's port after each tick; damping that is declared to be there takes its part.

    The account that is checked knows the way by what the encoders say, in counts of that many metres, and no other.
    """
    device, x = witness.params.device, np.array(positions)
    dx = np.diff(x, axis=0)
    forces = np.vstack([np.zeros((1, dx.shape[1])), np.array(witness.applied)])[: len(dx)]
    tick_s = max(1.0 / device.servo_hz, round(1e9 / device.servo_hz) * NANO)  # the servo's clock has whole nanoseconds
    trusted = device.trusted_damping * np.maximum(0.0, np.abs(dx) - count) ** 2 / tick_s
    return _running(np.sum(trusted - forces * dx, axis=1))


def _hand(witness: Witness) -> tuple[Array, Array]:
    """Energy put in by the hand after each tick [J], and the coupling's mean force on the device over it [N]."""
    device, arm = witness.params.device, witness.hand.impedance
    h = 1.0 / device.servo_hz
    x = np.array(witness.positions)
    wanted = np.array([witness.hand.reference(k * h) for k in range(len(x))])
    dx = np.diff(x, axis=0)
    mean = dx / h
    v = np.zeros_like(x)
    for k, velocity in enumerate(mean):
        v[k + 1] = 2.0 * velocity - v[k]
    dv = np.diff(v, axis=0) / h
    force = arm.stiffness * (wanted[1:] + wanted[:-1] - x[1:] - x[:-1]) / 2.0
    force += arm.damping * (np.diff(wanted, axis=0) / h - mean) - arm.mass * dv
    tau = device.mass * dv - force + device.own_damping * mean
    return _running(np.sum(force * dx, axis=1)), tau


def walls(params: Params) -> Sequence[tuple[int, float, float]]:
    """(axis, +1 or -1, where along it [m]) of the faces; solid beyond."""
    wall, n = params.world.wall, params.dof
    if params.scene == "wall":
        return [(0, 1.0, wall.position_m)]
    if params.scene == "box":
        return [(axis, side, wall.half_width_m) for axis in range(n) for side in (1.0, -1.0)]
    return [(2, -1.0, 0.0)] if params.scene == "paper" else []


def _environment(witness: Witness) -> Array:
    """Energy put in by the walls after each step of the virtual mass.

    A face gives back what its spring held and takes what its damper does inside; one that would pull lets go instead.
    """
    wall = witness.params.world.wall
    begun, ended = (np.array([step[k] for step in witness.steps]) for k in (3, 4))
    before = np.array([witness.start, *(step.position for step in witness.steps[:-1])])
    T = np.array([step.step_s for step in witness.steps])
    total = np.zeros(len(T))
    for axis, side, at in walls(witness.params):
        way = side * (ended - begun)[:, axis]
        outer, inner, carried = (np.maximum(0.0, side * x[:, axis] - at) for x in (begun, ended, before))
        work = -0.5 * wall.stiffness * (inner**2 - outer**2) - wall.damping * way * (inner - outer) / T
        total += np.where(work * way <= 0.0, work, 0.0)  # else its force would point into the wall
        total -= 0.5 * wall.stiffness * (outer**2 - carried**2)  # a mass that was carried into a wall would show
    return _running(total)


def _both(witness: Witness, device: Array, world: Array) -> float:
    """The least over time of the energy put in at both ports: at T with the world's steps that have begun by then.

    A running step may be paired with or without its work: the theorem allows both, and both must hold.
    """
    period_ns = round(1e9 / witness.params.device.servo_hz)
    ticks = witness.origin_ns + period_ns * np.arange(len(device))
    ends = np.array([step.ended_ns for step in witness.steps])
    ended = np.searchsorted(ends, ticks, side="right")
    begun = np.minimum(ended + 1, len(world) - 1)
    lowest = min(0.0, float(np.min(device + np.minimum(world[ended], world[begun]))))
    last = np.maximum(np.searchsorted(ticks, ends, side="left") - 1, 0)  # the device's last tick as a step ends
    following = np.minimum(np.arange(1, len(ends) + 1) + 1, len(world) - 1)
    return min(lowest, float(np.min(device[last] + np.minimum(world[1:], world[following]), initial=0.0)))


def motion(witness: Witness) -> dict[str, float | int | None]:
    """Figures of the motion over the whole run, as `hapnet.ext.metrics` defines them; the peak force of a hold only.

    Device and proxy are compared where both are known, the proxy in between its steps on a straight line.
    """
    sampled = witness.servo == "sampled"
    x = np.array(witness.readings if sampled else witness.positions)[1:]
    period_ns = round(1e9 / witness.params.device.servo_hz)
    times = witness.origin_ns + period_ns * np.arange(1, len(x) + 1)
    proxy = np.array([*(step.begun for step in witness.steps[1:]), witness.stopped])
    ends = np.array([step.ended_ns for step in witness.steps])
    depth = np.zeros(len(proxy))
    for axis, side, at in walls(witness.params):
        depth = np.maximum(depth, side * proxy[:, axis] - at)
    inside = depth > 0.0
    known = (times >= ends[0]) & (times <= ends[-1])
    there = np.column_stack([np.interp(times[known], ends, column) for column in proxy.T])
    away = np.sum((x[known] - there) ** 2, axis=1)
    contact = inside[np.searchsorted(ends, times[known], side="right") - 1]
    return {
        "free_rms_m": _root_mean(away[~contact]),
        "contact_rms_m": _root_mean(away[contact]),
        "peak_force_N": float(np.max(np.linalg.norm(witness.applied, axis=1))) if sampled else None,
        "peak_penetration_m": float(np.max(depth)),
        "contacts": int(np.count_nonzero(np.diff(inside.astype(int), prepend=0) > 0)),
    }


def _root_mean(squares: Array) -> float | None:
    return math.sqrt(np.mean(squares)) if len(squares) else None


def _before(call: Callable[..., Any], first: Callable[[], None]) -> Callable[..., Any]:
    def both(*args: Any, **kwargs: Any) -> Any:
        first()
        return call(*args, **kwargs)

    return both
