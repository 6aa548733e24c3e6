import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from hapnet.errors import InvalidParameter
from hapnet.plant.live_hand import LiveHand
from hapnet.plant.operator import Impedance

TICK_S = 0.001


def test_it_solves_its_filter_whatever_the_ticks() -> None:
    """Against scipy's solution of tau^2 x'' + 2 tau x' + x = goal, led somewhere else every 50 ms."""
    tau, goals = 0.03, (0.04, -0.01, 0.03, 0.03)
    hand = LiveHand((0.0,), Impedance(), tau)
    rng = np.random.default_rng(1)
    state, t = np.zeros(2), 0.0
    for goal in goals:
        hand.lead((goal,))
        ticks = np.sort(rng.uniform(0.0, 0.05, 20)).tolist()
        ticks.append(0.05)
        solved = solve_ivp(
            lambda _, y, g=goal: (y[1], (g - y[0] - 2.0 * tau * y[1]) / tau**2),
            (0.0, 0.05), state, t_eval=ticks, rtol=1e-10, atol=1e-13,
        )  # fmt: skip
        followed = [hand.reference(t + tick)[0] for tick in ticks]
        np.testing.assert_allclose(followed, solved.y[0], atol=1e-9)
        state, t = solved.y[:, -1], t + 0.05


@settings(max_examples=50, deadline=None)
@given(goals=st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=20))
def test_a_mouse_at_20_hz_becomes_a_hand(goals: list[float]) -> None:
    """The filter's kernel ``t e^(-t/tau) / tau^2`` is positive, of area 1 and of variation 2/(e tau).

    So the hand never leaves the range of what was asked, and is never faster than that range over e tau.
    """
    tau = 0.03
    hand = LiveHand((0.0,), Impedance(), tau)
    path = [hand.reference(0.0)[0]]
    for number, goal in enumerate(goals):
        hand.lead((goal,))
        path += [hand.reference(number * 0.05 + tick * TICK_S)[0] for tick in range(1, 51)]
    reach = max(*goals, 0.0) - min(*goals, 0.0)
    assert max(path) <= max(*goals, 0.0) + 1e-12
    assert min(path) >= min(*goals, 0.0) - 1e-12
    assert np.abs(np.diff(path)).max() / TICK_S <= reach / (np.e * tau) + 1e-9


def test_it_starts_at_rest_and_stays_until_it_is_led() -> None:
    hand = LiveHand((0.01, -0.02), Impedance(0.1, 0.5, 40.0))
    assert [hand.reference(t) for t in (0.0, 0.001, 5.0)] == [(0.01, -0.02)] * 3
    assert hand.impedance.stiffness == 40.0


@pytest.mark.parametrize("position", [(), (1.0,), (1.0, float("nan")), (1.0, 2.0, 3.0), ("a", "b")])
def test_no_position(position: tuple[float, ...]) -> None:
    hand = LiveHand((0.0, 0.0), Impedance())
    with pytest.raises(InvalidParameter, match="position"):
        hand.lead(position)
    assert hand.reference(1.0) == (0.0, 0.0)
