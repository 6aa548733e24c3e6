"""Which cases a spec makes: against products written out by hand, and what it refuses."""

import itertools
import json
import math
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from hapnet.errors import InvalidParameter
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.spec import MOST, Case, Spec, flat_of, link_words, params_of, value_words

PIECES: dict[str, list[Any]] = {
    "coupling": ["pspm", "zoh"],
    "device.stiffness": [50.0, 100.0, 237.5],
    "world.wall.stiffness": [1e3, 3e4],
    "device.substeps": [1, 2, 8],
    "wire.accept_stale": [True, False],
    "seed": [0, 3, 11],
}


def spec(tmp_path: Path, text: str, **assigned: str) -> Spec:
    file = tmp_path / "study.toml"
    file.write_text(text, encoding="utf-8")
    return Spec.read(file, {name.replace("__", "."): value for name, value in assigned.items()})


def reported(case: Case) -> tuple[Any, ...]:
    return (*case.values.values(), case.seed)


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.sampled_from(sorted(PIECES)), min_size=1, max_size=4, unique=True).flatmap(
        lambda names: st.fixed_dictionaries(
            {name: st.lists(st.sampled_from(PIECES[name]), min_size=1, max_size=3, unique=True) for name in names}
        )
    )
)
def test_cases_are_the_product_in_the_order_of_the_file(
    tmp_path_factory: pytest.TempPathFactory, axes: dict[str, list[Any]]
) -> None:
    text = "[vary]\n" + "\n".join(f'"{name}" = {json.dumps(values)}' for name, values in axes.items())
    cases = spec(tmp_path_factory.mktemp("spec"), text).cases()
    order = [name for name in axes if name != "seed"]
    expected = [dict(zip(axes, choice, strict=True)) for choice in itertools.product(*axes.values())]
    assert [{**case.values, **({"seed": case.seed} if "seed" in axes else {})} for case in cases] == expected
    assert all(list(case.values) == order for case in cases)
    assert [case.number for case in cases] == list(range(len(expected)))
    assert len({case.key for case in cases}) == len(expected)
    for case in cases:
        params = params_of({}, case.values)
        assert all(params.get(name) == value for name, value in case.values.items())


def test_tables_dotted_names_and_links_are_all_understood(tmp_path: Path) -> None:
    found = spec(
        tmp_path,
        """
        [fixed]
        duration_s = 2
        [fixed.world.wall]
        stiffness = 1000
        [vary]
        link = ["4g", { up = "dsl", down = "delay 5ms" }]
        [vary.device]
        stiffness = [10, 20]
        [vary.world.wall]
        damping = [1]
        """,
    )
    cases = found.cases()
    assert found.varied == ["link", "device.stiffness", "world.wall.damping"]
    assert [case.seed for case in cases] == [0] * 4
    params = [params_of(found.fixed, case.values) for case in cases]
    assert [p.device.stiffness for p in params] == [10.0, 20.0, 10.0, 20.0]
    assert {p.world.wall.stiffness for p in params} == {1000.0}
    assert [(p.link.up, p.link.down) for p in params[::2]] == [("4g", "4g"), ("dsl", "delay 5ms")]
    assert value_words("link", cases[2].values["link"]) == "up dsl, down delay 5ms"
    assert link_words("", "") == "ideal"


@settings(max_examples=20, deadline=None)
@given(
    st.floats(1e-3, 1e3), st.floats(1.01, 1e3), st.integers(2, 40), st.booleans(), st.booleans()
)  # from, ratio, steps, down, log
def test_ranges_hold_both_ends_and_are_even(
    tmp_path_factory: pytest.TempPathFactory, first: float, ratio: float, steps: int, down: bool, log: bool
) -> None:
    ends = (first * ratio, first) if down else (first, first * ratio)
    scale = ", scale = 'log'" if log else ""
    text = f"[vary]\ndevice.stiffness = {{ from = {ends[0]!r}, to = {ends[1]!r}, steps = {steps}{scale} }}"
    values = [case.values["device.stiffness"] for case in spec(tmp_path_factory.mktemp("spec"), text).cases()]
    assert len(values) == steps
    assert (values[0], values[-1]) == ends
    measure = math.log if log else float
    gaps = [measure(b) - measure(a) for a, b in itertools.pairwise(values)]
    whole = measure(ends[1]) - measure(ends[0])
    assert gaps == pytest.approx([whole / (steps - 1)] * (steps - 1), rel=1e-6, abs=1e-9)


def test_a_range_prints_as_it_was_meant(tmp_path: Path) -> None:
    cases = spec(tmp_path, "[vary]\ndevice.damping = { from = 0.1, to = 0.7, steps = 7 }").cases()
    assert [case.values["device.damping"] for case in cases] == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]


