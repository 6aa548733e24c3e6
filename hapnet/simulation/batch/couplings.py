"""One side's couplings and ledgers in many scenarios at once: `hapnet.control`, in the same order of operations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.control.ledger import Ledger, LedgerState
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import Arrived, SetPositionCoupling
from hapnet.control.zoh import ZeroOrderHold
from hapnet.simulation.batch.arrays import Index, pick, place, vectors
from hapnet.simulation.batch.springs import Springs


class Ledgers:
    """The ledgers of one side, an array (N,) for each of `Ledger`'s sums."""

    def __init__(self, ledgers: list[Ledger]) -> None:
        sums: list[Array] = list(vectors([ledger.state() for ledger in ledgers]))
        (
            self.bound, self.work, self.credited, self.sent, self.margin, self.margin_min, self.slack, self.slack_min,
            self._carry, self._sent_carry, self._credited_carry,
        ) = sums  # fmt: skip

    def write_back(self, i: int, ledger: Ledger) -> None:
        """Give scenario i's sums back."""
        sums = (
            self.bound, self.work, self.credited, self.sent, self.margin, self.margin_min, self.slack, self.slack_min,
            self._carry, self._sent_carry, self._credited_carry,
        )  # fmt: skip
        ledger.restore(LedgerState(*(float(values[i]) for values in sums)))

    def put_in_all(self, work: Array, stored: Array, reservoir: Array) -> None:
        """`put_in` and `observe` for every scenario."""
        term = work - self._carry
        total = self.work + term
        np.subtract(total, self.work, out=self._carry)
        self._carry -= term
        self.work = total
        margin = total + self.bound
        margin += self.credited
        margin -= self.sent
        self.margin = margin
        slack = margin - stored
        slack -= reservoir
        self.slack = slack
        np.minimum(self.margin_min, margin, out=self.margin_min)
        np.minimum(self.slack_min, slack, out=self.slack_min)

    def put_in(self, at: Index, work: Array) -> None:
        before = self.work[at]
        term = work - self._carry[at]
        total = before + term
        self._carry[at] = (total - before) - term
        self.work[at] = total

    def observe(self, at: Index, stored: Array, reservoir: Array) -> None:
        margin = self.work[at] + self.bound[at]
        margin += self.credited[at]
        margin -= self.sent[at]
        slack = margin - stored
        slack -= reservoir
        self.margin[at] = margin
        self.slack[at] = slack
        self.margin_min[at] = np.minimum(self.margin_min[at], margin)
        self.slack_min[at] = np.minimum(self.slack_min[at], slack)

    def credit(self, at: Index, energy: Array) -> None:
        _add(self.credited, self._credited_carry, at, energy)

    def send(self, at: Index, energy: Array) -> None:
        _add(self.sent, self._sent_carry, at, energy)


