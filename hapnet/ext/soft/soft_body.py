"""An elastic body of tetrahedra: its mesh, its material, its state, and the parts of its linear equations.

A step of length T has one linear system, with K the stiffness rotated with the body, and beta its damping:

    S v = b,    S = 2m/T + (T/2 + beta) K

It is solved by conjugate gradients with a factor at rest as preconditioner (`soft_linear`), in the frames of the nodes:
a node's rotation Theta is the mean of the rotations of the tetrahedra around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.ext.soft.soft_elastic import equations
from hapnet.ext.soft.soft_linear import Factor, Indices

Marks = NDArray[np.bool_]

_LEAST_AROUND = 4
"""The fewest tetrahedra around an edge that make a patch."""


@dataclass(frozen=True)
class Material:
    """The material of a body.

    young : of each tetrahedron (E,), or of all [Pa]. poisson : its ratio, below 0.5. density : [kg/m^3].
    beta_s : damping, as a share of the stiffness [s]. gravity : (3,) [m/s^2].
    """

    young: Any = 20e3
    poisson: float = 0.4
    density: float = 1000.0
    beta_s: float = 0.01
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)


class Body:
    """A body at rest, undeformed.

    nodes : (N, 3) [m]. tets : (E, 4), as indices of nodes, of positive volume. pinned : (N,), true for a fixed node.

    Attributes: x, v (N, 3) [m], [m/s], and mean, the velocity of the last step; pinned nodes are the last nodes, from
    `free` on. mass (N,) [kg]. patches (P + 1,), shares, strains (E, 6), turns (E, 3, 3), see `soft_elastic`; middle, h:
    the rotations and rotated gradients of a step's middle; nodal (N, 3, 3) : Theta. surface (F, 3), normals (N, 3)
    outwards at rest. young (N,) [Pa], poisson : of the material at the surface.

    More than twenty attributes: the arrays of the mesh, of its state and of a step's middle, for the compiled loops.
    """

    def __init__(self, nodes: Array, tets: Indices, pinned: Marks, material: Material) -> None:
        number: Indices = np.empty(len(nodes), dtype=np.int64)
        order = np.argsort(pinned, kind="stable")
        number[order] = np.arange(len(nodes))
        self.free = int(len(nodes) - np.count_nonzero(pinned))
        self.x: Array = np.ascontiguousarray(nodes[order], dtype=float)
        self.v: Array = np.zeros_like(self.x)
        self.mean: Array = np.zeros_like(self.x)
        tets, self.patches, order = in_patches(number[tets], self.x)
        self.tets: Indices = np.ascontiguousarray(tets)
        edges = self.x[self.tets[:, 1:]] - self.x[self.tets[:, :1]]
        volumes: Array = np.asarray(np.linalg.det(edges) / 6.0, dtype=np.float64)
        self.grads: Array = np.empty((len(tets), 4, 3))
        self.grads[:, 1:] = np.linalg.inv(edges).transpose(0, 2, 1)
        self.grads[:, 0] = -self.grads[:, 1:].sum(axis=1)
        young = np.broadcast_to(material.young, len(tets))[order]
        modulus = volumes * young / (1.0 + material.poisson)
        starts = self.patches[:-1]
        self.lam: Array = np.add.reduceat(modulus, starts) * material.poisson / (1.0 - 2.0 * material.poisson)
        self.shares: Array = volumes / np.repeat(np.add.reduceat(volumes, starts), np.diff(self.patches))
        self.mu: Array = 0.5 * modulus
        self.beta_s = material.beta_s
        parts = np.repeat(0.25 * material.density * volumes, 4)
        self.mass: Array = np.asarray(np.bincount(self.tets.ravel(), parts), dtype=np.float64)
        self.weight: Array = self.mass[:, None] * material.gravity
        self.weight[self.free :] = 0.0
        self.turns: Array = np.tile(np.eye(3), (len(tets), 1, 1))
        self.middle: Array = self.turns.copy()  # Q
        self.strains: Array = np.zeros((len(tets), 6))
        self.h: Array = self.grads.copy()
        self._stretch, self._spin = self.turns.copy(), self.turns.copy()  # A, M
        self._slopes: Array = np.tile(np.eye(6), (len(tets), 1, 1))
        self._rates: Array = np.zeros_like(self.strains)
        self.surface = boundary(self.tets, self.x)
        self.normals: Array = corner_normals(self.x, self.surface)
        self._around = self._mean_of_turns(volumes)
        self.young: Array = self._around @ young
        self.poisson = material.poisson
        self.factor = Factor(self, self.x)
        self.nodal: Array = np.tile(np.eye(3), (len(nodes), 1, 1))  # Theta

    # -- energies -----------------------------------------------------------------------------------------------------

    @property
    def moving_J(self) -> float:
        """Kinetic energy, and potential energy in the field of gravity [J]."""
        return float(0.5 * (self.mass @ (self.v * self.v).sum(axis=1)) - (self.weight * self.x).sum())

    @property
    def strained_J(self) -> float:
        """Energy of the stored strains [J]."""
        return float(equations().energy(self.patches, self.shares, self.lam, self.mu, self.strains))

    # -- a step's parts -----------------------------------------------------------------------------------------------

    def true_strains(self) -> Array:
        """The strains at the present positions (E, 6), and the rotations."""
        equations().turn(self.x, self.tets, self.grads, self.turns)
        found = np.zeros_like(self.strains)
        equations().strain(self.x, self.tets, self.grads, self.turns, found)
        equations().general_strain(found)
        return found

    def push(self, dt: float, mean: Array) -> Array:
        """b without contacts (N, 3) [N], of the body rotated as half way through a step of `dt` [s] with `mean`."""
        half = self.x + 0.5 * dt * mean
        self.middle[:] = self.turns
        equations().turn(half, self.tets, self.grads, self.middle)
        equations().turned(half, self.tets, self.grads, self.middle, self.h, self._stretch, self._spin)
        equations().slopes(self._stretch, self._slopes)
        b: Array = (2.0 / dt * self.mass)[:, None] * self.v + self.weight
        strains = np.zeros_like(self.strains)
        equations().rotate(self.middle, self.strains, 1.0, strains)
        self._spread(strains, -1.0, b)
        b[self.free :] = 0.0
        self.nodal[:] = (self._around @ self.middle.reshape(-1, 9)).reshape(-1, 3, 3)
        return b

    def _spread(self, strains: Array, sign: float, out: Array) -> None:
        """Add the forces of these strains, in the frame of space (E, 6), times `sign` to out (N, 3)."""
        equations().spread(
            self.tets,
            self.h,
            self._stretch,
            self._spin,
            self._slopes,
            self.patches,
            self.shares,
            self.lam,
            self.mu,
            strains,
            sign,
            out,
        )

    def _rates_of(self, v: Array) -> Array:
        """The strains' rates (E, 6) in the frame of space."""
        equations().rates(v, self.tets, self.h, self._stretch, self._spin, self._slopes, self._rates)
        return self._rates

    def stiffness(self, v: Array) -> Array:
        """K v (N, 3)."""
        out = np.zeros_like(v)
        self._spread(self._rates_of(v), 1.0, out)
        out[self.free :] = 0.0
        return out

    def response(self, dt: float, v: Array) -> Array:
        """S v (N, 3) [N]."""
        out = self.stiffness(v)
        out *= 0.5 * dt + self.beta_s
        out += (2.0 / dt * self.mass)[:, None] * v
        out[self.free :] = 0.0
        return out

    def to_local(self, forces: Array) -> Array:
        """(N, 3) in the frames of the free nodes, (3 free,)."""
        turns = self.nodal[: self.free].transpose(0, 2, 1)
        found: Array = (turns @ forces[: self.free, :, None]).ravel()
        return found

    def to_world(self, local: Array) -> Array:
        """The inverse of `to_local`, if Theta is a rotation."""
        out = np.zeros_like(self.x)
        out[: self.free] = (self.nodal[: self.free] @ local.reshape(-1, 3, 1))[:, :, 0]
        return out

    def with_momentum(self, dt: float, mean: Array) -> Array:
        """The mean velocity (N, 3), with the rigid motion added by which a free body keeps its momentum and its angular
        momentum to rounding, but for its weight.

        The solved one misses them by the solver's tolerance, and as the rotation half way was expected, not known.
        With ``y = x + (T/2) v0`` the change of angular momentum is ``2 sum m (y x mean - x x v0)``, linear in `mean`.
        """
        whole, m = self.mass.sum(), self.mass[:, None]
        fall = self.weight.sum(axis=0) / whole
        mean = mean + (m * (self.v - mean)).sum(axis=0) / whole + 0.5 * dt * fall
        ahead = self.x + 0.5 * dt * self.v
        middle = (m * (self.x + 0.5 * dt * mean)).sum(axis=0)
        missing = (m * np.cross(self.x, self.v)).sum(axis=0) + 0.5 * dt * np.cross(middle, fall)
        missing -= (m * np.cross(ahead, mean)).sum(axis=0)
        arms = ahead - (m * ahead).sum(axis=0) / whole
        inertia = (m * arms * arms).sum() * np.eye(3) - arms.T @ (m * arms)
        found: Array = mean + np.cross(np.linalg.solve(inertia, missing), arms)
        return found

    def advance(self, dt: float, mean: Array) -> None:
        """Make the step with the mean velocity (N, 3) [m/s]."""
        back = np.ascontiguousarray(self.middle.transpose(0, 2, 1))
        equations().rotate(back, self._rates_of(mean), dt, self.strains)
        self.x += dt * mean
        self.v = 2.0 * mean - self.v
        self.mean = mean

    def nodal_strains(self) -> Array:
        """The equivalent strain at each node (N,): ``sqrt(2/3 e:e)`` of the deviator e."""
        normal, shear = self.strains[:, :3], self.strains[:, 3:]
        deviator = normal - normal.mean(axis=1, keepdims=True)
        square = (deviator**2).sum(axis=1) + 2.0 * (shear**2).sum(axis=1)
        found: Array = self._around @ np.sqrt(2.0 / 3.0 * square)
        return found

    def turned_normals(self) -> Array:
        """The normals at the nodes (N, 3) of the body as it is rotated now, of about unit length."""
        found: Array = (self.nodal @ self.normals[:, :, None])[:, :, 0]
        return found

    # -- computed once ------------------------------------------------------------------------------------------------

    def _mean_of_turns(self, volumes: Array) -> Any:
        """A matrix (N, E) that averages values of tetrahedra at their nodes."""
        from scipy import sparse

        count = len(self.tets)
        weight = np.repeat(volumes, 4)
        whole = np.bincount(self.tets.ravel(), weight)
        values = weight / whole[self.tets.ravel()]
        return sparse.csr_matrix((values, (self.tets.ravel(), np.repeat(np.arange(count), 4))), (len(self.x), count))


