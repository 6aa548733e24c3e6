"""One-sided walls for the passive integrator: exactly passive, in closed form, at any step size.

A wall is a potential ``U(p) = 1/2 K_w max(0, p)^2`` of the penetration ``p = n.x - offset``, plus a damper. Over a step
of length T in which p goes from p0 to p1 = p0 + T vn, its force along n is the *discrete gradient* of U plus the
damper's force for the fraction of the path inside:

    f = -(U(p1) - U(p0)) / (p1 - p0)  -  B_w vn (max(0, p1) - max(0, p0)) / (p1 - p0)

So f vn T = U(p0) - U(p1) - (the damper's dissipation), whatever T is. The integrator requires ``a (vn - w) = f``, where
w is the velocity along n without contact and ``a = 1 / (n' A^-1 n)`` (`hapnet.plant.integrator`). f never increases
with vn, so the solution is unique, and it is at worst the root of a quadratic. A wall would pull if its damper
outweighed its spring on the way out. Then it is left out of the step and the rest is solved again: the mass leaves the
wall faster still, so U does not grow and the step stays passive.

Two walls are independent iff ``n_i' A^-1 n_j = 0``. Opposite faces of one axis share one potential; a fast mass may
cross the whole gap between them in one step. Walls with any other coupling are solved together
(`hapnet.plant.worlds.coupled`).

D. J. Lee and K. Huang (World Haptics 2009) take their wall from a companion paper. The law here is not theirs: it is
derived from energy, for their integrator L_dp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot, inf, isfinite, sqrt
from typing import Annotated

import numpy as np

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.sliding import slide_along_walls, stays_in_walls
from hapnet.params import WallParams
from hapnet.plant.worlds import coupled
from hapnet.plant.worlds.coupled import MOST, Coupled
from hapnet.records.record import AXES, POINT_PLANES, FloatRows, Floats, OfAxes, Reals, Record, Wholes, equation
from hapnet.records.vectors import dot, inner

_WALL = WallParams()
WALL_STIFFNESS, WALL_DAMPING = _WALL.stiffness, _WALL.damping

# Two normals count as independent up to this cosine in the metric of A^-1: it allows for rounding only.
_SEPARATE = 1e-12


@dataclass(frozen=True, slots=True)
class Wall:
    """A plane with a one-sided spring and damper behind it.

    normal : (n,) direction pointing into the wall; any length, stored as a unit vector.
    offset : position of the surface along the unit normal [m]: ``p = normal . x - offset``, free where p <= 0.
    stiffness : K_w [N/m], positive.
    damping : B_w [Ns/m], zero or positive.

    Raises InvalidParameter.
    """

    normal: Vector
    offset: float
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        normal = checks.vector("normal", self.normal)
        length = hypot(*normal)
        if not 0.0 < length < inf:
            raise InvalidParameter("normal", self.normal, "a vector of non-zero length")
        object.__setattr__(self, "normal", tuple(x / length for x in normal))
        check_number("offset", self.offset, "a finite number [m]", isfinite)
        check_number("stiffness", self.stiffness, "a positive number [N/m]", lambda k: 0.0 < k < inf)
        check_number("damping", self.damping, "zero or a positive number [Ns/m]", lambda b: 0.0 <= b < inf)

    def penetration(self, position: Sequence[float]) -> float:
        """Signed penetration p [m] of `position` (n,) [m]: negative on the free side."""
        return float(inner(self.normal, position) - self.offset)

    def depths(self, positions: Array) -> Array:
        """`penetration` of many positions (N, n): (N,) [m]."""
        return np.asarray(positions @ np.array(self.normal) - self.offset)

    def normals(self, positions: Array) -> Array:
        """The normal at each of them: (N, n)."""
        return np.broadcast_to(self.normal, positions.shape)


class Face(Record):
    """One end of an axis: its position along the axis [m], K_w [N/m], B_w [Ns/m]."""

    at: float
    stiffness: float
    damping: float

    def __init__(self, at: float, stiffness: float, damping: float) -> None:
        self.at, self.stiffness, self.damping = at, stiffness, damping


_NOWHERE = Face(-inf, 0.0, 0.0)


class Axis(Record):
    """The walls that share one normal: free for ``lower.at <= q <= upper.at`` with ``q = normal . x``."""

    normal: Annotated[Vector, (AXES,)]
    upper: Face
    lower: Face

    def __init__(self, normal: Vector, upper: Face, lower: Face) -> None:
        self.normal, self.upper, self.lower = normal, upper, lower

    @equation
    def force(self, q: float, w: float, a: float, dt: float) -> float:
        """Force along the normal [N] over a step from coordinate `q` [m], with velocity `w` [m/s] without contact.

        `a` [Ns/m] is the mass's resistance along the normal, `dt` [s] the step's length.
        """
        if q > self.upper.at:
            return -leaving(self.upper, self.lower, q - self.upper.at, self.upper.at - self.lower.at, -w, a, dt)
        if q < self.lower.at:
            return leaving(self.lower, self.upper, self.lower.at - q, self.upper.at - self.lower.at, w, a, dt)
        if w > 0.0:
            return -entering(self.upper, self.upper.at - q, w, a, dt)
        return entering(self.lower, q - self.lower.at, -w, a, dt)

    @equation
    def potential_J(self, q: float) -> float:
        """Energy stored in the axis's springs at coordinate `q` [m]."""
        above, below = max(0.0, q - self.upper.at), max(0.0, self.lower.at - q)
        return 0.5 * (self.upper.stiffness * above * above + self.lower.stiffness * below * below)


