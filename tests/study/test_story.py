"""The words above the comparison's figure."""

from dataclasses import replace

import pytest

from hapnet.ext.pictures.comparison import Look
from hapnet.ext.study.compare import ComparedRun, Plan, RunMeasures, Variant
from hapnet.ext.study.figures import story, tradeoff
from hapnet.laws import COUPLING_NAMES
from hapnet.params import Params
from tests.conftest import mostly_slow

PLAN = Plan(Params(), ("pspm", "zoh", "pd"), {"lan": ("", ""), "4g": ("", "")}, ("press",), (0, 1))


def outcomes(reported: dict[tuple[str, str], tuple[float, float]]) -> list[RunMeasures]:
    """For each coupling over each link: the force error [%] and the margin [J], the same with both seeds."""
    return [
        RunMeasures(
            ComparedRun(Variant(coupling), link, "press", seed, Params()),
            {"true_force_error_percent": error, "margin_J": margin_J},
        )
        for (coupling, link), (error, margin_J) in reported.items()
        for seed in (0, 1)
    ]


def test_the_best_of_those_that_were_passive_is_named_and_those_that_were_not() -> None:
    reported = {
        ("pspm", "lan"): (0.5, 0.1), ("pspm", "4g"): (0.7, 0.1), ("pd", "lan"): (9.0, 0.1), ("pd", "4g"): (30.0, 0.1),
        ("zoh", "lan"): (0.4, 0.1), ("zoh", "4g"): (0.4, -0.1),
    }  # fmt: skip
    assert story(PLAN, outcomes(reported)).splitlines() == [
        "not passive in all cases: zoh (4g)",
        "of the others pspm has the smallest force error: 0.5 to 0.7 % (a link's median)",
    ]


def test_where_all_were_passive_it_says_so() -> None:
    reported = {("pspm", "lan"): (0.5, 0.1), ("pspm", "4g"): (0.5, 0.1)}
    assert story(PLAN, outcomes(reported)).splitlines() == [
        "every coupling was passive in all cases",
        "pspm has the smallest force error: 0.5 % (a link's median)",
    ]


def test_no_two_couplings_look_alike() -> None:
    looks = [Look(name, number) for number, name in enumerate(COUPLING_NAMES)]
    assert len({look.color for look in looks}) == len({look.mark["marker"] for look in looks}) == len(looks)


LONG = tuple(f"pspm:device.stiffness={stiffness}" for stiffness in (100, 200, 300, 400, 500))


@pytest.mark.parametrize("margin_J", [0.1, -0.1])
@pytest.mark.parametrize("couplings", mostly_slow([(one,) for one in [("pspm", "zoh"), COUPLING_NAMES, LONG]], 1))
def test_words_names_and_panels_lie_beside_one_another(couplings: tuple[str, ...], margin_J: float) -> None:
    """Also where the story is long: none of the couplings was passive, on any of three links."""
    plan = replace(PLAN, couplings=couplings, links=dict.fromkeys(("lan", "4g", "intercontinental"), ("", "")))
    reported = [
        RunMeasures(
            case,
            {
                "true_force_error_percent": 1.0,
                "stiffness_percent": 90.0,
                "margin_J": margin_J,
                "energy_out_J": 0.1 - margin_J,
            },
        )
        for case in plan.cases()
    ]
    made = tradeoff(plan, reported)
    made.draw_without_rendering()
    (legend,) = made.legends
    above = legend.get_window_extent()
    assert above.x0 >= 0.0
    assert above.x1 <= made.bbox.x1
    assert above.y1 <= made.bbox.y1
    assert all(not above.overlaps(panel.get_tightbbox()) for panel in made.axes)
    assert made.get_suptitle() == ""