def in_patches(tets: Indices, nodes: Array) -> tuple[Indices, Indices, Indices]:
    """Group tetrahedra around edges, long ones first: the tetrahedra in the order of their groups, the numbers at which
    the groups begin, with the end (P + 1,), and the order (E,).

    In a block a group is one of its cells, whose six tetrahedra share a diagonal. A tetrahedron that is left over joins
    the group with which it shares most nodes.
    """
    pairs = np.sort(tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1)
    edges, of = np.unique(pairs, axis=0, return_inverse=True)
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    around = np.split(np.argsort(of.reshape(-1), kind="stable") // 6, np.cumsum(np.bincount(of.reshape(-1)))[:-1])
    group = np.full(len(tets), -1, dtype=np.int64)
    for edge in np.argsort(-np.round(lengths / lengths.max(), 6), kind="stable").tolist():
        if len(around[edge]) >= _LEAST_AROUND and (group[around[edge]] < 0).all():
            group[around[edge]] = edge
    touching: dict[int, list[int]] = {}
    for number in np.flatnonzero(group >= 0).tolist():
        for node in tets[number].tolist():
            touching.setdefault(node, []).append(int(group[number]))
    for number in np.flatnonzero(group < 0).tolist():
        near = [one for node in tets[number].tolist() for one in touching.get(node, ())]
        group[number] = max(set(near), key=near.count) if near else len(edges) + number
    order: Indices = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    return tets[order], np.append(starts, len(tets)), order


def boundary(tets: Indices, nodes: Array) -> Indices:
    """The triangles (F, 3) of a body's surface, counter-clockwise as seen from outside."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    found: Indices = faces[first[count == 1]]
    return found


def corner_normals(nodes: Array, triangles: Indices) -> Array:
    """The unit normal at each node of a surface (N, 3); 0 at nodes that are not on it."""
    a, b, c = (nodes[triangles[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    found = np.zeros_like(nodes)
    for i in range(3):
        np.add.at(found, triangles[:, i], across)
    sizes = np.linalg.norm(found, axis=1, keepdims=True)
    normals: Array = np.divide(found, sizes, out=np.zeros_like(found), where=sizes > 0.0)
    return normals
