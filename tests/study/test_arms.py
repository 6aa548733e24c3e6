"""The comparison of laws between two robots: what its page says of it, and one of its cases run again."""

import pytest

from examples.pictures.bilateral import BOUND_MJ, rows
from hapnet.ext.study.plans import plans
from hapnet.ext.study.sections import ARMS, BILATERAL
from hapnet.ext.study.task import run_case
from hapnet.laws import BILATERAL_NAMES
from netem.presets import PRESETS
from tests.conftest import ROOT, mostly_slow

PAGE = (ROOT / "hapnet" / "ext" / "robots" / "bilateral.md").read_text("utf-8")


def test_the_cases_are_every_law_and_port_over_every_link_with_every_arm() -> None:
    found = [(case["law"], case["port"], case["link"], case["arm"]) for case in rows()]
    assert len(set(found)) == len(found) == len(BILATERAL) * len(PRESETS) * len(ARMS)
    assert {case[0] for case in found} == set(BILATERAL_NAMES)


def test_the_page_counts_what_the_cases_show() -> None:
    broken = dict.fromkeys(BILATERAL_NAMES, 0)
    for case in rows():
        if float(case["out_mJ"]) > BOUND_MJ:
            assert case["port"] == "bare"
            broken[case["law"]] += 1
    cases = len(rows()) // 2
    assert f"{sum(broken.values())} of {cases} cases are not passive" in PAGE
    assert (
        f"`pp` in {broken['pp']} of {cases // 3}, `pf` in {broken['pf']}, `four-channel` in {broken['four-channel']}"
        in PAGE
    )
    assert f"Behind PSPM all {cases} are passive" in PAGE


@pytest.mark.parametrize("coupling", mostly_slow([("pp:bilateral.port=pspm",), ("pp",)], 1))
def test_a_case_is_still_what_it_was(coupling: str) -> None:
    (plan,) = plans(bench="arms", couplings=[coupling], links=["4g"], operators=[ARMS["0.1 kg"]]).values()
    assert plan.local == ""  # a pair has no local wall
    measures = run_case(plan.spec.fixed, plan.spec.cases()[0]).measures
    port = "behind PSPM" if "pspm" in coupling else "bare"
    (known,) = [
        float(case["out_mJ"]) for case in rows()
        if (case["law"], case["port"], case["link"], case["arm"]) == ("pp", port, "4g", "0.1 kg")
    ]  # fmt: skip
    assert measures["energy_out_J"] == pytest.approx(1e-3 * known, rel=1e-3)