@pytest.mark.parametrize(
    ("given_as", "expected"),
    [
        ("{ from = 1, to = 4 }", [1, 2, 3, 4]),
        ("{ from = 4, to = 1 }", [4, 3, 2, 1]),
        ("{ from = 1, to = 100, steps = 3, scale = 'log' }", [1, 10, 100]),
        ("{ from = 0, to = 9, steps = 3 }", [0, 4, 9]),
    ],
)
def test_whole_numbers_stay_whole(tmp_path: Path, given_as: str, expected: list[int]) -> None:
    cases = spec(tmp_path, f"[vary]\nseed = {given_as}").cases()
    assert [case.seed for case in cases] == expected
    if min(expected) > 0:
        values = [
            case.values["device.substeps"] for case in spec(tmp_path, f"[vary]\ndevice.substeps = {given_as}").cases()
        ]
        assert values == expected
        assert {type(value) for value in values} == {int}


def test_seeds_as_simulate_takes_them(tmp_path: Path) -> None:
    assert [case.seed for case in spec(tmp_path, "[vary]\nseed = '3:7'").cases()] == [3, 4, 5, 6]
    assert spec(tmp_path, "[fixed]\nseed = 8\n[vary]\ncoupling = ['pspm']").cases()[0].seed == 8


def test_several_products_are_run_once_where_they_meet(tmp_path: Path) -> None:
    """Also where one says in other words what the other says; but what is set to its default is not what is not set."""
    found = spec(
        tmp_path,
        """
        [[vary]]
        coupling = ["pspm"]
        device.stiffness = [50, 0]
        link = ["lan"]
        [[vary]]
        coupling = ["pspm", "zoh"]
        device.stiffness = [0]
        link = ["delay 100us 20us distribution normal rate 1gbit"]
        """,
    )
    cases = found.cases()
    assert found.count == 4
    assert [reported(case)[:2] for case in cases] == [("pspm", 50.0), ("pspm", 0.0), ("zoh", 0.0)]
    assert found.varied == ["coupling", "device.stiffness", "link"]
    found = spec(tmp_path, "[[vary]]\ncoupling = ['pspm']\ndevice.ceiling_J = [0.1]\n[[vary]]\ncoupling = ['pspm']")
    assert [case.given.get("device.ceiling_J") for case in found.cases()] == [0.1, None]
    with closing(Journal.create_or_resume(tmp_path, found, found.cases())) as journal:
        assert journal.pending() == found.cases()


def test_a_repeated_value_is_one_case(tmp_path: Path) -> None:
    assert [reported(case) for case in spec(tmp_path, "[vary]\ndevice.stiffness = [100, 100.0, 50]").cases()] == [
        (100.0, 0),
        (50.0, 0),
    ]


def test_a_case_is_known_by_what_it_is_not_by_how_it_is_written(tmp_path: Path) -> None:
    one = spec(tmp_path, "[vary]\nlink = ['lan', '4g']\nseed = [1, 2]\n[fixed]\nduration_s = 3").cases()
    two = spec(tmp_path, "[fixed]\nduration_s = 3.0\n[vary]\nseed = '1:3'\nlink = ['4g', 'lan']").cases()
    three = spec(tmp_path, "[fixed]\nduration_s = 4\n[vary]\nseed = '1:3'\nlink = ['4g', 'lan']").cases()
    assert {case.key for case in one} == {case.key for case in two}
    assert not {case.key for case in one} & {case.key for case in three}


def test_the_command_line_overrides_what_is_fixed(tmp_path: Path) -> None:
    found = spec(tmp_path, "[fixed]\nduration_s = 3\n[vary]\ndof = [1]", duration_s="5", seed="7")
    assert found.cases()[0].seed == 7
    assert params_of(found.fixed, {}).duration_s == 5.0
    with pytest.raises(InvalidParameter, match=r"--set is 'dof=2'.*does not vary"):
        spec(tmp_path, "[vary]\ndof = [1]", dof="2")


def test_cases_that_differ_in_their_seeds_only_have_the_same_parameters(tmp_path: Path) -> None:
    cases = spec(tmp_path, "[vary]\nseed = '0:50'\ncoupling = ['pspm', 'zoh']").cases()
    assert {(case.parameters, case.values["coupling"]) for case in cases} == {
        (cases[0].parameters, "pspm"),
        (cases[1].parameters, "zoh"),
    }
    assert cases[0].parameters != cases[1].parameters


