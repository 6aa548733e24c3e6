"""Blocks with friction, solved by another method: projected Gauss-Seidel over the contacts, one at a time."""

from dataclasses import dataclass, field

import numpy as np

from hapnet.checks import Array
from tests.support.pushed_blocks import DAMPING, STIFFNESS, Bench, Proxy, law, own_energy

ROUNDS = 400


@dataclass
class RubBench(Bench):
    """A `Bench` that also keeps the stretch of each contact's friction, as the equations say [m]."""

    stretches: dict[tuple[int, int], Array] = field(default_factory=dict)

    def mu(self, pair: tuple[int, int]) -> float:
        """Of a contact: the larger one of both bodies."""
        return max(self.blocks[k - len(self.proxies)].friction for k in pair if k >= len(self.proxies))

    def solved(self, dt: float) -> Array:
        """The mean velocities of all bodies in the next step [m/s], proxies first; the stretches are moved on."""
        count, places = len(self.proxies), self.places()
        free, weight = np.zeros((len(places), self.world.n)), np.zeros(len(places))  # weight: 1/a
        for k, proxy in enumerate(self.proxies):
            free[k], a = proxy.free(dt)
            weight[k] = 1.0 / a
        for k, block in enumerate(self.blocks, count):
            if block.mass_kg:
                a = 2.0 * block.mass_kg / dt + block.drag_Ns_m + 0.5 * block.spring_N_m * dt
                c = 2.0 * block.mass_kg / dt * np.array(self.world.v[k - count])
                c -= block.spring_N_m * (places[k] - block.home)
                c[-1] -= block.mass_kg * block.gravity
                free[k], weight[k] = c / a, 1.0 / a
        pushes = dict.fromkeys(self.faces, 0.0)
        rubs = {pair: np.zeros(self.world.n) for pair in self.faces}
        firm = STIFFNESS * dt + DAMPING
        v = free.copy()
        for _ in range(ROUNDS):
            last = v.copy()
            for pair, (axis, side) in self.faces.items():
                one, other = pair
                give = weight[one] + weight[other]
                v[one], v[other] = self._without(v, weight, pair, pushes[pair], rubs[pair])
                pushes[pair] = self._push(pair, places, -side * (v[one] - v[other])[axis], give, dt)
                across = np.delete(np.arange(self.world.n), axis)
                held = STIFFNESS * self._stretch(pair) + firm * (v[one] - v[other])[across]
                size, most = np.linalg.norm(held) / (1.0 + firm * give), self.mu(pair) * pushes[pair]
                rubs[pair][across] = held / (1.0 + firm * give) * (min(1.0, most / size) if size else 0.0)
                v[one], v[other] = self._without(v, weight, pair, -pushes[pair], -rubs[pair])
            if np.abs(v - last).max() <= 1e-15 * np.abs(v).max():
                break
        for pair, (axis, _) in self.faces.items():
            s, g = self._stretch(pair), np.delete(rubs[pair], axis)
            self.stretches[pair] = s + (g - STIFFNESS * s) / (STIFFNESS + DAMPING / dt)
        return v

    def _stretch(self, pair: tuple[int, int]) -> Array:
        return self.stretches.get(pair, np.zeros(self.world.n - 1))

    def _without(self, v: Array, weight: Array, pair: tuple[int, int], push: float, rub: Array) -> tuple[Array, Array]:
        """The velocities of both bodies without these forces between them."""
        axis, side = self.faces[pair]
        force = -rub  # on the first
        force[axis] += side * push
        return v[pair[0]] - weight[pair[0]] * force, v[pair[1]] + weight[pair[1]] * force

    def _push(self, pair: tuple[int, int], places: Array, u: float, give: float, dt: float) -> float:
        """N = law(u - give N), by bisection."""
        depth, limit = self.depth(pair, places), self.limit(pair)
        low, high = 0.0, law(depth, u, dt, limit)[0]
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if law(depth, u - give * middle, dt, limit)[0] > middle else (low, middle)
        return 0.5 * (low + high)

    def rub_energy(self) -> float:
        """Of the stretches [J]."""
        return sum(0.5 * STIFFNESS * float(s @ s) for s in self.stretches.values())


def stored_J(bench: Bench, hands: list[Proxy]) -> float:
    """What the blocks report [J]."""
    return bench.world.stored_J({k: tuple(hand.x) for k, hand in enumerate(hands)})


def weight_J(bench: Bench) -> float:
    """The blocks' energy in motion, springs and weight [J]."""
    lifted = [
        block.mass_kg * block.gravity * (x[-1] - block.home[-1])
        for block, x in zip(bench.blocks, bench.world.x, strict=True)
    ]
    return own_energy(bench.world) + sum(lifted)
