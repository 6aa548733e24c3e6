"""The layer on a soft body's surface by which a ball is felt as on the material, and not as on its tetrahedra.

A surface of linear tetrahedra of size h is too stiff under a load that is not much wider than h: its displacement
cannot follow the ball within a triangle. What it lacks is about as soft as a layer of thickness h, and less as the
contact grows wider than h. With F the force of the ball, the layer has, per area, the stiffness

    k = k0 (c0 + c1 F/F_h),    k0 = E/((1 - nu)^2 h),    F_h = 4/3 E/(1 - nu^2) h^3/R

F_h is the force at which the contact's radius is h (Hertz), so F/F_h is the cube of the contact's radius over h. c0 and
c1 are fitted to converged finite elements with hard contact (`tests.measure.soft_reference`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import Array

if TYPE_CHECKING:
    from hapnet.ext.soft.soft_body import Body
    from hapnet.ext.soft.soft_contacts import Skin

NARROW, WIDE = 1.12, 0.37
"""c0 and c1."""

MOST = 2.5
"""The greatest value of k/k0."""


class Layer:
    """The layer of a body, for the contact with a ball.

    Attributes: stiffness (F,), of each triangle's layer with k0 [N/m].
    """

    def __init__(self, body: Body, skin: Skin) -> None:
        a, b, c = (body.x[body.surface[:, i]] for i in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        size = np.sqrt(2.0 * area)
        young = body.young[body.surface].mean(axis=1)
        self.stiffness: Array = young / (1.0 - body.poisson) ** 2 * area / size
        mean = float(area @ size / area.sum())
        self._whole_N = 4.0 / 3.0 * float(np.median(young)) / (1.0 - body.poisson**2) * mean**3 / skin.radius
        self._is_given = skin.stiffness is not None

    def factor(self, force: float) -> float:
        """k/k0 at this force of the ball [N]; 1 if a stiffness was given."""
        return 1.0 if self._is_given else min(NARROW + WIDE * force / self._whole_N, MOST)
