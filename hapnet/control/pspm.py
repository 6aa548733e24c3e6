"""Passive set-position modulation: Algorithm 1 of Lee and Huang (World Haptics 2009).

At each instant t_k, triggered by a sample or by a clock, the modulated set-position ybar(k) comes as near to the
received y(k) as the available energy allows, and energy above the reservoir's ceiling is shuffled to the other side:

    ybar(k) = argmin |y(k) - ybar|                                                        (8)
    subject to  E(k) = E(k-1) + E_y(k) + D(k-1) - Pbar(k) >= 0                            (9)
    Pbar(k) = phi(x - ybar(k)) - phi(x - ybar(k-1))                                       (11)
    E(k) > ceiling:  E_x(k) out of the surplus, E(k) = ceiling                            (lines 7 to 12)

D is the energy dissipated since the last instant: a bound from the positions' extremes (10), or measured (see
harvest.py), or exact (the virtual world). A measured D may be negative.

A servo that holds its torque outputs energy between two instants. The reserve covers that energy: the spring's jumps
use only the part of E(k) above the reserve (see reserve.py).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.control import reservoir_level
from hapnet.control.harvest import dissipated_by_range
from hapnet.control.reserve import spendable as spendable_of
from hapnet.errors import InvalidParameter
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring, shared_spring
from hapnet.records.record import OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy

_ROUNDING = 2.0**-50
"""A shortfall below this share of the terms in D and phi is rounding, not a deficit."""

Shuffle = Literal["harvested", "all"]
SHUFFLES: tuple[Shuffle, ...] = ("harvested", "all")


class Modulation(NamedTuple):
    """The result of one update; energies in joules, positions in metres."""

    set_position: Vector
    """ybar(k), the modulated set-position."""
    energy: float
    """E(k), the reservoir, never negative."""
    deficit: float
    """The part of a measured, negative D that the reservoir could not cover; zero unless the reservoir is empty."""
    sent: float
    """E_x(k), shuffled to the other side."""
    discarded: float
    """Surplus that is neither kept nor sent."""
    jump: float
    """Pbar(k), the spring's jump (11)."""


class ArrayModulation(NamedTuple):
    """`Modulation` with the set-position as an array of shape (n,)."""

    set_position: Array
    energy: float
    deficit: float
    sent: float
    discarded: float
    jump: float


