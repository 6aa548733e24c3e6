"""The linear equations of a soft body: conjugate gradients, and a factor at rest as their preconditioner.

S at rest is factored once, for one step length. A body that has rotated since is nearly at rest in the frames of its
nodes: so with their rotations Theta the preconditioner is ``Theta S0^-1 Theta'``. It is positive definite for any
Theta; a good Theta saves rounds. A few columns of ``S0^-1`` are kept: the displacements by forces on those nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array

if TYPE_CHECKING:
    from hapnet.ext.soft.soft_body import Body

Indices = NDArray[np.int64]

FACTORED_S = 0.2
"""The step length for which S is factored [s]: good for 10 to 100 ms, and nearly static, so that S is the stiffness."""

MOST_ROUNDS = 60
MOST_COLUMNS = 500
"""Most nodes whose columns are kept: the nodes that were touched last."""


@cache
def one_thread() -> None:
    """Use one thread for linear algebra in this process from now on.

    A step solves matrices of some hundred rows. With more threads that takes 100 times as long where other programs
    run: all threads wait for a thread that the system has suspended.
    """
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, user_api="blas")


class Factor:
    """S at rest, ``2m/T + (T/2 + beta) K`` for T = `FACTORED_S`, factored.

    body : its tetrahedra, material and masses. places (N, 3) : the nodes' [m].

    If all nodes are free, there are rigid motions too: for these S is ``2m/T``, and their part of the inverse is exact.
    """

    def __init__(self, body: Body, places: Array) -> None:
        from scipy import sparse
        from scipy.sparse.linalg import splu

        mass, free, beta_s = body.mass, body.free, body.beta_s
        self._free, self._beta_s = free, beta_s
        self._rigid = rigid_modes(mass, places) if free == len(mass) else np.zeros((3 * free, 0))
        self._slots: dict[int, int] = {}
        self._kept: Array = np.empty((3 * MOST_COLUMNS, 3 * free))
        whole = (0.5 * FACTORED_S + beta_s) * stiffness_at_rest(body)
        inertia = sparse.diags(np.repeat(2.0 / FACTORED_S * mass, 3))
        whole = (whole + inertia)[: 3 * free, : 3 * free]
        symmetric = {"SymmetricMode": True}
        self._factor = splu(whole.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)

    @property
    def static(self) -> float:
        """The factor with which S0^-1 is about K^-1 [s]."""
        return 0.5 * FACTORED_S + self._beta_s

    def softness(self, dt: float) -> float:
        """The approximate ratio of S at its factored step length to S at a step of `dt` [s]."""
        return self.static / (0.5 * dt + self._beta_s)

    def solve(self, dt: float, local: Array) -> Array:
        """Approximate ``S^-1 b``, with b and the result in the frames of the nodes, (3 free,)."""
        found: Array = self._factor.solve(local) * self.softness(dt)
        if self._rigid.size:
            found += self._stiffer(dt) * (self._rigid @ (self._rigid.T @ local))
        return found

    def _stiffer(self, dt: float) -> float:
        """The correction of the inverse for rigid motions [s], over the mass."""
        return 0.5 * (dt - self.softness(dt) * FACTORED_S)

    def responses(self, dt: float, nodes: Indices, at: Indices | None = None) -> Array:
        """The approximate columns of ``S^-1`` for a step of `dt` [s] and free nodes (m,): (3 free, 3 m).

        at : only the rows of these free nodes (l,), in order: (3 l, 3 m).
        """
        found: Array = self.softness(dt) * self.columns(nodes, at)
        if self._rigid.size:
            rows = self._rigid if at is None else self._rigid[axes_of(at)]
            found += self._stiffer(dt) * (rows @ self._rigid[axes_of(nodes)].T)
        return found

    def columns(self, nodes: Indices, at: Indices | None = None) -> Array:
        """The columns of ``S0^-1``, as in `responses`: the body's displacements by forces on these nodes."""
        missing = [a for a in nodes.tolist() if a not in self._slots]
        if len(self._slots) + len(missing) > MOST_COLUMNS:
            self._slots.clear()
            missing = nodes.tolist()
        if missing:
            unit = np.zeros((3 * self._free, 3 * len(missing)))
            unit[axes_of(np.array(missing)), np.arange(3 * len(missing))] = 1.0
            first = len(self._slots)
            self._kept[3 * first : 3 * (first + len(missing))] = self._factor.solve(unit).T
            self._slots.update({a: first + i for i, a in enumerate(missing)})
        slots = axes_of(np.array([self._slots[a] for a in nodes.tolist()], dtype=np.int64))
        found: Array = self._kept[slots if at is None else np.ix_(slots, axes_of(at))].T
        return found


def stiffness_at_rest(body: Body) -> Any:
    """K at rest, a sparse matrix (3N, 3N)."""
    from scipy import sparse

    tets, g, unit = body.tets, body.grads, np.eye(3)
    blocks = np.einsum("e,ebi,eaj->eaibj", body.mu, g, g) + np.einsum("e,eak,ebk,ij->eaibj", body.mu, g, g, unit)
    rows = (3 * tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    where = (np.repeat(rows, 12, axis=1).ravel(), np.tile(rows, (1, 12)).ravel())
    size = 3 * len(body.mass)
    shear = sparse.csc_matrix((blocks.ravel(), where), (size, size))
    patch = np.repeat(np.arange(len(body.lam)), 12 * np.diff(body.patches))
    traces = sparse.csr_matrix(((body.shares[:, None, None] * g).ravel(), (patch, rows.ravel())), (len(body.lam), size))
    return (shear + traces.T @ sparse.diags(body.lam) @ traces).tocsc()


def axes_of(nodes: Indices) -> Indices:
    """The numbers of the axes of nodes (m,), in order (3m,)."""
    found: Indices = (3 * nodes[:, None] + np.arange(3)).ravel()
    return found


def rigid_modes(mass: Array, places: Array) -> Array:
    """An orthonormal basis of a body's rigid motions, in the metric of its masses (3N, 6)."""
    apart = places - mass @ places / mass.sum()
    turns = [np.cross(axis, apart) for axis in np.eye(3)]
    shifts = [np.broadcast_to(axis, places.shape) for axis in np.eye(3)]
    root = np.repeat(np.sqrt(mass), 3)[:, None]
    found: Array = np.linalg.qr(root * np.stack([one.ravel() for one in (*shifts, *turns)], axis=1))[0] / root
    return found


def conjugate_gradients(
    apply: Callable[[Array], Array], precondition: Callable[[Array], Array], b: Array, v: Array, tolerance: float
) -> tuple[Array, int]:
    """Solve ``S v = b`` up to a residual r with ``r . v = 0``, from the guess v; returns v and the number of rounds.

    tolerance : of the error's norm in S, as a share of the solution's.
    """
    v = v.copy()
    r = b - apply(v)
    z = precondition(r)
    p, left, rounds = z, float((r * z).sum()), 0
    while rounds < MOST_ROUNDS and left > tolerance * tolerance * abs(float((b * v).sum())) and left > 0.0:
        along = apply(p)
        share = left / float((p * along).sum())
        v += share * p
        r -= share * along
        z = precondition(r)
        before, left = left, float((r * z).sum())
        p = z + left / before * p
        rounds += 1
    work = float((v * apply(v)).sum())
    return (v * (float((v * b).sum()) / work) if work > 0.0 else v), rounds
