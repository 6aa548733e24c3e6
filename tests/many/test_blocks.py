"""The joint step of blocks and proxies, beside equations and methods of its own."""

from collections.abc import Callable

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.many.blocks import Block, Blocks, Free
from tests.support.pushed_blocks import DAMPING, STIFFNESS, Bench, Proxy, own_energy, pushed, row

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

COUNTS = [(blocks, proxies) for blocks in (1, 2, 3) for proxies in (1, 2, 6)]


@pytest.mark.parametrize(("blocks", "proxies"), COUNTS)
def test_every_step_obeys_the_balance_and_each_contacts_law(blocks: int, proxies: int) -> None:
    touched = hit = limited = 0
    for seed in range(14):
        rng = np.random.default_rng([blocks, proxies, seed])
        bench = row(rng, blocks, proxies)
        for _ in range(12):
            step = bench.step(float(rng.uniform(1e-3, 0.1)))
            scale = max(1.0, step.largest)
            moving = np.array([block.mass_kg > 0.0 for block in bench.blocks])
            assert step.reported == pytest.approx(step.asked[:proxies], rel=0.0, abs=1e-12 * scale)
            assert step.needed[moving] == pytest.approx(step.asked[proxies:][moving], rel=0.0, abs=1e-12 * scale)
            limited += int((np.abs(np.abs(step.reported)[..., None] - [0.5, 2.0]) < 1e-9).any())
            touched += int(np.abs(step.reported).max() > 0.1)
            hit += int(len([f for f in step.asked[proxies:, 0] if abs(f) > 0.1]) > 1)
    assert touched > 60
    assert limited > 5
    assert blocks == 1 or hit > 4


@pytest.mark.parametrize(("blocks", "proxies"), COUNTS)
def test_the_work_put_in_is_stored_or_lost_in_dampers(blocks: int, proxies: int) -> None:
    """As an equality: none of these contacts ends at an edge."""
    for seed in range(14):
        rng = np.random.default_rng([blocks, proxies, seed, 1])
        bench = row(rng, blocks, proxies)
        start, work, lost = bench.energy(), 0.0, 0.0
        for _ in range(30):
            step = bench.step(float(rng.uniform(1e-3, 0.1)))
            work, lost = work + step.work, lost + step.lost
            now = bench.energy()
            assert work == pytest.approx(now - start + lost, rel=0.0, abs=1e-12)
            stored = bench.world.stored_J({k: tuple(proxy.x) for k, proxy in enumerate(bench.proxies)})
            assert stored == pytest.approx(now, rel=0.0, abs=1e-13)
        assert lost > 0.0


def test_a_hand_that_comes_to_rest_at_the_limit_of_force_is_pushed_with_just_that() -> None:
    """However short its path in a step is: a difference of energies over it would be rounding."""
    block = Block((0.0, 0.0, 0.0), (0.03,) * 3, 0.0, 0.0, 0.0, 3.0)
    hand = Proxy(np.array([-0.03, 0.0, 0.0]), np.zeros(3), np.array([-0.015, 0.0, 0.0]), stiffness=250.0, damping=20.0)
    bench, paths = Bench([hand], [block], {(0, 1): (0, -1.0)}), []
    for _ in range(600):
        before = hand.x[0]
        step = bench.step(5e-3)
        assert step.reported == pytest.approx(step.asked[:1], rel=0.0, abs=1e-12)
        paths.append(abs(hand.x[0] - before))
    assert step.reported[0][0] == pytest.approx(-3.0, abs=1e-12)
    assert sum(1e-12 < path < 1e-7 for path in paths) > 20


def thrown(rng: np.random.Generator, blocks: int, proxies: int) -> tuple[Blocks, list[Proxy]]:
    """Proxies thrown at small blocks from all sides, so that they enter through faces and edges, and slide off."""
    half, made = (0.03,) * 3, []
    for k in range(blocks):
        home = (0.065 * k, *rng.uniform(-0.02, 0.02, 2))
        made.append(
            Block(
                home,
                half,
                float(rng.choice([0.0, 0.05, 0.5])),
                float(rng.uniform(0, 2)),
                20.0,
                float(rng.choice([5.0, np.inf])),
            )
        )
    world = Blocks(made, STIFFNESS, DAMPING)
    world.v = [tuple(rng.uniform(-2.0, 2.0, 3)) if block.mass_kg else (0.0,) * 3 for block in made]
    hands = []
    for _ in range(proxies):
        way = rng.normal(size=3)
        x = np.array(made[int(rng.integers(blocks))].home) + 0.12 * way / np.linalg.norm(way) + [0.0, 0.0, 0.05]
        if world.clearance(x) > 0.0:
            hands.append(Proxy(x, -3.0 * way + rng.normal(size=3), rng.uniform(-0.05, 0.05, 3), stiffness=200.0))
    return world, hands


