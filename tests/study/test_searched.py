"""What a tuning may change of each law: the same in the code, in the examples and on the page."""

import re
import tomllib
from typing import Any

import pytest

from hapnet.couplings.registry import COUPLINGS
from hapnet.couplings.spec import Between
from hapnet.ext.study.search_space import searched
from hapnet.ext.study.tune_spec import TuneSpec
from hapnet.params import Params
from tests.conftest import ROOT

FILES = ROOT / "examples" / "tune"


def table(name: str) -> dict[str, Any]:
    return tomllib.loads((FILES / f"{name}.toml").read_text())


@pytest.mark.parametrize("name", COUPLINGS)
def test_a_laws_example_searches_what_the_law_says(name: str) -> None:
    spec = TuneSpec.read(FILES / f"{name}.toml")
    wanted = {
        parameter: {"from": allowed.low, "to": allowed.high, **({"scale": "log"} if allowed.log else {})}
        if isinstance(allowed, Between)
        else list(allowed)
        for parameter, allowed in COUPLINGS[name].searched.items()
    }
    assert wanted
    assert spec.space == searched(wanted)
    assert spec.tuning.fixed["coupling"] == name


@pytest.mark.parametrize("name", COUPLINGS)
def test_every_end_of_a_range_makes_a_run(name: str) -> None:
    for parameter, allowed in COUPLINGS[name].searched.items():
        for value in (allowed.low, allowed.high) if isinstance(allowed, Between) else allowed:
            Params().set({"coupling": name, parameter: value})


def test_all_laws_have_the_same_objective_hands_and_links() -> None:
    def rest(name: str) -> dict[str, Any]:
        whole = table(name)
        whole.pop("search")
        assert whole["fixed"].pop("coupling") == name
        return whole

    assert {file.stem for file in FILES.glob("*.toml")} == set(COUPLINGS)
    assert all(rest(name) == rest("pspm") for name in COUPLINGS)


def test_the_page_lists_what_is_searched() -> None:
    text = (
        (ROOT / "hapnet" / "ext" / "study" / "comparison.md")
        .read_text()
        .partition("| coupling | searched |")[2]
        .partition("\n\n")[0]
    )
    reported = {
        name: re.findall(r"`([^`]+)`", names)
        for laws, names in re.findall(r"^\| (`.*`) \| (`.*`) \|$", text, re.MULTILINE)
        for name in re.findall(r"`([^`]+)`", laws)
    }
    assert reported == {name: list(spec.searched) for name, spec in COUPLINGS.items()}
