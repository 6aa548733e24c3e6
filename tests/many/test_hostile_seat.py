"""A hostile device in one of three seats: what it can do to the block, and to those who hold it."""

from functools import cache

import numpy as np
import pytest

from hapnet.ext.many.run import GraphResult
from tests.support.hostile_hands import run

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

HOLDING = ("left-table", "right-table")


def felt(result: GraphResult) -> float:
    """The largest force that those who hold the block feel after 2.5 s [N]."""
    largest = 0.0
    for name in HOLDING:
        device = result.pairs[name].recording.device
        late = device["time_ns"] - device["time_ns"][0] > 2.5e9
        largest = max(largest, float(np.linalg.norm(device["force_N"][late], axis=1).max()))
    return largest


@cache
def made(kind: str) -> tuple[GraphResult, float]:
    """Each run once."""
    return run(kind)


SLOW = pytest.mark.slow


@pytest.mark.parametrize("kind", [pytest.param("liar", marks=SLOW), pytest.param("forger", marks=SLOW), "shaker"])
def test_no_hand_is_pushed_harder_and_the_block_stays_slow(kind: str) -> None:
    (honest, _), (result, speed) = made("honest"), made(kind)
    assert speed <= 1.0
    assert felt(result) <= 1.1 * felt(honest)
    for name in HOLDING:
        part = result.pairs[name].summary
        assert part["verdict"]["passive"] is True
        assert part["theorem"]["margin_J"] >= -1e-9
        before = honest.pairs[name].summary["world"]["modulated_share"]
        assert part["world"]["modulated_share"] <= before + 0.1
    assert result.summary["nodes"]["table"]["environment"]["env_slack_J"] >= -1e-12
    ledger = result.pairs["third-table"].summary["world"]["ledger"]
    assert ledger["slack_J"] >= -1e-12


@pytest.mark.parametrize("kind", [pytest.param("forger", marks=SLOW), "shaker"])
def test_who_sends_more_than_its_ledger_counts_is_named(kind: str) -> None:
    assert made("honest")[0].summary["verdict"]["passive"] is True
    verdict = made(kind)[0].summary["verdict"]
    assert verdict["passive"] is False
    assert verdict["reason"].startswith("third sent ")


@pytest.mark.slow
def test_with_the_admission_for_one_hand_the_block_is_thrown() -> None:
    """So that the first test can fail: 1 W and 0.1 J are what keep the block slow."""
    _, speed = run("forger", wire={"admission_W": 5.0, "admission_burst_J": 0.5})
    assert speed > 1.2
