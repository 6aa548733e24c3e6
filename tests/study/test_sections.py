"""The quick set, and the full one in its sections: what they contain, what flags change, what is said before."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from hapnet import cli
from hapnet.ext.study import backend, compare, markdown, tables, task
from hapnet.ext.study.backend import ThisProcess
from hapnet.ext.study.case import Measures, simulated
from hapnet.ext.study.commands import compare as command, studies
from hapnet.ext.study.compare import ComparedRun, Plan, Variant
from hapnet.ext.study.sections import FULL, HANDS, QUICK, TAPS
from hapnet.params import Params
from tests.study.comparisons import known, outcomes, plan

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command's cases run in this process."""
    monkeypatch.setattr(backend, "local_workers", lambda count: ThisProcess())


def asked_for(*flags: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Plan]:
    """The plans of a command with these flags."""
    found: dict[str, Plan] = {}

    def kept(words: Console, plans: dict[str, Plan], given: object) -> None:
        found.update(plans)

    monkeypatch.setattr(command, "_announce", kept)
    assert cli.main(["compare", "--dry-run", *flags]) == 0
    return found


def test_what_is_asked_for_is_run_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = ("--coupling", "pspm,zoh,pd", "--link", "lan", "--link", "4g", "--operator", "press", "--seeds", "4:5")
    plan = asked_for(*flags, monkeypatch=monkeypatch)[""]
    assert [str(one) for one in plan.cases()] == [
        f"{coupling} over {link}, press, seed 4" for coupling in ("pspm", "zoh", "pd") for link in ("lan", "4g")
    ]


