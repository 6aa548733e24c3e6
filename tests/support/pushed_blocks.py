"""Proxies on springs that push blocks, with equations of their own: what a joint step must obey, written anew."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf

import numpy as np

from hapnet.checks import Array
from hapnet.ext.many.blocks import Block, Blocks, Free

STIFFNESS, DAMPING = 3000.0, 10.0


@dataclass
class Proxy:
    """A mass on a spring K' and a damper B' to a fixed place."""

    x: Array
    v: Array
    place: Array
    mass: float = 0.1
    stiffness: float = 300.0
    damping: float = 2.0

    def free(self, dt: float) -> tuple[Array, float]:
        """The mean velocity without contact [m/s], and the resistance [Ns/m]: (12) of the paper."""
        a = 2.0 * self.mass / dt + self.damping + 0.5 * self.stiffness * dt
        return (2.0 * self.mass / dt * self.v - self.stiffness * (self.x - self.place)) / a, a

    def move(self, dt: float, mean: Array) -> None:
        self.x = self.x + dt * mean
        self.v = 2.0 * mean - self.v


def pushed(world: Blocks, proxies: Sequence[Proxy], dt: float) -> tuple[Array, Array]:
    """A step of blocks and proxies; returns the proxies' forces [N] and mean velocities [m/s], (proxies, n)."""
    free = [proxy.free(dt) for proxy in proxies]
    rows = enumerate(zip(proxies, free, strict=True))
    given = {k: Free(tuple(proxy.x), tuple(w), (a,) * world.n) for k, (proxy, (w, a)) in rows}
    answer = world.solve(dt, given)
    forces = np.array([answer[k] for k in range(len(proxies))])
    means = np.array([w + force / a for force, (w, a) in zip(forces, free, strict=True)])
    for proxy, mean in zip(proxies, means, strict=True):
        proxy.move(dt, mean)
    return forces, means


def dissipated_J(world: Blocks, hands: Sequence[Proxy], steps_s: Iterable[float], most_J: float) -> float:
    """The energy that is gone after these steps; after none of them has the world given out more than `most_J`."""
    work, gone = 0.0, 0.0
    start = world.stored_J({})
    for dt in steps_s:
        forces, means = pushed(world, hands, dt)
        work -= dt * float(np.sum(forces * means))
        stored = world.stored_J({k: tuple(hand.x) for k, hand in enumerate(hands)})
        gone = work - (stored - start)
        assert gone >= -most_J
    return gone


def spring_force(depth: float, limit: float) -> float:
    """K p, from 0 to the limit [N]."""
    return min(max(0.0, STIFFNESS * depth), limit)


def spring_energy(depth: float, limit: float) -> float:
    """The integral of `spring_force` over the depth [J]."""
    yields = limit / STIFFNESS
    inner, beyond = min(max(0.0, depth), yields), max(0.0, depth - yields)
    return 0.5 * STIFFNESS * inner * inner + (limit * beyond if beyond else 0.0)


def law(depth: float, u: float, dt: float, limit: float) -> tuple[float, float]:
    """A contact's force [N] and what its spring alone would push with [N], both means over a step.

    The spring's is the mean of `spring_force` along the path, a trapezoid between its corners; the damper's is B u for
    the share of the path inside. Neither pulls, and both together push with no more than the limit.
    """
    end = depth + u * dt
    low, high = min(depth, end), max(depth, end)
    if low == high:
        spring, share = spring_force(depth, limit), float(depth > 0.0)
    else:
        corners = [low, *(corner for corner in (0.0, limit / STIFFNESS) if low < corner < high), high]
        parts = [0.5 * (spring_force(a, limit) + spring_force(b, limit)) * (b - a) for a, b in pairwise(corners)]
        spring, share = sum(parts) / (high - low), (high - max(low, 0.0)) / (high - low) if high > 0.0 else 0.0
    return min(max(0.0, spring + DAMPING * u * share), limit), spring


@dataclass
class Step:
    """The figures of a step: the forces that the contacts' laws ask for on all bodies (proxies first) (k, n) [N], those
    that `Blocks` reports on the proxies, what the blocks' motion needs beside its own terms (blocks, n) [N], the work
    put in at the proxies, what dampers and drag took [J], and the largest term of a balance [N]."""

    asked: Array
    reported: Array
    needed: Array
    work: float
    lost: float
    largest: float