class SetPositionModulator(Record):
    """One side's modulator with its energy reservoir.

    Parameters
    ----------
    stiffness : K [N/m], symmetric positive definite: a scalar, n diagonal entries, or (n, n).
    position : x(0) [m], shape (n,); ``ybar(0) = x(0)``.
    ceiling : the reservoir's ceiling [J].
    damping : B [Ns/m], positive diagonal: only needed by `update` with `extremes`, for (10).
    shuffle : ``"harvested"``: only the surplus that this side harvested is sent; the rest is discarded, so that energy
        does not circulate between two full reservoirs. ``"all"``: Algorithm 1 as printed.
    force_limit : the force at which the spring saturates [N], see `Spring`.
    energy : E(0) [J]; None: the ceiling, as in the paper. A restarted side starts with 0.
    reserve : energy that the spring's jumps must leave in the reservoir [J]; at most the ceiling.
    held_m, drag_N : for a held torque, see `hapnet.control.reserve.spendable`; 0: no torque is held.
    injects : whether the energy in the spring comes back by itself, see `hapnet.control.reservoir_level`.

    Raises InvalidParameter: a value is not allowed, or the dimensions do not agree.

    Attributes
    ----------
    ybar : the modulated set-position [m]. energy : E(k) [J].
    deficit : the part of a measured, negative D that the reservoir could not cover [J].
    modulated : whether ybar differs from the y of the last update. stored : phi after that update [J].
    sent, discarded, jump : of the last update, as in `Modulation`.
    level : the reservoir's level after the last update, see `hapnet.control.reservoir_level`.
    offset : temporary memory of `modulate`.
    """

    ybar: OfAxes
    energy: float
    deficit: float
    ceiling: float
    reserve: float
    held_m: float
    drag_N: float
    harvested_only: int
    injects: int
    modulated: int
    stored: float
    sent: float
    discarded: float
    jump: float
    level: float
    spring: Spring
    offset: OfAxes

    def __init__(
        self,
        *,
        stiffness: ArrayLike,
        position: ArrayLike,
        ceiling: float = 0.05,
        damping: ArrayLike | None = None,
        shuffle: Shuffle = "harvested",
        force_limit: float | None = None,
        energy: float | None = None,
        reserve: float = 0.0,
        held_m: float = 0.0,
        drag_N: float = 0.0,
        injects: bool = False,
    ) -> None:
        super().__init__()
        self.ybar = list(checks.vector("position", position))
        self.dof: int = len(self.ybar)
        self.offset = [0.0] * self.dof
        self.spring = shared_spring(stiffness, self.dof, force_limit)
        self.ceiling = checks.non_negative("ceiling", ceiling)
        self.damping: Vector | None = None if damping is None else checks.diagonal("damping", damping, self.dof)
        self.harvested_only = int(checks.one_of("shuffle", shuffle, SHUFFLES) == "harvested")
        self.energy = self.ceiling if energy is None else checks.non_negative("energy", energy)
        if self.energy > self.ceiling:
            raise InvalidParameter("energy", energy, f"at most the ceiling, {self.ceiling} J")
        self.reserve = checks.non_negative("reserve", reserve)
        if self.reserve > self.ceiling:
            raise InvalidParameter("reserve", reserve, f"at most the ceiling, {self.ceiling} J")
        self.held_m = checks.non_negative("held_m", held_m)
        self.drag_N = checks.non_negative("drag_N", drag_N)
        self.injects = int(injects)
        self.level = reservoir_level.level(self.energy, 0.0, self.reserve, self.ceiling, False)

    @property
    def set_position(self) -> Vector:
        """ybar, the modulated set-position [m]."""
        return tuple(self.ybar)

    @set_position.setter
    def set_position(self, position: Vector) -> None:
        self.ybar[:] = position

    @property
    def account(self) -> float:
        """The reservoir's content as the ledger counts it [J]: energy less deficit."""
        return self.energy - self.deficit

    def split_reservoir(self, most: float = math.inf) -> float:
        """Take half of the energy out of the reservoir, but at most `most` [J]. Returns the energy taken [J]."""
        given = max(0.0, min(self.energy / 2.0, most))
        self.energy -= given
        return given

    def give(self, dt: float, peer_level: float, keep: float) -> float:
        """Take out energy that the other side needs more (`hapnet.control.reservoir_level`). Returns that energy [J].

        dt : time since the last update [s]. peer_level : the other side's level. keep : as in `modulate`.
        """
        return give(self, dt, peer_level, keep)

    def update(
        self,
        *,
        set_position: ArrayLike,
        position: ArrayLike,
        dissipated: float | None = None,
        received: float = 0.0,
        extremes: tuple[ArrayLike, ArrayLike] | None = None,
        interval: float | None = None,
    ) -> ArrayModulation:
        """Run Algorithm 1 once.

        set_position : y(k) [m], shape (n,): as received, or after filters and predictors.
        position : x(t_k) [m], shape (n,).
        dissipated : D(k-1) [J]; may be negative if it was measured.
        received : E_y(k) [J], credited once.
        extremes, interval : in place of `dissipated`: smallest and largest position on each axis since the last update
            [m], both ends included, and an upper bound of the time since then [s]. D is then computed by (10).

        Raises InvalidParameter: a dimension or a value is not allowed. The state is then unchanged.
        """
        y = checks.vector("set_position", set_position, self.dof)
        x = checks.vector("position", position, self.dof)
        if (dissipated is None) == (extremes is None):
            raise InvalidParameter("dissipated", dissipated, "either dissipated, or extremes with an interval")
        if extremes is not None:
            if self.damping is None or interval is None:
                raise InvalidParameter("extremes", extremes, "extremes need an interval, and a modulator with damping")
            low = checks.vector("extremes[0]", extremes[0], self.dof)
            high = checks.vector("extremes[1]", extremes[1], self.dof)
            checks.non_negative("interval", interval)
            dissipated = dissipated_by_range(self.damping, low, high, interval)
        assert dissipated is not None
        checks.vector("dissipated", dissipated, 1)
        checks.non_negative("received", received)
        r = self.modulate(y, x, dissipated, received)
        return ArrayModulation(np.array(r.set_position), *r[1:])

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        """As `update`, for a servo: the arguments are not checked; they must be finite and of the right dimension.

        keep : energy that spring and reservoir together should keep [J]; it does not count as surplus.
        """
        modulate(self, y, x, dissipated, received, keep)
        return Modulation(self.set_position, self.energy, self.deficit, self.sent, self.discarded, self.jump)


