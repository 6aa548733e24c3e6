"""A soft body's strains and stiffness by other ways than its own: singular values, differences, and scikit-fem."""

from importlib import import_module
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.ext.soft.soft_body import Body


def without_locking(body: Body, places: Array, young: float, poisson: float) -> tuple[Any, Any]:
    """The body's basis and stiffness in scikit-fem, with the mean divergence of each patch of its tetrahedra."""
    from scipy import sparse

    skfem: Any = import_module("skfem")
    elasticity: Any = import_module("skfem.models.elasticity")
    div: Any = import_module("skfem.helpers").div
    basis = skfem.Basis(skfem.MeshTet(places.T, body.tets.T), skfem.ElementVector(skfem.ElementTetP1()))
    lam, mu = elasticity.lame_parameters(young, poisson)
    of_tets = skfem.BilinearForm(lambda u, v, w: div(u) * v).assemble(basis, basis.with_element(skfem.ElementTetP0()))
    count = len(body.patches) - 1
    patch_of = np.repeat(np.arange(count), np.diff(body.patches))
    whole = sparse.csr_matrix((np.ones(len(patch_of)), (patch_of, np.arange(len(patch_of))))) @ of_tets
    volumes = np.bincount(patch_of, basis.dx.sum(axis=1))
    shear = skfem.asm(elasticity.linear_elasticity(0.0, mu), basis)
    return basis, shear + whole.T @ sparse.diags(lam / volumes) @ whole


def strains_of(gradients: Array) -> Array:
    """``X - 0.4 X^2 + 0.18 X^3`` with X = U - I, by singular values, of (E, 3, 3)."""
    _, sizes, vt = np.linalg.svd(gradients)
    x = sizes - 1.0
    found: Array = (vt.transpose(0, 2, 1) * (x - 0.4 * x**2 + 0.18 * x**3)[:, None]) @ vt
    return found


def strain_rates(gradients: Array, rates: Array) -> Array:
    """The change of `strains_of` by a change of the gradients (E, 3, 3), by differences."""
    found: Array = (strains_of(gradients + 1e-5 * rates) - strains_of(gradients - 1e-5 * rates)) / 2e-5
    return found