class Couplings:
    """The couplings of one side, all with the same parameters; vectors are (n, N), other arrays (N,).

    `account` is the reservoir's energy less its deficit; at least one of the two is always zero.
    """

    def __init__(self, couplings: list[SetPositionCoupling]) -> None:
        first = couplings[0]
        self.springs = Springs(first.spring)
        self.ledgers = Ledgers([coupling.ledger for coupling in couplings])
        self._longest = first.longest_step
        modulator = first.modulator
        self._pspm = modulator if isinstance(modulator, SetPositionModulator) else None
        self.set_position = vectors([c.modulator.set_position for c in couplings])
        arrived = [c.arrived for c in couplings]
        self.received = vectors([each.set_position for each in arrived])
        self.account = np.array([c.account for c in couplings])
        self._least = np.array([-c.deficit_max if c.deficit_max else c.energy_min for c in couplings])
        self.discarded = np.array([c.discarded for c in couplings])
        self.credit = np.array([each.credit for each in arrived])
        self.has_sample = np.array([each.has_sample for each in arrived])

    def write_back(self, i: int, coupling: SetPositionCoupling) -> None:
        """Write scenario i's state back, except the target, which only recordings use."""
        modulator = coupling.modulator
        assert isinstance(modulator, SetPositionModulator | ZeroOrderHold)
        modulator.set_position = tuple(self.set_position[:, i].tolist())
        account, least = float(self.account[i]), float(self._least[i])
        if self._pspm is not None:
            modulator.energy, modulator.deficit = max(account, 0.0), max(-account, 0.0)
            coupling.energy_min, coupling.deficit_max = max(least, 0.0), max(-least, 0.0)
        coupling.account = account
        coupling.discarded = float(self.discarded[i])
        received = tuple(self.received[:, i].tolist())
        coupling.restore(Arrived(received, float(self.credit[i]), bool(self.has_sample[i])))
        self.ledgers.write_back(i, coupling.ledger)

    def take(self, at: Index, energy_nJ: NDArray[np.int64]) -> None:
        """Shuffled energy was credited [nJ]; a zero does not count as a new sample."""
        some = energy_nJ.nonzero()[0]
        if some.size:
            which = at[some]
            self.credit[which] += energy_nJ[some] * 1e-9
            self.has_sample[which] = True

    def potential(self, at: Index, x: Array) -> Array:
        """phi [J] at positions x (n, M)."""
        return self.springs.potential(x - pick(self.set_position, at))

    def update(self, at: Index, x: Array, dissipated: Array) -> Array:
        """`SetPositionCoupling.update` in the scenarios `at`. Returns the energy to send [J], shape (M,)."""
        credit = self.credit[at]
        self.credit[at] = 0.0
        self.has_sample[at] = False
        self.ledgers.credit(at, credit)  # zeros too: they may add the carry
        y, before = pick(self.received, at), pick(self.set_position, at)
        if self._longest != math.inf:
            y = _step_towards(before, y, self._longest)
        if self._pspm is None:
            place(self.set_position, at, y)
            return np.zeros(len(at))
        return self._modulate(self._pspm, at, before, y, x, dissipated, credit)

    def _modulate(
        self, pspm: SetPositionModulator, at: Index, ybar: Array, y: Array, x: Array, dissipated: Array, credit: Array
    ) -> Array:
        """`SetPositionModulator.modulate`."""
        springs = self.springs
        at_hand = self.account[at] + credit
        at_hand += dissipated
        at_hand += springs.potential(x - ybar)
        after = springs.potential(x - y)
        spendable = at_hand - pspm.reserve
        short = (after > spendable).nonzero()[0]
        if short.size:
            y = y.copy()
            y[:, short], after[short] = self._within(x[:, short], y[:, short], spendable[short])
        place(self.set_position, at, y)
        left = at_hand - after
        sent = np.zeros(len(at))
        full = (left > pspm.ceiling).nonzero()[0]
        if full.size:
            surplus = left[full] - pspm.ceiling
            given = np.maximum(0.0, surplus - credit[full]) if pspm.harvested_only else surplus
            self.discarded[at[full]] += surplus - given
            sent[full] = given
            left[full] = pspm.ceiling
            some = given.nonzero()[0]
            if some.size:
                self.ledgers.send(at[full[some]], given[some])
        self.account[at] = left
        self._least[at] = np.minimum(self._least[at], left)
        return sent

    def _within(self, x: Array, y: Array, spendable: Array) -> tuple[Array, Array]:
        """(ybar, phi) where the energy that may be spent is not enough for y."""
        springs = self.springs
        if springs.isotropic:
            offset = springs.nearest(x - y, spendable)
        else:  # one secular equation per scenario
            pairs = zip((x - y).T.tolist(), spendable.tolist(), strict=True)
            offset = np.array([springs.scalar.nearest(tuple(e), energy) for e, energy in pairs]).T
        ybar = x - offset
        after = springs.potential(x - ybar)
        excess: float = 2.0**-50
        while (out := ((after > spendable) & (spendable >= 0.0)).nonzero()[0]).size:
            offset[:, out] = (1.0 - excess) * offset[:, out]
            ybar[:, out] = x[:, out] - offset[:, out]
            after[out] = springs.potential(x[:, out] - ybar[:, out])
            excess *= 2.0
        return ybar, after


def _step_towards(start: Array, goal: Array, longest: float) -> Array:
    way = goal - start
    distance = np.abs(way[0]) if len(way) == 1 else np.sqrt((way * way).sum(axis=0))
    far = (distance > longest).nonzero()[0]
    if far.size:
        goal = goal.copy()
        goal[:, far] = start[:, far] + longest / distance[far] * way[:, far]
    return goal


def _add(total: Array, carry: Array, at: Index, term: Array) -> None:
    before = total[at]
    term = term - carry[at]
    after = before + term
    carry[at] = (after - before) - term
    total[at] = after
