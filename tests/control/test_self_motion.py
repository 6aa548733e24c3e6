"""The own motion since the time for which the world's answer stands."""

import pytest

from hapnet.control.self_motion import SelfMotion, approach, place


def at(motion: SelfMotion, *x: float) -> list[float]:
    place(motion, len(x), x, y := list(x))
    return y


def test_y_is_the_worlds_answer_and_the_own_motion_since_as_far_as_the_proxy_follows() -> None:
    """y = y_w + sigma (x - x_then): the proxy is 3 of 10 mm away, so sigma is 0.7; it has come 5 mm since."""
    motion = SelfMotion(distance=0.01, smoothing=1e-12, history=0.1)
    motion.reset((0.0, 0.0))
    assert at(motion, 0.004, 0.002) == [0.0, 0.0]
    for k in range(1, 21):
        motion.observe(0.01, (0.001 * k, 0.002))
    motion.receive((0.018, 0.002), 0.055)
    approach(motion, 2, 0.01)
    assert at(motion, 0.02, 0.002) == pytest.approx((0.0215, 0.002))
    assert at(motion, 0.03, 0.001) == pytest.approx((0.0285, 0.0013))
    assert motion.own(0.0) == pytest.approx((0.02, 0.002))
    assert motion.own(5.0) == pytest.approx((0.011, 0.002), abs=0.0011)  # no older than `history`
    motion.receive((0.03, 0.002), 0.055)  # 15 mm away: in contact
    approach(motion, 2, 0.01)
    assert at(motion, 0.5, 0.5) == pytest.approx((0.03, 0.002))


def test_both_parts_follow_with_a_lag() -> None:
    """A step of one time constant, 20 ms, goes half of the way (implicit Euler); sigma is 0.6 at 6 of 15 mm."""
    motion = SelfMotion()
    motion.reset((0.0,))
    for k in range(21):
        motion.observe(0.25, (0.1 * k,))
    assert motion.own(9.0) == pytest.approx((0.1 * (20 - 8),))  # two seconds ago
    motion.receive((2.006,), 0.0)
    approach(motion, 1, 0.02)
    assert at(motion, 0.01) == pytest.approx(((2.006 - 0.6 * 2.0) / 2.0 + 0.3 * 0.01,))
