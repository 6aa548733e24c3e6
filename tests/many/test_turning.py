"""Blocks that turn, beside equations of motion of the test's own and an independent solver."""

from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.many.blocks import Block, Blocks
from hapnet.ext.many.shared import shared_world
from hapnet.ext.many.turning import TurningBlocks
from tests.many.test_blocks import thrown
from tests.many.test_friction import G, lifted_over
from tests.support.pushed_blocks import DAMPING, STIFFNESS, Proxy, dissipated_J, pushed, row

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

HALF = (0.03, 0.02, 0.01)
MASS = 0.2
INERTIA = MASS / 3.0 * np.array([0.02**2 + 0.01**2, 0.03**2 + 0.01**2, 0.03**2 + 0.02**2])
"""Of a uniform box, m/12 times the sums of its squared sides [kg m^2]."""


def turn(q: Any) -> Array:
    """The rotation matrix of a unit quaternion, by its products with the axes."""
    w, v = q[0], np.array(q[1:])
    return np.array([e + 2.0 * np.cross(v, np.cross(v, e) + w * e) for e in np.eye(3)]).T


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 5e-2])
def test_free_it_keeps_its_energy_and_its_angular_momentum(dt: float) -> None:
    """About no axis of symmetry: it tumbles."""
    world = TurningBlocks([Block((0.0, 0.0, 0.0), HALF, MASS, 0.0, 0.0, turns=True)], STIFFNESS, DAMPING)
    spin = np.array([3.0, -5.0, 8.0])
    world.spins[0] = spin.copy()
    for _ in range(round(5.0 / dt)):
        world.solve(dt, {})
    now = world.spins[0]
    assert 0.5 * now @ (INERTIA * now) == pytest.approx(0.5 * spin @ (INERTIA * spin), rel=1e-10)
    assert world.stored_J({}) == pytest.approx(0.5 * spin @ (INERTIA * spin), rel=1e-10)
    assert turn(world.quaternions[0]) @ (INERTIA * now) == pytest.approx(INERTIA * spin, rel=1e-9)
    assert np.abs(now - spin).max() > 0.1


def off_centre() -> tuple[TurningBlocks, Proxy]:
    """A hand that touches a face off its centre, at rest, and presses it."""
    world = TurningBlocks([Block((0.0, 0.0, 0.0), HALF, MASS, 0.5, 5.0, turns=True)], STIFFNESS, DAMPING)
    hand = Proxy(np.array([0.012, 0.02, 0.004]), np.zeros(3), np.array([0.012, 0.012, 0.004]), damping=5.0)
    return world, hand


def slope(hand: Proxy, _: float, state: Array) -> Array:
    """The derivatives of the hand's and the block's place and velocity, its quaternion and its angular velocity."""
    x, v, centre, speed, q, spin = np.split(state, [3, 6, 9, 12, 16])
    R = turn(q / np.linalg.norm(q))
    at = R.T @ (x - centre)
    depth, rate = HALF[1] - at[1], -(R.T @ (v - speed) - np.cross(spin, at))[1]
    push = max(0.0, STIFFNESS * depth + DAMPING * rate) if depth > 0.0 else 0.0
    force = push * R[:, 1]
    drag = 0.5 * (0.03**2 + 0.02**2 + 0.01**2) / 3.0
    torque = -np.cross(at, [0.0, push, 0.0]) - drag * spin - np.cross(spin, INERTIA * spin)
    hand_force = force - hand.stiffness * (x - hand.place) - hand.damping * v
    w, vector = q[0], q[1:]
    turning = 0.5 * np.array([-vector @ spin, *(w * spin + np.cross(vector, spin))])
    own = -force - 0.5 * speed - 5.0 * centre
    return np.concatenate([v, hand_force / hand.mass, speed, own / MASS, turning, torque / INERTIA])


def test_a_push_off_centre_turns_it_as_an_independent_solver_says_with_order_2() -> None:
    integrate = pytest.importorskip("scipy.integrate")
    _, hand = off_centre()
    start = np.concatenate([hand.x, np.zeros(9), [1.0, 0.0, 0.0, 0.0], np.zeros(3)])
    whole, errors = 0.16, []
    options: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-13}
    end = integrate.solve_ivp(lambda t, y: slope(hand, t, y), (0.0, whole), start, "DOP853", **options).y[:, -1]
    assert end[12] < 0.97  # it has turned by more than 25 degrees
    for dt in (4e-3, 2e-3, 1e-3):
        world, hand = off_centre()
        for _ in range(round(whole / dt)):
            pushed(world, [hand], dt)
        found = [*hand.x, *world.x[0], *(0.03 * x for x in world.quaternions[0])]
        expected = [*end[:3], *end[6:9], *(0.03 * end[12:16])]
        errors.append(float(np.abs(np.subtract(found, expected)).max()))
    assert errors[0] < 2e-4
    assert errors[0] / errors[2] > 10.0  # 16, of order 2


def test_those_that_do_not_turn_move_as_before() -> None:
    """Hands at one block, as corners and not faces of blocks meet here."""
    for seed in range(6):
        plain = row(np.random.default_rng([seed, 6]), 1, 4)
        made = [block._replace(friction=0.4) for block in plain.blocks]
        worlds = [kind(made, STIFFNESS, DAMPING) for kind in (Blocks, TurningBlocks)]
        hands = [[Proxy(p.x.copy(), p.v.copy(), p.place) for p in plain.proxies] for _ in worlds]
        for _ in range(20):
            one, other = (pushed(world, own, 0.01)[0] for world, own in zip(worlds, hands, strict=True))
            assert other == pytest.approx(one, rel=1e-7, abs=1e-8)


