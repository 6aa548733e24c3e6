"""The hand that a mouse leads in `hapnet play`, in virtual time: its defaults, and the start of another pair."""

import dataclasses
import math

import numpy as np
import pytest

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.ext.page.choices import CHOICES
from hapnet.ext.page.commands.play import led
from hapnet.params import Params
from hapnet.plant.live_hand import LiveHand
from hapnet.plant.operator import Impedance
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.support.own_motion import largest_step

K_WORLD, K_WALL, WALL_M, GOAL_M = 500.0, 3000.0, 0.02, 0.04
HAND = led(Params()).operator_model
IMPEDANCE = Impedance(HAND.mass, HAND.damping, HAND.stiffness)


def pressed_N(rendering: str) -> float:
    """The force when the hand aims at `GOAL_M`: the springs of hand, device, proxy and wall in series."""
    K = 100.0 if rendering == "paper" else 600.0
    series = K * K_WALL / (K_WALL + K_WORLD)  # what the handle feels per depth, at rest [N/m]
    return (GOAL_M - WALL_M) * HAND.stiffness * series / (HAND.stiffness + series)


class Mouse(LiveHand):
    """Led at 20 Hz, as a drag does: to and fro for 3 s, then into the wall, held there, out, and held."""

    def reference(self, t: float) -> Vector:
        moved = math.floor(t * 20.0) / 20.0
        if moved < 3.0:
            goal = 0.015 * math.sin(2.0 * math.pi * moved)
        elif moved < 6.0:
            goal = GOAL_M * min(1.0, (moved - 3.0) / 0.5)
        else:
            goal = GOAL_M * max(0.0, 1.0 - (moved - 6.0) / 0.5)
        self.lead((goal,))
        return super().reference(t)


def simulation(hand: LiveHand, duration_s: float, **changes: object) -> Simulation:
    params = led(Params()).set({"operator": "rest", "duration_s": duration_s, "record_hz": 1000.0, **changes})
    return Simulation(params, 1, dataclasses.replace(prepare(params), hand=hand))


def test_the_defaults_feel_right_at_once() -> None:
    """Over the default link: free motion is free, the wall is the wall, and nothing swings."""
    result = simulation(Mouse((0.0,), IMPEDANCE), 9.0).run()
    device = result.recording.device
    t, force = device["time_s"], device["force_N"][:, 0]

    def between(since_s: float, until_s: float) -> np.ndarray:
        return np.asarray(force[(t >= since_s) & (t < until_s)])

    assert np.abs(between(0.5, 3.0)).max() < 0.1  # at up to 94 mm/s
    assert between(5.0, 6.0).mean() == pytest.approx(-pressed_N("hapnet"), rel=0.02)
    assert between(5.0, 6.0).std() < 0.02
    assert between(8.0, 9.0).std() < 0.02
    assert np.abs(between(8.0, 9.0)).max() < 0.02
    assert result.summary["verdict"]["passive"] is True


@pytest.mark.parametrize("label", mostly_slow(CHOICES, 3))
def test_another_pair_begins_where_the_handle_is_without_force(label: str) -> None:
    """With the handle in the wall: no force at first, steps within the limit, and the hand stays there or comes back.

    The wall is felt one round trip late, so a light hand swings into it first and bounces off the stiff one.
    """
    coupling, rendering = CHOICES[label]
    pressed = pressed_N(rendering or "hapnet")
    x = GOAL_M - pressed / HAND.stiffness
    hand = LiveHand((0.0,), IMPEDANCE)
    begun = simulation(hand, 1.5, coupling=coupling, rendering=rendering or "hapnet")
    begun.device.place((x,))
    begun.world.place((x,))
    hand.lead((GOAL_M,))
    result = begun.run()
    device, world = result.recording.device, result.recording.world
    assert device["position_m"][0, 0] == pytest.approx(x, abs=1e-5)
    assert world["position_m"][0, 0] == pytest.approx(WALL_M, abs=1e-4)
    force = device["force_N"][:, 0]
    assert abs(force[0]) < 0.01
    assert device["margin_J"][0] > 0.04  # a fresh account
    assert device["position_m"][:, 0].min() > WALL_M - 0.005
    assert device["position_m"][500:, 0].min() > WALL_M
    if coupling == "pspm":
        K = begun.setup.params.device.stiffness
        assert largest_step(device["force_N"], device["position_m"], K) <= 0.5 + 1e-9
        assert force[-200:].mean() == pytest.approx(-pressed, rel=0.2)
    assert force[-1] < -0.1