def test_blocks_give_out_no_more_than_was_put_in_whatever_is_thrown_at_them() -> None:
    dropped = deepest = 0.0
    for seed in range(60):
        rng = np.random.default_rng([seed, 2])
        world, hands = thrown(rng, 1 + seed % 3, 6)
        places = {k: tuple(hand.x) for k, hand in enumerate(hands)}
        start, own_start, work = world.stored_J(places), own_energy(world), 0.0
        assert start == pytest.approx(own_start, rel=1e-14)  # nothing touches yet
        for _ in range(40):
            dt = float(10.0 ** rng.uniform(-3.0, -1.0))
            forces, means = pushed(world, hands, dt)
            work -= dt * float(np.sum(forces * means))
            stored = world.stored_J({k: tuple(hand.x) for k, hand in enumerate(hands)})
            assert work - (stored - start) >= -1e-12
            assert stored >= own_energy(world) - 1e-15  # the contacts' springs hold nothing below 0
            deepest = max([deepest, *(-world.clearance(hand.x) for hand in hands)])
        dropped += work - (own_energy(world) - own_start)
    assert deepest > 0.01
    assert dropped > 1.0


def test_blocks_that_hit_each_other_keep_their_momentum_and_lose_energy() -> None:
    """Without drag and springs, the proxies' impulses are all that changes the momentum."""
    for seed in range(20):
        rng = np.random.default_rng([seed, 3])
        half = (0.03, 0.03, 0.03)
        blocks = [Block((0.07 * k, 0.0, 0.0), half, float(rng.uniform(0.05, 2.0)), 0.0, 0.0) for k in range(3)]
        world = Blocks(blocks, STIFFNESS, DAMPING)
        world.v = [tuple(rng.uniform(0.1, 0.5) * np.array([-(k - 1.0), 0.1, 0.1])) for k in range(3)]
        masses = np.array([block.mass_kg for block in blocks])
        hands = [Proxy(np.array([-0.05, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]), np.zeros(3))]
        momentum, changes = masses @ np.array(world.v), 0
        for _ in range(40):
            dt = float(rng.uniform(1e-3, 0.05))
            before = np.array(world.v)
            forces, _ = pushed(world, hands, dt)
            momentum = momentum - dt * forces[0]
            assert masses @ np.array(world.v) == pytest.approx(momentum, rel=0.0, abs=1e-13)
            changes += int(np.abs(np.array(world.v) - before)[2].max() > 1e-6)
        assert changes > 0  # the last block was hit, and no proxy is near


def pressed() -> Bench:
    """Two proxies that touch opposite faces of a block, at rest, and press it unequally."""
    block = Block((0.0, 0.0, 0.0), (0.03, 0.03, 0.03), 0.2, 1.0, 5.0)
    hands = [
        Proxy(np.array([side * 0.03, 0.0, 0.0]), np.zeros(3), np.array([side * aim, 0.0, 0.0]), damping=5.0)
        for side, aim in ((-1.0, 0.01), (1.0, 0.018))
    ]
    return Bench(hands, [block], {(0, 2): (0, -1.0), (1, 2): (0, 1.0)})


def slope_of(bench: Bench) -> Callable[[float, Array], Array]:
    """The derivatives of x of both proxies and the block, then of their velocities, along the first axis."""
    block, hands = bench.blocks[0], bench.proxies

    def slope(_: float, state: Array) -> Array:
        x, v = state[:3], state[3:]
        force = np.zeros(3)
        force[2] = -block.drag_Ns_m * v[2] - block.spring_N_m * x[2]
        for k, (hand, side) in enumerate(zip(hands, (-1.0, 1.0), strict=True)):
            depth, rate = 0.03 - side * (x[k] - x[2]), -side * (v[k] - v[2])
            push = max(0.0, STIFFNESS * depth + DAMPING * rate) if depth > 0.0 else 0.0
            force[k] = -hand.stiffness * (x[k] - hand.place[0]) - hand.damping * v[k] + side * push
            force[2] -= side * push
        return np.concatenate([v, force / [hands[0].mass, hands[1].mass, block.mass_kg]])

    return slope


