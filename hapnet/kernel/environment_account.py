"""The environment's own account: `hapnet.plant.worlds.account`, of walls at rest."""

from __future__ import annotations

from hapnet.kernel import walls
from hapnet.records.equation import equation
from hapnet.records.record import Floats, Record


class EnvironmentAccount(Record):
    """`EnvironmentAccount`: nothing is supplied by walls at rest."""

    start_J: float
    stored_J: float
    slack_min: float


@equation
def observe(account: EnvironmentAccount, contacts: walls.Contacts, work: float, n: int, x: Floats) -> None:
    """`EnvironmentAccount.observe`."""
    account.stored_J = walls.stored(contacts, n, x)
    slack = 0.0 - work - (account.stored_J - account.start_J)
    if not slack >= account.slack_min:
        account.slack_min = slack
