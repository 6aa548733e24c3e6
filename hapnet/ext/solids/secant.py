"""A solid near the proxy, and the plane that stands for it in a step."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.ext.solids.friction import Friction, FrictionTexture, textured
from hapnet.ext.solids.shapes import UNKNOWN, Bent, Form, Near, Shape, Triple, form_of, near_form, triple
from hapnet.mechanics.curvature import Curvatures
from hapnet.plant.worlds.walls import Axis, Face
from hapnet.records.record import Floats, OfAxes, Record, compiled_as, equation, zero
from hapnet.records.vectors import distance as apart

GOOD_MPS = 5e-5
"""A plane whose error at the step's end is below this times the step's length is not corrected [m/s]. The anchor pays
for errors, so their rate counts: 5 N times this is 0.25 mW."""

_MOST_TURN = 0.7
"""The largest correction of a gradient."""

_AGAINST = -0.5
"""A cosine below this means that the gradient belongs to the back."""

_LIFT_M, _LIFTS = 0.005, 5
"""The front is searched at least this far in front, then this many times at twice the distance."""

_CAST_STEPS = 16


class Hit(NamedTuple):
    """A point on a path or at its end, in front of the surface or behind it; not `found`: the path misses the solid."""

    found: bool
    at: Vector
    near: Near


class Tangent(NamedTuple):
    """A tangent plane relative to a place: the distance of the place in front of it, and the curvatures."""

    distance_m: float
    gradient: Vector
    curvatures: Curvatures


class Known(Record):
    """A solid's distance and gradient, in front of it or behind, at a place [m]; `here`: whether there is one."""

    here: int
    at: OfAxes
    distance: float
    gradient: OfAxes


