"""The environment's own account: did the surroundings of the proxy give out more energy than they had?

With f the force that was really applied, U = `stored_J` and S = `supplied_J` of the surroundings

    slack = -sum f . vhat T + S - (U - U(0))

is what they have dissipated. Below 0: the environment is active, it gave out energy that nobody had put in. Theorem 1
holds in either case (hapnet/plant/integrator.py, (13)); this tells who gave the energy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from hapnet.plant.worlds.protocol import Observed, Surroundings


class AccountState(NamedTuple):
    """`EnvironmentAccount`'s figures [J]."""

    start_J: float
    """U(0)."""
    supplied_at_start_J: float
    stored_J: float
    supplied_J: float
    slack_min: float


class EnvironmentAccount:
    """The account of `surroundings` from now on, with the proxy at `position` (n,) [m]."""

    def __init__(self, surroundings: Surroundings, position: Sequence[float]) -> None:
        self._surroundings = surroundings
        self.stored_J: float = surroundings.stored_J(position)
        self._start_J = self.stored_J
        self._supplied_at_start_J = surroundings.supplied_J
        self.supplied_J: float = 0.0
        """S: work put in by obstacles that are moved from outside."""
        self.slack_min: float = math.inf
        """The least slack so far, infinite before the first step."""

    @property
    def observed(self) -> Observed | None:
        """What an observer saw and made the surroundings pay; None: they promise to be passive, nothing observes."""
        return getattr(self._surroundings, "observed", None)

    def observe(self, work: float, position: Sequence[float]) -> None:
        """A step has ended at `position` (n,) [m]; `work` is the sum of f . vhat T since the start [J]."""
        surroundings = self._surroundings
        self.stored_J = stored = surroundings.stored_J(position)
        self.supplied_J = supplied = surroundings.supplied_J - self._supplied_at_start_J
        slack = supplied - work - (stored - self._start_J)
        if not slack >= self.slack_min and not math.isnan(self.slack_min):  # NaN stays: then the account is not known
            self.slack_min = slack

    def state(self) -> AccountState:
        """What `restore` takes."""
        return AccountState(
            self._start_J, self._supplied_at_start_J, self.stored_J, self.supplied_J, self.slack_min
        )  # fmt: skip

    def restore(self, state: AccountState) -> None:
        """Go on from there."""
        self._start_J, self._supplied_at_start_J, self.stored_J, self.supplied_J, self.slack_min = state
