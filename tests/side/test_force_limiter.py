"""What a real device may render: nothing without its dead-man switch, a growing part at first, less when it is hot."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from hapnet.side.force_limiter import ForceLimiter

FORCE = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))


def test_the_force_grows_over_the_ramp() -> None:
    limiter = ForceLimiter(ramp_s=0.5)
    shares = [limiter.permit(0.1, (2.0,), ())[0] / 2.0 for _ in range(7)]
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0])
    limiter.restart()
    assert limiter.permit(0.05, (2.0,), ()) == pytest.approx((0.2,))


def test_without_a_ramp_the_force_passes_as_it_is() -> None:
    force = (0.1, 0.2)
    assert ForceLimiter().permit(1e-3, force, ()) is force


def test_a_dead_man_switch_that_is_not_held_leaves_no_force() -> None:
    limiter = ForceLimiter(ramp_s=0.2, dead_man=1)
    assert limiter.permit(0.1, (1.0,), ()) == (0.0,)  # a device that does not report its buttons
    assert limiter.permit(0.1, (1.0,), (True, False)) == (0.0,)
    assert limiter.permit(0.1, (1.0,), (False, True)) == pytest.approx((0.5,))
    assert limiter.permit(0.1, (1.0,), (False, True)) == (1.0,)
    assert limiter.permit(0.1, (1.0,), (False, False)) == (0.0,)
    assert limiter.released
    assert limiter.permit(0.1, (1.0,), (False, True)) == pytest.approx((0.5,))  # it grows again


@given(st.lists(st.tuples(FORCE, st.booleans(), st.floats(0.0, 0.5)), max_size=40))
@pytest.mark.long
def test_it_only_ever_shortens_a_force(steps: list[tuple[tuple[float, float], bool, float]]) -> None:
    """So what the account counts is never more than what the law asked for; the direction stays."""
    limiter = ForceLimiter(ramp_s=0.3, dead_man=0, peak=5.0, continuous=2.0, thermal_s=1.0)
    for force, pressed, dt in steps:
        permitted = limiter.permit(dt, force, (pressed,))
        assert math.hypot(*permitted) <= min(5.0, math.hypot(*force)) * (1.0 + 1e-12)
        assert permitted[0] * force[1] == pytest.approx(permitted[1] * force[0], abs=1e-9)
        assert min(permitted[0] * force[0], permitted[1] * force[1]) >= 0.0
        assert pressed or permitted == (0.0, 0.0)


def test_hot_actuators_come_down_to_the_continuous_force() -> None:
    """In equilibrium the mean square force, which is the heat, is at most that of the continuous force."""
    limiter = ForceLimiter(peak=5.0, continuous=2.0, thermal_s=1.0)
    given = [limiter.permit(1e-3, (4.0,), ())[0] for _ in range(10_000)]
    assert given[0] == 4.0
    last = given[-3000:]
    assert math.sqrt(sum(force * force for force in last) / len(last)) <= 2.0 * (1.0 + 1e-6)
    assert max(abs(a - b) for a, b in pairwise(given)) < 0.05  # no step that a hand would feel
    assert limiter.limited_s > 5.0
    for _ in range(10_000):
        limiter.permit(1e-3, (0.0,), ())
    assert limiter.permit(1e-3, (4.0,), ()) == (4.0,)  # cooled down


def test_they_cool_down_while_the_switch_is_not_held() -> None:
    limiter = ForceLimiter(dead_man=0, peak=5.0, continuous=2.0, thermal_s=1.0)
    for _ in range(10_000):
        limiter.permit(1e-3, (4.0,), (True,))
    assert limiter.permit(1e-3, (4.0,), (True,))[0] < 3.0
    for _ in range(10_000):
        limiter.permit(1e-3, (4.0,), (False,))
    assert limiter.permit(1e-3, (4.0,), (True,)) == (4.0,)
