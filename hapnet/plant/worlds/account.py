"""The environment's own account, which shows whether the surroundings of the proxy gave out more energy than they had.

With f the force that was really applied, U = `stored_J` and S = `supplied_J` of the surroundings

    slack = -sum f . vhat T + S - (U - U(0))

is what they have dissipated. Below 0: the environment is active, it gave out energy that nobody had put in. Theorem 1
holds in either case (hapnet/plant/integrator.py, (13)); this account shows who gave the energy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.mechanics.contacts import Observed, Surroundings
from hapnet.records.record import Record, equation


class EnvironmentAccount(Record):
    """The account of `surroundings` from now on, with the proxy at `position` (n,) [m].

    start_J : U(0). supplied_at_start_J : what had been supplied before. supplied_J : S, work put in since then by
    obstacles that are moved from outside. slack_min : the minimum of slack so far, infinite before the first step.
    """

    start_J: float
    supplied_at_start_J: float
    stored_J: float
    supplied_J: float
    slack_min: float

    def __init__(self, surroundings: Surroundings, position: Sequence[float]) -> None:
        super().__init__()
        self._surroundings = surroundings
        self.start_J = self.stored_J = surroundings.stored_J(position)
        self.supplied_at_start_J = surroundings.supplied_J
        self.slack_min = math.inf

    @property
    def observed(self) -> Observed | None:
        """The account of an observer of the surroundings; None: they promise to be passive, nothing observes."""
        return self._surroundings.observed

    def observe(self, work: float, position: Sequence[float]) -> None:
        """A step has ended at `position` (n,) [m]; `work` is the sum of f . vhat T since the start [J]."""
        settle(self, work, self._surroundings.stored_J(position), self._surroundings.supplied_J)


@equation
def settle(account: EnvironmentAccount, work: float, stored: float, supplied: float) -> None:
    """As `EnvironmentAccount.observe`, with what the surroundings store and have been supplied [J]."""
    account.stored_J = stored
    account.supplied_J = supplied - account.supplied_at_start_J
    slack = account.supplied_J - work - (stored - account.start_J)
    if not slack >= account.slack_min and not math.isnan(account.slack_min):  # NaN stays: the account is not known
        account.slack_min = slack
