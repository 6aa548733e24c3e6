"""The environment's own account: it shows whether the surroundings of the proxy gave out more energy than they had.

With f the force that was really applied, U = `stored_J` and S = `supplied_J` of the surroundings

    slack = -sum f . vhat T + S - (U - U(0))

is the energy that they have dissipated. Below 0 the environment is active: it gave out energy that was never put in.
Theorem 1 holds in either case (hapnet/plant/integrator.py, (13)); this account shows where the energy came from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.mechanics.contacts import Observed, Surroundings
from hapnet.records.record import Record, equation


class EnvironmentAccount(Record):
    """The account of `surroundings` from now on, with the proxy at `position` (n,) [m].

    start_J : U(0). supplied_at_start_J : the energy supplied before. supplied_J : S, the work put in since then by
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
        """The account of the surroundings' observer; None: they are passive by construction and have no observer."""
        return self._surroundings.observed

    def observe(self, work: float, position: Sequence[float]) -> None:
        """Account for a step that ended at `position` (n,) [m]; `work` is the sum of f . vhat T since the start [J]."""
        settle(self, work, self._surroundings.stored_J(position), self._surroundings.supplied_J)


@equation
def settle(account: EnvironmentAccount, work: float, stored: float, supplied: float) -> None:
    """As `EnvironmentAccount.observe`, with the surroundings' stored and supplied energy [J]."""
    account.stored_J = stored
    account.supplied_J = supplied - account.supplied_at_start_J
    slack = account.supplied_J - work - (stored - account.start_J)
    if not slack >= account.slack_min and not math.isnan(account.slack_min):  # NaN stays: the account is not known
        account.slack_min = slack