class Secant(Record):
    """A solid near the proxy. In a step a plane stands for it, ``p = depth + normal . Delta``, with spring and damper.

    shape : of the solid. stiffness, damping, friction : K_w [N/m], B_w [Ns/m] and Coulomb's mu; if that is a function
        of the place (`varies`), the attribute is its value for this step.

    normal : into the solid; of about unit length. plane : the force along it, from depth, velocity without contact,
        A along it, and the step's length. met : whether this step meets it.
    form, texture : of shape and friction, if there are equations for them.
    known : the last known distance of the surface.
    start : distance [m] and gradient where the step begins. front : the gradient at the last onset if that was inside,
        or where a step enters. entering : whether the step enters. rounds : the corrections in this step.
    """

    form: Form
    texture: FrictionTexture
    plane: Axis
    slope: float
    stiffness: float
    damping: float
    friction: float
    varies: int
    depth: float
    normal: OfAxes
    known: Known
    start_m: float
    start: OfAxes
    has_front: int
    front: OfAxes
    entering: int
    rounds: int
    met: int

    def __init__(self, shape: Shape, stiffness: float, damping: float, friction: float | Friction) -> None:
        super().__init__()
        self.shape: Shape = shape
        self.form = form_of(shape) or zero(Form)
        self.slope = shape.slope
        self.stiffness, self.damping = stiffness, damping
        self.plane = Axis((), Face(0.0, stiffness, damping), Face(-inf, 0.0, 0.0))
        self.mu: float | Friction = friction
        if callable(friction):
            self.varies = 1
            if type(friction) is FrictionTexture:
                self.texture = friction
        else:
            self.friction = friction

    @property
    def has_formula(self) -> bool:
        """Whether equations describe its shape and its friction."""
        return self.form.what != UNKNOWN and (not self.varies or self.texture is self.mu)

    def near(self, x: Vector) -> Near:
        """Distance and gradient at `x` [m]; for a thin solid those of the side where it was entered."""
        known = self.known
        if known.here:
            at = known.at
            if at[0] == x[0] and at[1] == x[1] and at[2] == x[2]:
                return Near(known.distance, triple(known.gradient))
        found = ask(self, x)
        if self.has_front and dot(found.gradient, triple(self.front)) < _AGAINST:
            found = _from_the_front(self, x, found, triple(self.front))
        note(known, x, found)
        return found

    def tangents(self, x: Vector, reach: float, dof: int) -> list[Tangent]:
        """The tangent planes of the surface within `reach` [m] of `x`, those at the nearest place first.

        dof : the number of axes along which the device moves.
        """
        if farther_than(self, reach, x):
            return []
        found = near(self, x)
        if found.distance_m > reach:
            return []
        # If the front counts, but the back is nearer, the shape returns the curvatures of the back.
        is_same = isinstance(self.shape, Bent) and self.shape.near(x).gradient == found.gradient
        return [Tangent(*found, self.shape.curvatures(x) if is_same and isinstance(self.shape, Bent) else ())]

    def farther_than(self, reach: float, x: Vector) -> bool:
        """Whether the surface is certainly farther than `reach` [m] from `x`, by known values nearby, at no cost."""
        distance = self.known.distance
        if not self.known.here or distance <= self.slope * reach:
            return False
        return distance > self.slope * (reach + apart(3, x, self.known.at))

    def meets(self, x: Vector, delta: Vector, length: float) -> bool:
        """Whether `x` is inside, or the straight path `delta` from there enters. If so, make the plane.

        length : of `delta` [m].
        """
        if farther_than(self, length, x):
            self.has_front = 0
            return False
        distance, gradient = near(self, x)
        self.start_m, self.rounds = distance, 0
        put(self.start, gradient)
        if self.varies:
            self.friction = friction_now(self, x)
        if distance <= 0.0:
            self.has_front, self.entering, self.depth = 1, 0, -distance
            put(self.front, gradient)
            put_opposite(self.normal, gradient)
            return True
        self.has_front = 0
        if distance > self.slope * length:
            return False
        entry = hit(self, x, delta, length)
        if not entry.found:
            return False
        self.entering = 1
        enter(self, x, entry.at, entry.near)
        return True

    def hit(self, x: Vector, direction: Vector, length: float) -> Hit:
        """The approximate entry of the straight path from `x`, which is outside, in `direction`."""
        before = Near(self.start_m, triple(self.start))
        end = along(x, direction, 1.0)
        after = near(self, end)
        recedes = dot(after.gradient, direction) >= 0.0
        if after.distance_m < 0.0 and not recedes:
            return Hit(True, end, after)
        if after.distance_m >= 0.0 and not (
            recedes
            and dot(before.gradient, direction) < 0.0
            and before.distance_m + after.distance_m <= self.slope * length
        ):
            return Hit(False, end, after)
        # It may have passed through, or be past the middle: find its entry.
        share, at, found = 0.0, x, before
        for _ in range(_CAST_STEPS):
            close = found.distance_m <= 0.01 * length
            if close and dot(found.gradient, direction) < 0.0:
                self.known.here = 0  # the known values at the end belong to the back
                return Hit(True, at, found)
            share += (1.0 / _CAST_STEPS) if close else found.distance_m / (self.slope * length)
            if share >= 1.0:
                break
            at = along(x, direction, share)
            found = ask(self, at)
        return Hit(after.distance_m < 0.0, end, after)

    def correct(self, x: Vector, delta: Vector, end: Vector, good: float) -> bool:
        """Turn the plane so that it is true at the step's end; False: its error is already below `good` [m].

        If the surface turns much within the step, the planes would alternate forever. So round k takes the mean
        of all k planes: it corrects 1/k of the error.
        """
        return turned(self, x, delta, end, near(self, end), good)


# Methods that other kinds of solids override, so plain Python calls the object:


@compiled_as(Secant.near)
def near(secant: Secant, x: Vector) -> Near:
    """Call the method of the same name, like the functions below; compiled code inserts the method itself."""
    return secant.near(x)


@compiled_as(Secant.farther_than)
def farther_than(secant: Secant, reach: float, x: Vector) -> bool:
    return secant.farther_than(reach, x)


@compiled_as(Secant.meets)
def meets(secant: Secant, x: Vector, delta: Vector, length: float) -> bool:
    return secant.meets(x, delta, length)


@compiled_as(Secant.hit)
def hit(secant: Secant, x: Vector, direction: Vector, length: float) -> Hit:
    return secant.hit(x, direction, length)


@compiled_as(Secant.correct)
def correct(secant: Secant, x: Vector, delta: Vector, end: Vector, good: float) -> bool:
    return secant.correct(x, delta, end, good)


def _friction_of_texture(secant: Secant, x: Vector) -> float:
    return textured(secant.texture, x)


@compiled_as(_friction_of_texture)
def friction_now(secant: Secant, x: Vector) -> float:
    """Return the value of the friction function at `x` [m]."""
    return secant.mu(x) if callable(secant.mu) else secant.mu


# -- where it is ------------------------------------------------------------------------------------------------------