@pytest.mark.parametrize(
    ("text", "wrong", "said"),
    [
        ("[vary]\ndevice.stiffness = [1, -2]", [1], "-2.0; allowed: 0 or above"),
        ("[vary]\ndevice.on_silence = ['hodl', 'hold']", [0], "did you mean hold"),
        (
            "[vary]\nworld.step_min_s = [0.01, 0.1]\nworld.step_max_s = [0.2, 0.05]\nlink = ['lan', '4g']",
            [6, 7],
            "world.step_min_s is 0.1",
        ),
        ("[fixed]\nworld.step_min_s = 0.1\n[vary]\nworld.step_max_s = [0.2, 0.05]", [1], "world.step_min_s is 0.1"),
    ],
)
def test_combinations_that_make_no_run_are_cases_all_the_same(
    tmp_path: Path, text: str, wrong: list[int], said: str
) -> None:
    found = spec(tmp_path, text)
    cases = found.cases()
    assert len(cases) == found.count
    for case in cases:
        every = flat_of(found.fixed, case.values)
        if case.number in wrong:
            with pytest.raises(InvalidParameter, match=said):
                params_of(found.fixed, case.values)
        else:
            assert params_of(found.fixed, case.values).flat() == every
        assert all(every[name] == value for name, value in case.values.items() if name != "link")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[vary]\ndevice.stifness = [1]", "'device.stifness'.* device.stiffness"),
        ("[vary]\ndevice.stiffness = []", "at least one value"),
        ("[vary]\ndevice.stiffness = 5", r"belongs under \[fixed\]"),
        ("[vary]\ndevice.stiffness = [1, 'soft']", "allowed: a number"),
        ("[vary]\ndevice.stiffness = {from = 0, to = 9, steps = 3, scale = 'log'}", "above 0 on a log scale"),
        ("[vary]\ndevice.stiffness = {from = -1, to = 9, steps = 3, scale = 'log'}", "above 0 on a log scale"),
        ("[vary]\ndevice.stiffness = {from = 1, to = 9, step = 3}", "unknown .*'step'; did you mean steps"),
        ("[vary]\ndevice.stiffness = {from = 1, to = 9}", "steps = N"),
        ("[vary]\ndevice.stiffness = {from = 1, to = 9, steps = 1}", "2 to"),
        ("[vary]\ndevice.stiffness = {from = 1, to = 9, steps = 3, scale = 'logg'}", "linear, or log"),
        ("[vary]\ndevice.stiffness = {from = 1, to = 1, steps = 3}", "two different numbers"),
        ("[vary]\ndevice.stiffness = {from = 1, steps = 3}", "two different numbers"),
        ("[vary]\ndevice.stiffness = {from = 1, to = inf, steps = 3}", "two different numbers"),
        ("[vary]\ncoupling = {from = 1, to = 3}", "these values have no range"),
        ("[vary]\ncoupling = ['pspm', 1]", "text"),
        ("[vary]\ndevice.stiffness = [1, inf]", "inf; allowed: a finite number"),
        ("[vary]\ndevice.mass = [1, 'NaN']", "nan; allowed: a finite number"),
        ("[vary]\ndof = [1, 2.5]", "a whole number"),
        ("[vary]\ndof = {from = 1, to = 2.5}", "whole numbers"),
        ("[vary]\ndof = {from = 1, to = 3, steps = 5}", "no more than there are whole numbers from 1 to 3"),
        ("[vary]\nseed = [1, -1]", "0 or above"),
        ("[vary]\nseed = [true]", "whole numbers"),
        ("[vary]\nseed = '5:5'", "'A:B'"),
        ("[vary]\nseed = 5", "a list, or a range"),
        ("[vary]\nseed = '0:2000000'", "at most"),
        (f"[vary]\nseed = '0:{MOST}'\nlink = ['lan', '4g']", f"{2 * MOST}; allowed: {MOST} at most"),
        ("[vary]\nlink = ['lann']", "unknown link 'lann'; did you mean lan"),
        ("[vary]\nlink = ['delay 5furlongs']", "furlongs"),
        ("[vary]\nlink = [{up = 'lan'}]", "up = ..., down = ..."),
        ("[vary]\nlink = ['lan']\n'link.up' = ['lan']", "either link.up or link"),
        ("[vary]\nlink.up = ['lann']", "unknown link.up 'lann'; did you mean lan"),
        ("[fixd]\na = 1\n[vary]\nseed = [1]", "'fixd'.*fixed"),
        ("[fixed]\ndof = 1\n[vary]\ndof = [1]", "either under"),
        ("[fixed]\ndvice.mass = 1\n[vary]\ndof = [1]", "'dvice.mass'.*device.mass"),
        ("[fixed]\nseed = 'x'\n[vary]\ndof = [1]", "a whole number"),
        ("fixed = 3\n[vary]\ndof = [1]", "a table"),
        ("[vary]", "varied values"),
        ("", "varied values"),
        ("vary = [3]", "varied values"),
        ("[vary", "a TOML file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InvalidParameter, match=said) as refused:
        spec(tmp_path, text).cases()
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match=r"none\.toml.*No such file"):
        Spec.read(tmp_path / "none.toml")
