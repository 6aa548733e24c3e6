"""Several hands in one engine: one step for all of them, an energy limit for each, and one account of the engine.

The coordinates of all N proxies are one vector (N n,), and their couplings one block-diagonal B' and K'. So the force
of `hapnet.ext.engines.engine_world` is that of all hands, with the inverse mass W of all proxies: two hands that hold
the same body are as stable as one. The work of a hand is exact, F_k . (x_{j+1,k} - x_{j,k}), and so is its harvest

    D_k = -sum F_k . (x_{j+1,k} - x_{j,k}) - (phi_{k+1} - phi_k),        phi = 1/2 |x_k - ybar_k|_K'^2

No substep takes more from a hand than its spring and its reservoir hold: a substep that would is repeated without this
hand's force. The engine's own account has the work of all hands together, as one hand may get what another has put in.
With one hand each number is that of a world with one hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil, inf
from operator import add, neg
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Vector
from hapnet.ext.engines.engine_account import EngineAccount
from hapnet.ext.engines.engine_world import MAX_S, PAID, EngineMass, matrix_of
from hapnet.ext.engines.mujoco_engine import MujocoEngine
from hapnet.ext.engines.mujoco_model import HandProxy
from hapnet.ext.engines.mujoco_proxy import lightness
from hapnet.mechanics.contacts import Step
from hapnet.records.vectors import added, inner


class MujocoHands(MujocoEngine):
    """The model that `scene` names, with the proxies of several hands: their coordinates are one vector."""

    def __init__(self, scene: str, dof: int, held: Sequence[HandProxy]) -> None:
        super().__init__(scene, dof, held)
        self._are_spheres = all(proxy.is_sphere for proxy in self.proxies)

    def position(self) -> Vector:
        return _joined([proxy.position() for proxy in self.proxies])

    def velocity(self) -> Vector:
        return _joined([proxy.velocity() for proxy in self.proxies])

    def inverse_mass(self) -> float | Array:
        """The inverse mass of all proxies without contacts (N n, N n) [1/kg]."""
        if not self._are_spheres:
            return lightness(list(self.proxies))
        values = [float(np.max(proxy.inverse_mass())) for proxy in self.proxies]
        return values[0] if min(values) == max(values) else np.diag([w for w in values for _ in range(self.dof)])

    def contact_force(self) -> Vector | None:
        """The forces of all contacts on the spheres [N]; 0 for the bodies of the model."""
        return _joined([proxy.contact_force() or (0.0,) * self.dof for proxy in self.proxies])

    def depth(self) -> float:
        return max([proxy.depth() for proxy in self.proxies])

    def weigh_hand(self, hand: int, mass: ArrayLike) -> None:
        """`weigh` for one hand's proxy."""
        if self.proxies[hand].is_sphere:
            self.proxies[hand].weigh(mass)
            self._weigh()

    def _apply(self, force: Vector) -> None:
        n = self.dof
        for proxy in self.proxies:
            proxy.release()
        for k, proxy in enumerate(self.proxies):
            proxy.push(force[k * n : k * n + n])


class HandsAccount(EngineAccount):
    """An engine with several hands, with one account. Positions, velocities and forces are those of all hands, (N n,).

    proxies : of the hands. hands, axes : N and n.
    """

    def __init__(self, engine: MujocoHands, name: str) -> None:
        self.proxies = engine.proxies
        self.hands, self.axes = len(engine.proxies), engine.dof
        super().__init__(engine, name)

    def _axes(self) -> int:
        return self.hands * self.axes

    def of(self, hand: int, vector: Sequence[float]) -> Vector:
        """The part of one hand (n,)."""
        return tuple(vector[hand * self.axes : (hand + 1) * self.axes])

    def joint_substep(self, h: float, force: Vector, most_J: Sequence[float]) -> tuple[Vector, list[float]]:
        """`substep`, in which the force of each hand may do at most so much work; returns the work of each [J]."""
        self._save()
        moved, supplied = self._advance("substep", h, force)
        cut = set[int]()
        while True:
            works = [inner(self.of(k, force), self.of(k, moved)) for k in range(self.hands)]
            over = {k for k, work in enumerate(works) if work > most_J[k]} - cut
            if not over:
                break
            cut |= over
            none = (0.0,) * self.axes
            force = _joined([none if k in cut else self.of(k, force) for k in range(self.hands)])
            self._return(at_rest=False)
            moved, supplied = self._advance("substep", h, force)
        applied, _ = self._entered(h, force, added(works), supplied, inf)
        return applied, works if applied is force else [0.0] * self.hands


