"""The plain coupling's held end: a spring and a damper to the newest position."""

from __future__ import annotations

import pytest

from hapnet.control.held_coupling import HeldCoupling
from hapnet.control.law import Motion
from hapnet.control.spring import Spring


def test_it_is_a_spring_and_a_damper_to_the_newest_position() -> None:
    """-K (x - y) - B v, an axis with numbers of its own: -200 0.01 + 0.5 0.1 and -100 (-0.02) - 0.25 0.2."""
    coupling = HeldCoupling(Spring([200.0, 100.0], 2), (0.5, 0.25), (0.0, 0.0))
    assert coupling.coupled((0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0)
    coupling.receive((0.02, 0.01))
    coupling.receive((0.01, 0.02))
    assert coupling.set_position == (0.01, 0.02)
    assert coupling.coupled((0.02, 0.0), (-0.1, 0.2)) == pytest.approx((-2.0 + 0.05, 2.0 - 0.05))
    coupling.renew()
    assert coupling.set_position == (0.01, 0.02)
    assert coupling.datum((0.3, 0.4), (1.0, 1.0)) == (0.3, 0.4)


def test_its_spring_saturates() -> None:
    coupling = HeldCoupling(Spring(100.0, 1, 2.97), (0.1,), (0.0,))
    coupling.receive((1.0,))
    assert coupling.coupled((0.0,), (0.0,)) == pytest.approx((2.97,))


def test_the_way_since_the_last_measurement() -> None:
    coupling = HeldCoupling(Spring(100.0, 2), (0.1, 0.1), (0.5, 0.25))
    assert coupling.moved((0.75, 0.0)) == (0.25, -0.25)
    assert coupling.moved((0.75, 1.0)) == (0.0, 1.0)


def test_it_takes_bare_positions_alone() -> None:
    with pytest.raises(AssertionError, match="bare position"):
        HeldCoupling(Spring(100.0, 1), (0.1,), (0.0,)).receive(Motion((0.0,), (0.0,)))
