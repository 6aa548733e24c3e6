"""Passive set-position modulation: Algorithm 1 of Lee and Huang (World Haptics 2009).

At each instant t_k, triggered by data or by a clock, the received set-position y(k) is moved as near as the energy at
hand allows, and what the reservoir holds above its ceiling is handed on:

    ybar(k) = argmin |y(k) - ybar|                                                        (8)
    subject to  E(k) = E(k-1) + E_y(k) + D(k-1) - Pbar(k) >= 0                            (9)
    Pbar(k) = phi(x - ybar(k)) - phi(x - ybar(k-1))                                       (11)
    E(k) > ceiling:  E_x(k) out of the surplus, E(k) = ceiling                            (lines 7 to 12)

D is what was dissipated since the last instant: (10) from the positions' extremes, or measured (see harvest.py), or
exact (the virtual world). A measured D may be negative.

A servo that holds its torque gives out energy between two instants. What that may come to is kept in reserve: the
spring's jumps are paid for with what E(k) holds above it (see reserve.py).
"""

from __future__ import annotations

import math
from operator import sub
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.control.harvest import dissipated_by_range
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import shared_spring

_ROUNDING = 2.0**-50
"""Of the terms that D and phi are differences of: less than that is no deficit."""

Shuffle = Literal["harvested", "all"]
SHUFFLES: tuple[Shuffle, ...] = ("harvested", "all")


class Modulation(NamedTuple):
    """What one update did; energies in joules, positions in metres."""

    set_position: Vector
    """ybar(k), the modulated set-position."""
    energy: float
    """E(k), the reservoir, never negative."""
    deficit: float
    """What a measured, negative D left unpaid; zero unless the reservoir is empty."""
    sent: float
    """E_x(k), shuffled to the other side."""
    discarded: float
    """Surplus that was neither kept nor sent."""
    jump: float
    """Pbar(k), the spring's jump (11)."""


class Update(NamedTuple):
    """`Modulation` with the set-position as an array of shape (n,)."""

    set_position: Array
    energy: float
    deficit: float
    sent: float
    discarded: float
    jump: float


class SetPositionModulator:
    """One side's modulator with its energy reservoir.

    Parameters
    ----------
    stiffness : K [N/m], symmetric positive definite: a scalar, n diagonal entries, or (n, n).
    position : x(0) [m], shape (n,); ``ybar(0) = x(0)``.
    ceiling : the reservoir's ceiling [J].
    damping : B [Ns/m], positive diagonal: only needed by `update` with `extremes`, for (10).
    shuffle : ``"harvested"``: of the surplus, only what this side harvested is sent and the rest is discarded, so
        energy does not orbit between two full reservoirs. ``"all"``: Algorithm 1 as printed.
    force_limit : saturates the spring [N], see `Spring`.
    energy : E(0) [J]; None: the ceiling, as the paper starts. A restarted side starts with 0.
    reserve : what the spring's jumps leave in the reservoir [J]; at most the ceiling.

    Raises
    ------
    InvalidParameter : a value is not allowed, or the dimensions do not agree.
    """

    __slots__ = (
        "_harvested_only", "ceiling", "damping", "deficit", "dof", "energy", "reserve", "set_position", "spring",
    )  # fmt: skip

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
    ) -> None:
        self.set_position: Vector = checks.vector("position", position)
        self.dof = len(self.set_position)
        self.spring = shared_spring(stiffness, self.dof, force_limit)
        self.ceiling = checks.non_negative("ceiling", ceiling)
        self.damping = None if damping is None else checks.diagonal("damping", damping, self.dof)
        self._harvested_only = checks.one_of("shuffle", shuffle, SHUFFLES) == "harvested"
        self.energy = self.ceiling if energy is None else checks.non_negative("energy", energy)
        if self.energy > self.ceiling:
            raise InvalidParameter("energy", energy, f"at most the ceiling, {self.ceiling} J")
        self.reserve = checks.non_negative("reserve", reserve)
        if self.reserve > self.ceiling:
            raise InvalidParameter("reserve", reserve, f"at most the ceiling, {self.ceiling} J")
        self.deficit = 0.0

    @property
    def account(self) -> float:
        """What the ledger counts as this reservoir's content [J]: energy less deficit."""
        return self.energy - self.deficit

    def split_reservoir(self, most: float = math.inf) -> float:
        """Give away half of the reservoir, but no more than `most` [J]; what was taken out of it [J]."""
        given = max(0.0, min(self.energy / 2.0, most))
        self.energy -= given
        return given

    def update(
        self,
        *,
        set_position: ArrayLike,
        position: ArrayLike,
        dissipated: float | None = None,
        received: float = 0.0,
        extremes: tuple[ArrayLike, ArrayLike] | None = None,
        interval: float | None = None,
    ) -> Update:
        """Algorithm 1, once.

        Parameters
        ----------
        set_position : y(k) [m], shape (n,): as received, or as a filter or predictor made it.
        position : x(t_k) [m], shape (n,).
        dissipated : D(k-1) [J]; may be negative if it was measured.
        received : E_y(k) [J], credited once.
        extremes, interval : in place of `dissipated`: smallest and largest position of each axis since the last update
            [m], both ends included, and an upper bound of the time between [s]; D is then (10).

        Raises
        ------
        InvalidParameter : a dimension or a value is not allowed; the state is then unchanged.
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
        return Update(np.array(r.set_position), *r[1:])

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        """`update` for a servo: the arguments are trusted to be finite and of the right dimension.

        keep : what spring and reservoir together must hold afterwards, as far as they can [J]: it is no surplus.
        """
        spring = self.spring
        before = spring.between(self.set_position, x)
        at_hand = self.energy - self.deficit + received + dissipated + before  # R of the ellipsoid (9)
        spendable = at_hand - self.reserve
        after = spring.between(y, x)
        if after <= spendable:
            self.set_position = y
        else:
            offset = spring.nearest(tuple(map(sub, x, y)), spendable)
            self.set_position = tuple(map(sub, x, offset))
            # phi as everyone else will compute it, from ybar: subtracting may have moved it by an ulp
            after = spring.between(self.set_position, x)
            excess: float = 2.0**-50
            while after > spendable >= 0.0:
                offset = tuple([(1.0 - excess) * component for component in offset])
                self.set_position = tuple(map(sub, x, offset))
                after = spring.between(self.set_position, x)
                excess *= 2.0  # reaches 1, where ybar = x, in 50 rounds at the most
        left = at_hand - after
        if 0.0 > left >= -_ROUNDING * (abs(dissipated) + before):
            left = 0.0
        energy = left if left > 0.0 else 0.0
        self.deficit = -left if left < 0.0 else 0.0
        sent = discarded = 0.0
        ceiling = self.ceiling if keep - after <= self.ceiling else keep - after
        if energy > ceiling:
            surplus = energy - ceiling
            sent = max(0.0, surplus - received) if self._harvested_only else surplus
            discarded = surplus - sent
            energy = ceiling
        self.energy = energy
        return Modulation(self.set_position, energy, self.deficit, sent, discarded, after - before)
