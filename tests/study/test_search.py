"""The search of a tuning, on objectives that are formulas: nothing is simulated."""

import math
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from hapnet.errors import InvalidParameter
from hapnet.ext.study.case import Measures
from hapnet.ext.study.journal import Journal, JournalRow
from hapnet.ext.study.search import Search, base, most_cases
from hapnet.ext.study.search_space import propose
from hapnet.ext.study.spec import Case, Values
from hapnet.ext.study.task import CaseResult
from hapnet.ext.study.tune_spec import TuneSpec
from hapnet.params import Params
from tests.conftest import mostly_slow
from tests.study.sweeps import spec_file

SPEC = """
[tune]
objective = "free_rms_mm"
constraints = ["passive", "buzz_N2 <= 0"]
trials = {trials}
generation = {generation}
seed = {seed}
[search]
contact_model.lead = {{ from = 0.0, to = 1.0 }}
contact_model.window_s = {{ from = 0.001, to = 1.0, scale = "log" }}
device.substeps = {{ from = 1, to = 9 }}
wave.missing = ["zero", "hold"]
[vary]
link = ["lan", "4g"]
[score]
link = ["wifi"]
seed = [7]
"""
Formula = Callable[[Case], Measures]


def read(directory: Path, text: str = SPEC, *, trials: int = 24, generation: int = 4, seed: int = 1) -> TuneSpec:
    return TuneSpec.read(spec_file(directory, text.format(trials=trials, generation=generation, seed=seed)))


def opened(directory: Path, spec: TuneSpec) -> Journal:
    tuned, scored = base(spec)
    return Journal.create_or_resume(directory, spec.whole(spec.defaults), [*tuned, *scored])


def searched(directory: Path, spec: TuneSpec, formula: Formula, *, backwards: bool = False) -> Search:
    """The search, with the cases of each generation in one order or the other."""
    journal = opened(directory, spec)
    search = Search(spec, journal)
    for _ in search.rounds():
        order = -1 if backwards else 1
        journal.record([CaseResult(case.number, formula(case)) for case in journal.pending()[::order]])
    journal.close()
    return search


def bowl(case: Case) -> Measures:
    """Least at lead 0.3, window 10^-1.5, 4 substeps and "hold"; the constraint wants a lead of at least 0.5."""
    x, w, n = (case.values[name] for name in ("contact_model.lead", "contact_model.window_s", "device.substeps"))
    cost = (x - 0.3) ** 2 + (math.log10(w) + 1.5) ** 2 + (n - 4) ** 2 / 10 + (case.values["wave.missing"] == "zero")
    return {"free_rms_mm": cost, "buzz_N2": 0.5 - x, "margin_J": 0.1, "claim_kept": 1.0}


@pytest.mark.slow
def test_it_finds_the_least_that_is_allowed(tmp_path: Path) -> None:
    """The least cost that is allowed is 0.2^2, at the edge of the constraint."""
    search = searched(tmp_path, read(tmp_path, trials=96, generation=8), bowl)
    assert search.best is not None
    found = search.trials[search.best]
    assert found.values["contact_model.lead"] >= 0.5
    assert found.measures[0]["free_rms_mm"] == pytest.approx(0.04, abs=0.05)
    assert (found.values["device.substeps"], found.values["wave.missing"]) == (4, "hold")
    scores = search.scores
    assert [(row.case.values["link"], row.case.seed) for row in scores[1].found.rows] == [("wifi", 7)]
    assert scores[1].found.values == found.values


