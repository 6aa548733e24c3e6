"""Metrics of contact: the stiffness that is rendered. When a contact is felt is in `test_metrics_felt.py`."""

import math

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.metrics.contact import depth_and_resistance, pressed_wall, rendered_stiffness
from hapnet.ext.metrics.obstacles import SolidObstacle, normal_where_deepest
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import Sphere
from hapnet.plant.worlds.walls import Wall
from tests.support.metric_recordings import RATE_HZ, SURFACE, TICK_S, WALL, device, exact, recording, sampled


def presses(seconds: float = 8.0) -> tuple[Array, Array]:
    """Times [s] and depths [m] of a hand that goes 10 mm into the wall and out again every 2 s."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    return t, -0.01 * np.cos(np.pi * t)


@pytest.mark.long
def test_the_stiffness_that_is_rendered() -> None:
    """Force 70 N/m times the depth once a visit is 115 ms old, drag before and outside, which must not count."""
    t, depth = presses()
    age = np.where(depth > 0.0, t % 2.0 - 0.5, 0.0)
    force = np.where(age > 0.115, 70.0 * depth, 0.3 * np.sin(np.pi * t))
    run = sampled(depth[:, None] + WALL.offset, -force[:, None])
    assert rendered_stiffness(run, [WALL], 0.1) == pytest.approx(70.0, rel=1e-9)
    assert rendered_stiffness(run, [WALL], 0.0) != pytest.approx(70.0, rel=1e-3)


def test_the_stiffness_along_the_normal_of_the_wall_that_is_pressed() -> None:
    t, depth = presses()
    normal = np.array([0.6, 0.8])
    along = np.array([-0.8, 0.6])
    x = np.outer(depth + 0.02, normal) + np.outer(0.01 * np.sin(t), along)
    force = np.outer(-70.0 * depth, normal) + np.outer(np.cos(t), along)
    oblique = Wall((3.0, 4.0), 0.02, 3000.0)  # to be normalised
    untouched = Wall((-3.0, -4.0), 0.5, 3000.0)
    run = sampled(x, force)
    assert rendered_stiffness(run, [untouched, oblique], 0.0) == pytest.approx(70.0, rel=1e-9)
    assert pressed_wall(run.device, [untouched, oblique]) is oblique


def test_no_stiffness_without_settled_contact() -> None:
    _, depth = presses()
    run = sampled(depth[:, None] + WALL.offset, -70.0 * depth[:, None])
    assert rendered_stiffness(run, [], 0.0) is None
    assert rendered_stiffness(run, [Wall((1.0,), 0.5, 3000.0)], 0.0) is None
    assert rendered_stiffness(run, [WALL], 0.98) is None  # a visit lasts 1 s
    assert rendered_stiffness(recording(device(0, (1.0,), (0.0,))), [WALL], 0.0) is None


def test_a_visit_has_settled_just_after_the_time_that_word_takes() -> None:
    """9 samples in the wall, the last before at 0: those more than 4 ticks after it count, 5 to 9: not 0.1 s."""
    depth = np.zeros(40)
    depth[1:10] = 1.0
    force = np.where(np.arange(40) > 4, 7.0, 1000.0) * depth
    run = exact(depth, force)
    assert rendered_stiffness(run, [SURFACE], 4 * TICK_S) is None  # 5 samples, 78 ms
    depth[10:13] = 1.0
    force[10:13] = 7.0
    assert rendered_stiffness(exact(depth, force), [SURFACE], 4 * TICK_S) == 7.0  # 8 samples, 125 ms
    longer = exact(depth, force, step_s=TICK_S)  # and two of the world's steps: 6 of them
    assert rendered_stiffness(longer, [SURFACE], 2 * TICK_S) == 7.0
    assert rendered_stiffness(longer, [SURFACE], 6 * TICK_S) is None  # 4 samples


def test_a_tenth_of_a_second_of_contact_is_enough() -> None:
    """At 50 Hz five samples are 0.1 s, as far as floats go: one period is 0.02 s, and 5 times that 0.1."""
    depth = np.array([0.0, *[1.0] * 5, *[0.0] * 6])
    run = exact(depth, 7.0 * depth)
    columns = run.device
    columns["time_s"] = np.arange(12) * 0.02
    period = (columns["time_s"][-1] - columns["time_s"][0]) / 11
    assert 5 * period == 0.1
    assert rendered_stiffness(run, [SURFACE], 0.0) == 7.0
    shorter = exact(depth[1:] * (np.arange(11) > 0), 7.0 * depth[1:])
    shorter.device["time_s"] = np.arange(11) * 0.02
    assert rendered_stiffness(shorter, [SURFACE], 0.0) is None


def test_in_a_ball_the_force_is_taken_along_its_radius() -> None:
    """At (1, 2, 2) mm from the middle of a ball of 5 mm it is 2 mm deep, and the normal points to the middle."""
    ball = SolidObstacle(Solid(Sphere((0.05, 0.0, 0.0), 0.005), 700.0))
    places = np.array([(0.051, 0.002, 0.002), (0.05, 0.004, 0.0), (0.0, 0.0, 0.0)])
    device = {
        "time_s": np.arange(3.0),
        "position_m": places,
        "force_N": np.array([(2.0, 4.0, 4.0), (0.0, -1.0, 0.0), (0.0, 0.0, 0.0)]),
    }
    assert ball.depths(places) == pytest.approx([0.002, 0.001, -0.045])
    assert pressed_wall(device, [ball]) is ball
    found = depth_and_resistance(device, [ball])
    assert found[1] == pytest.approx([6.0, -1.0, 0.0])
    assert normal_where_deepest(ball, places) == pytest.approx((-1 / 3, -2 / 3, -2 / 3))
    disc = places[:, :2].copy()  # with two axes: cut where z is 0
    assert ball.depths(disc) == pytest.approx([0.005 - math.hypot(0.001, 0.002), 0.001, -0.045])
