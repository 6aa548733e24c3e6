"""One side's coupling: `hapnet.control.set_position_coupling`, with its modulator, `pspm` or `zoh`."""

from __future__ import annotations

from hapnet.control import ledger as ledgers
from hapnet.control.ledger import Ledger
from hapnet.control.reserve import spendable as spendable_of
from hapnet.control.reservoir_level import gift
from hapnet.control.reservoir_level import level as level_of
from hapnet.kernel import smoothing
from hapnet.kernel.smoothing import Stages
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.equation import equation
from hapnet.records.record import Floats, OfAxes, Record
from hapnet.records.vectors import copy, distance

_ROUNDING = 2.0**-50


class Coupling(Record):
    """`SetPositionCoupling` and its modulator.

    passive : is it PSPM? fresh : has a sample come since the last update, sent at `sent_s`? y : the set-position that
    is being chosen. shuffled : the energy to send, of the last update. shares, lends : as the reference's. level,
    peer_level : how full both reservoirs are; below 0: not told.
    """

    set_position: OfAxes
    target: OfAxes
    received: OfAxes
    y: OfAxes
    offset: OfAxes
    has_sample: int
    fresh: int
    sent_s: float
    credit: float
    account: float
    energy: float
    deficit: float
    ceiling: float
    reserve: float
    held_m: float
    drag_N: float
    passive: int
    harvested_only: int
    longest_step: float
    energy_min: float
    deficit_max: float
    discarded: float
    shuffled: float
    shares: int
    lends: int
    level: float
    peer_level: float
    updates: int
    modulated: int


@equation
def potential(coupling: Coupling, spring: Spring, x: Floats) -> float:
    """phi [J] with the present ybar."""
    return springs.between(spring, coupling.set_position, x)


@equation
def update(
    coupling: Coupling,
    spring: Spring,
    ledger: Ledger,
    stages: Stages,
    dt: float,
    x: Floats,
    dissipated: float,
    keep: float,
) -> None:
    """`SetPositionCoupling.update`, once the source has put its y into `coupling.y`."""
    n, y = spring.dof, coupling.y
    fresh = coupling.fresh != 0
    coupling.fresh = 0
    smoothing.step(n, stages, dt, y, fresh, coupling.sent_s)
    if smoothing.silent(stages, dt, fresh):
        copy(n, x, y)
    if stages.elapsed > stages.after:
        coupling.peer_level = -1.0
    copy(n, y, coupling.target)
    step_towards(n, coupling.set_position, y, coupling.longest_step)
    credit = coupling.credit
    coupling.credit = 0.0
    coupling.has_sample = 0
    if coupling.passive:
        _modulate(coupling, spring, dt, x, dissipated, credit, keep)
    else:
        copy(n, y, coupling.set_position)
        coupling.shuffled = 0.0
    coupling.updates += 1
    ledgers.credit(ledger, credit)
    if coupling.shuffled != 0.0:
        ledgers.send(ledger, coupling.shuffled)
    if coupling.passive:
        coupling.account = coupling.energy - coupling.deficit
    coupling.energy_min = min(coupling.energy_min, coupling.energy)
    coupling.deficit_max = max(coupling.deficit_max, coupling.deficit)


@equation
def step_towards(n: int, start: Floats, goal: Floats, longest: float) -> None:
    """`hapnet.control.limits.step_towards`: replaces `goal` by a point at most `longest` [m] away from `start`."""
    far = distance(n, goal, start)
    if far <= longest:
        return
    share = longest / far
    for i in range(n):
        goal[i] = start[i] + share * (goal[i] - start[i])


@equation
def _modulate(
    coupling: Coupling, spring: Spring, dt: float, x: Floats, dissipated: float, received: float, keep: float
) -> None:
    """`SetPositionModulator.modulate`, with what `give` gives."""
    y, ybar = coupling.y, coupling.set_position
    before = springs.between(spring, ybar, x)
    at_hand = coupling.energy - coupling.deficit + received + dissipated + before
    spendable = spendable_of(at_hand, coupling.reserve, coupling.held_m, coupling.drag_N, spring.ellipsoid.largest)
    after = springs.between(spring, y, x)
    modulated = after > spendable
    if not modulated:
        copy(spring.dof, y, ybar)
    else:
        after = _bring_within(coupling, spring, x, spendable)
    left = at_hand - after
    if 0.0 > left >= -_ROUNDING * (abs(dissipated) + before):
        left = 0.0
    energy = left if left > 0.0 else 0.0
    coupling.deficit = -left if left < 0.0 else 0.0
    sent = 0.0
    ceiling = coupling.ceiling if keep - after <= coupling.ceiling else keep - after
    if energy > ceiling:
        surplus = energy - ceiling
        sent = max(0.0, surplus - received) if coupling.harvested_only else surplus
        coupling.discarded += surplus - sent
        energy = ceiling
    coupling.modulated += modulated
    if coupling.shares:
        room = coupling.ceiling - coupling.reserve
        lent = after if coupling.lends else 0.0
        coupling.level = level_of(energy, lent, coupling.reserve, coupling.ceiling, modulated)
        own = level_of(energy, 0.0, coupling.reserve, coupling.ceiling, modulated)
        given = gift(dt, own, coupling.peer_level, room, energy - max(coupling.reserve, keep - after))
        energy -= given
        sent += given
    coupling.energy = energy
    coupling.shuffled = sent


@equation
def _bring_within(coupling: Coupling, spring: Spring, x: Floats, spendable: float) -> float:
    """Tie the spring as near to y as the energy allows; returns phi [J]."""
    n, ybar, offset = spring.dof, coupling.set_position, coupling.offset
    for i in range(n):
        offset[i] = x[i] - coupling.y[i]
    springs.nearest(spring, offset, spendable)
    for i in range(n):
        ybar[i] = x[i] - offset[i]
    after = springs.between(spring, ybar, x)
    excess = 2.0**-50
    while after > spendable >= 0.0:
        for i in range(n):
            offset[i] = (1.0 - excess) * offset[i]
            ybar[i] = x[i] - offset[i]
        after = springs.between(spring, ybar, x)
        excess *= 2.0
    return after
