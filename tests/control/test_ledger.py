"""The ledger's definitions by hand, and its sums over very many terms."""

import math

import pytest

from hapnet.control.ledger import Ledger


def test_margin_and_slack_by_hand() -> None:
    ledger = Ledger(stored=0.002, reservoir=0.05)
    ledger.put_in(0.1)
    ledger.credit(0.03)
    ledger.send(0.02)
    ledger.observe(stored=0.04, reservoir=0.045)
    assert ledger.margin == pytest.approx(0.1 + 0.052 + 0.03 - 0.02)
    assert ledger.slack == pytest.approx(ledger.margin - 0.085)
    ledger.put_in(-0.12)
    ledger.observe(stored=0.0, reservoir=0.0)
    assert ledger.margin_min == pytest.approx(0.042)
    ledger.put_in(1.0)
    ledger.observe(stored=0.0, reservoir=0.0)
    assert ledger.margin_min == pytest.approx(0.042)
    assert ledger.slack_min == pytest.approx(0.042)


def test_nothing_observed_has_no_slack() -> None:
    assert Ledger(0.0, 0.05).slack_min == math.inf


def test_sums_do_not_drift() -> None:
    """300,000 terms of 0.1 nJ: a plain sum on top of 1000 J is off by 1e-9 and more, the ledger's is exact to 1e-12."""
    ledger = Ledger(0.0, 0.0)
    ledger.put_in(1000.0)
    ledger.send(1000.0)
    for _ in range(300_000):
        ledger.put_in(1e-10)
        ledger.send(1e-10)
    assert ledger.work - 1000.0 == pytest.approx(3e-5, abs=1.2e-13)
    assert ledger.sent - 1000.0 == pytest.approx(3e-5, abs=1.2e-13)