@equation
def modulate(m: SetPositionModulator, y: Reals, x: Reals, dissipated: float, received: float, keep: float) -> None:
    """Run PSPM once, without checks of the arguments: `SetPositionModulator.modulate`."""
    spring, ybar = m.spring, m.ybar
    before = springs.between(spring, ybar, x)
    at_hand = m.energy - m.deficit + received + dissipated + before  # R of the ellipsoid (9)
    spendable = spendable_of(at_hand, m.reserve, m.held_m, m.drag_N, spring.ellipsoid.largest)
    after = springs.between(spring, y, x)
    modulated = after > spendable
    if not modulated:
        copy(spring.dof, y, ybar)
    else:
        after = _bring_within(m, y, x, spendable)
    left = at_hand - after
    if 0.0 > left >= -_ROUNDING * (abs(dissipated) + before):
        left = 0.0
    energy = left if left > 0.0 else 0.0
    m.deficit = -left if left < 0.0 else 0.0
    m.sent = m.discarded = 0.0
    ceiling = m.ceiling if keep - after <= m.ceiling else keep - after
    if energy > ceiling:
        surplus = energy - ceiling
        m.sent = max(0.0, surplus - received) if m.harvested_only else surplus
        m.discarded = surplus - m.sent
        energy = ceiling
    m.energy, m.stored, m.jump, m.modulated = energy, after, after - before, 1 if modulated else 0
    m.level = reservoir_level.level(energy, after if m.injects else 0.0, m.reserve, m.ceiling, modulated)


@equation
def give(m: SetPositionModulator, dt: float, peer_level: float, keep: float) -> float:
    """Take out and return energy that the other side needs more [J]; 0 if its level is unknown, below 0."""
    own = reservoir_level.level(m.energy, 0.0, m.reserve, m.ceiling, m.modulated != 0)
    spare = m.energy - max(m.reserve, keep - m.stored)
    given = reservoir_level.gift(dt, own, peer_level, m.ceiling - m.reserve, spare)
    m.energy -= given
    return given


@equation
def _bring_within(m: SetPositionModulator, y: Reals, x: Reals, spendable: float) -> float:
    """Tie the spring as near to y as the energy allows; returns phi [J]."""
    n, ybar, offset = m.spring.dof, m.ybar, m.offset
    for i in range(n):
        offset[i] = x[i] - y[i]
    springs.nearest(m.spring, offset, spendable)
    for i in range(n):
        ybar[i] = x[i] - offset[i]
    # phi is computed from ybar, as in all other code: the subtraction may have changed ybar by an ulp
    after = springs.between(m.spring, ybar, x)
    excess = 2.0**-50
    while after > spendable >= 0.0:
        for i in range(n):
            offset[i] = (1.0 - excess) * offset[i]
            ybar[i] = x[i] - offset[i]
        after = springs.between(m.spring, ybar, x)
        excess *= 2.0  # reaches 1, where ybar = x, in 50 rounds at the most
    return after