@dataclass
class Bench:
    """Proxies and blocks.

    faces : the axis and side (of the first) of each pair of bodies that may touch; bodies are the proxies, then the
    blocks.
    """

    proxies: list[Proxy]
    blocks: list[Block]
    faces: dict[tuple[int, int], tuple[int, float]]
    world: Blocks = field(init=False)

    def __post_init__(self) -> None:
        self.world = Blocks(self.blocks, STIFFNESS, DAMPING)

    def places(self) -> Array:
        return np.array([*(proxy.x for proxy in self.proxies), *self.world.x])

    def depth(self, pair: tuple[int, int], places: Array) -> float:
        one, other = pair
        axis, side = self.faces[pair]
        halves = [self.blocks[k - len(self.proxies)].half[axis] for k in pair if k >= len(self.proxies)]
        return float(sum(halves) - side * (places[one][axis] - places[other][axis]))

    def limit(self, pair: tuple[int, int]) -> float:
        """Of a contact [N]; two blocks push each other without a limit."""
        one, other = (k - len(self.proxies) for k in pair)
        return inf if one >= 0 else self.blocks[other].limit_N

    def energy(self) -> float:
        """Of the blocks' motion, their springs and all contacts' springs [J]."""
        return own_energy(self.world) + sum(
            spring_energy(self.depth(pair, self.places()), self.limit(pair)) for pair in self.faces
        )

    def step(self, dt: float) -> Step:
        n, count = self.world.n, len(self.proxies)
        before, speeds = self.places(), [np.array(v) for v in self.world.v]
        reported, velocities = pushed(self.world, self.proxies, dt)
        mean = np.vstack([velocities, np.zeros((len(self.blocks), n))])
        needed = np.zeros((len(self.blocks), n))
        lost, largest = 0.0, float(np.abs(reported).max())
        for k, block in enumerate(self.blocks):
            largest = max(largest, block.mass_kg / dt * float(np.abs([speeds[k], self.world.v[k]]).max()))
            mean[count + k] = 0.5 * (speeds[k] + self.world.v[k])
            assert np.allclose(self.world.x[k], before[count + k] + dt * mean[count + k], rtol=0.0, atol=1e-15)
            middle = 0.5 * (before[count + k] + self.world.x[k]) - block.home
            own = block.drag_Ns_m * mean[count + k] + block.spring_N_m * middle
            needed[k] = block.mass_kg * (np.array(self.world.v[k]) - speeds[k]) / dt + own
            lost += dt * block.drag_Ns_m * float(mean[count + k] @ mean[count + k])
        asked = np.zeros_like(mean)
        for (one, other), (axis, side) in self.faces.items():
            u = -side * float(mean[one][axis] - mean[other][axis])
            push, spring = law(self.depth((one, other), before), u, dt, self.limit((one, other)))
            asked[one][axis] += side * push
            asked[other][axis] -= side * push
            lost += dt * u * (push - spring)
        return Step(asked, reported, needed, -dt * float(np.sum(reported * mean[:count])), lost, largest)


def own_energy(world: Blocks) -> float:
    """The energy of the blocks' motion and of their own springs [J]."""
    total = 0.0
    for block, x, v in zip(world.blocks, world.x, world.v, strict=True):
        moved = np.subtract(x, block.home)
        total += 0.5 * block.mass_kg * float(np.dot(v, v)) + 0.5 * block.spring_N_m * float(moved @ moved)
    return total


HALF_M = 0.1


def row(rng: np.random.Generator, blocks: int, proxies: int) -> Bench:
    """Blocks in a row along the first axis, some fixed, with proxies in front of their faces and between them.

    All are so wide that nothing passes an edge: each contact keeps its face.
    """
    made, centres = [], [0.0, 0.0, 0.0]
    for _ in range(blocks):
        mass = float(rng.choice([0.0, 0.05, 0.2, 2.0]))
        spring, drag = float(rng.uniform(50.0, 200.0)), float(rng.uniform(0.0, 3.0))
        made.append(Block(tuple(centres), (HALF_M,) * 3, mass, drag, spring, float(rng.choice([0.5, 2.0, inf]))))
        centres[0] += 2.0 * HALF_M + float(rng.uniform(0.002, 0.01))
    hands, faces = [], {}
    for number in range(proxies):
        k, axis, side = int(rng.integers(blocks)), int(rng.integers(3)), float(rng.choice([-1.0, 1.0]))
        if axis == 0:  # beyond an end of the row, as there is no room between
            k = 0 if side < 0.0 else blocks - 1
        x = np.array(made[k].home) + rng.uniform(-0.03, 0.03, 3)
        x[axis] = made[k].home[axis] + side * (HALF_M + rng.uniform(0.0005, 0.004))
        aim = x.copy()
        aim[axis] -= side * rng.uniform(0.005, 0.02)
        hands.append(Proxy(x, rng.uniform(-0.5, 0.5, 3), aim))
        for j in range(blocks) if axis == 0 else (k,):
            faces[number, proxies + j] = axis, side
    for k in range(blocks):
        for j in range(k):
            if made[k].mass_kg or made[j].mass_kg:
                faces[proxies + k, proxies + j] = 0, 1.0
    bench = Bench(hands, made, faces)
    bench.world.v = [tuple(rng.uniform(-0.1, 0.1, 3)) if block.mass_kg else (0.0,) * 3 for block in made]
    return bench