def test_it_gives_out_no_energy_whatever_is_thrown_at_it() -> None:
    dropped = turned = 0.0
    for seed in range(12):
        rng = np.random.default_rng([seed, 7])
        plain, hands = thrown(rng, 1 + seed % 2, 4)
        made = [
            block._replace(turns=True, friction=float(rng.uniform(0.0, 1.0)), gravity=float(rng.choice([0.0, G])))
            for block in plain.blocks
        ]
        world = TurningBlocks(made, STIFFNESS, DAMPING)
        world.v = plain.v
        world.spins = [rng.uniform(-5.0, 5.0, 3) if block.mass_kg else np.zeros(3) for block in made]
        dropped += dissipated_J(world, hands, (10.0 ** rng.uniform(-3.0, -1.3, 30)).tolist(), 1e-11)
        turned = max([turned, *(1.0 - abs(q[0]) for q in world.quaternions)])
    assert dropped > 1.0
    assert turned > 0.5


def test_light_blocks_that_spin_fast_in_long_steps_give_out_no_energy() -> None:
    """From 5 g, at up to 60 rad/s on each axis, in steps of 10 to 250 ms: some are made without turning."""
    stopped = 0
    for seed in (0, 1, 2):
        rng = np.random.default_rng([seed, 17])
        plain, hands = thrown(rng, 1 + seed % 3, 4)
        made = [
            block._replace(
                turns=True, mass_kg=block.mass_kg and float(rng.choice([0.005, 0.05, 0.5])),
                friction=float(rng.uniform(0.0, 2.0)), gravity=float(rng.choice([0.0, G])),
            )
            for block in plain.blocks
        ]  # fmt: skip
        world = TurningBlocks(made, STIFFNESS, DAMPING)
        world.v = plain.v
        world.spins = [rng.uniform(-60.0, 60.0, 3) if block.mass_kg else np.zeros(3) for block in made]
        dissipated_J(world, hands, (10.0 ** rng.uniform(-2.0, -0.6, 20)).tolist(), 1e-11)
        stopped += world.stopped
    assert stopped > 0


def test_without_dampers_and_friction_all_work_is_stored() -> None:
    """As an equality, step by step: the hand turns the block by a spring at a face."""
    _, hand = off_centre()
    world = TurningBlocks([Block((0.0, 0.0, 0.0), HALF, MASS, 0.0, 5.0, turns=True)], STIFFNESS, 0.0)
    start, work, rng = world.stored_J({0: tuple(hand.x)}), 0.0, np.random.default_rng(3)
    for _ in range(60):
        dt = float(rng.uniform(5e-4, 4e-3))
        forces, means = pushed(world, [hand], dt)
        work -= dt * float(np.sum(forces * means))
        assert work == pytest.approx(world.stored_J({0: tuple(hand.x)}) - start, rel=0.0, abs=1e-14)
    assert work > 1e-4
    assert world.quaternions[0][0] < 0.99


def test_two_that_hit_each_other_keep_their_momentum() -> None:
    """A corner of one meets a face of the other; without drag and springs nothing else changes the momentum."""
    blocks = [Block((0.075 * k, 0.015 * k, 0.01 * k), (0.03,) * 3, MASS, 0.0, 0.0, turns=True) for k in range(2)]
    world = TurningBlocks(blocks, STIFFNESS, DAMPING)
    world.v = [(0.4, 0.0, 0.0), (-0.2, 0.0, 0.0)]
    world.spins[1] = np.array([0.0, 0.0, 4.0])
    energy = start = world.stored_J({})
    for _ in range(60):
        world.solve(0.005, {})
        assert np.sum(world.v, axis=0) == pytest.approx([0.2, 0.0, 0.0], abs=1e-9)
        now = world.stored_J({})
        assert now <= energy + 1e-13
        energy = now
    assert energy < 0.9 * start  # they have met
    assert np.abs(world.spins[0]).max() > 0.5


@pytest.mark.parametrize("dt", [1e-2, 3e-2])
def test_it_comes_to_rest_flat_on_a_table(dt: float) -> None:
    """Thrown with a spin: its four lower corners carry it, each m g/4."""
    table = Block((0.0, 0.0, -0.06), (0.5, 0.5, 0.01), 0.0, 0.0, 0.0)
    block = Block((0.0, 0.0, 0.0), (0.03,) * 3, MASS, 0.0, 0.0, friction=0.5, gravity=G, turns=True)
    world = TurningBlocks([block, table], STIFFNESS, DAMPING)
    world.spins[0] = np.array([4.0, 2.0, 1.0])
    for _ in range(round(3.0 / dt)):
        world.solve(dt, {})
    assert world.x[0][2] == pytest.approx(-0.02 - MASS * G / (4.0 * STIFFNESS), abs=3e-6)
    assert np.abs(turn(world.quaternions[0])[2]).max() == pytest.approx(1.0, abs=1e-6)
    assert np.abs(world.v[0]).max() < 1e-3


def test_two_hands_lift_it_over_a_link() -> None:
    seat, _ = lifted_over("delay 40ms 10ms loss 2%", "drag=0.2&turns=yes", 4.0, table="0,0,-41mm", up_m=0.01)
    assert seat.shared.blocks.x[0] == pytest.approx((0.0, 0.0, 0.04), abs=0.008)
    assert seat.picture().poses()[0, 3] == pytest.approx(1.0, abs=0.05)


def test_blocks_turn_where_asked() -> None:
    assert isinstance(shared_world("shared:block?turns=yes").shared.blocks, TurningBlocks)
    for text in ("shared:block", "shared:block?turns=no"):
        assert type(shared_world(text).shared.blocks) is Blocks