force_along, _potential = Axis.force, Axis.potential_J


@equation
def entering(face: Face, distance: float, w: float, a: float, dt: float) -> float:
    """Resistance (>= 0) [N] of a face that lies `distance` >= 0 ahead of a mass that moves at `w` towards it."""
    free_depth = dt * w - distance
    if not free_depth > 0.0:
        return 0.0
    K, B, h = face.stiffness, face.damping, distance
    # With e the depth at the end: (a + K T/2 + B) e^2 + (a (h - free_depth) + B h) e - a free_depth h = 0. Solving for
    # e, not for the velocity, avoids terms that cancel in the discriminant and in the force.
    e = _positive_root(a + K * dt / 2 + B, a * (h - free_depth) + B * h, -a * free_depth * h)
    return K * e * (e / (h + e)) / 2 + B * e / dt if e > 0.0 else 0.0


@equation
def leaving(near: Face, far: Face, depth: float, gap: float, w: float, a: float, dt: float) -> float:
    """Outward force [N] of `near` on a mass `depth` > 0 inside it that moves outwards at `w`; `far` is across `gap`."""
    K, B, d = near.stiffness, near.damping, depth
    if (a - K * dt / 2 + B) * d >= a * w * dt:  # inside: the end is not beyond the surface
        push = a * (K * d - (K * dt / 2 + B) * w) / (a + K * dt / 2 + B)
        return push if push >= 0.0 else -entering(far, d + gap, w, a, dt)
    # Leaving over u >= d: a u^2 + (B d - a w T) u - K T d^2/2 = 0.
    h = d + gap
    u = max(d, _positive_root(a, B * d - a * w * dt, -K * dt * d * d / 2))
    e = 0.0
    if u > h:  # Crossing to e inside the far face: u = h + e, both faces in one balance.
        e = _positive_root(
            a + far.stiffness * dt / 2 + far.damping,
            a * (2 * h - w * dt) + far.damping * h + B * d,
            -(a * (w * dt - h) * h + K * dt * d * d / 2 - B * d * h),
        )
        u = h + e
    push = K * d * (d / u) / 2 - B * d / dt
    if push < 0.0:
        return -entering(far, h, w, a, dt)
    return push - (far.stiffness * e * (e / u) / 2 + far.damping * e / dt)


@equation
def _positive_root(a: float, b: float, c: float) -> float:
    """Positive root of ``a z^2 + b z + c`` for a > 0 >= c, without cancellation (0 where rounding made c positive)."""
    if c > 0.0:
        return 0.0
    root = sqrt(b * b - 4.0 * a * c)
    if b > 0.0:
        return -2.0 * c / (b + root)
    return (root - b) / (2.0 * a)