def test_it_is_better_than_chance(tmp_path: Path) -> None:
    spec = read(tmp_path, trials=64, generation=8)
    late = searched(tmp_path, spec, bowl).trials[32:]
    random = propose(spec.space, [], 32, (5,), 100)
    assert sum(trial.values["contact_model.lead"] >= 0.5 for trial in late) >= 22  # by chance 16 keep the constraint
    some = [trial.values for trial in late], random
    costs = [sorted(bowl(Case(0, values, 0, ""))["free_rms_mm"] or 0.0 for values in one) for one in some]
    assert costs[0][16] < 0.5 * costs[1][16]


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_what_breaks_a_constraint_is_never_chosen(
    tmp_path_factory: pytest.TempPathFactory, seed: int, share: float
) -> None:
    """The choice is the best of those that break none, by measures without any order."""
    directory = tmp_path_factory.mktemp("search")
    spec = read(directory, trials=12, seed=seed)

    def rough(case: Case) -> Measures:
        x = zlib.crc32(f"{case.values}{seed}".encode()) % 1000 / 1000
        passive = 0.1 if x > 0.3 * share else -0.1
        return {"free_rms_mm": 1000 * x % 1, "buzz_N2": share - x, "margin_J": passive, "claim_kept": 1.0}

    search = searched(directory, spec, rough)
    allowed = {}
    for i, trial in enumerate(search.trials):
        reported = [{name: value or 0.0 for name, value in row.measures.items()} for row in trial.rows]
        if all(one["margin_J"] > 0.0 and one["buzz_N2"] <= 0.0 for one in reported):
            allowed[i] = sum(one["free_rms_mm"] for one in reported) / 2  # the median of two
    assert search.best == (min(allowed, key=lambda i: (allowed[i], i)) if allowed else None)
    scores = search.scores
    assert (scores[1].found is None) == (not allowed)


class Killed(Exception):
    """The process ends here."""


@pytest.mark.parametrize("after", mostly_slow([0, 5, 22, 49], 1))
def test_a_search_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path, after: int) -> None:
    """It ends the same, and runs no case twice."""
    spec = read(tmp_path)
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    whole = searched(tmp_path / "whole", spec, bowl)
    ran: list[str] = []

    def until(limit: float) -> Search:
        journal = opened(tmp_path / "cut", spec)
        search = Search(spec, journal)
        try:
            for _ in search.rounds():
                for case in journal.pending():
                    if len(ran) >= limit:
                        raise Killed
                    journal.record([CaseResult(case.number, bowl(case))])
                    ran.append(case.key)
        finally:
            journal.close()
        return search

    with pytest.raises(Killed):
        until(after)
    again = until(math.inf)
    assert again.trials == whole.trials
    assert again.scores == whole.scores
    assert len(ran) == len(set(ran)) == len({row.case.key for row in rows(tmp_path / "whole")})


def rows(directory: Path) -> list[JournalRow]:
    journal = Journal.look(directory)
    try:
        return list(journal.rows())
    finally:
        journal.close()


def test_the_order_of_results_does_not_matter_but_the_seed_does(tmp_path: Path) -> None:
    found: list[list[Values]] = []
    for name, seed, backwards in (("a", 1, False), ("b", 1, True), ("c", 2, False)):
        (tmp_path / name).mkdir()
        search = searched(tmp_path / name, read(tmp_path, seed=seed), bowl, backwards=backwards)
        found.append([trial.values for trial in search.trials])
    assert found[0] == found[1]
    assert (
        found[0][0]
        == found[2][0]
        == {
            "contact_model.lead": Params().contact_model.lead,
            "contact_model.window_s": Params().contact_model.window_s,
            "device.substeps": 4,
            "wave.missing": "zero",
        }
    )
    assert not [values for values in found[0][1:] if values in found[2][1:]]


def test_more_trials_go_on_from_the_same_journal(tmp_path: Path) -> None:
    few = searched(tmp_path, read(tmp_path, trials=8), bowl)
    before = len(rows(tmp_path))
    more = searched(tmp_path, read(tmp_path, trials=16), bowl)
    assert more.trials[:8] == few.trials
    assert before < len(rows(tmp_path)) <= before + 8 * 2 + 1


