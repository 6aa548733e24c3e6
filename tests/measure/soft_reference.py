"""The force of a rigid ball on a linear elastic block with hard contact, by scikit-fem.

``python -m tests.measure soft_reference`` prints the forces for `tests/plant/worlds/test_soft_force.py`.

A quarter of a block of 60 mm with its far side held is meshed with triquadratic hexahedra, finer near the contact. The
ball presses without friction: a penalty on the area where the ball's depth is above the surface's displacement, found
by Newton's method on the compliance of the surface. The material is linear, as Hertz has it, at any depth.
"""

from importlib import import_module
from typing import Any

import numpy as np

from hapnet.checks import Array

YOUNG_PA, SIDE_M, RADIUS_M, NEAR_M = 20e3, 0.06, 0.01, 0.0105
DEPTHS_M = (0.002, 0.003, 0.004, 0.006, 0.008, 0.01)
POISSONS = (0.3, 0.4, 0.45, 0.49)


def graded(first: float, until: float, count: int, end: float, growth: float) -> Array:
    """Coordinates from `first`: `count` equal cells up to `until`, then growing cells up to `end`."""
    found = list(np.linspace(first, until, count + 1))
    size, rest = found[1] - found[0], [0.0]
    while rest[-1] < end - until:
        size *= growth
        rest.append(rest[-1] + size)
    return np.array([*found, *(until + np.array(rest[1:]) * (end - until) / rest[-1])])


def forces(poisson: float, count: int, depths: tuple[float, ...] = DEPTHS_M, penalty: float = 2000.0) -> list[float]:
    """The forces [N] at these depths of the ball [m]. penalty : of the contact, times E/((1 - nu^2) R)."""
    from scipy.sparse.linalg import splu

    skfem: Any = import_module("skfem")
    elasticity: Any = import_module("skfem.models.elasticity")
    aside = graded(0.0, NEAR_M, count, 0.5 * SIDE_M, 1.5)
    down = graded(0.0, 0.3 * NEAR_M, max(2, count // 3), SIDE_M, 1.4)
    mesh = skfem.MeshHex.init_tensor(down, aside, aside)
    element = skfem.ElementVector(skfem.ElementHex2())
    basis = skfem.Basis(mesh, element, intorder=4)
    whole = skfem.asm(elasticity.linear_elasticity(*elasticity.lame_parameters(YOUNG_PA, poisson)), basis)
    held = np.concatenate(
        [
            basis.get_dofs(lambda x: x[0] > SIDE_M - 1e-9).all(),
            basis.get_dofs(lambda x: x[1] < 1e-12).all(["u^2"]),
            basis.get_dofs(lambda x: x[2] < 1e-12).all(["u^3"]),
        ]
    )
    free = np.setdiff1d(np.arange(basis.N), held)
    top = mesh.facets_satisfying(lambda x: (x[0] < 1e-12) & (x[1] < NEAR_M) & (x[2] < NEAR_M))
    facets = skfem.FacetBasis(mesh, element, facets=top, intorder=8)
    stiffness = penalty * YOUNG_PA / (1.0 - poisson * poisson) / RADIUS_M
    normal = skfem.LinearForm(lambda v, w: w["p"] * v[0])
    area = skfem.BilinearForm(lambda u, v, w: w["on"] * u[0] * v[0])
    _, y, z = facets.global_coordinates().value
    distance = np.hypot(y, z)
    pushed = np.flatnonzero(normal.assemble(facets, p=np.ones_like(distance)) != 0.0)
    factor = splu(whole[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                  options={"SymmetricMode": True})  # fmt: skip
    where = np.full(basis.N, -1)
    where[free] = np.arange(len(free))
    unit = np.zeros((len(free), len(pushed)))
    unit[where[pushed], np.arange(len(pushed))] = 1.0
    compliance = np.concatenate([factor.solve(part)[where[pushed]] for part in np.array_split(unit, 8, axis=1)], axis=1)
    found = []
    for depth in depths:
        shape = np.where(
            distance < RADIUS_M, depth - RADIUS_M + np.sqrt(np.maximum(RADIUS_M**2 - distance**2, 0.0)), -1.0
        )
        u, on = np.zeros(basis.N), shape > 0.0
        for _ in range(50):
            matrix = area.assemble(facets, on=stiffness * on)[pushed][:, pushed].toarray()
            load = normal.assemble(facets, p=stiffness * on * np.where(on, shape, 0.0))[pushed]
            u[pushed] = np.linalg.solve(np.eye(len(pushed)) + compliance @ matrix, compliance @ load)
            depth_of = shape - facets.interpolate(u)[0]
            if np.array_equal(depth_of > 0.0, on):
                break
            on = depth_of > 0.0
        found.append(4.0 * float((stiffness * np.maximum(depth_of, 0.0) * facets.dx).sum()))
    return found


def hertz(poisson: float, depth: float) -> float:
    """The force on a half space [N]."""
    return float(4.0 / 3.0 * YOUNG_PA / (1.0 - poisson**2) * np.sqrt(RADIUS_M) * depth**1.5)


def main(counts: str = "4,6,8") -> None:
    """counts : of the cells along the contact."""
    print("depth [mm]:", *(f"{1e3 * depth:g}" for depth in DEPTHS_M))
    for poisson in POISSONS:
        print(f"nu {poisson:g}, Hertz:", *(f"{hertz(poisson, depth):.4f}" for depth in DEPTHS_M))
        for count in map(int, counts.split(",")):
            print(f"  {count} cells:", *(f"{force:.4f}" for force in forces(poisson, count)), flush=True)


if __name__ == "__main__":
    main()