def apart(bench: Bench, dt: float, steps: int, reference: Array) -> float:
    """The largest distance of proxies and block from the reference (steps + 1, 3) [m]."""
    far = 0.0
    for k in range(steps):
        bench.step(dt)
        far = max(far, float(np.abs(bench.places()[:, 0] - reference[k + 1]).max()))
    return far


def test_a_held_block_moves_as_an_independent_solver_says_with_order_2() -> None:
    integrate = pytest.importorskip("scipy.integrate")
    bench, whole = pressed(), 0.4
    start = np.concatenate([bench.places()[:, 0], np.zeros(3)])
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        steps = round(whole / dt)
        times = np.linspace(0.0, whole, steps + 1)
        found = integrate.solve_ivp(slope_of(bench), (0.0, whole), start, "DOP853", times, rtol=1e-11, atol=1e-14)
        errors.append(apart(pressed(), dt, steps, found.y[:3].T))
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_a_block_that_is_hit_moves_as_an_independent_solver_says() -> None:
    """A contact that begins and ends within steps: of the same order, but not evenly."""
    integrate = pytest.importorskip("scipy.integrate")

    def hit() -> Bench:
        bench = pressed()
        for hand, gap, speed in zip(bench.proxies, (0.004, 0.011), (0.4, -0.3), strict=True):
            hand.x[0] += np.sign(hand.x[0]) * gap
            hand.v, hand.place = np.array([speed, 0.0, 0.0]), hand.x.copy()
        return bench

    whole, bench = 0.2, hit()
    start = np.concatenate([bench.places()[:, 0], [0.4, -0.3, 0.0]])
    times = np.linspace(0.0, whole, 3201)
    found = integrate.solve_ivp(slope_of(bench), (0.0, whole), start, "RK45", times, max_step=4e-5)
    assert np.abs(found.y[2]).max() > 5e-4
    errors = [apart(hit(), whole / n, n, found.y[:3, :: 3200 // n].T) for n in (25, 100, 400)]
    assert errors[0] < 2e-4
    assert errors[2] < errors[0] / 64.0


def test_blocks_do_not_overlap() -> None:
    one = Block((0.0, 0.0, 0.0), (0.03,) * 3, 0.2, 1.0, 5.0)
    with pytest.raises(InvalidParameter, match="outside the block"):
        Blocks([one, one._replace(home=(0.05, 0.0, 0.0))], STIFFNESS, DAMPING)


def test_a_hand_that_lets_go_ends_its_contacts_and_loses_their_energy() -> None:
    bench = pressed()
    for _ in range(200):
        bench.step(2e-3)
    places = {k: tuple(hand.x) for k, hand in enumerate(bench.proxies)}
    whole = bench.world.stored_J(places)
    depth = bench.depth((0, 2), bench.places())
    assert depth > 1e-4
    bench.world.let_go(0)
    assert bench.world.stored_J(places) == pytest.approx(whole - 0.5 * STIFFNESS * depth**2, rel=1e-12)
    (w, a), block = bench.proxies[1].free(2e-3), np.array(bench.world.x[0])
    bench.world.solve(2e-3, {1: Free(tuple(bench.proxies[1].x), tuple(w), (a,) * 3)})
    assert bench.world.x[0][0] < block[0]  # the other hand alone pushes it


def test_a_proxy_that_is_carried_around_an_edge_stores_nothing() -> None:
    """In free space a proxy is moved without any work, past the plane of a face too, beside the block."""
    world = Blocks([Block((0.0, 0.0, 0.0), (0.03,) * 3, 0.2, 1.0, 5.0)], STIFFNESS, DAMPING)
    hand = Proxy(np.array([-0.032, 0.029, 0.0]), np.zeros(3), np.array([-0.032, 0.029, 0.0]))
    forces, _ = pushed(world, [hand], 0.02)
    assert not forces.any()
    hand.x = np.array([-0.026, 0.035, 0.0])
    assert world.clearance(hand.x) > 0.0
    assert world.stored_J({0: tuple(hand.x)}) == 0.0
