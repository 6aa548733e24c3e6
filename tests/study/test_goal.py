"""Objectives and constraints: what a spec may say, and what values are worth."""

import math

import pytest
from hypothesis import given, strategies as st

from hapnet.errors import InvalidParameter
from hapnet.ext.study.case import Measures
from hapnet.ext.study.goal import Constraint, goal_of

PASSIVE: Measures = {"margin_J": 0.1, "claim_kept": 1.0}


@pytest.mark.parametrize(
    ("better", "worst"), [("lower", 140.0), ("higher", -60.0), ("nearer 100", 40.0), ("nearer 0", 140.0)]
)
def test_the_upper_quantile_is_the_worst_case(better: str, worst: float) -> None:
    goal = goal_of({"stiffness_percent": {"quantile": 1.0, "better": better}}, [])
    assert goal.terms[0].value([{"stiffness_percent": x} for x in (60.0, 100.0, 140.0)], ()) == worst


def test_a_metric_goes_the_way_of_its_definition_and_terms_add_up() -> None:
    goal = goal_of({"stiffness_percent": 0.5, "free_rms_mm": 2.0, "margin_J": 10.0}, [])
    assert goal.judge([{"stiffness_percent": 90.0, "free_rms_mm": 3.0, "margin_J": 0.1}], ()).objective == 10.0


def test_a_case_without_a_value_is_the_worst_where_another_trial_has_one() -> None:
    goal = goal_of("swing_N", ["swing_N <= 30"])
    cases: list[Measures] = [{"swing_N": 20.0}, {"swing_N": None}, {"swing_N": None}]
    alone = goal.judge(cases, {("swing_N", 0)})
    assert (alone.objective, alone.held[0].kept, alone.held[0].cases, alone.allowed) == (20.0, 1, 1, True)
    other = goal.judge(cases, {("swing_N", 0), ("swing_N", 1)})
    assert (other.objective, other.held[0].kept, other.held[0].cases, other.allowed) == (math.inf, 1, 2, False)


def test_a_miss_is_the_worst_value() -> None:
    goal = goal_of({"first_contact_ms": {"quantile": 0.75, "better": "higher"}}, ["first_contact_ms > 10 in 75 %"])
    felt: Measures = {"first_contact_ms": 20.0, "first_contact_missed": 0.0}
    missed: Measures = {"first_contact_ms": None, "first_contact_missed": 1.0}
    assert goal.judge([felt, felt, felt, felt, missed], ()).objective == -20.0
    reported = goal.judge([felt, felt, missed, missed], ())
    assert (reported.objective, reported.held[0].kept, reported.held[0].cases, reported.allowed) == (
        math.inf,
        2,
        4,
        False,
    )


def test_a_share_is_of_the_cases_that_are_about_the_metric() -> None:
    """Of eight hands four never rest in the wall: one of the other four may be too soft, not two."""
    free: list[Measures] = [{"stiffness_percent": None}] * 4
    (constraint,) = goal_of("free_rms_mm", ["stiffness_percent >= 90 in 75 %"]).constraints
    for soft in (0, 1, 2):
        contact: list[Measures] = [{"stiffness_percent": 50.0 if i < soft else 99.0} for i in range(4)]
        assert constraint.judge(free + contact, ()).met == (soft < 2)


@pytest.mark.parametrize(
    ("words", "value", "kept"),
    [
        ("buzz_N2 <= 2", 2.0, True),
        ("buzz_N2 < 2", 2.0, False),
        ("buzz_N2>=2", 2.0, True),
        ("buzz_N2 > 2", 2.0, False),
        ("buzz_N2 > -1e-3", 0.0, True),
    ],
)
def test_relations(words: str, value: float, kept: bool) -> None:
    held = goal_of("free_rms_mm", [words]).judge([{"buzz_N2": value, "free_rms_mm": 1.0}], ()).held[0]
    assert (held.met, held.excess > 0.0) == (kept, not kept)


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(1, 100))
def test_a_share_is_the_least_number_of_cases(kept: list[bool], percent: int) -> None:
    constraint = Constraint("buzz_N2", "<=", 1.0, percent / 100)
    held = constraint.judge([{"buzz_N2": 0.5 if good else 3.0} for good in kept], ())
    assert held.met == (100 * sum(kept) >= percent * len(kept))
    assert (held.excess == 0.0) == held.met


@pytest.mark.parametrize(
    "measures", [{"margin_J": -1e-3, "claim_kept": 1.0}, {"margin_J": 0.1, "claim_kept": 0.0}], ids=str
)
def test_passive_means_margin_and_claim(measures: Measures) -> None:
    passive = Constraint("passive")
    assert passive.judge([PASSIVE], ()).met
    assert not passive.judge([PASSIVE, measures], ()).met
    assert passive.judge([PASSIVE, measures], ()).excess >= 1.0


def test_a_failed_case_is_never_allowed() -> None:
    reported = goal_of("free_rms_mm", []).judge([{"free_rms_mm": 1.0}, {}], (), failed=1)
    assert (reported.objective, reported.allowed) == (math.inf, False)


@pytest.mark.parametrize(
    ("objective", "constraints", "said"),
    [
        ("free_rms", [], "'free_rms'; did you mean free_rms_mm"),
        ({}, [], "a metric, or a table"),
        (None, [], "a metric, or a table"),
        ({"free_rms_mm": 0}, [], "weight of free_rms_mm is 0; allowed: a number above 0; `better` is lower or higher"),
        ({"free_rms_mm": {"weigth": 1}}, [], "'weigth'; did you mean weight"),
        ({"free_rms_mm": {"quantile": 90}}, [], "quantile of free_rms_mm is 90; allowed: 0 to 1"),
        ({"free_rms_mm": {"better": "less"}}, [], "one of higher, lower, nearer 0, nearer 100"),
        ("free_rms_mm", "passive", "a list of 'passive'"),
        ("free_rms_mm", ["pasive"], "'pasive'"),
        ("free_rms_mm", ["passive > 3"], "'passive > 3'; allowed: 'passive', or a metric"),
        ("free_rms_mm", ["buzz_N2"], "'buzz_N2'; allowed: 'passive', or a metric"),
        ("free_rms_mm", ["buzz_N2 = 3"], "'buzz_N2 = 3'"),
        ("free_rms_mm", ["buzz_N2 <= three"], "three"),
        ("free_rms_mm", ["buzz_N2 <= nan"], "nan"),
        ("free_rms_mm", ["buzz_N2 <= 3 in 0 %"], "in 0 %"),
        ("free_rms_mm", ["buz_N2 <= 3"], "'buz_N2'; did you mean buzz_N2"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(objective: object, constraints: object, said: str) -> None:
    with pytest.raises(InvalidParameter, match=said) as refused:
        goal_of(objective, constraints)
    assert "\n" not in str(refused.value)


def test_a_goal_can_be_read_again() -> None:
    words = ["passive", "passive in 90 %", "buzz_N2 <= 0.002 in 75 %", "margin_J > 0"]
    assert [str(one) for one in goal_of("free_rms_mm", words).constraints] == words
