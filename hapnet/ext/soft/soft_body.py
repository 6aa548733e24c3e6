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
    `free` on. mass (N,) [kg]. strains (E, 6), turns (E, 3, 3), see `soft_elastic`; middle, h: the rotations and rotated
    gradients of a step's middle; nodal (N, 3, 3) : Theta. surface (F, 3), normals (N, 3) outwards at rest.
    """

    def __init__(self, nodes: Array, tets: Indices, pinned: Marks, material: Material) -> None:
        number: Indices = np.empty(len(nodes), dtype=np.int64)
        order = np.argsort(pinned, kind="stable")
        number[order] = np.arange(len(nodes))
        self.free = int(len(nodes) - np.count_nonzero(pinned))
        self.x: Array = np.ascontiguousarray(nodes[order], dtype=float)
        self.v: Array = np.zeros_like(self.x)
        self.mean: Array = np.zeros_like(self.x)
        self.tets: Indices = np.ascontiguousarray(number[tets])
        edges = self.x[self.tets[:, 1:]] - self.x[self.tets[:, :1]]
        volumes: Array = np.asarray(np.linalg.det(edges) / 6.0, dtype=np.float64)
        self.grads: Array = np.empty((len(tets), 4, 3))
        self.grads[:, 1:] = np.linalg.inv(edges).transpose(0, 2, 1)
        self.grads[:, 0] = -self.grads[:, 1:].sum(axis=1)
        modulus = volumes * material.young / (1.0 + material.poisson)
        self.lam: Array = modulus * material.poisson / (1.0 - 2.0 * material.poisson)
        self.mu: Array = 0.5 * modulus
        self.beta_s = material.beta_s
        shares = np.repeat(0.25 * material.density * volumes, 4)
        self.mass: Array = np.asarray(np.bincount(self.tets.ravel(), shares), dtype=np.float64)
        self.weight: Array = self.mass[:, None] * material.gravity
        self.weight[self.free :] = 0.0
        self.turns: Array = np.tile(np.eye(3), (len(tets), 1, 1))
        self.middle: Array = self.turns.copy()  # Q
        self.strains: Array = np.zeros((len(tets), 6))
        self.h: Array = self.grads.copy()
        self.surface = boundary(self.tets, self.x)
        self.normals: Array = corner_normals(self.x, self.surface)
        self._around = self._mean_of_turns(volumes)
        self.factor = Factor(self.tets, self.grads, self.lam, self.mu, self.mass, self.free, self.beta_s, self.x)
        self.nodal: Array = np.tile(np.eye(3), (len(nodes), 1, 1))  # Theta

    # -- energies -----------------------------------------------------------------------------------------------------

    @property
    def moving_J(self) -> float:
        """Kinetic energy, and potential energy in the field of gravity [J]."""
        return float(0.5 * (self.mass @ (self.v * self.v).sum(axis=1)) - (self.weight * self.x).sum())

    @property
    def strained_J(self) -> float:
        """Energy of the stored strains [J]."""
        return float(equations().energy(self.lam, self.mu, self.strains))

    # -- a step's parts -----------------------------------------------------------------------------------------------

    def true_strains(self) -> Array:
        """The strains at the present positions (E, 6), and the rotations."""
        equations().turn(self.x, self.tets, self.grads, self.turns)
        found = np.zeros_like(self.strains)
        found[:, :3] = -1.0
        equations().strain(self.x, self.tets, self.grads, self.turns, 1.0, found)
        return found

    def push(self, dt: float, mean: Array) -> Array:
        """b without contacts (N, 3) [N], of the body rotated as half way through a step of `dt` [s] with `mean`."""
        self.middle[:] = self.turns
        equations().turn(self.x + 0.5 * dt * mean, self.tets, self.grads, self.middle)
        b: Array = (2.0 / dt * self.mass)[:, None] * self.v + self.weight
        equations().stress(self.tets, self.grads, self.middle, self.lam, self.mu, self.strains, self.h, b)
        b[self.free :] = 0.0
        self.nodal[:] = (self._around @ self.middle.reshape(-1, 9)).reshape(-1, 3, 3)
        return b

    def stiffness(self, v: Array) -> Array:
        """K v (N, 3)."""
        out = np.zeros_like(v)
        equations().stiff(self.tets, self.h, self.lam, self.mu, v, out)
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

    def advance(self, dt: float, mean: Array) -> None:
        """Make the step with the mean velocity (N, 3) [m/s]."""
        equations().strain(mean, self.tets, self.grads, self.middle, dt, self.strains)
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
