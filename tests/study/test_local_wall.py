"""The local wall: as stiff as the device renders without a network, the same over every link, and in every table."""

import pytest

from hapnet.ext.study import markdown, plans
from hapnet.ext.study.compare import LOCAL, Plan, RunMeasures, groups, local_wall
from hapnet.ext.study.comparison import compare
from hapnet.params import Params
from tests.study.comparisons import QUICK_PARAMS, known, outcomes

LINKS = {"near": ("delay 1ms", "delay 1ms"), "far": ("delay 120ms", "delay 120ms")}


@pytest.mark.parametrize(
    ("changes", "felt"),
    [
        ({}, 600.0),  # 2 b/T
        ({"device.own_damping": 0.2}, 400.0),
        ({"device.own_damping": 5.0}, 3000.0),  # the wall itself
        ({"device.servo_hz": 4000.0}, 2400.0),
        ({"world.wall.stiffness": 500.0}, 500.0),
    ],
)
def test_it_is_as_stiff_as_the_device_renders_alone(changes: dict[str, object], felt: float) -> None:
    """The smaller of 2 b/T (Colgate, Schenkel 1997) and the wall; K and K' are in series with the wall."""
    params = Params().set(changes)
    name, *own = local_wall(params).split(":")
    K = float(dict(one.split("=") for one in own)["device.stiffness"])
    wall = params.world.wall.stiffness
    assert name == "zoh"
    assert K * wall / (500.0 + wall) == pytest.approx(felt, rel=1e-5)


def test_a_device_whose_limit_is_unknown_has_none() -> None:
    assert local_wall(Params().set({"world.stiffness": [500.0, 400.0]})) == ""


def test_it_is_felt_as_stiff_as_the_limit_over_any_link() -> None:
    """Measured on a hand that presses; over 240 ms the run is the same, and `pspm` is felt softer."""
    found = compare("pspm", LINKS, operators="press", params={"duration_s": 4.0})
    near, far = (row for row in found.rows() if row["coupling"] == str(LOCAL))
    assert near["felt_N_per_m"] == pytest.approx(600.0, rel=0.01)
    assert {name: value for name, value in near.items() if name != "link"} == {
        name: value for name, value in far.items() if name != "link"
    }
    felt = [row["felt_N_per_m"] for row in found.rows() if row["coupling"] == "pspm"]
    assert felt == pytest.approx([600.0 * 3000.0 / 3500.0] * 2, rel=0.02)


def test_it_has_a_row_in_every_table() -> None:
    (asked,) = plans.plans(QUICK_PARAMS, couplings=["pspm"], links=LINKS).values()
    assert asked.local
    found = outcomes(asked, lambda one: known(drag_N=0.01))
    found += [RunMeasures(one, known(drag_N=0.02, energy_out_J=0.0)) for one in asked.local_cases()]
    text = markdown.page(asked, groups(asked, found), "some hands")
    assert text.count("| `local wall` |") >= 3
    assert [group.variant for group in groups(asked, found)].count(LOCAL) == len(LINKS)
    assert Plan(QUICK_PARAMS, ("pspm",), LINKS, ("press",), (0,)).rows == asked.variants
