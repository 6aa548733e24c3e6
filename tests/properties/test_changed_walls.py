"""The local contact model when the world changes under the hand, or lies: no jump, right again soon, passive."""

import pytest

from tests.conftest import mostly_slow
from tests.measure.changed_walls import CHANGES, HANDS, Denied, denied

STEP_N = 0.5  # device.step_limit_N
LEAD_N = 0.06  # half of the damper's drag is cancelled in free motion, with a delay: the light hand leaves at 0.1 m/s
LIGHT_NPM = 200.0  # a spring in which a light hand stands deeper than the wall moves


def assert_mended(change: str, one: Denied) -> None:
    assert one.slack >= -1e-9
    assert one.margin >= 0.0
    assert one.step <= STEP_N * (1.0 + 1e-9)
    if one.wrong is not None:
        assert one.wrong <= 0.1 * one.right + (LEAD_N if change in ("vanishes", "comes") else 0.005)


@pytest.mark.parametrize("change", mostly_slow(["moves by 3 mm", "vanishes", "lies"], 1))
def test_what_changes_under_the_hand_is_right_after_100_ms_and_passive(change: str) -> None:
    assert_mended(change, denied(change, "light", 1.7, stiffness=LIGHT_NPM))


@pytest.mark.parametrize("seeds", mostly_slow([(range(1),), (range(1, 6),)], 0, 1), ids=["one", "all"])
@pytest.mark.parametrize("hand", HANDS)
@pytest.mark.parametrize("change", CHANGES)
def test_at_any_moment_of_a_contact(change: str, hand: str, seeds: range) -> None:
    """A wall that comes throws a light hand out, the faster the stiffer the spring: there with the paper's."""
    stiffness = 0.0 if hand != "light" else 100.0 if change == "comes" else LIGHT_NPM
    for seed in seeds:
        assert_mended(change, denied(change, hand, 1.2 + 0.37 * seed, seed=seed, stiffness=stiffness))


def test_the_same_stages_without_pspm_create_energy() -> None:
    """The local contact model makes the feel; what makes it passive is PSPM."""
    lies = denied("lies", "light", 1.7, coupling="zoh")
    assert lies.slack < -0.01
    assert lies.margin < 0.0