@equation
def friction_of(secant: Secant, x: Vector) -> float:
    """Coulomb's mu at `x` [m]; 0: no friction, or an invalid value."""
    mu = friction_now(secant, x) if secant.varies else secant.friction
    return mu if mu > 0.0 else 0.0


def _near_form(secant: Secant, x: Vector) -> Near:
    return near_form(secant.form, x)


@compiled_as(_near_form)
def ask(secant: Secant, x: Vector) -> Near:
    """Compute distance and gradient at `x` [m] from the shape itself."""
    return secant.shape.near(x)


@equation
def note(known: Known, x: Vector, found: Near) -> None:
    known.here, known.distance = 1, found.distance_m
    put(known.at, x)
    put(known.gradient, found.gradient)


@equation
def _from_the_front(secant: Secant, x: Vector, found: Near, front: Vector) -> Near:
    lift = _LIFT_M + 2.0 * abs(found.distance_m)
    for _ in range(_LIFTS):
        out = along(x, front, lift)
        distance, gradient = ask(secant, out)
        if dot(gradient, front) > -_AGAINST:
            return Near(distance + dot(gradient, x) - dot(gradient, out), gradient)
        lift *= 2.0
    return found


# -- its plane in a step ----------------------------------------------------------------------------------------------


@equation
def onset_J(secant: Secant) -> float:
    """U at the step's onset [J]."""
    return 0.5 * secant.stiffness * secant.depth * secant.depth if secant.depth > 0.0 else 0.0


@equation
def end_J(secant: Secant, delta: Vector) -> float:
    """U of the plane at the end of the displacement `delta` (3,) [m]."""
    depth = _after(secant, delta)
    return 0.5 * secant.stiffness * depth * depth if depth > 0.0 else 0.0


@equation
def turned(secant: Secant, x: Vector, delta: Vector, end: Vector, found: Near, good: float) -> bool:
    """Turn the plane so that it is true at the step's end, from distance and gradient in `found`: `Secant.correct`."""
    distance = found.distance_m
    after = _after(secant, delta)
    if after <= 0.0 <= distance:
        return False
    wanted = -distance if secant.entering else secant.depth + secant.start_m - distance
    if -good <= after - wanted <= good:
        return False
    secant.rounds += 1
    before = triple(secant.normal)
    if secant.entering:
        enter(secant, x, end, found)
    else:
        out = triple(secant.start)
        if distance < 0.0:
            a, b, c = out
            d, e, f = found.gradient
            out = (0.5 * (a + d), 0.5 * (b + e), 0.5 * (c + f))
        put_opposite(secant.normal, out)
    normal = triple(secant.normal)
    square = dot(delta, delta)
    turn = (wanted - secant.depth - dot(normal, delta)) / square if square > 0.0 else 0.0
    if turn != 0.0:
        turn *= min(1.0, _MOST_TURN / (abs(turn) * sqrt(square)))
        normal = along(normal, delta, turn)
    if not secant.entering and secant.rounds > 1:
        a, b, c = normal
        normal = along(before, (a - before[0], b - before[1], c - before[2]), 1.0 / secant.rounds)
    put(secant.normal, normal)
    return True


@equation
def _after(secant: Secant, delta: Vector) -> float:
    """The depth of the end of the displacement `delta` behind the plane [m]."""
    a, b, c = triple(secant.normal)
    return secant.depth + a * delta[0] + b * delta[1] + c * delta[2]


@equation
def enter(secant: Secant, x: Vector, at: Vector, found: Near) -> None:
    """Make the tangent plane at the entry. `x` stays in front of it, so it stores no energy at the onset."""
    distance, (a, b, c) = found
    secant.has_front = 1
    put(secant.front, (a, b, c))
    put_opposite(secant.normal, (a, b, c))
    secant.depth = min(0.0, a * (at[0] - x[0]) + b * (at[1] - x[1]) + c * (at[2] - x[2]) - distance)


@equation
def along(x: Vector, direction: Vector, share: float) -> Triple:
    return (x[0] + share * direction[0], x[1] + share * direction[1], x[2] + share * direction[2])


@equation
def dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@equation
def put(target: Floats, vector: Vector) -> None:
    target[0], target[1], target[2] = vector[0], vector[1], vector[2]


@equation
def put_opposite(target: Floats, vector: Vector) -> None:
    target[0], target[1], target[2] = -vector[0], -vector[1], -vector[2]
