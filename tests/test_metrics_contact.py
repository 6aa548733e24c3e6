"""Metrics of contact: the stiffness that is rendered, and when a contact is felt."""

from __future__ import annotations

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.metrics.contact import first_felt_s, pressed_wall, rendered_stiffness
from hapnet.plant.worlds.walls import Wall
from tests.metric_recordings import RATE_HZ, SURFACE, TICK_S, WALL, device, exact, recording, sampled


def presses(seconds: float = 8.0) -> tuple[Array, Array]:
    """Times [s] and depths [m] of a hand that goes 10 mm into the wall and out again every 2 s."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    return t, -0.01 * np.cos(np.pi * t)


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


def test_when_a_contact_is_felt() -> None:
    """Drag of 0.5 N until 80 ms after the crossing at 0.5 s, then 10 N/s more: it exceeds 0.6 N 10 ms later."""
    t, depth = presses()
    crossing = int(np.flatnonzero(depth > 0.0)[0]) / RATE_HZ
    force = 0.5 + np.where(depth > 0.0, np.clip(10.0 * (t % 2.0 - crossing - 0.08), 0.0, None), 0.0)
    run = sampled(depth[:, None] + WALL.offset, -force[:, None])
    assert first_felt_s(run, [WALL], 0.08) == pytest.approx(0.0105, abs=0.001)
    assert first_felt_s(run, [WALL], 0.05) == pytest.approx(0.0405, abs=0.001)
    strong = run.device
    assert strong is not None
    strong["force_N"][100] = -9.0  # felt before, and stronger: 10 % more than that counts
    assert first_felt_s(run, [WALL], 0.08) is None
    strong["force_N"][100] = -2.0
    assert first_felt_s(run, [WALL], 0.08) == pytest.approx(0.1705, abs=0.001)  # 2.2 N


def test_drag_that_grows_is_no_contact() -> None:
    """Nothing can be felt before word of the crossing is back, nor what comes long after the device has left."""
    t, depth = presses()
    force = np.where(t < 0.7, t, 0.6)
    force[(t > 1.7) & (t < 1.8)] = 3.0
    run = sampled(depth[:, None] + WALL.offset, -force[:, None])
    assert first_felt_s(run, [WALL], 0.2) is None
    assert first_felt_s(run, [], 0.2) is None
    assert first_felt_s(run, [Wall((1.0,), 0.0, 3000.0)], 0.2) is None  # it began in there


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
    assert columns is not None
    columns["time_s"] = np.arange(12) * 0.02
    period = (columns["time_s"][-1] - columns["time_s"][0]) / 11
    assert 5 * period == 0.1
    assert rendered_stiffness(run, [SURFACE], 0.0) == 7.0
    shorter = exact(depth[1:] * (np.arange(11) > 0), 7.0 * depth[1:])
    assert shorter.device is not None
    shorter.device["time_s"] = np.arange(11) * 0.02
    assert rendered_stiffness(shorter, [SURFACE], 0.0) is None


def test_on_the_surface_is_outside() -> None:
    """A device that only touches presses no wall, and one that begins on the surface has not begun inside."""
    touching = exact(np.zeros(40), np.ones(40))
    assert pressed_wall(touching.device, [SURFACE]) is None
    assert first_felt_s(touching, [SURFACE], 0.0) is None
    depth = np.zeros(40)
    depth[8:16] = 1.0
    force = np.zeros(40)
    force[10:] = 5.0
    assert first_felt_s(exact(depth, force), [SURFACE], 0.0) == 2 * TICK_S


def test_felt_is_more_than_a_tenth_and_a_tenth_of_a_newton_more() -> None:
    """Drag of 2 N until word is back: 2.2 N is not felt, what is more is. Of 0.5 N: not 0.6."""
    for drag, same, more in ((2.0, 2.0 + 0.1 * 2.0, 2.21), (0.5, 0.5 + 0.1, 0.61)):
        depth = np.zeros(64)
        depth[8:32] = 1.0
        force = np.full(64, drag)
        force[12:16] = same
        force[16:] = more
        assert first_felt_s(exact(depth, force), [SURFACE], 0.0) == 8 * TICK_S
        force[16:] = same
        assert first_felt_s(exact(depth, force), [SURFACE], 0.0) is None


def test_a_device_that_comes_back_within_a_tenth_of_a_second_has_not_left() -> None:
    """Six ticks away, 94 ms, are a tremble: what is felt after that is of the same visit. Seven, 109 ms, are not."""
    for away, felt in ((6, True), (7, False)):
        depth = np.zeros(64)
        depth[8:12] = 1.0
        depth[11 + away : 40] = 1.0
        force = np.zeros(64)
        force[30:] = 5.0
        found = first_felt_s(exact(depth, force), [SURFACE], 0.0)
        assert found == (22 * TICK_S if felt else None)


def test_a_force_is_felt_from_when_word_is_back_until_a_round_trip_after_the_visit() -> None:
    """A visit from tick 8 to 15, a round trip of 4: a force that is there from tick 12 on counts, from 19 on not."""
    for begin, felt in ((11, None), (12, 0.0), (18, 6 * TICK_S), (19, None)):
        depth = np.zeros(64)
        depth[8:16] = 1.0
        force = np.zeros(64)
        force[begin:] = 5.0
        assert first_felt_s(exact(depth, force), [SURFACE], 4 * TICK_S) == felt
