"""The contact planes of a force function, found by differences of its force around the proxy.

A function F of position, velocity and time is a contact at a place q where its force grows against the motion that it
resists. With h a small distance,

    n = -F/|F|,    K = -n . (F(q + h n) - F(q))/h,    kappa = t . (F(q + h t) - F(q))/(h |F|)   for t across n

A plane begins where the tangent of the force along n is zero, or at the surface if that is deeper. From there on, the
course of the force is rendered as springs in parallel, each from its own depth on; a linear law needs one. If the force
resists motion across n about as much as along n, q is in a corner: the eigenvectors of the differences are the normals
of its walls.

Surfaces in front of the proxy are searched along rays, a few in each step. A surface that was found is found again from
its place in the step before. Its curvature tells where it is nearest to the proxy; the plane is taken there.

No plane describes attraction, friction, drag in free space, the same force everywhere, or a force that changes with
time. When the proxy meets such a force, the search ends for good. Then the device feels the proxy's position, with the
delay. PSPM pays for any y, so passivity does not depend on the planes.
"""

from __future__ import annotations

import dis
import inspect
from collections.abc import Iterator, Sequence
from itertools import product
from math import hypot, isfinite

import numpy as np

from hapnet.checks import MOST_CURVATURE_PER_M, MOST_PLANES, MOST_VISCOSITY, Vector
from hapnet.ext.engines.obstacle import Law
from hapnet.loading import failure
from hapnet.mechanics.curvature import Curvature, Curvatures, across, tangent
from hapnet.mechanics.effects import Effects
from hapnet.mechanics.plane import Plane
from hapnet.records.vectors import added, inner

PROBE_M, PROBE_MPS, PROBE_S = 1e-5, 0.1, 0.05
"""Differences of position [m], velocity [m/s] and time [s]."""

INSIDE_M = 2e-4
"""Depth at which a surface in front of the proxy is examined [m]."""

AHEAD_M = (0.002, 0.006, 0.015)
"""Depths of the course beyond the proxy, or beyond the surface in front of it [m]."""

FIRST_M, GROWTH = 0.001, 1.3
"""First sample of a ray [m]; growth of the distance to the next sample."""

RAYS = 4
"""Rays of a step, besides the one along the proxy's motion; one axis has only two."""

HALVINGS, TURNS = 12, 3
"""Rounds of a bisection, and of the search for the nearest point."""

PATIENCE = 3
"""Steps in a row without a contact, after which the search ends for good: changes to and fro would be felt."""

DEEPEST_M, SLOWEST_S = 1.0, 0.03
"""Greatest depth of a contact [m]; its longest time constant, damping by stiffness [s], about that of the proxy."""

LEAST_N, SOFTEST, FLAT_PER_M = 1e-3, 1.0, 0.01
"""Least force [N], stiffness [N/m] and curvature [1/m]."""

SLIGHT, NEW, CORNER = 0.01, 0.1, 0.25
"""Shares of a force or stiffness: below the first it is left out, above the second it is another contact, above the
third it makes a corner."""

SAME, ALIKE = 1.0 - 1e-6, 0.9
"""Cosines between the normals at one point of a surface, and between those of one surface."""


def can_be_searched(law: object, dof: int, units: str) -> bool:
    """Whether `law` is a plain function of one to three lengths or angles that seems to keep no state.

    It must not set a global, an outer variable, an attribute, or an item of a global or an outer variable.
    """
    if not inspect.isfunction(law) or dof > 3 or len(set(units.split(","))) > 1:
        return False
    code, outer = list(dis.get_instructions(law)), law.__code__.co_freevars
    for one, container in zip(code, [*code[:2], *code], strict=False):  # loaded two instructions before
        lasts = container.opname == "LOAD_GLOBAL" or container.argval in outer
        sets = {"STORE_GLOBAL": True, "STORE_ATTR": True, "STORE_DEREF": one.argval in outer, "STORE_SUBSCR": lasts}
        if sets.get(one.opname, False):
            return False
    return True


class NotAContact(Exception):
    """No plane describes the force."""


