"""The contacts between a ball, which is the proxy, an elastic body and rigid solids: a step, and its energy.

The equations of the points that touch are those of `hapnet.ext.soft.soft_touch`, the body's those of
`hapnet.ext.soft.soft_body`. The stored energy is anchored (`hapnet.ext.solids.rigid_contacts`): at a step's onset
all strains and depths are set back to the true ones, times one common s that E_c can pay for. E_c gets the energy that
dampers and friction dissipate. It is full at the start: the body may give out this much, which counts as stored then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.observed_world import compliance_of
from hapnet.ext.soft.soft_body import Body
from hapnet.ext.soft.soft_layer import Layer
from hapnet.ext.soft.soft_linear import Indices, conjugate_gradients, one_thread
from hapnet.ext.soft.soft_planes import planes_at
from hapnet.ext.soft.soft_solids import Solids
from hapnet.ext.soft.soft_touch import ContactEquations, block_diagonal
from hapnet.ext.solids.rigid_contacts import Solid, padded
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane

RESERVOIR_J = 0.01
"""The ceiling of E_c."""

NODE_N_PER_M = 500.0
"""The stiffness of a node's contact with a solid, if no other is given."""

TOLERANCE = 0.01
"""Relative tolerance of the linear solve."""

_SOLVES, _NEWTON, _CAREFUL = 8, 2, 5
"""The most solves in a step; the first of them in which points that slide have dampers, and in which all have: those
take energy, so E_c need not pay."""

_FAR_M = 3e-4
"""If a node moves farther than expected by more than this, the body's rotations are computed again."""

_NEAR_M, _MOST, _MOST_LYING = 3e-3, 150, 300
"""A point may touch if it is nearer to the ball's path than this plus its own displacement; the most points that touch
the ball, and that touch solids."""

_FREE = 1e3
"""Compliance of a body that nothing holds [m/N]."""

_SETTLING_S, _SETTLES, _SETTLED_MPS = (0.01, 0.1), 20, 1e-4
"""The first steps are short: in a long step a body would tilt over an edge before the contact pushes back."""

_SUNK = 0.5
"""Largest cosine by which a touching point may lie behind the ball's centre: a ball that has sunk in by more than its
radius also touches the surface beside it."""

_STAYS_S = 0.5
"""Time constant with which the shape without the ball is filtered: a held body has about its shape at rest, and the
estimate from a single step's motion is rough."""


@dataclass(frozen=True)
class Skin:
    """The contact between body and ball: k [N/m], b [Ns/m] and mu of each point; the ball's radius [m].

    stiffness : None: what the mesh lacks to be as soft as its material under a ball (`hapnet.ext.soft.soft_layer`).
        Then `damping` is for a point of `NODE_N_PER_M`, and those of less or more stiffness have less or more.
    """

    stiffness: float | None = None
    damping: float = 0.5
    friction: float = 0.3
    radius: float = 0.01


