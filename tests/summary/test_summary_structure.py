"""Whatever a file says of itself, `read` makes a summary of it that has every key."""

import json
import math
from typing import Any, get_type_hints, is_typeddict

from hypothesis import given, settings, strategies as st

from hapnet.params import Params
from hapnet.simulation.simulation import simulate
from hapnet.summary.structure import SidePart, Summary, Theorem, known, read, unknown
from hapnet.summary.tables import summary_text, verdict_text
from hapnet.summary.verdict import broken, judge
from hapnet.summary.words import verdict

KEYS = st.sampled_from(sorted({*get_type_hints(Summary), *get_type_hints(SidePart), *get_type_hints(Theorem)}))
LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
TREES = st.recursive(
    LEAVES, lambda within: st.lists(within, max_size=3) | st.dictionaries(KEYS, within, max_size=6), max_leaves=20
)


def fits(shape: Any, value: Any) -> bool:
    """Has `value` every key of the typed dictionary, wherever one is within another?"""
    hints = get_type_hints(shape)
    return set(value) == set(hints) and all(
        fits(hint, value[name]) for name, hint in hints.items() if is_typeddict(hint)
    )


@settings(max_examples=60)
@given(TREES)
def test_anything_becomes_a_summary_that_can_be_judged_and_shown(tree: Any) -> None:
    summary = read(tree)
    assert fits(Summary, summary)
    for side in (summary["device"], summary["world"]):
        assert side is None or fits(SidePart, side)
        numbers = [] if side is None else [side["reservoir_min_J"], side["ledger"]["margin_J"], side["sent_nJ"]]
        assert all(number is None or math.isfinite(number) for number in numbers)
    assert judge(tree)["passive"] in (True, False, None)
    assert judge(summary)["reason"]
    assert isinstance(broken(tree), bool)
    assert verdict(tree)
    assert verdict_text(tree)
    assert summary_text(tree)


def test_what_a_run_says_is_kept() -> None:
    """All that a run's summary has and that has a type is in what is read of it, from JSON too."""
    summary = simulate(Params().set({"duration_s": 0.2}), 1).summary
    reported = json.loads(json.dumps(summary))
    again = read(reported)
    for name in set(get_type_hints(Summary)) - {"device", "world", "links", "replay", "reconstructed"}:
        assert again[name] == reported[name], name
    for side in ("device", "world"):
        assert {name: again[side][name] for name in reported[side]} == reported[side]


def test_what_is_no_such_value_is_unknown() -> None:
    found = read({"seed": "three", "coupling": 3, "duration_s": math.inf, "tuning": [], "torn": "device", "device": 1})
    assert (found["seed"], found["coupling"], found["duration_s"]) == (None, None, None)
    assert (found["tuning"], found["torn"], found["device"]) == ({}, [], None)
    assert found["theorem"] == unknown(Theorem)
    assert [known(value) for value in (True, "1", math.nan, 2**70, 2, 0.5)] == [None, None, None, None, 2, 0.5]
