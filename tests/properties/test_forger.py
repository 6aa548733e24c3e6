"""Whoever speaks in a side's name never makes a run look passive, and with a word he changes nothing."""

import bisect
import random
from collections.abc import Callable

import pytest

from hapnet.params import Params
from hapnet.summary.verdict import contradicted
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.support.forger import STYLES, Attacked, Lie

LINKS = ("lan", "wifi", "4g", "leo", "wan-intercontinental", "delay 20ms 5ms loss 20%")
WORD = "correct horse"
SCENES = ("wall", "box", "moving")


def params(rng: random.Random) -> Params:
    return Params().set(
        {
            "duration_s": 4.0,
            "scene": rng.choice(SCENES),
            "operator": f"hand-{rng.randint(41, 99)}",
            "link.up": rng.choice(LINKS),
            "link.down": rng.choice(LINKS),
            "device.shuffle": rng.choice(("needed", "harvested", "all")),
            "device.on_silence": (silence := rng.choice(("hold", "release"))),
            "world.on_silence": silence,
            "device.watchdog_s": rng.choice((0.0, 0.02)),
            "device.step_limit_N": 0.5,
            "world.step_limit_N": 0.5,
        }
    )


def lie(rng: random.Random) -> Lie:
    """Early by 0.25 to 1 s, or by 40 mJ to 5 J that the other side may harvest later or never."""
    from_s = rng.uniform(0.5, 1.5)
    more_nJ = rng.choice((0, round(4e7 * 125 ** rng.random())))
    return Lie(from_s, from_s + rng.uniform(0.3, 2.0), rng.uniform(0.25, 1.0), more_nJ, rng.choice(STYLES))


def seeds_up_to(many: int) -> pytest.MarkDecorator:
    """One, two more among the slow tests, and all of them by hand."""
    slow, soak = pytest.mark.slow, pytest.mark.soak
    sets = [range(1), pytest.param(range(1, 3), marks=slow), pytest.param(range(many), marks=soak)]
    return pytest.mark.parametrize("seeds", sets, ids=["one", "two", "all"])


def foresight(honest: Attacked) -> Callable[[int], int]:
    times = [time_ns for time_ns, _ in honest.totals]
    return lambda now_ns: honest.totals[min(bisect.bisect(times, now_ns), len(times) - 1)][1]


@seeds_up_to(100)
@pytest.mark.parametrize("towards", mostly_slow(["world", "device"], 1))
def test_no_attacked_run_is_passive_and_with_a_word_all_are_as_without_attack(seeds: range, towards: Role) -> None:
    early = 0
    for seed in seeds:
        rng = random.Random(seed)
        of, reported = params(rng), lie(rng)
        honest = Attacked(of, seed, towards=towards, secrets=True, word=WORD)
        plain = honest.run().summary
        attacked = Attacked(of, seed, reported, foresight(honest), towards=towards)
        verdict = attacked.run().summary["verdict"]
        if attacked.early_nJ > 0:  # else he sent nothing false
            early += 1
            assert verdict["passive"] is not True, (seed, reported, verdict)
        sealed = Attacked(of, seed, reported, foresight(honest), towards=towards, secrets=True)
        doubted = sealed.run().summary
        assert sealed.early_nJ == 0  # dropped; but who shares the key may be a stranger, and this the true one
        assert doubted["verdict"]["passive"] is None
        assert contradicted(doubted)
        guarded = Attacked(of, seed, reported, foresight(honest), towards=towards, secrets=True, word=WORD)
        kept = guarded.run().summary
        assert guarded.early_nJ == 0
        assert guarded.deceived.dropped["forged"] > 0
        # his frames are dropped, and that is all: not a bit of the run is another
        for key in ("theorem", "motion", "energy", "verdict"):
            assert kept[key] == plain[key], (seed, key)  # type: ignore[literal-required]
    assert early >= 0.5 * len(seeds)  # a run that shuffles little has nothing to report early


@seeds_up_to(300)
@pytest.mark.parametrize("secrets", [False, True])
def test_no_ordinary_run_is_doubted(seeds: range, secrets: bool) -> None:
    for seed in seeds:
        run = Attacked(params(random.Random(seed)), seed, secrets=secrets)
        summary = run.run().summary
        assert summary["verdict"]["passive"] is True, (seed, summary["verdict"])
        assert run.early_nJ <= 0
        for endpoint in (run.device_endpoint, run.world_endpoint):
            assert not endpoint.session.sums.contradictions
            assert "forged" not in endpoint.session.dropped