class SoftContacts(Surroundings):
    """The `Surroundings` of a ball, one body and solids. dof : the ball's axes; the body always has three.

    A contact is a row: the first `points` rows are the contacts of the body's surface with the ball, then those of the
    surface's nodes with each solid, and last those of the ball with each solid. nodes, weights (C, 3): the place of a
    row in the body. by_ball (C,) : 1 if the row moves with the ball, else 0. stiffness, damping (C,) [N/m], [Ns/m].

    Attributes: scale, s of the last step; discarded_J, in total; rounds, of the last step's solve, all passes; q (C,)
    [m] and forces (C, 3) [N], of the rows; still: the rows' places without the ball (C, 3) [m], None: not known, as
    nothing holds the body.

    More than twenty attributes: the rows have an array for each quantity.
    """

    def __init__(
        self, body: Body, skin: Skin, dof: int, tolerance: float = TOLERANCE, solids: Sequence[Solid] = ()
    ) -> None:
        one_thread()
        self.body, self.skin, self._dof, self.tolerance = body, skin, dof, tolerance
        layer = Layer(body, skin)
        nodes, weights, base = surface_points(body.surface, layer.stiffness)
        self.layer = layer
        self.points, corners, many = len(nodes), len(np.unique(body.surface)), len(solids)
        self.solids = Solids(solids, corners, skin.radius)
        self.nodes: Indices = np.concatenate([nodes, *[nodes[:corners]] * many, np.zeros((many, 3), dtype=np.int64)])
        self.weights: Array = np.concatenate([weights, *[weights[:corners]] * many, np.zeros((many, 3))])
        self.reservoir_J, self.discarded_J = RESERVOIR_J, 0.0
        self.scale, self.rounds = 1.0, 0
        count = len(self.nodes)
        self.by_ball: Array = np.ones(count)
        self.stiffness: Array = np.full(count, skin.stiffness or NODE_N_PER_M)
        self.damping: Array = np.full(count, skin.damping)
        self.firm: Array = base if skin.stiffness is None else self.stiffness[: self.points].copy()
        self._factor = layer.factor(0.0)
        self.damping[: self.points] *= self.firm / (skin.stiffness or NODE_N_PER_M)
        if many:
            self.by_ball[self.points : -many] = 0.0
            self.stiffness[-many:] = [solid.stiffness for solid in solids]
            self.damping[-many:] = [solid.damping for solid in solids]
        self.q: Array = np.zeros(count)
        self._stiffen()
        self.forces: Array = np.zeros((count, 3))  # on the points [N]
        self.rho: Array = np.zeros((count, 3))  # of the last step
        self.normals: Array = np.zeros((count, 3))
        self.centre: Array = np.zeros(3)  # of the ball, after the last step
        self.rest, self.outward_at_rest = self.places(body.x), self.outward()
        self._outward = self.outward_at_rest
        self._falling = float((np.linalg.norm(body.weight, axis=1) / body.mass).max())  # [m/s2]
        self.still = self.rest.copy() if body.free < len(body.x) else None

    @property
    def dof(self) -> int:
        return self._dof

    # -- geometry -----------------------------------------------------------------------------------------------------

    def places(self, x: Array) -> Array:
        """The places of all rows in the body (C, 3), with the nodes at x (N, 3)."""
        found: Array = np.einsum("pk,pki->pi", self.weights, x[self.nodes])
        return found

    def outward(self) -> Array:
        """The body's normals at all rows (C, 3), of about unit length."""
        return self.places(self.body.turned_normals())

    def turn_of(self, point: int) -> Array:
        """The rotation of a point of the surface (3, 3)."""
        return np.asarray(self.weights[point] @ self.body.nodal[self.nodes[point]].reshape(3, 9)).reshape(3, 3)

    def compliance(self, points: Indices) -> Array:
        """The static compliance of points (k,): their displacements by forces on one another (3k, 3k) [m/N].

        A body on solids is held by the springs of its contacts, and with friction also across them.
        """
        resting = np.flatnonzero((self.q > 0.0) & (self.by_ball == 0.0))
        to_points, held = self.from_nodes(np.concatenate([points, resting]))
        cut = 3 * len(points)
        of_nodes = self.body.factor.static * self.body.factor.columns(held, held)
        whole = to_points @ (to_points @ of_nodes.T).T
        springs = block_diagonal(self._held_by(resting))
        found: Array = whole[:cut, :cut] - whole[:cut, cut:] @ np.linalg.solve(
            whole[cut:, cut:] + springs, whole[cut:, :cut]
        )
        return found

    def _held_by(self, rows: Indices) -> Array:
        """The compliance of the nodes' contacts with solids (k, 3, 3) [m/N]."""
        places, gives = self.places(self.body.x)[rows], 1.0 / self.stiffness[rows, None, None]
        _, normals = self.solids.tangents(rows - self.points, places)
        along = normals[:, :, None] * normals[:, None, :]
        across = np.where(self.friction(rows, places)[:, None, None] > 0.0, gives, _FREE)
        found: Array = gives * along + across * (np.eye(3) - along)
        return found

    def from_nodes(self, points: Indices) -> tuple[Any, Indices]:
        """The sparse matrix (3k, 3m) from the frames of free nodes (m,) to rows (k,), and these nodes."""
        from scipy import sparse

        nodes, weights, body = self.nodes[points], self.weights[points], self.body
        held = np.unique(nodes[weights > 0.0])
        held = held[held < body.free]
        row, of = np.nonzero((weights > 0.0) & (nodes < body.free))
        node = nodes[row, of]
        blocks = weights[row, of][:, None, None] * body.nodal[node]
        until = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(points)))])
        shape = (3 * len(points), 3 * len(held))
        return sparse.bsr_array((blocks, np.searchsorted(held, node), until), shape, blocksize=(3, 3)), held

    def gaps(self, points: Array, centre: Array, which: Any = slice(None)) -> tuple[Array, Array]:
        """Depth (k,) [m] of points (k, 3) in the ball, and the unit normals (k, 3) from the ball into the body.

        which : the rows' numbers, without rows of solids.

        The ball is in front of a point's surface, or has sunk in beside it. If its centre is behind the surface at the
        nearest point, it has passed through: then this point is deeper than the radius.
        """
        apart = points - centre
        sizes = np.linalg.norm(apart, axis=1)
        outside = (apart * self._outward[which]).sum(axis=1) < _SUNK * sizes
        depths = np.where(outside, self.skin.radius - sizes, -np.inf)
        normals = apart / np.maximum(sizes, 1e-12)[:, None]
        nearest = int(sizes.argmin()) if len(sizes) else -1
        if nearest >= 0 and not outside[nearest]:
            depths[nearest] = self.skin.radius + sizes[nearest]
            normals[nearest] *= -1.0
        return depths, normals

    # -- surroundings of the mass -------------------------------------------------------------------------------------

    def require_outside(self, position: Sequence[float]) -> None:
        if (depth := self.penetration(position)) > 0.0:
            allowed = f"a place for a ball of {self.skin.radius:g} m outside the body (it is {depth:.3g} m deep)"
            raise InvalidParameter("start", tuple(position), allowed)

    def penetration(self, position: Sequence[float]) -> float:
        """The depth of the ball at `position` at its deepest point [m]."""
        centre, ball = np.array(padded(position)), slice(0, self.points)
        depths, _ = self.gaps(self.places(self.body.x)[ball], centre, ball)
        others, _ = self.solids.tangents(*self._balls(centre))
        return float(np.concatenate([[0.0], depths, others]).max())

    def _balls(self, centre: Array) -> tuple[Indices, Array]:
        """The rows of the ball with solids, and the ball's place for each."""
        rows = np.arange(self.solids.balls, self.solids.rows)
        return rows, np.tile(centre, (len(rows), 1))

    def depths(self, points: Array, centre: Array, travel: Array) -> Array:
        """The depths of all rows (C,) [m]; each may move by at most `travel` (C,) [m]."""
        ball, middle = slice(0, self.points), slice(self.points, self.points + self.solids.balls)
        corners = slice(0, self.solids.count)
        found, _ = self.gaps(points[ball], centre, ball)
        others = self.solids.depths(points[corners], travel[middle])
        return np.concatenate([found, others, self.solids.tangents(*self._balls(centre))[0]])

    def friction(self, rows: Indices, places: Array) -> Array:
        """mu of rows (k,) at places (k, 3): for a node and a solid the larger of both."""
        found, first = np.full(len(rows), self.skin.friction), int(np.searchsorted(rows, self.points))
        mu = self.solids.friction(rows[first:] - self.points, places[first:])
        found[first:] = np.where(self.by_ball[rows[first:]] > 0.0, mu, np.maximum(mu, found[first:]))
        return found

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        return planes_at(self, np.array(padded(position)), reach_m)

    def stored_J(self, position: Sequence[float]) -> float:
        return self.body.moving_J + self._held_J() + self.reservoir_J

    def _held_J(self) -> float:
        return self.body.strained_J + 0.5 * float(self.stiffness @ (self.q * self.q))

    # -- a step -------------------------------------------------------------------------------------------------------

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        n, place, free = self._dof, np.array(padded(position)), np.array(padded(velocity))
        compliance = np.zeros((3, 3))
        compliance[:n, :n] = compliance_of(inverse, n)
        points, travel = self.places(self.body.x), self._travel(dt, free)
        depths = self.depths(points, place, travel)
        force, ball = self._advance(dt, points, depths, travel, place, free, compliance)
        self.centre = place + dt * ball
        return tuple((-force)[:n].tolist()), ball[:n].tolist()

    def settle(self) -> float:
        """Let the body come to rest under gravity and on the solids, without the ball. Returns the last speed [m/s]."""
        body, speed, none = self.body, 0.0, np.zeros(3)
        first, longest = _SETTLING_S
        for turn in range(_SETTLES):
            dt = min(first * 2.0**turn, longest)
            points, travel = self.places(body.x), self._travel(dt, none)
            depths = np.full(len(points), -np.inf)
            nodes = points[: self.solids.count]
            depths[self.points : self.points + self.solids.balls] = self.solids.depths(
                nodes, travel[self.points : self.points + self.solids.balls]
            )
            self.reservoir_J = inf
            self._advance(dt, points, depths, travel, none, none, np.zeros((3, 3)))
            body.v[:] = 0.0
            speed = float(np.abs(body.mean).max())
            if speed < _SETTLED_MPS:
                break
        body.strains[:] = body.true_strains()
        body.mean[:] = 0.0
        self.still = None if self.still is None else self.places(body.x)
        self.reservoir_J, self.discarded_J = RESERVOIR_J, 0.0
        return speed

    def _travel(self, dt: float, free: Array) -> Array:
        """The largest displacement of each row [m]: by the motion of ball and body, and by the body's fall."""
        reached = np.linalg.norm(self.places(self.body.mean), axis=1) + self.by_ball * np.linalg.norm(free)
        found: Array = dt * (reached + (1.0 - self.by_ball) * dt * self._falling)
        return found

    def _advance(
        self, dt: float, points: Array, depths: Array, travel: Array, place: Array, free: Array, compliance: Array
    ) -> tuple[Array, Array]:
        """Make a step. Returns the ball's total force (3,) [N], and its velocity (3,) [m/s]."""
        body = self.body
        self._anchor(depths)
        b = body.push(dt, body.mean)
        self._outward = self.outward()
        touch = ContactEquations(self, dt, self._near(depths, points, travel, place, dt * free), free, compliance)
        touch.place(points, depths, place)
        mean, forces, rho, self.rounds = body.mean, self.forces[touch.points], self.rho[touch.points], 0
        expected, is_far, rubbed = mean, False, 0.0
        for turn in range(_SOLVES):
            damps = int(turn >= _NEWTON) + int(turn >= _CAREFUL)
            settled = touch.settle(mean, forces, damps)
            if turn and (is_far := dt * float(np.abs(mean - expected).max()) > _FAR_M):
                b = body.push(dt, mean)
            if settled is None and not is_far and (damps > 1 or self.reservoir_J + rubbed >= 0.0):
                break
            expected, guess = mean, mean if settled is None else mean + touch.spread(settled - forces)
            mean, rounds = conjugate_gradients(touch.apply, touch.precondition, b + touch.load, guess, self.tolerance)
            ball = touch.ball(mean)
            rho = touch.rho(ball, mean)
            forces = touch.forces(rho)
            rubbed = dt * touch.rubbed_W(rho, forces)
            self.rounds += rounds
        self._finish(dt, touch, mean, rho, forces)
        return touch.on_ball(forces), ball

    def _near(self, depths: Array, points: Array, travel: Array, place: Array, going: Array) -> Indices:
        """The rows that touch, or may touch, in this step.

        travel : the largest displacement of each (C,) [m]. going : the ball's displacement from `place` on (3,) [m].
        """
        apart = points - place
        share = np.clip(apart @ going / max(float(going @ going), 1e-12), 0.0, 1.0)
        passing = self.skin.radius - np.linalg.norm(apart - share[:, None] * going, axis=1)
        by_ball = (np.arange(len(depths)) < self.points) & (depths > -np.inf)
        ahead = np.where(by_ball, np.maximum(depths, passing), depths)
        near = np.flatnonzero(ahead > -(travel - by_ball * np.linalg.norm(going) + _NEAR_M))
        first = int(np.searchsorted(near, self.points))
        return np.concatenate([_deepest(near[:first], ahead, _MOST), _deepest(near[first:], depths, _MOST_LYING)])

    def _finish(self, dt: float, touch: ContactEquations, mean: Array, rho: Array, forces: Array) -> None:
        """Compute body and springs at the step's end, and the dissipated energy."""
        body = self.body
        along = (touch.normals * rho).sum(axis=1)
        dissipated = dt * (
            body.beta_s * float((mean * body.stiffness(mean)).sum())
            + float((self.damping[touch.points] * touch.theta) @ (along * along))
            + touch.rubbed_W(rho, forces)
        )
        self.q[touch.points] += dt * touch.theta * along
        for kept, new in ((self.forces, forces), (self.rho, rho), (self.normals, touch.normals)):
            kept[:] = 0.0
            kept[touch.points] = new
        if body.free == len(body.x) and not forces.any() and not self.q.any():
            dissipated = self._fly(dt, mean, dissipated)
        else:
            body.advance(dt, mean)
        if self.still is not None:
            shape = self.places(body.x + body.beta_s * mean - touch.yielded(forces))
            self.still += dt / (_STAYS_S + dt) * (shape - self.still)
        whole = self.reservoir_J + dissipated
        self.reservoir_J = min(whole, RESERVOIR_J)
        self.discarded_J += whole - self.reservoir_J

    def _fly(self, dt: float, mean: Array, dissipated: float) -> float:
        """Make the step of a body that nothing touches, with its momentum kept if E_c can pay. Returns E_c's gain [J].

        dissipated : with the mean velocity as solved (N, 3) [J].
        """
        body, before = self.body, self.body.moving_J + self.body.strained_J
        kept = body.x.copy(), body.v.copy(), body.strains.copy()
        body.advance(dt, body.with_momentum(dt, mean))
        left = before - body.moving_J - body.strained_J
        if self.reservoir_J + left >= 0.0:
            return left
        body.x, body.v, body.strains = kept
        body.advance(dt, mean)
        return dissipated

    def _stiffen(self) -> None:
        """Bring the stiffness of the ball's contacts nearer to that by their present force."""
        ball = slice(0, self.points)
        wanted = self.layer.factor(float(self.stiffness[ball] @ self.q[ball]))
        self._factor += 0.5 * (wanted - self._factor)
        self.stiffness[ball] = self._factor * self.firm

    def _anchor(self, depths: Array) -> None:
        """Set strains and depths back to the true ones; `depths` (C,) [m]."""
        body = self.body
        held = self._held_J()
        body.strains[:] = body.true_strains()
        self.q = np.maximum(depths, 0.0)
        self._stiffen()
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