class Contacts(Record, Surroundings):
    """The `Surroundings` of walls that act on one mass, grouped into axes that are solved independently.

    Parameters
    ----------
    walls : the walls, all of the same dimension. Two may be parallel only as opposite faces with a gap between them.
    dof : the dimension n; needed only without walls.

    Attributes
    ----------
    axes, lines : the axes, and their number. faces : the number of walls; normals, offsets, stiffnesses : of each.
    supplied_J : zero, as no wall moves. near : the indices of the walls that `nearest` has found.
    response, taken : work arrays of `solve` and `nearest`.

    Raises InvalidParameter if dimensions differ, or if parallel walls overlap or face the same direction.
    """

    dof: int = 0
    lines: int
    axes: Annotated[Sequence[Axis], (MOST,)]
    faces: int
    normals: Annotated[FloatRows, (MOST, AXES)]
    offsets: Annotated[Floats, (MOST,)]
    stiffnesses: Annotated[Floats, (MOST,)]
    supplied_J: float = 0.0
    near: Annotated[Wholes, (POINT_PLANES,)]
    taken: Annotated[Wholes, (MOST,)]
    response: OfAxes

    def __init__(self, walls: Sequence[Wall], dof: int | None = None) -> None:
        super().__init__()
        self.walls: tuple[Wall, ...] = tuple(walls)
        if dof is None and not self.walls:
            raise InvalidParameter("dof", dof, "the number of degrees of freedom, because without walls it is unknown")
        self.dof = len(self.walls[0].normal) if dof is None else dof
        for i, wall in enumerate(self.walls):
            if len(wall.normal) != self.dof:
                raise InvalidParameter(
                    f"walls[{i}].normal", wall.normal, f"{self.dof} numbers, one for each degree of freedom"
                )
        self.separate: bool = True
        """Whether all axes are independent, with the A of the last `require_separate`."""
        self._units = [tuple([float(i == j) for j in range(self.dof)]) for i in range(self.dof)]
        self._planes = [Plane(wall.normal, wall.offset, wall.stiffness, wall.damping) for wall in self.walls]
        self.axes = self._axes()
        self.lines, self.faces = len(self.axes), len(self.walls)
        self.normals = [list(wall.normal) for wall in self.walls]
        self.offsets = [wall.offset for wall in self.walls]
        self.stiffnesses = [wall.stiffness for wall in self.walls]
        self.taken, self.response = [0] * self.faces, [0.0] * self.dof
        self._together = Coupled(self.dof, self.faces)
        for wall in self.walls:
            coupled.put(self._together, wall.normal, 0.0, wall.stiffness, wall.damping)
        self._compliance: FloatRows = [[0.0] * self.dof for _ in range(self.dof)]

    def _axes(self) -> list[Axis]:
        axes: list[Axis] = []
        first: list[int] = []  # index of the first wall of each axis
        for i, wall in enumerate(self.walls):
            for k, axis in enumerate(axes):
                name = f"walls[{first[k]}] and walls[{i}]"
                if _same_direction(wall.normal, axis.normal):
                    raise InvalidParameter(name, (axis.normal, wall.normal), "one wall a direction")
                if _same_direction(tuple(-x for x in wall.normal), axis.normal):
                    lower = Face(-wall.offset, wall.stiffness, wall.damping)
                    if axis.lower is not _NOWHERE:
                        raise InvalidParameter(name, (axis.normal, wall.normal), "one wall a direction")
                    if not lower.at < axis.upper.at:
                        raise InvalidParameter(
                            name, f"gap {axis.upper.at - lower.at} m", "opposite faces with a gap between them"
                        )
                    axes[k] = Axis(axis.normal, axis.upper, lower)
                    break
            else:
                axes.append(Axis(wall.normal, Face(wall.offset, wall.stiffness, wall.damping), _NOWHERE))
                first.append(i)
        return axes

    @equation
    def penetration(self, position: Reals) -> float:
        """Depth [m] of `position` (n,) in the wall where it is deepest; 0 outside all walls."""
        deepest = 0.0
        for k in range(self.lines):
            axis = self.axes[k]
            q = dot(self.dof, axis.normal, position)
            if q - axis.upper.at > deepest:
                deepest = q - axis.upper.at
            elif axis.lower.at - q > deepest:
                deepest = axis.lower.at - q
        return deepest

    @equation
    def clearance(self, position: Reals) -> float:
        """The distance [m] of `position` (n,) from the nearest wall."""
        nearest = inf
        for k in range(self.faces):
            nearest = min(nearest, self.offsets[k] - dot(self.dof, self.normals[k], position))
        return nearest

    slide, stays = slide_along_walls, stays_in_walls

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        """The walls at `position` (n,) [m], or within `reach_m` [m] of it: at most four, the deepest first."""
        return tuple([self._planes[k] for k in self.near[: self.nearest(position, reach_m)]])

    @equation
    def nearest(self, position: Reals, reach_m: float) -> int:
        """The number of walls in `planes`; their indices are put into `near`."""
        found = 0
        for k in range(self.faces):
            self.taken[k] = 0
        for _ in range(min(POINT_PLANES, self.faces)):
            nearest, minimum = -1, 0.0
            for k in range(self.faces):
                if not self.taken[k]:
                    away = -(dot(self.dof, self.normals[k], position) - self.offsets[k])
                    if nearest < 0 or away < minimum:
                        nearest, minimum = k, away
            self.taken[nearest] = 1
            if minimum <= reach_m:
                self.near[found] = nearest
                found += 1
        return found

    @equation
    def stored_J(self, position: Reals) -> float:
        """Energy stored in all springs at `position` (n,) [m]."""
        total = 0.0
        for k in range(self.lines):
            total += _potential(self.axes[k], dot(self.dof, self.axes[k].normal, position))
        return total

    def require_outside(self, position: Sequence[float]) -> None:
        """Raise InvalidParameter if `position` (n,) is inside a wall: starting there would create energy."""
        for i, wall in enumerate(self.walls):
            if wall.penetration(position) > 0.0:
                surface = f"outside walls[{i}] (normal {wall.normal}, offset {wall.offset} m)"
                raise InvalidParameter("position", tuple(position), surface)

    def require_separate(self, inverse: Inverse) -> None:
        """Set `separate`; False if there are axes with ``n_i' A^-1 n_j != 0``, which are then solved together."""
        responses = [inverse(axis.normal) for axis in self.axes]
        for i, one in enumerate(self.axes):
            for j in range(i):
                other = self.axes[j]
                coupling = inner(other.normal, responses[i])
                own = inner(one.normal, responses[i]) * inner(other.normal, responses[j])
                if abs(coupling) > _SEPARATE * sqrt(own):
                    self.separate = False

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[list[float], list[float]]:
        """Contact force (n,) [N] and mean velocity vhat (n,) [m/s] over a step, with A vhat = c + force.

        dt : T [s]. position : (n,) x_k [m]. velocity : (n,) the mean velocity A^-1 c [m/s] that the step has without
        contact. inverse : applies A^-1 to a vector.
        """
        if not self.separate:
            return self._solve_together(dt, position, velocity, inverse)
        force, vhat = [0.0] * self.dof, velocity.copy()
        push_back(self, inverse, dt, position, velocity, force, vhat)
        return force, vhat

    def _solve_together(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[list[float], list[float]]:
        together = self._together
        for k, wall in enumerate(self.walls):
            together.depths[k] = wall.penetration(position)
        coupled.compliance(self.dof, [inverse(unit) for unit in self._units], self._compliance)
        coupled.solve(together, velocity, self._compliance, dt)
        force = [0.0] * self.dof
        coupled.total(together, force)
        return force, [v + r for v, r in zip(velocity, inverse(tuple(force)), strict=True)]


@equation
def push_back(
    contacts: Contacts, inverse: Inverse, dt: float, x: Reals, free: Reals, force: Floats, vhat: Floats
) -> None:
    """Solve the contacts of separate walls: `Contacts.solve`; `force` starts at zero, and vhat at `free`."""
    for k in range(contacts.lines):
        if meets(contacts, k, dt, x, free):
            apply(inverse, contacts.axes[k].normal, contacts.response)
            push(contacts, k, dt, x, free, force, vhat)


def apply(inverse: Inverse, vector: Reals, out: Floats) -> None:
    """A^-1 times a vector; in compiled code `inverse` is the mass, and this calls its `solve` (ext/compiled)."""
    out[:] = inverse(tuple(vector))


@equation
def meets(contacts: Contacts, k: int, dt: float, x: Reals, free: Reals) -> bool:
    """Whether axis k acts in a step that has the velocity `free` [m/s] without contact."""
    axis = contacts.axes[k]
    low, high, q = axis.lower.at, axis.upper.at, dot(contacts.dof, axis.normal, x)
    return not (low <= q <= high and low <= q + dt * dot(contacts.dof, axis.normal, free) <= high)


@equation
def push(contacts: Contacts, k: int, dt: float, x: Reals, free: Reals, force: Floats, vhat: Floats) -> None:
    """Add the force [N] of axis k, and its effect on vhat; `response` is A^-1 times the normal."""
    n, axis, response = contacts.dof, contacts.axes[k], contacts.response
    normal = axis.normal
    f = force_along(axis, dot(n, normal, x), dot(n, normal, free), 1.0 / dot(n, normal, response), dt)
    for i in range(n):
        force[i] = force[i] + f * normal[i]
        vhat[i] = vhat[i] + f * response[i]


penetration, nearest, stored, clearance = Contacts.penetration, Contacts.nearest, Contacts.stored_J, Contacts.clearance
"""The names in equations."""


def _same_direction(one: Vector, other: Vector) -> bool:
    return max(abs(x - y) for x, y in zip(one, other, strict=True)) < _SEPARATE


def check_number(name: str, value: object, allowed: str, accept: Callable[[float], bool]) -> None:
    """Raise InvalidParameter unless `value` is a number for which `accept` returns true."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not accept(value):
        raise InvalidParameter(name, value, allowed)