def test_what_is_not_named_is_one_hand_and_seed_0(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three couplings over two links are six cases; nothing named is the quick set."""
    flags = ("--coupling", "pspm,zoh,pd", "--link", "lan", "--link", "4g")
    six = [
        f"{coupling} over {link}, press@light, seed 0" for coupling in ("pspm", "zoh", "pd") for link in ("lan", "4g")
    ]
    for more in ((), ("--seeds", "0:1")):
        assert [str(one) for one in asked_for(*flags, *more, monkeypatch=monkeypatch)[""].cases()] == six
    whole = asked_for(monkeypatch=monkeypatch)[""]
    assert (whole.operators, whole.couplings, tuple(whole.links)) == (QUICK.operators, QUICK.couplings, QUICK.links)
    assert len(whole.cases()) == (len(QUICK.couplings) + 1) * len(QUICK.links) * len(QUICK.operators)
    one = asked_for("--link", "4g", monkeypatch=monkeypatch)[""]
    assert len(one.cases()) == len(QUICK.couplings)


@pytest.mark.slow
def test_the_full_set_has_what_ten_seconds_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    plans = asked_for("--bench", "full", monkeypatch=monkeypatch)
    assert list(plans) == list(FULL)
    assert plans["minutes"].operators == HANDS == tuple(f"hand-{number}" for number in range(21, 41))
    assert plans["minutes"].params.duration_s == 300.0
    assert {one.params.device.stiffness for one in plans["stiffness"].cases()} == {100.0, 300.0, 700.0}
    assert {one.params.operator_model.start_m for one in plans["taps"].cases()} == {0.0, -0.05, -0.1, -0.15}
    for words in TAPS:  # minimum jerk is fastest in its middle: 15/8 of the mean
        hand = plans["taps"].case(Variant("pspm"), "4g", words, 0).params.operator_model
        peak = 15.0 / 8.0 * (hand.goal_m - hand.start_m) / hand.reach_s
        assert min(abs(peak / speed - 1.0) for speed in (0.2, 0.4, 0.8)) < 0.01


def test_what_is_given_counts_for_all_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = ("--bench", "minutes,solid", "--duration", "7", "--link", "lan", "--seeds", "3:5", "--coupling", "eba")
    plans = asked_for(*flags, monkeypatch=monkeypatch)
    assert list(plans) == ["minutes", "solid"]
    for one in plans.values():
        assert (one.params.duration_s, list(one.links), one.seeds, one.couplings) == (7.0, ["lan"], (3, 4), ("eba",))
    assert plans["solid"].params.scene == "sphere"


def test_sections_have_directories_of_their_own_and_one_object_for_machines(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(task, "measure", lambda params, seed: known(drag_N=params.duration_s))
    monkeypatch.setattr(command, "_write", lambda *given: [])
    flags = ("--link", "lan", "--coupling", "pspm", "--duration", "0.2", "--out", str(tmp_path))
    assert cli.main(["compare", "--bench", "taps,friction", *flags, "--json", "-"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert list(whole["sections"]) == ["taps", "friction"]
    assert len(whole["sections"]["taps"]["cases"]) == 2 * len(TAPS)  # with a local wall each
    assert whole["sections"]["friction"]["groups"][0]["metrics"]["drag_N"]["low"] == 0.2
    assert {path.name for path in tmp_path.iterdir()} == {"taps", "friction"}


def test_the_tables_as_markdown() -> None:
    """Three hands: medians, the interval that is their extremes, the worst case, and what came out at each port."""
    asked = replace(plan(seeds=1), operators=("press", "sine@light", "hand-3"))
    each = dict(zip(asked.operators, (0.011, 0.02, 0.0349), strict=True))
    worst = dict(zip(asked.operators, (101.0, 98.0, 36.0), strict=True))

    def measured(one: ComparedRun) -> Measures:
        return known(
            drag_N=each[one.operator], stiffness_percent=99.6,
            stiffness_worst_percent=worst[one.operator], energy_out_J=0.0131, hand_energy_out_J=0.0,
            world_energy_out_J=1.5,
        )  # fmt: skip

    text = markdown.page(asked, compare.groups(asked, outcomes(asked, measured)), "some hands").splitlines()
    assert text[0] == "## some hands"
    assert "- every coupling was passive in all cases" in text
    assert "3 cases a cell: 3 hands, seed 0, 0.2 s each." in text
    assert text.count("|  | near | far |") == 2
    assert "| `zoh` | 3/3 · 100 · – · – · 0.02 | 3/3 · 100 · – · – · 0.02 |" in text
    assert "| `zoh` | 13.1 · 0.0 · 1500 | 13.1 · 0.0 · 1500 |" in text
    assert "| drag [N] | `pspm` | 0.020 (0.011 to 0.035; worst 0.035) | 0.020 (0.011 to 0.035; worst 0.035) |" in text
    row = "| worst tenth's stiffness [%] | `pspm` | 98 (36 to 101; worst 36) | 98 (36 to 101; worst 36) |"
    assert row in text


def test_it_says_how_many_cases_there_are_before_it_begins(
    here: None, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """And how long they take, unless that is at once: a tenth of a second here, by the first 5 s of each of 40 s."""
    monkeypatch.setattr(task, "measure", lambda params, seed: known())
    monkeypatch.setattr(studies, "mean_seconds", lambda run, parts: (0.1, len(parts)))
    flags = ["compare", "--link", "lan", "--coupling", "pspm,zoh", "--workers", "1", "--no-files"]
    assert cli.main([*flags, "--operator", "press", "--operator", "sine", "--duration", "80"]) == 0
    first, second = capsys.readouterr().out.splitlines()[:2]
    assert first == "6 cases: 2 couplings, 1 link, 2 operators, 1 seed, and 2 of the local wall"
    assert second == "a case takes 1.6 s (mean of 6); all of them, with 1 worker: about 10 s"
    assert cli.main([*flags, "--operator", "press", "--duration", "0.2"]) == 0
    assert "about" not in capsys.readouterr().out


def test_the_headline_says_at_which_port_energy_came_out() -> None:
    """zoh was not passive with one hand and seed 0, over both links; over the near one nothing came out at the hand."""
    asked = plan(seeds=2)

    def measured(one: ComparedRun) -> Measures:
        lost = one.variant.coupling == "zoh" and one.seed == 0 and one.operator == "press"
        out = 0.0 if one.link == "near" else 0.01
        both = 0.3 if lost else 0.9  # what came out where the coupling was passive does not count
        return known(
            margin_J=-0.2 if lost else 0.1, energy_out_J=both, hand_energy_out_J=out, world_energy_out_J=both + 0.1
        )

    assert tables.headline(asked, compare.groups(asked, outcomes(asked, measured))) == [
        "zoh was not passive in 2 cases (near, far): at most 300 mJ came out of both ports together, 10.0 mJ at the "
        "hand's, 400 mJ at the world's, into its walls; nothing at the hand's in 1"
    ]
    assert tables.headline(asked, compare.groups(asked, outcomes(asked, lambda one: known()))) == [
        "every coupling was passive in all cases"
    ]


@pytest.mark.parametrize(
    "hand", [name if k % 4 == 0 else pytest.param(name, marks=pytest.mark.slow) for k, name in enumerate(HANDS)]
)
@pytest.mark.parametrize("stiffness", [100.0, 300.0, 700.0])
def test_each_hand_touches_the_wall_within_ten_seconds(hand: str, stiffness: float) -> None:
    """By a millimetre at least: nothing is measured of a contact that never comes."""
    own = {"device.servo": "sampled", "operator": hand, "device.stiffness": stiffness, "link.up": "", "link.down": ""}
    assert (simulated(Params().set(own), 0).device["position_m"][:, 0] > 0.021).any()