def _deepest(rows: Indices, depths: Array, most: int) -> Indices:
    """The deepest of these rows, in order."""
    return rows if len(rows) <= most else np.sort(rows[np.argsort(-depths[rows])[:most]])


def surface_points(surface: Indices, stiffness: Array) -> tuple[Indices, Array, Array]:
    """The points of a surface that can touch, its nodes and the middles of its edges: nodes and weights (P, 3), and the
    part of the triangles' stiffness (F,) [N/m] that each has (P,).
    """
    nodes = np.unique(surface)
    pairs = np.sort(np.concatenate([surface[:, [0, 1]], surface[:, [1, 2]], surface[:, [2, 0]]]), axis=1)
    edges, of = np.unique(pairs, axis=0, return_inverse=True)
    corners = np.concatenate([np.repeat(nodes[:, None], 3, axis=1), edges[:, [0, 1, 1]]])
    weights = np.concatenate([np.tile((1.0, 0.0, 0.0), (len(nodes), 1)), np.tile((0.5, 0.5, 0.0), (len(edges), 1))])
    of_nodes = np.bincount(np.searchsorted(nodes, surface).ravel(), np.repeat(stiffness / 12.0, 3))
    return corners, weights, np.concatenate([of_nodes, np.bincount(of.reshape(-1), np.tile(stiffness / 4.0, 3))])
