"""The points of a soft body that touch a ball or solids in one step: one linear solve, and exact energy.

Points of the body's surface meet the ball with springs of depth q along a normal n, from the ball into the body. With
rho the ball's velocity less the point's, u = n . rho, and theta the share of the path on which they touch, a point gets

    f = k theta (q + theta T u/2) + b theta u along n, and c_t rho across it;    q1 = q + theta T u

so ``f u T`` is the spring's gain plus the dampers' dissipation, for any theta. With a solid, at rest, rho is the
point's velocity alone, or the ball's. theta and the friction's c_t (mu f over the speed) are found beforehand: with
both given, all forces are ``F = f0 n + H rho``, linear in the velocities. The ball's own equation ``A v_p = c - sum F``
is eliminated (a 3 x 3 Schur complement), the body's is solved by conjugate gradients to any tolerance and scaled so
that its residual does no work, and then the ball's is solved exactly. So the account closes at any tolerance. Without
the elimination the error would act on the ball: energy from nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import Array
from hapnet.ext.soft.soft_body import Marks
from hapnet.ext.soft.soft_linear import Indices, axes_of

if TYPE_CHECKING:
    from hapnet.ext.soft.soft_contacts import SoftContacts

_PASSES = 10
_SAME, _SLIGHT = 0.02, 0.01
"""Largest change of theta in the last pass; a theta below the second value is 0."""

_RUB = 0.1
"""Relative tolerance of friction."""

_CREEP_MPS = 5e-5
"""Below this speed friction is a damper: a contact that sticks creeps by less."""


class ContactEquations:
    """The points of one step that may touch, and their equations.

    contacts : of these points. dt : of the step [s]. points : (k,), as numbers of rows, in order.
    free, compliance : the ball's velocity without contact [m/s], and its C = A^-1, 0 along missing axes (3, 3).

    First the passes use an approximation of the body with only these points (`settle`): with G
    their compliance by the factor at rest, ``rho = rho_free - (G + C) F`` and ``F = f0 n + H rho``. Then the body's
    equation is solved with the resulting theta, normals and c_t.

    More than twenty attributes: a step's whole linear system, and the results that its passes share.
    """

    def __init__(self, contacts: SoftContacts, dt: float, points: Indices, free: Array, compliance: Array) -> None:
        self._contacts, self._dt, self.points = contacts, dt, points
        self._free, self._compliance = free, compliance
        self._nodes, self._weights = contacts.nodes[points], contacts.weights[points]
        self._by_ball: Array = contacts.by_ball[points, None]
        self._in_body = self._weights.any(axis=1, keepdims=True)
        self._stiffness, self._damping = contacts.stiffness[points], contacts.damping[points]
        self._first = int(np.searchsorted(points, contacts.points))  # of the solids
        self._to_points, self._held_nodes = contacts.from_nodes(points)
        count = len(points)
        self._columns_known = np.zeros((3 * count, 3 * count))  # G + C; only columns of `_known` points are computed
        self._known = np.zeros(count, dtype=bool)
        self._is_solved, self._eliminated = False, -1
        self._put(np.zeros(count), np.zeros((count, 3)), np.zeros(count))
        self.drag = contacts.drag[points]

    def _put(self, theta: Array, normals: Array, drag: Array) -> None:
        """Set theta, the normals and c_t."""
        self.theta, self.normals, self.drag = theta, normals, np.where(theta > 0.0, drag, 0.0)
        self._push = (self._stiffness * theta * self._contacts.q[self.points])[:, None] * normals  # f0 n
        firm = 0.5 * self._stiffness * self._dt * theta * theta + self._damping * theta
        along = normals[:, :, None] * normals[:, None, :]
        self._H = firm[:, None, None] * along + self.drag[:, None, None] * (np.eye(3) - along)

    def _compute_columns(self, which: Marks) -> None:
        """Compute the displacements of all points by forces on these points (k,), if not known yet."""
        new = np.flatnonzero(which & ~self._known)
        if not len(new):
            return
        self._known[new] = True
        to_points, held = self._contacts.from_nodes(self.points[new])
        of_nodes = self._contacts.body.factor.responses(self._dt, held, self._held_nodes)
        given = (to_points @ (self._to_points @ of_nodes).T).T
        given += np.kron(np.outer(self._by_ball, self._by_ball[new]), self._compliance)
        self._columns_known[:, axes_of(new)] = given

    # -- the passes ---------------------------------------------------------------------------------------------------

    def place(self, points: Array, depths: Array, centre: Array) -> None:
        """Set the places of all rows at the onset (C, 3) [m], their depths (C,) [m], and the ball's centre."""
        self._centre, self._depths = centre, depths[self.points]
        self._places = np.where(self._in_body, points[self.points], centre)
        self._mu = self._contacts.friction(self.points, self._places)

    def _travel(self, rho: Array, ball: Array) -> Array:
        """The displacements of the rows (k, 3) [m] with these velocities."""
        return self._dt * np.where(self._in_body, self._by_ball * ball - rho, ball)

    def _see(self, rho: Array, ball: Array) -> tuple[Array, Array]:
        """The solids' tangents half way: the rows' depths without their own displacement [m], and the normals."""
        rows, half = slice(self._first, None), 0.5 * self._travel(rho, ball)[self._first :]
        depths, normals = self._contacts.solids.tangents(
            self.points[rows] - self._contacts.points, self._places[rows] + half
        )
        return depths - 0.5 * self._dt * (normals * rho[rows]).sum(axis=1), normals

    def _gaps(self, rho: Array, ball: Array, solids: tuple[Array, Array]) -> tuple[Array, Array]:
        """Depths (k,) [m] at the step's end, and normals (k, 3) half way, with these velocities."""
        contacts, dt, first = self._contacts, self._dt, self._first
        travel, place, rows = self._travel(rho, ball)[:first], self._places[:first], self.points[:first]
        depths, _ = contacts.gaps(place + travel, self._centre + dt * ball, rows)
        _, normals = contacts.gaps(place + 0.5 * travel, self._centre + 0.5 * dt * ball, rows)
        still, across = solids
        return (
            np.concatenate([depths, still + dt * (across * rho[first:]).sum(axis=1)]),
            np.concatenate([normals, across]),
        )

    def settle(self, v: Array, forces: Array) -> Array | None:
        """Find theta, normals, c_t and the forces (k, 3) [N], of a body that moves with v (N, 3) under `forces`.

        None: they did not change since the body was solved.
        """
        given = self._columns_known
        self._compute_columns(np.asarray(forces.any(axis=1)))
        ball = self._free - self._compliance @ self.on_ball(forces)
        rho = self.rho(ball, v)
        free = rho.ravel() + given @ forces.ravel()
        solids = self._see(rho, ball)
        for turn in range(_PASSES):
            depths, normals = self._gaps(rho, ball, solids)
            theta = shares(self._depths, depths)
            if turn or self._is_solved:
                theta = np.where((forces * self.normals).sum(axis=1) < 0.0, 0.0, theta)
                if np.abs(theta - self.theta).max(initial=0.0) < _SAME and self._rubs_rightly(rho, forces):
                    if not turn:
                        return None
                    break
                theta = 0.5 * (theta + self.theta)
            self._put(
                np.where(theta > _SLIGHT, theta, 0.0), normals, self.next_drag(rho, forces) if turn else self.drag
            )
            touching: Marks = np.asarray(self.theta > 0.0)
            self._compute_columns(touching)
            rows = axes_of(np.flatnonzero(touching))
            inner = given[np.ix_(rows, rows)]
            beside = np.eye(len(rows)) + times_blocks(inner, self._H[touching])
            among = np.linalg.solve(beside, free[rows] - inner @ self._push[touching].ravel()).reshape(-1, 3)
            pushes = self._push[touching] + (self._H[touching] @ among[:, :, None])[:, :, 0]
            rho = (free - given[:, rows] @ pushes.ravel()).reshape(-1, 3)
            forces = self.forces(rho)
            ball = self._free - self._compliance @ self.on_ball(forces)
        self._is_solved = True
        self._eliminate()
        return forces

    def rho(self, ball: Array, v: Array) -> Array:
        """Return the pushing points' velocity less the pushed points' (k, 3) [m/s], from the velocities of the ball and
        the nodes (N, 3).
        """
        return self._by_ball * ball - self.at_points(v)

    def _rubs_rightly(self, rho: Array, forces: Array) -> bool:
        """Whether friction is nearly Coulomb's, of all points together."""
        push, slip = self._pushes(forces), self._slips(rho)
        wrong = np.abs(self.next_drag(rho, forces) - self.drag) * slip
        return float(wrong @ (self.theta > 0.0)) <= _RUB * float(self._mu @ push)

    def next_drag(self, rho: Array, forces: Array) -> Array:
        """c_t (k,) [Ns/m]: Coulomb's force over the present speed."""
        found: Array = self._mu * self._pushes(forces) / np.maximum(self._slips(rho), _CREEP_MPS)
        return found

    def _pushes(self, forces: Array) -> Array:
        """The components of forces along the normals (k,) [N]."""
        found: Array = np.maximum((forces * self.normals).sum(axis=1), 0.0)
        return found

    def _slips(self, rho: Array) -> Array:
        """The speeds across the normals (k,) [m/s]."""
        found: Array = np.linalg.norm(rho - (rho * self.normals).sum(axis=1)[:, None] * self.normals, axis=1)
        return found

    def forces(self, rho: Array) -> Array:
        """The forces of the rows on the pushed parts (k, 3) [N]."""
        found: Array = self._push + (self._H @ rho[:, :, None])[:, :, 0]
        return found

    def on_ball(self, forces: Array) -> Array:
        """Return the force of the ball on them (3,) [N]."""
        found: Array = (self._by_ball * forces).sum(axis=0)
        return found

    # -- the body's equation, without the ball ------------------------------------------------------------------------

    def _eliminate(self) -> None:
        """``(I + C sum H) v_p = w - C sum (f0 n - H v_i)``, and compute the preconditioner's parts."""
        by_ball = self._by_ball[:, :, None] * self._H
        whole = by_ball.sum(axis=0)
        self._schur = np.linalg.solve(np.eye(3) + self._compliance @ whole, self._compliance)
        self._held = self._free - self._schur @ (whole @ self._free + self.on_ball(self._push))
        self.load = self.to_nodes(self._push + by_ball @ self._held)
        touching = np.flatnonzero(self._known)
        if len(touching) != self._eliminated:
            to_points, self._pushed = self._contacts.from_nodes(self.points[touching])
            self._from_points, self._eliminated = to_points.T, len(touching)
            self._columns = self._contacts.body.factor.responses(self._dt, self._pushed)  # L
        beside = by_ball[touching].reshape(-1, 3)
        held_by = block_diagonal(self._H[touching]) - beside @ self._schur @ beside.T
        M = self._from_points @ (self._from_points @ held_by).T
        self._inner = np.linalg.solve(np.eye(len(M)) + M @ self._columns[axes_of(self._pushed)], M)

    def at_points(self, v: Array) -> Array:
        """Interpolate a field of the nodes (N, 3) at the points (k, 3)."""
        found: Array = np.einsum("pk,pki->pi", self._weights, v[self._nodes])
        return found

    def to_nodes(self, forces: Array) -> Array:
        """Distribute forces on the points (k, 3) to the nodes (N, 3)."""
        out = np.zeros_like(self._contacts.body.x)
        np.add.at(out, self._nodes, self._weights[:, :, None] * forces[:, None, :])
        out[self._contacts.body.free :] = 0.0
        return out

    def spread(self, forces: Array) -> Array:
        """The approximate change of the nodes' velocities (N, 3) by forces on the points (k, 3)."""
        local = self._from_points @ forces[self._known].ravel()
        return self._contacts.body.to_world(self._columns @ local)

    def yielded(self, forces: Array) -> Array:
        """The nodes' displacements by the ball (N, 3) [m] in a held body, if its forces (k, 3) persist."""
        return (0.5 * self._dt + self._contacts.body.beta_s) * self.spread(self._by_ball * forces)

    def apply(self, v: Array) -> Array:
        """Multiply v (N, 3) by the body's matrix, including the contacts, with the ball eliminated."""
        held = (self._H @ self.at_points(v)[:, :, None])[:, :, 0]
        back = self._by_ball * (self._H @ (self._schur @ self.on_ball(held)))
        return self._contacts.body.response(self._dt, v) + self.to_nodes(held - back)

    def precondition(self, residual: Array) -> Array:
        """Apply the preconditioner, including the contacts by Woodbury's formula."""
        body = self._contacts.body
        local = body.to_local(residual)
        found = body.factor.solve(self._dt, local) - self._columns @ (self._inner @ (self._columns.T @ local))
        return body.to_world(found)

    def ball(self, v: Array) -> Array:
        """v_p (3,) [m/s] with the body's mean velocity v."""
        held = (self._H @ self.at_points(v)[:, :, None])[:, :, 0]
        found: Array = self._held + self._schur @ self.on_ball(held)
        return found


def shares(before: Array, after: Array) -> Array:
    """theta: the share of a path that lies inside, from the depths at both ends."""
    d0, d1 = np.maximum(before, -1.0), np.maximum(after, -1.0)
    travel = np.maximum(np.abs(d1 - d0), 1e-12)
    inside = np.minimum(1.0, np.maximum(np.maximum(d0, d1), 0.0) / travel)
    return np.where(np.minimum(d0, d1) > 0.0, 1.0, inside)


def times_blocks(matrix: Array, blocks: Array) -> Array:
    """Multiply a matrix (n, 3k) by the block diagonal matrix of (k, 3, 3)."""
    parts: Array = matrix.reshape(len(matrix), len(blocks), 3).transpose(1, 0, 2) @ blocks
    return parts.transpose(1, 0, 2).reshape(matrix.shape)


def block_diagonal(blocks: Array) -> Array:
    """The block diagonal matrix (3k, 3k) of blocks (k, 3, 3)."""
    k = len(blocks)
    found = np.zeros((k, 3, k, 3))
    found[np.arange(k), :, np.arange(k)] = blocks
    return found.reshape(3 * k, 3 * k)
