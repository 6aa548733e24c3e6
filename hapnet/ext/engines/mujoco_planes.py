"""The planes around an added sphere in a MuJoCo model, for the device's local contact model.

For a geom that the sphere touches, normal and depth are those of the engine's contact; for a geom nearby, those of the
shortest line between them. Planes are for the sphere's centre, so its radius r is subtracted, and the curvature of a
ball of radius R is 1/(R + r).

The stiffness is that of the engine's soft contact at rest, where a force f presses the sphere in by f/K. With the
impedance d, the reference stiffness k of `solref` and the inverse weights w of both bodies ("Computation" in MuJoCo's
documentation)

    K = k d^2 / ((1 - d) (w_1 + w_2)),      k = 1 / (d_max timeconst dampratio)^2      or  -stiffness / d_max^2

and likewise the damping. The velocity is that of the touched body's point.

A plane has Coulomb's friction, and does not yield. So by default planes are sent only for geoms with little friction
that are fixed or heavy. While the sphere touches any other geom no planes are sent, and the device feels the sphere's
position.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import hypot
from typing import NamedTuple

import numpy as np

from hapnet.checks import MOST_FRICTION, MOST_PLANES, Array, Vector
from hapnet.ext.engines.mujoco_model import MujocoModel
from hapnet.mechanics.curvature import Curvature, Curvatures, across, round_all_over
from hapnet.mechanics.plane import Plane
from hapnet.records.vectors import added, inner

_ALIKE = 0.99
"""Two contacts with a geom count as one surface if the cosine between their normals is above this."""

_RUBS = 0.1
"""Geoms with more friction are not sent, as the engine's is not Coulomb's, but a damper of b/R up to mu times the push.
With the default `solref` a sphere of 20 g that slides at 50 mm/s feels a fifth of the friction that mu = 1 allows."""

_LIGHT_PER_KG = 0.05
"""A body lighter than this feels wrong even as a moving plane: in a round trip of 0.1 s a push of 3.5 N moves 2 kg by
9 mm, 20 kg by 0.9 mm."""

_STRAIGHT = 1e-6
_PRESSED_M = 1e-3
"""At smaller depths the stiffness is that at this depth, which a pressing hand reaches [m]."""
_SOFTEST, _STIFFEST = 1.0, 1e6
"""The range of the stiffnesses that are sent [N/m]."""


class NearGeom(NamedTuple):
    """A geom near the sphere: its number, the unit normal (3,) into it, the depth and the point [m], and the engine's
    contact parameters."""

    geom: int
    normal: Array
    depth: float
    point: Array
    solref: Array
    solimp: Array


class SpherePlanes:
    """The planes around the sphere that was added to a model.

    found : the model. dof : axes of the hand. everything : whether to include bodies with friction, or that yield.
    """

    def __init__(self, found: MujocoModel, dof: int, *, everything: bool = False) -> None:
        self._found, self._dof = found, dof
        model = found.model
        self._own = int(model.body_geomadr[found.body])
        self._radius = float(model.geom_size[self._own, 0])
        touches = (model.geom_contype & model.geom_conaffinity[self._own]) | (
            model.geom_conaffinity & model.geom_contype[self._own]
        )
        self._others = np.flatnonzero(touches.astype(bool) & (model.geom_bodyid != found.body))
        self._mu = [self._friction(geom) for geom in range(model.ngeom)]
        self._fits = [everything or self._fits_a_plane(geom) for geom in range(model.ngeom)]
        flat = model.geom_type[self._others] == found.engine.mjtGeom.mjGEOM_PLANE
        self._reach = np.where(flat, np.inf, model.geom_rbound[self._others] + self._radius)
        self._segment, self._jacobian = np.zeros(6), np.zeros((3, model.nv))

    @property
    def any_fits(self) -> bool:
        """Whether a plane describes any geom well."""
        return any(self._fits[geom] for geom in self._others)

    def _fits_a_plane(self, geom: int) -> bool:
        model = self._found.model
        return self._mu[geom] <= _RUBS and float(model.body_invweight0[model.geom_bodyid[geom], 0]) <= _LIGHT_PER_KG

    def _friction(self, geom: int) -> float:
        """Coulomb's mu of a contact with this geom, as the engine mixes it: the larger one, or that of higher rank."""
        model, own = self._found.model, self._own
        ranks = int(model.geom_priority[own]), int(model.geom_priority[geom])
        counted = [one for one, rank in zip((own, geom), ranks, strict=True) if rank == max(ranks)]
        has_friction = max(model.geom_condim[counted]) > 1
        return min(float(max(model.geom_friction[counted, 0])), MOST_FRICTION) if has_friction else 0.0

    def around(self, position: Vector, reach_m: float) -> tuple[Plane, ...] | None:
        """Return the planes that the sphere touches or has within `reach_m` [m], with its centre at `position` (n,)
        [m]: at most four.

        None: it touches a body that no plane describes.
        """
        touched = list(self._touched())
        if not all(self._fits[one.geom] for one in touched):
            return None
        found = touched + list(self._near({one.geom for one in touched}, reach_m))
        planes = [plane for one in found if (plane := self._plane(position, one)) is not None]
        return tuple(sorted(planes, key=lambda plane: -plane.depth(position))[:MOST_PLANES])

    def _touched(self) -> Iterator[NearGeom]:
        data, own = self._found.data, self._own
        count, seen = data.ncon, list[tuple[int, Array]]()
        if not count:
            return
        geoms = data.contact.geom[:count]
        mine = np.flatnonzero((geoms == own).any(axis=1))
        for i in mine[np.argsort(data.contact.dist[mine])].tolist():
            contact = data.contact[i]
            first = int(contact.geom[0]) == own
            other = int(contact.geom[1 if first else 0])
            normal = np.array(contact.frame[:3]) * (1.0 if first else -1.0)
            if other < 0 or any(geom == other and normal @ known > _ALIKE for geom, known in seen):
                continue
            seen.append((other, normal))
            depth = float(contact.includemargin - contact.dist)
            yield NearGeom(other, normal, depth, np.array(contact.pos), contact.solref, contact.solimp)

    def _near(self, touched: set[int], reach_m: float) -> Iterator[NearGeom]:
        engine, model, data, own = self._found.engine, self._found.model, self._found.data, self._own
        centre = data.geom_xpos[own]
        away = np.linalg.norm(data.geom_xpos[self._others] - centre, axis=1)
        for geom in self._others[away <= self._reach + reach_m].tolist():
            if geom in touched or not self._fits[geom]:
                continue
            distance = engine.mj_geomDistance(model, data, own, geom, reach_m, self._segment)
            unit = self._segment[3:] - self._segment[:3]
            length = float(np.linalg.norm(unit))
            if 0.0 < distance < reach_m and length > 0.0:
                solref, solimp = self._material(geom)
                yield NearGeom(geom, unit / length, -float(distance), self._segment[3:].copy(), solref, solimp)

    def _material(self, geom: int) -> tuple[Array, Array]:
        """`solref` and `solimp` of a contact with this geom, mixed as the engine does."""
        model, own = self._found.model, self._own
        priorities = model.geom_priority[own], model.geom_priority[geom]
        mix, other = float(model.geom_solmix[own]), float(model.geom_solmix[geom])
        share = mix / (mix + other) if mix + other > 0.0 else 0.5
        if priorities[0] != priorities[1]:
            share = float(priorities[0] > priorities[1])
        refs = model.geom_solref[own], model.geom_solref[geom]
        direct = refs[0][0] <= 0.0 or refs[1][0] <= 0.0
        solref = np.minimum(*refs) if direct and 0.0 < share < 1.0 else share * refs[0] + (1.0 - share) * refs[1]
        return solref, share * model.geom_solimp[own] + (1.0 - share) * model.geom_solimp[geom]

    def _plane(self, position: Vector, touch: NearGeom) -> Plane | None:
        """The plane for the sphere's centre, in the hand's axes; None: it is perpendicular to all of them."""
        into: Vector = tuple(touch.normal.tolist())
        length = hypot(*into[: self._dof])
        if length < 1e-3:
            return None
        normal = tuple([part / length for part in into[: self._dof]])
        offset = inner(normal, position) - touch.depth / length
        stiffness, damping = self._soft(touch)
        friction = mu if (mu := self._mu[touch.geom]) <= _RUBS else 0.0
        bends: Curvatures = ()
        if length > 1.0 - _STRAIGHT:
            bends = self._bends(touch, into)
            if self._dof < 3:
                bends = tuple([Curvature(unit, _along(bends, unit)) for unit in across(normal)]) if bends else ()
        return Plane(normal, offset, stiffness, damping, self._speed(touch) / length, bends, friction)

    def _soft(self, touch: NearGeom) -> tuple[float, float]:
        """Stiffness [N/m] and damping [Ns/m] of the engine's contact."""
        model = self._found.model
        weights = model.body_invweight0[:, 0]
        light = float(weights[self._found.body] + weights[model.geom_bodyid[touch.geom]])
        lowest, most, width, middle, power = touch.solimp[:5].tolist()
        lowest, most, at = (min(max(one, 1e-4), 0.9999) for one in (lowest, most, middle))
        share = min(max(touch.depth, _PRESSED_M) / max(width, 1e-15), 1.0)
        if power > 1.0 and 0.0 < share < 1.0:
            share = share**power / at ** (power - 1.0) if share <= at else (
                1.0 - (1.0 - share) ** power / (1.0 - at) ** (power - 1.0)
            )  # fmt: skip
        impedance = lowest + share * (most - lowest)
        constant, ratio = touch.solref[:2].tolist()
        if constant > 0.0:
            constant = max(constant, 2.0 * float(model.opt.timestep))
            k, b = 1.0 / (most * constant * ratio) ** 2, 2.0 / (most * constant)
        else:
            k, b = -constant / most**2, -ratio / most
        gain = impedance / ((1.0 - impedance) * light)
        return min(max(k * impedance * gain, _SOFTEST), _STIFFEST), max(b * gain, 0.0)

    def _speed(self, touch: NearGeom) -> float:
        """The velocity of the touched body's point along the normal [m/s]."""
        model, data = self._found.model, self._found.data
        body = int(model.geom_bodyid[touch.geom])
        if not model.body_weldid[body]:
            return 0.0
        self._found.engine.mj_jac(model, data, self._jacobian, None, touch.point, body)
        return float(touch.normal @ (self._jacobian @ data.qvel))

    def _bends(self, touch: NearGeom, into: Vector) -> Curvatures:
        """The curvature of the surface on which the sphere's centre just touches; empty: flat, an edge, unknown."""
        kinds, model = self._found.engine.mjtGeom, self._found.model
        kind, size = int(model.geom_type[touch.geom]), model.geom_size[touch.geom].tolist()
        turn = self._found.data.geom_xmat[touch.geom].reshape(3, 3)
        centre = turn.T @ (self._found.data.geom_xpos[self._own] - self._found.data.geom_xpos[touch.geom])
        along = float(turn[:, 2] @ touch.normal)
        if kind == kinds.mjGEOM_SPHERE or (kind == kinds.mjGEOM_CAPSULE and abs(centre[2]) > size[1]):
            return round_all_over(into, size[0] + self._radius)
        if kind == kinds.mjGEOM_CAPSULE or (kind == kinds.mjGEOM_CYLINDER and abs(along) < _STRAIGHT):
            around = np.cross(turn[:, 2], touch.normal)
            return (Curvature(_unit(around), 1.0 / (size[0] + self._radius)),)
        if kind == kinds.mjGEOM_ELLIPSOID:
            foot = centre + (self._radius - touch.depth) * (turn.T @ touch.normal)
            return self._of_ellipsoid(foot, np.array(size), into, turn)
        return ()

    def _of_ellipsoid(self, foot: Array, half_axes: Array, into: Vector, turn: Array) -> Curvatures:
        """Second fundamental form of x'Hx = 1 at `foot`, in the ellipsoid's frame; the sphere's radius is added."""
        squares = 1.0 / half_axes**2
        units = np.array(across(into))
        local = units @ turn
        values, vectors = np.linalg.eigh(local @ (squares[:, None] * local.T) / np.linalg.norm(squares * foot))
        found = zip(values.tolist(), (vectors.T @ units).tolist(), strict=True)
        return tuple([Curvature(tuple(unit), k / (1.0 + k * self._radius)) for k, unit in found])


def _along(bends: Curvatures, unit: Sequence[float]) -> float:
    """The normal curvature along a direction (Euler's theorem)."""
    return float(added([k * inner(direction, unit) ** 2 for direction, k in bends]))


def _unit(vector: Array) -> Vector:
    return tuple((vector / np.linalg.norm(vector)).tolist())
