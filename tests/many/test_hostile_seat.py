"""A hostile device in one of three seats: what it can do to the block, and to those who hold it."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from hapnet.ext.many.run import GraphResult
from tests.support.hostile_hands import run

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

HOLDING = ("left-table", "right-table")


def felt(result: GraphResult, from_s: float = 2.5) -> float:
    """The largest force that those who hold the block feel after a time [N]."""
    largest = 0.0
    for name in HOLDING:
        device = result.pairs[name].recording.device
        late = device["time_ns"] - device["time_ns"][0] >= from_s * 1e9
        largest = max(largest, float(np.linalg.norm(device["force_N"][late], axis=1).max()))
    return largest


@cache
def made(kind: str, **others: Any) -> tuple[GraphResult, float]:
    """Each run once."""
    return run(kind, **others)


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


FAST = {"speed": 5.0}


@pytest.mark.slow
@pytest.mark.parametrize("way", ["", " across"])
def test_a_rammer_is_felt_no_more_than_a_hand_that_presses_as_hard(way: str) -> None:
    """Against another hand both push with all the force that a block's limit lets through. A block that comes back hits
    the hand beside the rammer too, with a third of what the one opposite feels.
    """
    (pressed, _), (rammed, speed) = made("presser" + way, **FAST), made("rammer" + way, **FAST)
    assert speed <= 1.0
    assert felt(rammed, 0.0) <= 1.1 * felt(pressed, 0.0)
    for name in HOLDING:
        before, after = (one.pairs[name].summary["world"]["modulated_share"] for one in (pressed, rammed))
        assert after <= before + 0.1
    third = rammed.pairs["third-table"].recording
    assert third.world is not None
    assert third.device is not None
    assert np.linalg.norm(third.device["velocity_mps"], axis=1).max() > 2.0
    assert third.world["credited_J"][-1] >= 0.9 * 3.0  # 1 W from 2 s on: all that is admitted
    if not way:
        for one in (pressed, rammed):
            world = one.pairs["third-table"].recording.world
            assert world is not None
            assert np.abs(world["contact_force_N"]).max() == pytest.approx(10.0, rel=1e-3)


@pytest.mark.slow
def test_a_rammer_is_no_liar_and_is_named_for_its_speed_alone() -> None:
    """His places and his energy are true, so the verdict does not name him. Above the speed that a device declares its
    account is not certain, and he is named for that.
    """
    honest = made("rammer", **FAST)[0]
    assert honest.summary["verdict"]["passive"] is True
    assert min(pair.summary["theorem"]["margin_J"] for pair in honest.pairs.values()) >= -1e-9
    verdict = made("rammer")[0].summary["verdict"]
    assert verdict["passive"] is None
    assert verdict["reason"].startswith("third-table: the device moved at ")
    assert "left" not in verdict["reason"]
    assert "right" not in verdict["reason"]
