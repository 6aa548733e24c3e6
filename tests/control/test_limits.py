"""The step limit and the silence policy."""

import math

import numpy as np
import pytest

from hapnet.control.limits import Silence, limit_step
from hapnet.control.pspm import SetPositionModulator
from tests.conftest import random_spd


def test_a_step_without_own_motion_is_on_the_way_and_no_longer_than_allowed() -> None:
    far, near, still = [3.0, 4.0], [0.3, 0.4], (0.0, 0.0)
    assert limit_step(2, still, still, far, 1.0)
    assert not limit_step(2, still, still, near, 1.0)
    assert far == pytest.approx([0.6, 0.8], rel=1e-15)
    assert near == [0.3, 0.4]


@pytest.mark.parametrize(
    ("goal", "limited"),
    [
        ((0.0, 0.0), (0.0, 0.0)),  # ybar stays: the hand causes all of the force's change
        ((5.0, 0.0), (5.0, 0.0)),  # ybar moves along: no change
        ((2.0, 1.0), (2.0, 1.0)),
        ((2.0, 3.0), (2.0, 1.0)),
        ((9.0, 0.0), (6.0, 0.0)),  # faster than the hand
        ((-9.0, 0.0), (-1.0, 0.0)),  # against it
        ((8.0, 4.0), (5.6, 0.8)),
    ],
)
def test_only_the_part_beyond_the_own_motion_is_limited(
    goal: tuple[float, float], limited: tuple[float, float]
) -> None:
    """The hand moved by (5, 0), and the limit is 1."""
    reached = list(goal)
    assert limit_step(2, (0.0, 0.0), (5.0, 0.0), reached, 1.0) == (goal != limited)
    assert reached == pytest.approx(limited, rel=1e-15)


def test_the_spring_force_never_steps_by_more_than_the_limit() -> None:
    """Through PSPM, whose projection is non-expansive: |K (ybar(k) - ybar(k-1))| <= dF_max for any data, without own
    motion."""
    rng = np.random.default_rng(1)
    for n in (1, 2, 3):
        K = random_spd(rng, n, 10.0, 3000.0)
        limit = 0.3
        maximum = limit / float(np.linalg.eigvalsh(K)[-1])
        m = SetPositionModulator(stiffness=K, position=np.zeros(n))
        for _ in range(1000):
            before = np.array(m.set_position)
            y = rng.normal(size=n).tolist()
            limit_step(n, m.set_position, (0.0,) * n, y, maximum)
            m.modulate(tuple(y), tuple(rng.normal(size=n) * 0.03), float(rng.uniform(0, 1e-4)), 0.0)
            step = np.array(m.set_position) - before
            assert np.linalg.norm(K @ step) <= limit * (1 + 1e-9)


def test_release_lets_go_after_the_silence_and_hold_never() -> None:
    for policy, expected in (("release", [False, False, True]), ("hold", [False, False, False])):
        silence = Silence(policy, 0.02)  # type: ignore[arg-type]
        assert [silence.step(0.01, fresh=False) for _ in range(3)] == expected
        assert not silence.step(math.inf, fresh=True)
