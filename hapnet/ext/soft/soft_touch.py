"""The points of a soft body that touch a ball or solids in one step: one linear solve, and exact energy.

Points of the body's surface meet the ball with springs of depth q along a normal n, from the ball into the body. With
rho the ball's velocity less the point's, u = n . rho, and theta the share of the path on which they touch, a point gets

    f = k theta (q + theta T u/2) + b theta u along n, and friction g0 + J rho across it;    q1 = q + theta T u

so ``f u T`` is the spring's gain plus the dampers' dissipation, for any theta. With a solid, at rest, rho is the
point's velocity alone, or the ball's. theta and the friction's g0 and J (`soft_friction`) are found beforehand: with
these given, all forces are ``F = f0 + H rho``, linear in the velocities. The ball's own equation ``A v_p = c - sum F``
is eliminated (a 3 x 3 Schur complement), the body's is solved by conjugate gradients to any tolerance and scaled so
that its residual does no work, and then the ball's is solved exactly. So the account closes at any tolerance. Without
the elimination the error would act on the ball: energy from nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import Array
from hapnet.ext.soft.soft_body import Marks
from hapnet.ext.soft.soft_friction import across, damped, errors, linearised
from hapnet.ext.soft.soft_linear import Indices, axes_of

if TYPE_CHECKING:
    from hapnet.ext.soft.soft_contacts import SoftContacts

_PASSES = 10
_SAME, _SLIGHT = 0.02, 0.01
"""Largest change of theta in the last pass; a theta below the second value is 0."""

_RUB, _ROUGHLY, _CHANGES = 0.01, 0.1, 0.1
"""Relative tolerances of friction, of all points together: by Newton's method, and with dampers; and the change of
theta above which points that slide have dampers, as Newton's method may lose the contact from afar."""


class ContactEquations:
    """The points of one step that may touch, and their equations.

    contacts : of these points. dt : of the step [s]. points : (k,), as numbers of rows, in order.
    free, compliance : the ball's velocity without contact [m/s], and its C = A^-1, 0 along missing axes (3, 3).

    First the passes use an approximation of the body with only these points (`settle`): with G
    their compliance by the factor at rest, ``rho = rho_free - (G + C) F`` and ``F = f0 + H rho``. Then the body's
    equation is solved with the resulting theta, normals and friction.

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
        self._last = contacts.rho[points]
        self._put(np.zeros(count), contacts.normals[points])

    def _put(self, theta: Array, normals: Array) -> None:
        """Set theta and the normals, without friction."""
        self.theta, self.normals = theta, normals
        self._push = (self._stiffness * theta * self._contacts.q[self.points])[:, None] * normals  # f0
        firm = 0.5 * self._stiffness * self._dt * theta * theta + self._damping * theta
        self._H = firm[:, None, None] * normals[:, :, None] * normals[:, None, :]

    def _rub(self, damps: int, rub: Array, slip: Array, most: Array) -> None:
        """Add the friction near g, s and mu N of the rows, see `soft_friction`; damps : see `settle`."""
        at = self.theta > 0.0
        n = self.normals[at]  # they may have turned since
        law = across(rub[at], n), across(slip[at], n), most[at], self._gives()[at], n
        given, slope = damped(*law, is_whole=damps > 1) if damps else linearised(*law)
        self._push[at] += given
        self._H[at] += slope

    def _coulomb(self, rho: Array, forces: Array) -> tuple[Array, Array, Array]:
        """The rows' friction g [N], s [m/s] and mu N [N], of velocities and forces with the present normals."""
        pushes = np.maximum((forces * self.normals).sum(axis=1), 0.0)
        return across(forces, self.normals), across(rho, self.normals), self._mu * pushes

    def _gives(self) -> Array:
        """r (k,) [m/s per N]."""
        return np.asarray(np.diagonal(self._columns_known).reshape(-1, 3).mean(axis=1))

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

    def settle(self, v: Array, forces: Array, damps: int) -> Array | None:
        """Find theta, normals, friction and the forces (k, 3) [N], of a body that moves with v (N, 3) under `forces`.

        damps : 1: points that slide have dampers, 2: all points.
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
            changed = np.abs(theta - self.theta).max(initial=0.0)
            if turn or self._is_solved:
                theta = np.where((forces * self.normals).sum(axis=1) < 0.0, 0.0, theta)
                if np.abs(theta - self.theta).max(initial=0.0) < _SAME and self._rubs_rightly(
                    rho, forces, _ROUGHLY if damps else _RUB
                ):
                    if not turn:
                        return None
                    break
                theta = 0.5 * (theta + self.theta)
            is_first = not (turn or self._is_solved)
            coulomb = self._coulomb(self._last if is_first else rho, forces)
            self._put(np.where(theta > _SLIGHT, theta, 0.0), normals)
            touching: Marks = np.asarray(self.theta > 0.0)
            self._compute_columns(touching)
            self._rub(max(damps, int(changed > _CHANGES)), *coulomb)
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

    def _rubs_rightly(self, rho: Array, forces: Array, tolerance: float) -> bool:
        """Whether friction is nearly Coulomb's, of all points together."""
        touching = self.theta > 0.0
        rub, slip, most = (part[touching] for part in self._coulomb(rho, forces))
        return float(errors(rub, slip, most, self._gives()[touching]).sum()) <= tolerance * float(most.sum())

    def rubbed_W(self, rho: Array, forces: Array) -> float:
        """The power that friction takes [W]."""
        return float((forces * across(rho, self.normals)).sum())

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
        """``(I + C sum H) v_p = w - C sum (f0 - H v_i)``, and compute the preconditioner's parts."""
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
