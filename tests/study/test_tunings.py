"""What a rule chose for a coupling, as the comparison shows it."""

import pytest

from hapnet.ext.study import tunings
from hapnet.ext.study.compare import Plan
from hapnet.params import Params

QUICK = Params().set({"duration_s": 2.0})


def test_what_a_rule_chose_is_shown_for_each_link_and_once_where_it_is_the_same() -> None:
    plan = Plan(
        QUICK, ("pspm", "pd", "eba"), {"near": ("", ""), "far": ("delay 120ms", "delay 120ms")}, ("press",), (0,)
    )
    columns = [list(column.cells) for column in tunings.table(plan).columns]
    assert columns[0][0] == "pspm"
    first = columns[0].index("pd")
    shown = {name: values for name, *values in zip(*(column[first:] for column in columns[1:]), strict=True)}
    near, far = map(float, shown["stiffness_N_m"])
    assert near == 100.0
    assert far == pytest.approx(2.0 * 5.0 / (0.24 + 0.005 + 0.05 + 0.001), rel=1e-3)  # K_p = 2 K_d / round trip
    assert shown["coordination_Ns_m"] == ["0", ""]
    found = tunings.tuning(plan.case(plan.variants[1], "far", "press", 0).params)
    assert found["damping_Ns_m"] == pytest.approx(5.0)