def test_defaults_outside_of_the_ranges_are_no_trial(tmp_path: Path) -> None:
    """0 stands for a rule: it is what the found values are compared with."""
    text = SPEC.replace("wave.missing", "wave.impedance = {{ from = 1.0, to = 9.0 }}\nwave.missing")
    spec = read(tmp_path, text, trials=4)
    search = searched(tmp_path, spec, bowl)
    assert search.defaults[0].values["wave.impedance"] == 0.0
    assert all(1.0 <= trial.values["wave.impedance"] <= 9.0 for trial in search.trials)
    assert len(rows(tmp_path)) <= most_cases(search.spec) == (1 + 4) * 2 + 2


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_tried_is_in_its_range_and_short(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    spec = read(tmp_path_factory.mktemp("spec"))
    for values in propose(spec.space, [], 8, (seed,), 4):
        assert all(values[one.name] in one for one in spec.space)
        assert isinstance(values["device.substeps"], int)
        assert float(f"{values['contact_model.lead']:.4g}") == values["contact_model.lead"]


def tuned_and_scored(directory: Path, tuned: str, scored: str) -> TuneSpec:
    head = SPEC.partition("[vary]")[0].format(trials=1, generation=1, seed=0)
    return TuneSpec.read(spec_file(directory, f"{head}[vary]\n{tuned}\n[score]\n{scored}\n"))


SLOW = "delay 40ms 10ms"
SAME = "a link, hand or seed that is not tuned on"


@pytest.mark.parametrize(
    ("tuned", "scored"),
    [
        ('link = ["lan", "4g"]', 'link = ["wifi", "4g"]\nseed = [7, 0]'),
        (f'link = ["{SLOW}"]\nseed = "3:8"', f'link = [{{up = "delay 0.04s 10000us", down = "{SLOW}"}}]\nseed = [7]'),
        ('link = ["lan"]\nworld.wall.stiffness = [1000]', 'link = ["lan"]\nworld.wall.stiffness = [3000]'),
        ('link = ["lan"]\noperator_model.mass = [0.1, 0.5]', 'link = ["lan"]\noperator_model.mass = [0.2, 0.1]'),
        ('seed = [0]', 'seed = [0]'),
    ],
)  # fmt: skip
def test_a_case_to_score_on_must_not_be_tuned_on(tmp_path: Path, tuned: str, scored: str) -> None:
    """Its link, its hand or its seed must be another one: another world, or the same link in other words, is none."""
    with pytest.raises(InvalidParameter, match=SAME):
        tuned_and_scored(tmp_path, tuned, scored)


@pytest.mark.parametrize(
    ("tuned", "scored"),
    [
        ('link = ["lan"]', 'link = ["4g"]'),
        ('link = ["lan"]', 'link = ["lan"]\nseed = [1]'),
        ("operator_model.mass = [0.1]", "operator_model.mass = [0.2]"),
        ('operator = ["sine"]', 'operator = ["press"]'),
        ('link.up = ["lan"]\nlink.down = ["4g"]', 'link.up = ["4g"]\nlink.down = ["lan"]'),
    ],
)
def test_another_link_hand_or_seed_is_enough(tmp_path: Path, tuned: str, scored: str) -> None:
    tuned_and_scored(tmp_path, tuned, scored)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[tune]", "[tuen]", "'tuen'; did you mean tune"),
        ("[score]", "[vary2]", "'vary2'"),
        ("trials =", "trails =", "'trails'; did you mean trials"),
        ("trials = {trials}", "trials = 0", "trials is 0; allowed: a whole number, 1 to"),
        ("trials = {trials}", "trials = true", "trials is True"),
        ("seed = {seed}", "seed = -1", "seed is -1"),
        ("contact_model.lead", "contact_model.leed", "'contact_model.leed'; did you mean contact_model.lead"),
        ("contact_model.lead", "link.path_s", "'link.path_s'.*but not the link"),
        ("contact_model.lead", "seed", "'seed'"),
        ("to = 1.0 }}", "to = 2.0 }}", "contact_model.lead is 2.0; allowed: 0 to 1"),
        ("from = 0.0", "from = 1.0", "A below B"),
        ("from = 0.0", "from = 0.0, steps = 3", "'steps'; allowed: from, to and scale"),
        ("from = 0.001", "from = 0", "above 0 on a log scale"),
        ('"log"', '"ln"', "linear, or log"),
        ("to = 9 }}", "to = 9.5 }}", "a whole number"),
        ('["zero", "hold"]', '["zero"]', "several different values"),
        ('["zero", "hold"]', '["zero", "zeros"]', "'zeros'; did you mean zero"),
        ('["zero", "hold"]', "{{ from = 0, to = 1 }}", "these values have no range"),
        ('["zero", "hold"]', '"zero"', "or a list of values"),
        ("[vary]", "[fixed]\ndevice.substeps = 4\n[vary]", "either under .search. or under another table"),
        ("[score]", "[score]\nwave.missing = ['hold']", "either under .search. or under another table"),
        ('link = ["wifi"]', "", "all that varies under .vary.: link too"),
        ('[score]\nlink = ["wifi"]\nseed = [7]', "", "a table .score."),
        ("[vary]", "[fixed]\nlink = 'lan'\n[vary]", "either under .fixed. or under .vary."),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InvalidParameter, match=said) as refused:
        read(tmp_path, SPEC.replace(old, new))
    assert "\n" not in str(refused.value)