class FoundPlanes:
    """Finds the planes of a force function with n axes around a proxy."""

    def __init__(self, law: Law, dof: int) -> None:
        self._law, self._dof = law, dof
        self._rest: Vector = (0.0,) * dof
        rays = [ray for ray in product((0.0, 1.0, -1.0), repeat=dof) if any(ray)]
        self._rays = [tuple([part / hypot(*ray) for part in ray]) for ray in rays]
        self._turn, self._refused, self._time = 0, 0, 0.0
        self._proxy = self._last = self._rest
        self._answer: list[Plane] | None = None
        self._places: list[Vector] = []
        self._planes: list[tuple[Plane, Vector]] = []  # with their feet

    def around(self, position: Vector, reach_m: float, time: float) -> list[Plane] | None:
        """The planes that `position` [m] touches, or has within `reach_m` [m]; None: no plane describes the force."""
        if self._refused >= PATIENCE:
            return None
        self._time, self._proxy, self._planes = time, position, []
        try:
            with np.errstate(all="ignore"):
                self._search(reach_m)
        except (NotAContact, ArithmeticError, np.linalg.LinAlgError):
            self._refused += reach_m > 0.0
            return None if self._refused >= PATIENCE else self._answer
        found = [plane for plane, _ in self._planes]
        if reach_m > 0.0:
            self._refused, self._answer = 0, found
        return found

    def _search(self, reach_m: float) -> None:
        force = self._force(self._proxy)
        if _size(force) > LEAST_N:
            self._add(self._proxy)
        elif not any(force):
            self._require_free()
        if reach_m > 0.0:
            self._look_around(reach_m)
        if self._force(self._proxy) != force:  # it has a state, or noise
            self._refused = PATIENCE
            raise NotAContact

    def _look_around(self, reach_m: float) -> None:
        """Add the contacts around the proxy: those found before, then along rays."""
        before, self._places = self._places, [self._proxy] if self._planes else []
        for place in before:
            if self._is_new(place):
                self._add(place)
        for ray in self._chosen(_minus(self._proxy, self._last)):
            self._look_along(ray, reach_m)
        self._last = self._proxy

    def _chosen(self, moved: Vector) -> Iterator[Vector]:
        if self._dof > 1 and _size(moved) > PROBE_M:
            yield _unit(moved)
        for _ in range(min(RAYS, len(self._rays))):
            self._turn = (self._turn + 1) % len(self._rays)
            yield self._rays[self._turn]

    def _look_along(self, ray: Vector, reach_m: float) -> None:
        """Add the contact that a ray from the proxy meets first."""
        far, step = 0.0, FIRST_M
        while far < reach_m:
            far, step = min(far + step, reach_m), GROWTH * step
            if self._is_new(_along(self._proxy, ray, far)):
                place = self._entered(_along(self._proxy, ray, far))
                rest = self._unexplained(place)
                if inner(rest, ray) < 0.0:
                    self._add(place)
                elif rest == self._force(place):  # attraction
                    raise NotAContact
                return

    def _entered(self, place: Vector) -> Vector:
        """The first place on the way from the proxy to `place` with a force that is new."""
        way, free, touching = _minus(place, self._proxy), 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (free + touching)
            new = self._is_new(_along(self._proxy, way, middle))
            free, touching = (free, middle) if new else (middle, touching)
        return _along(self._proxy, way, touching)

    # -- one contact --------------------------------------------------------------------------------------------------

    def _add(self, place: Vector) -> None:
        """Add the planes of the contact that `place` [m] is in, at its point nearest to the proxy."""
        if len(self._planes) >= MOST_PLANES:
            return
        for _ in range(TURNS):
            rest = self._unexplained(place)
            if not (force := _size(rest)) > 0.0:
                return  # the surface ends before it comes to the proxy
            normal = _scaled(rest, -1.0 / force)
            stiffness = (self._push(_along(place, normal, PROBE_M), normal) - force) / PROBE_M
            if not stiffness > -SLIGHT:
                raise NotAContact
            begin = self._begin(place, normal, force, stiffness)
            bends, resisting = self._bends(place, rest, inner(normal, place) - begin, across(normal))
            if place is self._proxy:
                break
            surface = _along(place, normal, begin - inner(normal, place))
            turned, depth = tangent(normal, surface, bends, self._proxy)
            place = self._under(turned, -depth)
            if inner(turned, normal) > SAME:
                break
        ahead = begin - inner(normal, self._proxy)
        if place is not self._proxy:
            if -ahead * stiffness > 2.0 * LEAST_N or not self._is_new(place):
                return
            self._places.append(place)
        planes = self._corner(place) if resisting > CORNER * stiffness else self._course(normal, begin, bends)
        if not planes:
            raise NotAContact
        effects = self._damping(place, normal, added([plane.stiffness for plane in planes]), resisting)
        planes[0] = planes[0]._replace(effects=effects)
        self._planes += [(plane, _along(self._proxy, plane.normal, -plane.depth(self._proxy))) for plane in planes]

    def _under(self, normal: Vector, ahead: float) -> Vector:
        """A place under the surface, along a normal from the proxy; the surface is about `ahead` of it [m]."""
        deeper = INSIDE_M
        while deeper < AHEAD_M[0] and not self._is_new(_along(self._proxy, normal, ahead + deeper)):
            deeper *= 2.0
        return _along(self._proxy, normal, ahead + deeper)

    def _bends(self, place: Vector, rest: Vector, deep: float, sides: Sequence[Vector]) -> tuple[Curvatures, float]:
        """The curvatures of the surface that is `deep` above a place [m]; the stiffness across its normal [N/m]."""
        if not sides:
            return (), 0.0
        J = [_scaled(_minus(self._unexplained(_along(place, side, PROBE_M)), rest), 1.0 / PROBE_M) for side in sides]
        bent = np.array([[inner(row, side) for side in sides] for row in J])
        values, turned = np.linalg.eigh(0.5 * (bent + bent.T))
        found = []
        for value, shares in zip(values.tolist(), turned.T.tolist(), strict=True):
            kappa = value / (_size(rest) + value * deep)
            if FLAT_PER_M < abs(kappa) < MOST_CURVATURE_PER_M:
                found.append(Curvature(tuple([inner(shares, parts) for parts in zip(*sides, strict=True)]), kappa))
        return tuple(found), -float(values[0])

    def _begin(self, place: Vector, normal: Vector, force: float, stiffness: float) -> float:
        """Where the force begins along the normal [m]: where its tangent does or its surface is, whichever is later."""
        along, depth = inner(normal, place), force / stiffness if stiffness > SLIGHT else DEEPEST_M
        if self._push(_along(place, normal, (SLIGHT - 1.0) * depth), normal) > 0.0:
            if depth == DEEPEST_M:
                raise NotAContact  # the same force everywhere
            return along - depth
        touching, free = 0.0, INSIDE_M
        while free < depth and self._push(_along(place, normal, -free), normal) > 0.0:
            touching, free = free, 2.0 * free
        for _ in range(HALVINGS):
            middle = 0.5 * (free + touching)
            inside = self._push(_along(place, normal, -middle), normal) > 0.0
            free, touching = (free, middle) if inside else (middle, touching)
        return along - touching

    def _course(self, normal: Vector, begin: float, bends: Curvatures) -> list[Plane]:
        """Springs in parallel that match the growth of the force along the normal through the proxy."""
        along = inner(normal, self._proxy)
        first = [begin, along] if along - begin > PROBE_M else [begin]
        knots = [*first, *[first[-1] + ahead for ahead in AHEAD_M]]
        pushes = [0.0, *[self._push(_along(self._proxy, normal, knot - along), normal) for knot in knots[1:]]]
        total, found = 0.0, list[Plane]()
        for k in range(len(knots) - 1):
            more = (pushes[k + 1] - pushes[k]) / (knots[k + 1] - knots[k]) - total
            if more > max(SOFTEST, SLIGHT * total):
                found.append(Plane(normal, knots[k], more, 0.0, 0.0, bends))
                total += more
        return found

    def _corner(self, place: Vector) -> list[Plane]:
        """The walls of a corner; they are perpendicular to one another."""
        rest = self._unexplained(place)
        axes = [tuple(axis) for axis in np.eye(self._dof).tolist()]
        J = np.array([_minus(self._unexplained(_along(place, axis, PROBE_M)), rest) for axis in axes]) / PROBE_M
        values, normals = np.linalg.eigh(-0.5 * (J + J.T))
        found = []
        for stiffness, n in zip(values.tolist(), normals.T.tolist(), strict=True):
            if stiffness > max(SOFTEST, SLIGHT * float(values[-1])):
                push = -inner(n, rest)
                normal = tuple(n) if push >= 0.0 else _scaled(n, -1.0)
                found.append(Plane(normal, inner(normal, place) - abs(push) / stiffness, stiffness, 0.0))
        return found

    def _damping(self, place: Vector, normal: Vector, stiffness: float, resisting: float) -> Effects | None:
        """The drag across the normal; NotAContact: friction, much damping, or a force that changes with time.

        resisting : the stiffness across the normal [N/m].
        """
        still, drags = self._force(place), []
        if self._force(place, None, PROBE_S) != still:
            raise NotAContact
        if self._unexplained(place) != still:
            return None  # in other contacts too, whose damping is not known apart
        for side, own in ((normal, stiffness), *[(side, resisting) for side in across(normal)]):
            change = _minus(still, self._force(place, _scaled(side, PROBE_MPS)))
            drag = inner(change, side)
            beside = _size(_minus(change, _scaled(side, drag)))
            is_damper = drag >= -1e-9 and beside <= SLIGHT * (_size(still) + drag) + 1e-9
            if not is_damper or (side is normal and drag > SLOWEST_S * PROBE_MPS * own):
                raise NotAContact
            if side is not normal and drag > SLOWEST_S * PROBE_MPS * max(own, 0.0) + 1e-9:
                twice = inner(_minus(still, self._force(place, _scaled(side, 2.0 * PROBE_MPS))), side)
                if abs(twice - 2.0 * drag) > SLIGHT * twice:
                    raise NotAContact
                drags.append(drag / PROBE_MPS)
        return Effects(viscosity=min(added(drags) / len(drags), MOST_VISCOSITY)) if drags else None

    def _require_free(self) -> None:
        """NotAContact: a force on a proxy that moves in free space, or later."""
        beside = [_along(self._proxy, ray, PROBE_M) for ray in self._rays]
        if any(map(any, map(self._force, beside))):
            return  # between contacts, as in the middle of a spring
        moves = [self._force(self._proxy, (speed,) * self._dof) for speed in (PROBE_MPS, -PROBE_MPS)]
        if any(map(any, (*moves, self._force(self._proxy, None, PROBE_S)))):
            raise NotAContact

    # -- the force ----------------------------------------------------------------------------------------------------

    def _force(self, place: Vector, velocity: Vector | None = None, later_s: float = 0.0) -> Vector:
        """The force at a place; zero where the function fails: the run reports that if the proxy comes there."""
        try:
            found = self._law(place, velocity or self._rest, self._time + later_s)
            force = tuple(np.array(found, dtype=float, ndmin=1).tolist())
        except BaseException as error:  # see `loading.failure`
            failure(error)
            return self._rest
        return force if len(force) == self._dof and isfinite(_size(force)) else self._rest

    def _unexplained(self, place: Vector) -> Vector:
        """The force at a place without that of the planes found so far."""
        rest = self._force(place)
        for plane, foot in self._planes:
            normal, depth = tangent(plane.normal, foot, plane.curvatures, place)
            if depth > 0.0:
                rest = _along(rest, normal, plane.stiffness * depth)
        return rest

    def _push(self, place: Vector, normal: Vector) -> float:
        """The unexplained force against the normal [N]."""
        return -inner(normal, self._unexplained(place))

    def _is_new(self, place: Vector) -> bool:
        """Whether the planes found so far leave a force at a place unexplained, along another normal."""
        rest = self._unexplained(place)
        if not (size := _size(rest)) > max(LEAST_N, NEW * _size(self._force(place))):
            return False
        for plane, foot in self._planes:
            normal, depth = tangent(plane.normal, foot, plane.curvatures, place)
            against = -inner(normal, rest) / size
            if against > ALIKE or (depth > 0.0 and against < -ALIKE):
                return False
        return True


def _size(vector: Vector) -> float:
    return hypot(*vector)


def _scaled(vector: Sequence[float], factor: float) -> Vector:
    return tuple([factor * part for part in vector])


def _unit(vector: Vector) -> Vector:
    return _scaled(vector, 1.0 / _size(vector))


def _minus(one: Vector, other: Vector) -> Vector:
    return tuple([a - b for a, b in zip(one, other, strict=True)])


def _along(place: Vector, direction: Vector, distance: float) -> Vector:
    return tuple([a + distance * b for a, b in zip(place, direction, strict=True)])
