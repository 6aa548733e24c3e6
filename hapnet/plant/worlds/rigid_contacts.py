"""Contact of a point with rigid solids of any shape: secant planes, with an anchored energy.

A solid is a signed distance d(x) and a one-sided potential ``U = 1/2 K_w max(0, -d)^2`` with a damper. A step replaces
it by a plane with the depth ``p = p0 - g . (x - x_k)`` and the law of `hapnet.plant.worlds.walls`, which is exact for
any step. g is a secant: the gradient of d, changed so that ``g . Delta = d(x_k + Delta) - d(x_k)`` holds for the
step's displacement Delta. As Delta depends on g, the two are found in a few rounds.

A better plane makes the contact feel better. Whether it is passive does not depend on the plane, as the energy is
accounted for (an anchored energy: PSPM inside the world). With e the energy that the planes of the last step ended with
and E_c a small reservoir,

* at the onset of a step the depths are set back to the true ones, whose energy is U. If ``U <= e + E_c``, E_c takes or
  pays the difference. Else all depths are scaled by ``s = sqrt((e + E_c)/U)``, and E_c is empty;
* after the step E_c gets what the dampers and friction have dissipated: the work done on the planes less their gain.

E_c has a ceiling, and what is above it is discarded. So for the work W = -sum f . vhat T of all steps

    W - (e + E_c) = what was discarded >= 0

A solid that is thinner than twice the depth is a matter of memory: the nearest surface would be the back one. While the
gradient turns against the one that the contact began with, the distance is taken from the front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

from hapnet import checks
from hapnet.checks import MOST_FRICTION, MOST_PLANES, Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.curvature import Curvature, Curvatures, across
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.coupled import Contact, compliance, solve, solved, times
from hapnet.plant.worlds.friction import Friction, coefficient, drag_of, tangential
from hapnet.plant.worlds.secant import GOOD_MPS, Secant
from hapnet.plant.worlds.shapes import Bent, Shape
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS
from hapnet.records.vectors import added, inner

ANCHOR_CEILING_J = 0.01
"""Of E_c. The springs store some 5 mJ in a firm contact."""

CORRECTIONS = 8
"""The most secants after the first plane; 1 is usual."""


@dataclass(frozen=True)
class Solid:
    """A shape and its material.

    Parameters
    ----------
    shape : see `hapnet.plant.worlds.shapes`. stiffness : K_w [N/m]. damping : B_w [Ns/m]. friction : Coulomb's mu, or
        a function that gives it for a place (3,) [m].

    Raises InvalidParameter.
    """

    shape: Shape
    stiffness: float = WALL_STIFFNESS
    damping: float = WALL_DAMPING
    friction: float | Friction = 0.0

    def __post_init__(self) -> None:
        checks.positive("stiffness", self.stiffness)
        checks.non_negative("damping", self.damping)
        if not callable(self.friction):
            checks.non_negative("friction", self.friction)


class RigidContacts(Surroundings):
    """The `Surroundings` of rigid solids. They keep the state of one contact, so they belong to one mass.

    dof : the number of axes, at most 3; `hapnet.plant.worlds.shapes` says what solids are with fewer.
    """

    dof: int = 0

    def __init__(self, solids: Sequence[Solid], dof: int) -> None:
        self.solids: tuple[Solid, ...] = tuple(solids)
        self.dof = dof
        self.energy_J: float = 0.0
        """e + E_c after the last step."""
        self.scale: float = 1.0
        """s of the last step; 1: its depths were the true ones."""
        self._secants = [Secant(one.shape, one.stiffness, one.damping, one.friction) for one in self.solids]
        self._rubs = any(solid.friction for solid in self.solids)
        self._is_scalar: bool | None = None
        self._end: Vector | None = None
        self._velocity: Vector = _STILL

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """A step, as in `hapnet.plant.worlds.protocol`, and its account."""
        if (missing := 3 - self.dof) == 0:
            force, vhat = self._solve(dt, tuple(position), tuple(velocity), inverse)
            return force, list(vhat)
        zeros = (0.0,) * missing

        def response(vector: Vector) -> Vector:
            return (*inverse(vector[: self.dof]), *zeros)

        force, vhat = self._solve(dt, (*position, *zeros), (*velocity, *zeros), response)
        return force[: self.dof], list(vhat[: self.dof])

    def _solve(self, dt: float, x: Vector, w: Vector, inverse: Inverse) -> tuple[Vector, Vector]:
        a, b, c = w
        delta: Vector = (dt * a, dt * b, dt * c)
        length = dt * sqrt(a * a + b * b + c * c)
        met = [secant for secant in self._secants if secant.meets(x, delta, length)]
        force, vhat, held = _STILL, w, 0.0
        if met:
            self._anchor(met)
            force, vhat, delta = self._touch(dt, x, met, w, inverse)
            for secant in met:
                held += secant.end_J(delta)
            self.energy_J = max(held, self.energy_J - _dot(force, delta))  # without rounding max would do nothing
        self.energy_J = min(self.energy_J, held + ANCHOR_CEILING_J)
        if self._rubs:
            a, b, c = self._velocity if self._end == x else _STILL
            self._velocity = (2.0 * vhat[0] - a, 2.0 * vhat[1] - b, 2.0 * vhat[2] - c)
            self._end = _plus(x, delta)
        return force, vhat

    def _anchor(self, met: list[Secant]) -> None:
        """Scale the depths down if the energy for them is not there."""
        true_J = 0.0
        for secant in met:
            true_J += secant.onset_J()
        self.scale = 1.0
        if true_J > self.energy_J:
            self.scale = scale = sqrt(self.energy_J / true_J)
            for secant in met:
                if secant.depth > 0.0:
                    secant.depth *= scale

    def _touch(
        self, dt: float, x: Vector, met: list[Secant], w: Vector, inverse: Inverse
    ) -> tuple[Vector, Vector, Vector]:
        """The step's force, vhat and displacement, with planes that fit. Other solids that it meets go into `met`."""
        for left in range(CORRECTIONS, -1, -1):
            force, vhat = self._step(dt, x, met, w, inverse)
            delta = (dt * vhat[0], dt * vhat[1], dt * vhat[2])
            if not left:
                break
            end = _plus(x, delta)
            wrong = False
            for secant in met:
                wrong = secant.correct(x, delta, end, dt * GOOD_MPS) or wrong
            if len(met) < len(self._secants):  # it may have been turned aside, to another one
                length = sqrt(_dot(delta, delta))
                aside = [one for one in self._secants if one not in met and one.meets(x, delta, length)]
                met += aside
                wrong = wrong or bool(aside)
            if not wrong:
                break
        return force, vhat, delta

    def _step(self, dt: float, x: Vector, met: list[Secant], w: Vector, inverse: Inverse) -> tuple[Vector, Vector]:
        """The force and vhat against these planes."""
        secant = met[0]
        if len(met) > 1 or (secant.friction and not self._is_scalar):
            return self._step_together(dt, x, met, w, inverse)
        n0, n1, n2 = normal = secant.normal
        r0, r1, r2 = inverse(normal)
        softness = n0 * r0 + n1 * r1 + n2 * r2
        if not softness:
            return _STILL, w
        push = secant.push(secant.depth, n0 * w[0] + n1 * w[1] + n2 * w[2], 1.0 / softness, dt)
        vhat = (w[0] + push * r0, w[1] + push * r1, w[2] + push * r2)
        force = (push * n0, push * n1, push * n2)
        if not (push and secant.friction):
            return force, vhat
        # A is a multiple of the identity, so friction changes nothing along the normal.
        square = _dot(normal, normal)
        alpha = softness / square
        start = self._velocity if self._end == x else _STILL
        drag = coefficient(normal, -secant.friction * push * sqrt(square), vhat, start, lambda direction: 1.0 / alpha)
        drag /= 1.0 + drag * alpha
        t0, t1, t2 = tangential(vhat, normal)
        force = (force[0] - drag * t0, force[1] - drag * t1, force[2] - drag * t2)
        return force, (w[0] + alpha * force[0], w[1] + alpha * force[1], w[2] + alpha * force[2])

    def _step_together(
        self, dt: float, x: Vector, met: Sequence[Secant], w: Vector, inverse: Inverse
    ) -> tuple[Vector, Vector]:
        """`_step` with several planes, or with friction and any A."""
        C = compliance([inverse(unit) for unit in _UNITS])
        contacts = [Contact(one.normal, one.depth, one.stiffness, one.damping) for one in met]
        pushes = solve(contacts, w, C, dt)
        force = _sum(pushes, met)
        vhat = _plus(w, times(C, force))
        start = self._velocity if self._end == x else _STILL

        def along(direction: Sequence[float]) -> float:
            return 1.0 / float(inner(direction, times(C, direction)))

        drags = [
            coefficient(one.normal, -one.friction * push * hypot(*one.normal), vhat, start, along)
            for one, push in zip(met, pushes, strict=True)
        ]
        if any(drags):
            D = drag_of(drags, [one.normal for one in met])
            one_and_CD = [
                [float(i == j) + added([row[k] * D[k][j] for k in range(3)]) for j in range(3)]
                for i, row in enumerate(C)
            ]
            dragged, *columns = solved(one_and_CD, [[v, *row] for v, row in zip(w, C, strict=True)])
            C_dragged = compliance(columns)
            force = _sum(solve(contacts, dragged, C_dragged, dt), met)
            slid = times(D, _plus(dragged, times(C_dragged, force)))
            force = (force[0] - slid[0], force[1] - slid[1], force[2] - slid[2])
        return force, _plus(w, times(C, force))

    # -- what they are ------------------------------------------------------------------------------------------------

    def require_outside(self, position: Sequence[float]) -> None:
        for i, solid in enumerate(self.solids):
            if (distance := solid.shape.near(padded(position)).distance_m) < 0.0:
                allowed = (
                    f"a place outside of every solid (it is {-distance:.3g} m deep in the one with number {i + 1})"
                )
                raise InvalidParameter("start", tuple(position), allowed)

    def require_separate(self, inverse: Inverse) -> None:
        """Nothing to require: solids that act on one another are solved together. It notes whether A is a scalar."""
        columns = [inverse(unit[: self.dof]) for unit in _UNITS[: self.dof]]
        diagonal = columns[0][0]
        scalar = all(
            value == (diagonal if i == j else 0.0) for i, row in enumerate(columns) for j, value in enumerate(row)
        )
        self._is_scalar = scalar and self.dof == 3 and self._is_scalar is not False

    def penetration(self, position: Sequence[float]) -> float:
        x: Vector = tuple(position) if self.dof == 3 else padded(position)
        deepest = 0.0
        for secant in self._secants:
            if not secant.farther_than(0.0, x):
                deepest = max(deepest, -secant.near(x).distance_m)
        return deepest

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
        for secant in self._secants:
            if secant.farther_than(reach, x):
                continue
            distance, gradient = secant.near(x)
            out = gradient[: self.dof]
            length = hypot(*out)
            if distance > reach or not length:
                continue
            normal = tuple([-part / length for part in out])
            offset = inner(normal, x) + distance / length
            bends = self._bends(secant.shape, x, gradient, length)
            mu = min(secant.friction_at(x), MOST_FRICTION)
            found.append((-distance, Plane(normal, offset, secant.stiffness, secant.damping, 0.0, bends, mu)))
        return sorted(found, reverse=True)

    def _bends(self, shape: Shape, x: Vector, gradient: Vector, length: float) -> Curvatures:
        """How the solid's surface bends, as it is cut by the axes: with two, along the one direction across the normal.

        Empty: it does not say so; or the front is what counts, and the back is nearer; or the cut is oblique.
        """
        if not isinstance(shape, Bent) or abs(length - 1.0) > _OBLIQUE or shape.near(x).gradient != gradient:
            return ()
        bends = shape.curvatures(x)
        if self.dof == 3:
            return bends
        tangents = across(gradient[: self.dof])
        return tuple(
            [Curvature(tangent, added([k * _dot(e, padded(tangent)) ** 2 for e, k in bends])) for tangent in tangents]
        )


_STILL: Vector = (0.0, 0.0, 0.0)
_OBLIQUE = 1e-6
"""A gradient whose part along the axes is shorter by more belongs to a solid that is cut obliquely."""
_UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def padded(position: Sequence[float]) -> Vector:
    """`position` with three coordinates."""
    return (*position, 0.0, 0.0)[:3]


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _plus(one: Sequence[float], other: Sequence[float]) -> Vector:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])


def _sum(pushes: Sequence[float], met: Sequence[Secant]) -> Vector:
    x = y = z = 0.0
    for push, one in zip(pushes, met, strict=True):
        a, b, c = one.normal
        x, y, z = x + push * a, y + push * b, z + push * c
    return (x, y, z)
