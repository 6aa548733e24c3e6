"""A wall that changes with time: what its timeline says, what it costs to move it, and what it reports of itself."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.assembly.build import prepare
from hapnet.errors import InvalidParameter
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scenes.moving import moving
from hapnet.plant.worlds.moving_wall import MovingWall, Schedule
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.walls import Wall
from hapnet.simulation.simulation import Simulation

WALL = Wall((1.0, 0.0), 0.02, 3000.0, 10.0)


def by_the_clock(timeline: str) -> MovingWall:
    """On one axis, with steps of 10 ms."""
    return moving(timeline=timeline, step_min_s=0.01, step_max_s=0.01)


def stepped(world: MovingWall, seconds: float, goal: float, steps_s: float = 0.01) -> PassiveIntegrator:
    """A proxy that is drawn to `goal` along the first axis for so long."""
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, world.start)
    for _ in range(round(seconds / steps_s)):
        proxy.step(steps_s, (goal, *(0.0,) * (world.dof - 1)), world.contacts)
    return proxy


def test_the_timeline_is_what_it_says() -> None:
    words = "at 2s: shift 3mm; at 3s: turn 20deg; at 4s: stiffness 1000; at 5s: gone; at 6s: back\nat 7s: damping 5"
    schedule = Schedule(WALL, words)
    assert schedule.at(1.999) == WALL
    assert schedule.at(2.0) == Wall((1.0, 0.0), 0.023, 3000.0, 10.0)
    turned = schedule.at(3.0)
    angle = math.radians(20.0)
    assert turned.normal == pytest.approx((math.cos(angle), math.sin(angle)))
    # Shifted by 3 mm along its normal from the line through (20 mm, 0): that is where the pivot is now.
    pivot = np.array([0.02, 0.0]) + 0.003 * np.array(turned.normal)
    assert turned.penetration(pivot.tolist()) == pytest.approx(0.0, abs=1e-15)
    softer = schedule.at(4.0)
    assert (softer.stiffness, softer.damping) == (1000.0, 10.0)
    assert schedule.at(5.0) is schedule.at(5.999) is None
    assert schedule.at(6.0) == softer
    last = schedule.at(7.0)
    assert last.damping == 5.0


def test_a_change_that_takes_time_is_a_minimum_jerk_move() -> None:
    """Flash, Hogan 1985: half the way at half the time, 15/8 of the mean speed there, at rest at both ends."""
    schedule = Schedule(WALL, "at 1s: shift -4mm over 200ms; at 2s: shift 1mm; at 3s: gone over 1s")
    offsets = [wall.offset for t in (1.0, 1.1, 1.2) if (wall := schedule.at(t)) is not None]
    assert offsets == pytest.approx([0.02, 0.018, 0.016])
    assert schedule.velocity_mps(1.1, (0.0, 0.0)) == pytest.approx(-0.004 / 0.2 * 15.0 / 8.0)
    assert schedule.velocity_mps(1.0, (0.0, 0.0)) == schedule.velocity_mps(1.3, (0.0, 0.0)) == 0.0
    half = schedule.at(3.5)
    assert (half.offset, half.stiffness, half.damping) == pytest.approx((0.017, 1500.0, 5.0))
    assert schedule.at(4.0) is None


def test_the_speed_of_the_surface_is_that_of_its_penetration() -> None:
    schedule = Schedule(WALL, "at 0s: shift 5mm over 1s; at 0s: turn 90deg over 2s")
    place, t, h = (0.025, 0.013), 0.4, 1e-6
    before, after = schedule.at(t - h), schedule.at(t + h)
    speed = -(after.penetration(place) - before.penetration(place)) / (2.0 * h)
    assert schedule.velocity_mps(t, place) == pytest.approx(speed, rel=1e-6)


def test_without_a_timeline_it_is_the_scene_wall() -> None:
    """The same steps to the last bit."""
    still = Params().set({"duration_s": 2.0, "link.up": "", "link.down": ""})
    one, other = (Simulation(still.set({"scene": name}), 3).run().recording.world for name in ("wall", "moving"))
    assert np.array_equal(one["position_m"], other["position_m"])
    assert one["penetration_m"].max() > 0.0
    assert moving().walls == (Wall((1.0,), 0.02, 3000.0, 10.0),)
    assert moving(timeline="at 9s: gone").walls == ()


def test_it_changes_at_the_onset_of_the_step_that_begins_then() -> None:
    """200 steps of 10 ms end at 2 s, though their sum in floats does not."""
    world = by_the_clock("at 2s: shift -25mm")
    stepped(world, 1.99, 0.0)
    assert world.plane((0.0,)) is None
    assert sum([0.01] * 200) != 2.0
    world = by_the_clock("at 2s: shift -25mm")
    stepped(world, 2.0, 0.0)
    assert world.time_s == pytest.approx(2.0)
    plane = world.plane((0.0,))
    assert plane.normal == (1.0,)
    assert plane.offset_m == pytest.approx(-0.005)


def test_the_work_that_moves_it_is_the_change_of_its_potential() -> None:
    """Deep in the wall at rest, p = F / K_w with F = K'/(1 + K'/K_w) (goal - wall); each change costs 1/2 K p^2."""
    world = by_the_clock("at 3s: shift 1mm; at 3s: gone")
    proxy = stepped(world, 2.99, 0.04)
    depth = 500.0 * 0.02 / (3000.0 + 500.0)
    assert proxy.position[0] - 0.02 == pytest.approx(depth, rel=1e-6)
    assert world.supplied_J == 0.0
    assert world.stored_J(proxy.position) == pytest.approx(0.5 * 3000.0 * depth**2, rel=1e-6)
    stored = world.stored_J(proxy.position)
    proxy.step(0.01, (0.04,), world)
    assert world.supplied_J == pytest.approx(-stored, rel=1e-6)  # it takes all that was stored away
    assert world.stored_J(proxy.position) == world.penetration(proxy.position) == 0.0
    softer = by_the_clock("at 3s: stiffness 1000")
    stepped(softer, 3.0, 0.04)
    assert softer.supplied_J == pytest.approx(-0.5 * 2000.0 * depth**2, rel=1e-6)
    nearer = by_the_clock("at 3s: shift -3mm")
    stepped(nearer, 3.0, 0.04)
    assert nearer.supplied_J == pytest.approx(0.5 * 3000.0 * ((depth + 0.003) ** 2 - depth**2), rel=1e-6)


ENTRIES = st.sampled_from([
    "shift 3mm", "shift -3mm", "shift -12mm", "turn 20deg", "turn -75deg", "stiffness 1000", "stiffness 20000",
    "damping 0", "damping 40", "gone", "back",
])  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.0, 0.4), ENTRIES, st.sampled_from(["", " over 30ms", " over 300ms"])), max_size=6),
    st.integers(1, 3), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_the_surroundings_give_no_more_than_they_have(
    entries: list[tuple[float, str, str]], dof: int, seed: int
) -> None:
    """-sum f . vhat T + S - (U - U(0)) never falls: each step adds what the damper dissipated, whatever moves."""
    at, parts = 0.0, []
    for pause, what, over in entries:
        if not (dof == 1 and what.startswith("turn")):
            parts.append(f"at {at:.4f}s: {what}{over}")
            at += pause + (0.31 if over else 0.01)
    world = moving(dof=dof, timeline="; ".join(parts), position=0.013)
    rng = np.random.default_rng(seed)
    proxy = PassiveIntegrator(0.02, 14.0, 500.0, world.start)
    work = left = 0.0
    while world.time_s < at + 0.2:
        goal = tuple((0.015 + rng.normal(0.0, 0.03, dof)).tolist())
        for dt in rng.uniform(0.001, 0.05, 3).tolist():
            work -= proxy.step(dt, goal, world).work_J
            now = work + world.supplied_J - world.stored_J(proxy.position)
            assert now >= left - 1e-12
            left = now
            wall = world.schedule.at(world.time_s + 1e-9)
            touched = world.plane(proxy.position)
            assert (touched is None) == (wall is None or wall.penetration(proxy.position) <= 0.0)
            assert world.penetration(proxy.position) == pytest.approx(
                0.0 if wall is None else max(0.0, wall.penetration(proxy.position)), abs=1e-15
            )


def test_the_plane_is_told_from_as_far_as_asked() -> None:
    world = moving(dof=2)
    assert isinstance(world, World)
    assert world.plane((0.019, 0.0)) is None
    assert world.planes((0.019, 0.0), 0.0005) == ()
    (near,) = world.planes((0.019, 0.5), 0.002)
    assert near == Plane((1.0, 0.0), 0.02, 3000.0, 10.0)
    assert world.planes((0.021, 0.0), 0.0) == (near,)
    assert moving(timeline="at 0s: gone").planes((0.1,), 1.0) == ()


def test_a_mass_starts_anew_outside_the_wall_as_it_is() -> None:
    world = by_the_clock("at 0.05s: shift -30mm")
    assert world.towards((0.03,)) == pytest.approx((0.02,))
    stepped(world, 0.1, 0.0)
    for goal in ((0.03,), (-0.005,), (-0.05,)):
        place = world.towards(goal)
        assert world.penetration(place) == 0.0
        assert place == pytest.approx((min(goal[0], -0.01),), abs=1e-8)


def test_a_run_with_a_moved_wall_keeps_both_accounts() -> None:
    words = "at 2s: shift -2mm; at 2.5s: stiffness 1000 over 100ms; at 3s: gone; at 3.3s: back"
    params = Params().set({"scene": "moving", "world.wall.timeline": words, "duration_s": 4.0})
    simulation = Simulation(params, seed=2)
    result = simulation.run()
    world = simulation.setup.scene
    assert result.world.coupling.ledger.slack >= -1e-9
    assert result.device.ledger.slack >= -1e-9
    assert world.supplied_J != 0.0
    left = -simulation.world.coupling.ledger.work + world.supplied_J - world.stored_J(simulation.world.mass.position)
    assert left >= -1e-12


@pytest.mark.parametrize(
    ("timeline", "says"),
    [
        ("shift 3mm", "'at TIME: '"),
        ("at 2s: jump 3mm", "'at TIME: '"),
        ("at 2s: shift", "'at TIME: '"),
        ("at 2s: gone 3mm", "'at TIME: '"),
        ("at 2s: shift 3", "a number with mm or m or um"),
        ("at 2s: turn 5deg over 1s", "cannot turn with one"),
        ("at 2s: stiffness -5", "a finite number above 0"),
        ("at 2s: shift 1e400mm", "a finite number"),
        ("at 2: gone", "a time with its unit"),
        ("at 2s: gone over 3", "a time with its unit"),
        ("at 2s: gone; at 1s: back", "ends at 2s; begin then or later"),
        ("at 2s: shift 1mm over 1s; at 2.5s: shift 1mm", "ends at 3s; begin then or later"),
        ("at 2s: turn 5deg", "cannot turn with one degree of freedom"),
    ],
)
def test_a_malformed_timeline_is_one_line_that_names_the_entry(timeline: str, says: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        prepare(Params().set({"scene": "moving", "world.wall.timeline": timeline}))
    assert str(caught.value).startswith("world.wall.timeline, entry ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_another_scene_says_that_it_does_not_read_the_timeline() -> None:
    with pytest.raises(InvalidParameter, match=r"world\.wall\.timeline at 2s: gone: .*does not read it"):
        prepare(Params().set({"world.wall.timeline": "at 2s: gone"}))
