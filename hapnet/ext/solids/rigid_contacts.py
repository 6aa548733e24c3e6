"""Contact of a point with rigid solids of any shape: secant planes, with an anchored energy.

A solid is a signed distance d(x) and a one-sided potential ``U = 1/2 K_w max(0, -d)^2`` with a damper. A step replaces
it by a plane with the depth ``p = p0 - g . (x - x_k)`` and the law of `hapnet.plant.worlds.walls`, which is exact for
any step. g is a secant: the gradient of d, changed so that ``g . Delta = d(x_k + Delta) - d(x_k)`` holds for the
step's displacement Delta. As Delta depends on g, the two are found in a few rounds.

A better plane makes the contact feel better. Passivity does not depend on the plane, as the energy is accounted for
(an anchored energy: PSPM inside the world). With e the energy in the planes at the end of the last step and E_c a
small reservoir,

* at the onset of a step the depths are set back to the true ones, whose energy is U. If ``U <= e + E_c``, E_c takes or
  pays the difference. Else all depths are scaled by ``s = sqrt((e + E_c)/U)``, and E_c is empty;
* after the step E_c gets the energy that dampers and friction dissipated: the work done on the planes less their gain.

E_c has a ceiling, and energy above it is discarded. So for the work W = -sum f . vhat T of all steps

    W - (e + E_c) = the discarded energy >= 0

For a solid thinner than twice the depth the nearest surface would be the back. So while the gradient points against the
gradient at the beginning of the contact, the distance is taken from the front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from hapnet import checks
from hapnet.checks import MOST_PLANES, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.friction import Friction
from hapnet.ext.solids.mesh_contact import secants_of
from hapnet.ext.solids.rigid_step import SolidContact, deepest, react
from hapnet.ext.solids.shapes import Shape, put_bend
from hapnet.ext.solids.sight import Sight, lay
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.curvature import Curvature, Curvatures
from hapnet.mechanics.effects import Effects
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.coupled import Coupled
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS
from hapnet.records.record import zero
from hapnet.records.vectors import inner

_WHOLE = 1e-6
"""Tolerance of the square of a unit gradient: within it, no axis cuts the solid and its curvature is used unchanged."""


@dataclass(frozen=True)
class Solid:
    """A shape and its material.

    shape : see `hapnet.ext.solids.shapes`. stiffness : K_w [N/m]. damping : B_w [Ns/m]. friction : Coulomb's mu, or
        a function of the place (3,) [m]. effects : further effects of its surface that a device renders.

    Raises InvalidParameter.
    """

    shape: Shape
    stiffness: float = WALL_STIFFNESS
    damping: float = WALL_DAMPING
    friction: float | Friction = 0.0
    effects: Effects | None = None

    def __post_init__(self) -> None:
        checks.positive("stiffness", self.stiffness)
        checks.non_negative("damping", self.damping)
        if not callable(self.friction):
            checks.non_negative("friction", self.friction)
        if self.effects is not None and (wrong := checks.wrong_effects(self.effects, 3)):
            raise InvalidParameter("effects", self.effects, f"those of a surface ({wrong})")


class RigidContacts(SolidContact, Surroundings):
    """The `Surroundings` of rigid solids. They hold the state of one contact, so they belong to one mass.

    dof : the number of axes, at most 3; `hapnet.ext.solids.shapes` defines solids with fewer axes.
    """

    def __init__(self, solids: Sequence[Solid], dof: int) -> None:
        super().__init__()
        self.solids: tuple[Solid, ...] = tuple(solids)
        self.scale, self.is_scalar = 1.0, -1
        each = [secants_of(one.shape, one.stiffness, one.damping, one.friction) for one in self.solids]
        self.secants = list(chain.from_iterable(each))
        self._effects = [
            one.effects and one.effects.cut(dof) for one, found in zip(self.solids, each, strict=True) for _ in found
        ]
        self.dof, self.count = dof, len(self.secants)
        self.met, self.order = [0] * self.count, [0] * self.count
        self.sights = [zero(Sight) for _ in self.secants]
        self.together = Coupled(3, self.count)
        self.has_friction = int(any(solid.friction for solid in self.solids))

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Solve a step, as in `hapnet.plant.worlds.protocol`, and update its account."""
        if (missing := 3 - self.dof) == 0:
            force, vhat = react(self, inverse, dt, tuple(position), tuple(velocity))
            return force, list(vhat)
        zeros = (0.0,) * missing

        def response(vector: Vector) -> Vector:
            return (*inverse(vector[: self.dof]), *zeros)

        force, vhat = react(self, response, dt, (*position, *zeros), (*velocity, *zeros))
        return force[: self.dof], list(vhat[: self.dof])

    # -- properties ---------------------------------------------------------------------------------------------------

    def require_outside(self, position: Sequence[float]) -> None:
        for i, solid in enumerate(self.solids):
            if (distance := solid.shape.near(padded(position)).distance_m) < 0.0:
                allowed = f"a place outside all solids (it is {-distance:.3g} m deep in solid number {i + 1})"
                raise InvalidParameter("start", tuple(position), allowed)

    def require_separate(self, inverse: Inverse) -> None:
        """Requires nothing: solids that act on one another are solved together. Stores whether A is a scalar."""
        columns = [inverse(unit[: self.dof]) for unit in _UNITS[: self.dof]]
        diagonal = columns[0][0]
        scalar = all(
            value == (diagonal if i == j else 0.0) for i, row in enumerate(columns) for j, value in enumerate(row)
        )
        self.is_scalar = int(scalar and self.dof == 3 and self.is_scalar != 0)

    @property
    def have_formulas(self) -> bool:
        """Whether equations describe all shapes, and the friction of all."""
        return all(secant.has_formula for secant in self.secants)

    def penetration(self, position: Sequence[float]) -> float:
        return deepest(self, tuple(position) if self.dof == 3 else padded(position))

    def clearance(self, position: Sequence[float]) -> float:
        """The distance [m] of `position` (n,) from the nearest solid, up to `SEARCHED_M`; 0 if a solid attracts."""
        if any(effects is not None for effects in self._effects):
            return 0.0
        nearest = next(iter(self._tangents(padded(position), SEARCHED_M)), None)
        return SEARCHED_M if nearest is None else -nearest[0]

    def plane(self, position: Sequence[float]) -> Plane | None:
        return next((plane for depth, plane in self._tangents(padded(position), 0.0) if depth > 0.0), None)

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        """The tangent planes at the nearest point of each solid."""
        return tuple([plane for _, plane in self._tangents(padded(position), reach_m)[:MOST_PLANES]])

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the springs and in the reservoir after the last step, wherever that ended."""
        return self.energy_J

    def _tangents(self, x: Vector, reach: float) -> list[tuple[float, Plane]]:
        """Depth and plane of the solids within `reach` [m] of `x`, the deepest first."""
        found = []
        sight = self.sights[0]
        for secant, effects in zip(self.secants, self._effects, strict=True):
            for distance, gradient, bends in secant.tangents(x, reach, self.dof):
                sight.bends.count, whole = 0, self.dof == 3 and abs(inner(gradient, gradient) - 1.0) < _WHOLE
                for direction, per_m in () if whole else bends:
                    put_bend(sight.bends, padded(direction), per_m)
                if lay(secant, self.dof, x, distance, gradient, sight):
                    found.append((sight.depth, _plane(sight, self.dof, bends if whole else None, effects)))
        return sorted(found, key=lambda one: (one[0], one[1][:7]), reverse=True)


SEARCHED_M = 0.1
"""The largest clearance that is searched for [m]."""

_UNITS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _plane(sight: Sight, n: int, bends: Curvatures | None, effects: Effects | None) -> Plane:
    if bends is None:
        bends = tuple([Curvature(direction[:n], per_m) for direction, per_m in sight.bends.curvatures])
    normal = tuple(sight.normal[:n])
    return Plane(normal, sight.offset, sight.stiffness, sight.damping, 0.0, bends, sight.friction, effects)


def padded(position: Sequence[float]) -> Vector:
    """`position` with three coordinates."""
    return (*position, 0.0, 0.0)[:3]
