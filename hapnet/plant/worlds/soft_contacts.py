"""A ball, the proxy, and an elastic body that it presses: what a step needs and leaves, and its energy.

The equations of the points that touch are those of `hapnet.plant.worlds.soft_touch`, the body's those of
`hapnet.plant.worlds.soft_body`. The stored energy is anchored (`hapnet.plant.worlds.rigid_contacts`): at a step's onset
all strains and depths are set back to the true ones, times one common s that E_c can pay for. E_c gets what dampers and
friction dissipate. It is full at the start: this much the body may give out, and it is part of what is stored then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.observed_world import compliance_of
from hapnet.plant.worlds.rigid_contacts import padded
from hapnet.plant.worlds.soft_body import Body
from hapnet.plant.worlds.soft_linear import Indices, conjugate_gradients
from hapnet.plant.worlds.soft_planes import planes_at
from hapnet.plant.worlds.soft_touch import Touch

RESERVOIR_J = 0.01
"""The ceiling of E_c."""

TOLERANCE = 0.01
"""Of the linear solve."""

_SOLVES = 3
_FAR_M = 1e-3
"""If a node goes by so much farther than expected, the body's turns are computed again."""

_NEAR_M, _MOST = 1e-3, 40
"""A point may touch if it is nearer than this, and than what body and ball go; the most of them."""


@dataclass(frozen=True)
class Skin:
    """How a body meets the ball: k [N/m], b [Ns/m] and mu of each of its points; the ball's radius [m]."""

    stiffness: float = 500.0
    damping: float = 0.5
    friction: float = 0.3
    radius: float = 0.01


