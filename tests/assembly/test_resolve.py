"""Resolving: few functions pass parameters on, and each part says only what it chooses."""

import pytest

from hapnet.assembly.choices import Choice, Refusal, choosing, contributions, refuse
from hapnet.errors import InvalidParameter
from hapnet.param_sources import DEVICE, RULE, SCENE
from hapnet.params import Params
from tests.conftest import mostly_slow
from tests.measure.returns import RUNS, longest


@pytest.mark.parametrize("kind", mostly_slow([(one,) for one in RUNS], 1))
def test_a_parameter_passes_few_returns_on_its_way_to_the_parts(kind: str) -> None:
    name, found = longest(RUNS[kind])
    assert found.total() <= 10, (name, found)


def test_each_part_knows_what_the_parts_before_it_chose() -> None:
    def first(params: Params) -> Choice:
        return Choice({"device.mass": 0.3, "dof": 2}, DEVICE)

    def second(params: Params) -> Choice:
        return Choice({"world.mass": 2.0 * params.device.mass}, {"world.mass": SCENE})

    plain = Params().set({"dof": 2}, "flag")
    found = choosing(plain, first, second)
    assert (found.device.mass, found.world.mass) == (0.3, 0.6)
    assert [found.source(name) for name in ("device.mass", "world.mass", "dof")] == [DEVICE, SCENE, "flag"]
    assert choosing(plain, lambda params: Choice(source=RULE)) is plain


def test_the_first_refusal_that_applies_is_raised() -> None:
    rows = [Refusal(False, "dof", 1, "2"), Refusal(True, "units", "m", "rad"), Refusal(True, "dof", 3, "2")]
    refuse(rows[:1])
    with pytest.raises(InvalidParameter, match=r"^units is 'm'; allowed: rad$"):
        refuse(rows)


def test_only_what_a_run_needs_contributes() -> None:
    assert contributions(Params()) == ()
    arm = Params().set({"hardware": "omni", "follower.robot": "simulated"})
    assert [bool(one.before_scene) for one in contributions(arm)] == [True, False]
