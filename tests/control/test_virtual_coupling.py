"""The plain coupling's held end: a spring and a damper to the newest position."""

import math

import pytest

from hapnet.control.coupling import MotionSample
from hapnet.ext.laws.parts.virtual_coupling import VirtualCoupling, pass_to
from hapnet.mechanics.spring import Spring


def test_it_is_a_spring_and_a_damper_to_the_newest_position() -> None:
    """-K (x - y) - B v, an axis with numbers of its own: -200 0.01 + 0.5 0.1 and -100 (-0.02) - 0.25 0.2."""
    coupling = VirtualCoupling(Spring([200.0, 100.0], 2), (0.5, 0.25), (0.0, 0.0))
    assert coupling.coupled((0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0)
    coupling.receive((0.02, 0.01))
    coupling.receive((0.01, 0.02))
    assert coupling.set_position == (0.01, 0.02)
    assert coupling.coupled((0.02, 0.0), (-0.1, 0.2)) == pytest.approx((-2.0 + 0.05, 2.0 - 0.05))
    coupling.on_peer_changed()
    assert coupling.set_position == (0.01, 0.02)
    assert coupling.next_sample((0.3, 0.4), (1.0, 1.0)) == (0.3, 0.4)


def test_its_spring_saturates() -> None:
    coupling = VirtualCoupling(Spring(100.0, 1, 2.97), (0.1,), (0.0,))
    coupling.receive((1.0,))
    assert coupling.coupled((0.0,), (0.0,)) == pytest.approx((2.97,))


def test_the_way_since_the_last_measurement() -> None:
    coupling = VirtualCoupling(Spring(100.0, 2), (0.1, 0.1), (0.5, 0.25))
    for position, moved in (((0.75, 0.0), [0.25, -0.25]), ((0.75, 1.0), [0.0, 1.0])):
        pass_to(coupling, position)
        assert coupling.moved == moved


def test_it_takes_bare_positions_alone() -> None:
    with pytest.raises(AssertionError, match="bare position"):
        VirtualCoupling(Spring(100.0, 1), (0.1,), (0.0,)).receive(MotionSample((0.0,), (0.0,)))


PERIOD = 1e-3
AMPLITUDE = 0.01


def least_power(K: float, B: float, own: float) -> float:
    """Least mean power [W] that a hand puts in which leads a device of this own damping to and fro, whatever its pace.

    y rests, and is known at once. Paces from 1/40 of to Nyquist's frequency; what the device itself takes is exact.
    """
    found = []
    for step in range(1, 41):
        omega = math.pi * step / 40.0 / PERIOD
        for phase in (0.3, 1.1, math.pi / 2.0):
            coupling = VirtualCoupling(Spring(K, 1), (B,), (0.0,))
            work, held, before, ticks = 0.0, 0.0, AMPLITUDE * math.sin(phase), 800  # whole periods of each pace
            for k in range(1, ticks + 1):
                angle = omega * k * PERIOD + phase
                x, v = AMPLITUDE * math.sin(angle), AMPLITUDE * omega * math.cos(angle)
                work -= held * (x - before)
                before, held = x, coupling.coupled((x,), (v,))[0]
            found.append(work / (ticks * PERIOD) + own * (AMPLITUDE * omega) ** 2 / 2.0)
    return min(found)


@pytest.mark.parametrize(("K", "B"), [(500.0, 0.1), (500.0, 0.5), (2000.0, 0.5)])
@pytest.mark.long
def test_held_it_is_passive_if_the_device_damps_by_more_than_half_a_periods_stiffness_and_its_damper(
    K: float, B: float
) -> None:
    """b > K T/2 + B (Colgate, Schenkel 1997), with a wall that rests and positions that are fresh every tick."""
    enough = K * PERIOD / 2.0 + B
    assert least_power(K, B, enough) > 0.0
    assert least_power(K, B, 0.6 * K * PERIOD / 2.0) < -0.1