class SoftContacts(Surroundings):
    """The `Surroundings` of a ball and one body. dof : the ball's axes; the body always has three.

    Attributes: scale, s of the last step; discarded_J, in total; rounds, of the last step's solve, all passes; points,
    depths, pushes: the surface's points (P, 3) as nodes, and of the last step those that touch.
    """

    def __init__(self, body: Body, skin: Skin, dof: int, tolerance: float = TOLERANCE) -> None:
        self.body, self.skin, self._dof, self.tolerance = body, skin, dof, tolerance
        self.nodes, self.weights = surface_points(body.surface)
        self.reservoir_J, self.discarded_J = RESERVOIR_J, 0.0
        self.scale, self.rounds = 1.0, 0
        count = len(self.nodes)
        self.q: Array = np.zeros(count)
        self.drag: Array = np.zeros(count)  # c_t
        self.forces: Array = np.zeros((count, 3))  # on the points [N]
        self.centre: Array = np.zeros(3)  # of the ball, after the last step
        self.rest, self.outward_at_rest = self.places(body.x), self.outward()
        self._outward = self.outward_at_rest

    @property
    def dof(self) -> int:
        return self._dof

    # -- geometry -----------------------------------------------------------------------------------------------------

    def places(self, x: Array) -> Array:
        """The surface's points (P, 3) with the nodes at x (N, 3)."""
        found: Array = np.einsum("pk,pki->pi", self.weights, x[self.nodes])
        return found

    def outward(self) -> Array:
        """The normals of the surface's points (P, 3), about of unit length."""
        return self.places(self.body.turned_normals())

    def turn_of(self, point: int) -> Array:
        """How a point of the surface is turned (3, 3)."""
        return np.asarray(self.weights[point] @ self.body.nodal[self.nodes[point]].reshape(3, 9)).reshape(3, 3)

    def compliance(self, points: Indices, normals: Array) -> Array:
        """The static one along the normals (k, 3) of points (k,): what gives way by pushes on others (k, k) [m/N]."""
        to_points, held = self.from_nodes(points)
        rows = (3 * held[:, None] + np.arange(3)).ravel()
        along = np.einsum("ki,kim->km", normals, to_points.reshape(len(points), 3, -1))
        found: Array = self.body.factor.static * (along @ self.body.factor.columns(held)[rows] @ along.T)
        return found

    def from_nodes(self, points: Indices) -> tuple[Array, Indices]:
        """The matrix (3k, 3m) from the frames of free nodes (m,) to points (k,), and these nodes."""
        nodes, weights, body = self.nodes[points], self.weights[points], self.body
        held = np.unique(nodes[weights > 0.0])
        held = held[held < body.free]
        there = np.searchsorted(held, nodes)
        found: Array = np.zeros((len(points), 3, len(held), 3))
        for i in range(3):
            at = np.flatnonzero((weights[:, i] > 0.0) & (nodes[:, i] < body.free))
            node = there[at, i]
            found[at, :, node] += weights[at, i][:, None, None] * body.nodal[held[node]]
        return found.reshape(3 * len(points), 3 * len(held)), held

    def gaps(self, points: Array, centre: Array, which: Any = slice(None)) -> tuple[Array, Array]:
        """Depth (k,) [m] of points (k, 3) in the ball, and the unit normals (k, 3) from the ball into the body.

        which : the points' numbers.

        The ball is in front of a point's surface. If its centre is behind that of the nearest point, it has gone
        through: then this point is deeper than the radius.
        """
        apart = points - centre
        sizes = np.linalg.norm(apart, axis=1)
        outside = (apart * self._outward[which]).sum(axis=1) < 0.0
        depths = np.where(outside, self.skin.radius - sizes, -np.inf)
        normals = apart / np.maximum(sizes, 1e-12)[:, None]
        nearest = int(sizes.argmin()) if len(sizes) else -1
        if nearest >= 0 and not outside[nearest]:
            depths[nearest] = self.skin.radius + sizes[nearest]
            normals[nearest] *= -1.0
        return depths, normals

    # -- what it is to the mass ---------------------------------------------------------------------------------------

    def require_outside(self, position: Sequence[float]) -> None:
        if (depth := self.penetration(position)) > 0.0:
            allowed = f"a place for a ball of {self.skin.radius:g} m outside the body (it is {depth:.3g} m deep)"
            raise InvalidParameter("start", tuple(position), allowed)

    def penetration(self, position: Sequence[float]) -> float:
        """How deep the ball at `position` is in the point where it is deepest [m]."""
        depths, _ = self.gaps(self.places(self.body.x), np.array(padded(position)))
        return max(0.0, float(depths.max()))

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        return planes_at(self, np.array(padded(position)), reach_m)

    def stored_J(self, position: Sequence[float]) -> float:
        return self.body.moving_J + self._held_J() + self.reservoir_J

    def _held_J(self) -> float:
        return self.body.strained_J + 0.5 * self.skin.stiffness * float(self.q @ self.q)

    # -- a step -------------------------------------------------------------------------------------------------------

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        body, n = self.body, self._dof
        place, free = np.array(padded(position)), np.array(padded(velocity))
        compliance = np.zeros((3, 3))
        compliance[:n, :n] = compliance_of(inverse, n)
        points = self.places(body.x)
        depths = self._anchor(points, place)
        b = body.push(dt, body.mean)
        self._outward = self.outward()
        touch = self._touch(dt, points, depths, place, free, compliance)
        mean, forces, self.rounds = body.mean, self.forces[touch.points], 0
        expected, is_far = mean, False
        for turn in range(_SOLVES):
            settled = touch.settle(mean, forces, points[touch.points], depths[touch.points], place)
            if turn and (is_far := dt * float(np.abs(mean - expected).max()) > _FAR_M):
                b = body.push(dt, mean)
            if settled is None and not is_far:
                break
            expected, guess = mean, mean if settled is None else mean + touch.spread(settled - forces)
            mean, rounds = conjugate_gradients(touch.apply, touch.precondition, b + touch.load, guess, self.tolerance)
            ball = touch.ball(mean)
            rho = ball - touch.at_points(mean)
            forces = touch.forces(rho)
            self.rounds += rounds
        self._finish(dt, touch, mean, ball, rho, forces)
        self.centre = place + dt * ball
        return tuple((-forces.sum(axis=0))[:n].tolist()), ball[:n].tolist()

    def _touch(self, dt: float, points: Array, depths: Array, place: Array, free: Array, compliance: Array) -> Touch:
        """The points that may touch in this step: those that do, and those that the ball may come to."""
        way = dt * (np.linalg.norm(self.places(self.body.mean), axis=1) + np.linalg.norm(free))
        near = np.flatnonzero(depths > -(way + _NEAR_M))
        if len(near) > _MOST:
            near = np.sort(near[np.argsort(-depths[near])[:_MOST]])
        return Touch(self, dt, near, free, compliance)

    def _finish(self, dt: float, touch: Touch, mean: Array, ball: Array, rho: Array, forces: Array) -> None:
        """Body and springs at the step's end, and what was dissipated."""
        body, skin = self.body, self.skin
        along = (touch.normals * rho).sum(axis=1)
        slip = (rho * rho).sum(axis=1) - along * along
        dissipated = dt * (
            body.beta_s * float((mean * body.stiffness(mean)).sum())
            + skin.damping * float(touch.theta @ (along * along))
            + float(touch.drag @ slip)
        )
        self.q[touch.points] += dt * touch.theta * along
        for kept, new in ((self.forces, forces), (self.drag, touch.next_drag(rho, forces))):
            kept[:] = 0.0
            kept[touch.points] = new
        body.advance(dt, mean)
        whole = self.reservoir_J + dissipated
        self.reservoir_J = min(whole, RESERVOIR_J)
        self.discarded_J += whole - self.reservoir_J

    def _anchor(self, points: Array, place: Array) -> Array:
        """Set strains and depths back to the true ones; these depths (P,) [m]."""
        body = self.body
        held = self._held_J()
        body.strains[:] = body.true_strains()
        depths, _ = self.gaps(points, place)
        self.q = np.maximum(depths, 0.0)
        true, at_hand = self._held_J(), held + self.reservoir_J
        self.scale = 1.0
        if true > at_hand:
            self.scale = sqrt(at_hand / true)
            body.strains *= self.scale
            self.q *= self.scale
            self.reservoir_J = max(0.0, at_hand - self._held_J())
        else:
            self.reservoir_J = min(at_hand - true, RESERVOIR_J)
            self.discarded_J += at_hand - true - self.reservoir_J
        return depths


def surface_points(surface: Indices) -> tuple[Indices, Array]:
    """The points of a surface that can touch: its nodes, and the middles of its edges. As nodes and weights (P, 3)."""
    nodes = np.unique(surface)
    edges = np.unique(
        np.sort(np.concatenate([surface[:, [0, 1]], surface[:, [1, 2]], surface[:, [2, 0]]]), axis=1), axis=0
    )
    corners = np.concatenate([np.repeat(nodes[:, None], 3, axis=1), edges[:, [0, 1, 1]]])
    weights = np.concatenate([np.tile((1.0, 0.0, 0.0), (len(nodes), 1)), np.tile((0.5, 0.5, 0.0), (len(edges), 1))])
    return corners, weights