class HandsMass(EngineMass):
    """The proxies of all hands on their virtual couplings. A hand has a spring and a damper from `hold` on."""

    def __init__(self, account: HandsAccount) -> None:
        super().__init__(account, 1.0, 0.0, 0.0)
        self._joint = account
        self._gains_of_hands: dict[int, tuple[Array, Array]] = {}
        self._acting: frozenset[int] = frozenset()

    def hold(self, hand: int, damping: ArrayLike, stiffness: ArrayLike) -> None:
        """Give a hand its B' [Ns/m] and K' [N/m]. Raises InvalidParameter."""
        n = self._joint.axes
        self._gains_of_hands[hand] = matrix_of("damping", damping, n), matrix_of("stiffness", stiffness, n)

    def put(self, hand: int, place: Callable[[], object]) -> None:
        """Move a hand's proxy before its first step."""
        place()
        self._joint.look()
        n = self._joint.axes
        self._pushed = (*self._pushed[: hand * n], *(0.0,) * n, *self._pushed[hand * n + n :])

    def _act(self, hands: frozenset[int]) -> None:
        """Let the couplings of these hands act, and no others."""
        if hands != self._acting:
            self._acting, self._gains_of = hands, (0.0, None)
            self._B, self._K = np.zeros_like(self._B), np.zeros_like(self._K)
            for k in hands:
                here = slice(k * self._joint.axes, (k + 1) * self._joint.axes)
                self._B[here, here], self._K[here, here] = self._gains_of_hands[k]

    def joint_step(self, dt: float, aims: Mapping[int, Aim]) -> dict[int, Step]:
        """Make a step of `dt` seconds of all hands; returns the step of each that takes part."""
        account = self._joint
        hands, n = range(account.hands), account.axes
        self._act(frozenset([k for k, aim in aims.items() if aim.acts]))
        goal = _joined([aims[k].set_position if k in aims else (0.0,) * n for k in hands])
        springs = {k: self._potential_of(k, aim) for k, aim in aims.items()}
        most = [PAID * (springs[k] + aims[k].available_J) if k in self._acting else 0.0 for k in hands]
        simulated = min(dt, MAX_S)
        count = max(1, ceil(simulated / account.engine.substep_s - 1e-9))
        h = simulated / count
        account.begin()
        gains, start = self._gains(h), account.position
        total, work = [0.0] * account.dof, [0.0] * account.hands
        for _ in range(count):
            before = account.velocity
            left = [all_J - done for all_J, done in zip(most, work, strict=True)]
            asked = self._demand(h, gains, goal)
            force = _joined([account.of(k, asked) if k in self._acting else (0.0,) * n for k in hands])
            applied, done = account.joint_substep(h, force, left)
            self._note(h, before, applied)
            work, total = list(map(add, work, done)), list(map(add, total, applied))
        mean = tuple([f / count for f in total])
        steps = {}
        for k, aim in aims.items():
            x, force, before = account.of(k, account.position), account.of(k, mean), account.of(k, start)
            harvested = -work[k] - (self._potential_of(k, aim) - springs[k])
            velocity = tuple([(b - a) / dt for a, b in zip(before, x, strict=True)])
            depth = account.proxies[k].depth()
            steps[k] = Step(velocity, tuple(map(neg, force)), -work[k], harvested, force, x, depth)
        return steps

    def _potential_of(self, hand: int, aim: Aim) -> float:
        """phi of a hand's spring [J], whether it acts or not."""
        e = [a - b for a, b in zip(self._joint.of(hand, self._joint.position), aim.set_position, strict=True)]
        return 0.5 * inner(e, (self._gains_of_hands[hand][1] @ e).tolist())


class Aim(NamedTuple):
    """A hand's part in a step. set_position : ybar (n,) [m]. available_J : the energy in its reservoir. acts : whether
    it holds its proxy."""

    set_position: Vector
    available_J: float
    acts: bool


def _joined(parts: Sequence[Sequence[float]]) -> Vector:
    return tuple([x for part in parts for x in part])
