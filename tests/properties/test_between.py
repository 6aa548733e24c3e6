"""Somebody who only adds frames and stands between two sides without a word: no run is passive without doubt."""

import random

import pytest

from hapnet.params import Params
from hapnet.summary.verdict import contradicted
from hapnet.wire.messages import Role
from tests.properties.test_forger import seeds_up_to
from tests.support.between import MS, Between
from tests.support.stranger import Plan

LINKS = ("", "lan", "wifi", "delay 20ms 5ms loss 5%")
SIDES: tuple[Role, Role] = ("device", "world")
NOBODY = "the peer's identity is not proven"


def params(rng: random.Random) -> Params:
    link = rng.choice(LINKS)
    return Params().set(
        {"duration_s": 2.0, "operator": rng.choice(("sine", "press")), "link.up": link, "link.down": link}
    )


def plan(rng: random.Random) -> Plan:
    """40 mJ to 5 J early; with and without a decoy, in their names or his own, edited accounts or not."""
    early_nJ = round(4e7 * 125 ** rng.random())
    decoy, own_names, edits = (rng.random() < 0.5 for _ in range(3))
    return Plan(early_nJ, rng.uniform(0.1, 1.0), decoy, own_names, edits)


@seeds_up_to(100)
def test_he_is_never_passed_over_in_silence(seeds: range) -> None:
    fooled = early = 0
    unheard: list[int] = []
    for seed in seeds:
        rng = random.Random(seed)
        run = Between(params(rng), seed, planned := plan(rng))
        run.run()
        fooled += run.fooled
        unheard += [] if run.fooled or planned.own_names else [seed]
        early += run.early_nJ > 0
        for role, seen in run.verdicts().items():
            verdict = seen["verdict"]
            assert verdict["passive"] is not True or NOBODY in verdict["reason"], (seed, planned, role, verdict)
            if run.fooled and not planned.own_names:  # he speaks in the other's name, and so does the other
                assert verdict["passive"] is not True, (seed, planned, role, verdict)
                assert contradicted(seen), (seed, planned, role)
    assert unheard == []  # else these runs would say little: in another's name he is always believed by one side
    assert fooled >= 0.8 * len(seeds)
    assert early >= 0.5 * len(seeds)


@seeds_up_to(100)
def test_with_a_word_all_is_as_without_him(seeds: range) -> None:
    for seed in seeds:
        rng = random.Random(seed)
        run = Between(params(rng), seed, plan(rng), word="correct horse")
        run.run()
        assert not run.fooled
        assert run.early_nJ <= 0
        assert max(run.paired_ns.values()) <= 1000 * MS, (seed, run.paired_ns)
        for seen in run.verdicts().values():
            assert seen["verdict"]["passive"] is True, (seed, seen["verdict"])
            assert NOBODY not in seen["verdict"]["reason"]
            assert not contradicted(seen)


@seeds_up_to(300)
@pytest.mark.parametrize("word", ["", "correct horse"])
def test_no_ordinary_run_is_doubted(seeds: range, word: str) -> None:
    for seed in seeds:
        run = Between(params(random.Random(seed)), seed, word=word)
        run.run()
        for seen in run.verdicts().values():
            assert seen["verdict"]["passive"] is True, (seed, seen["verdict"])
            assert (NOBODY in seen["verdict"]["reason"]) == (not word)
            assert not contradicted(seen)
