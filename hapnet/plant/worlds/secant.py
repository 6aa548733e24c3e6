"""A solid near the proxy, and the plane that stands for it in a step."""

from __future__ import annotations

from collections.abc import Callable
from math import dist, inf, sqrt
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.plant.worlds.friction import Friction
from hapnet.plant.worlds.shapes import Near, Shape
from hapnet.plant.worlds.walls import Axis, Face

GOOD_MPS = 5e-5
"""A plane that is wrong at the step's end by less than this times its length is not corrected [m/s]. The anchor pays
for errors, so what counts is how much a second: 5 N times this is 0.25 mW."""

_MOST_TURN = 0.7
"""The largest correction of a gradient."""

_AGAINST = -0.5
"""A cosine below this: the gradient is that of the back."""

_LIFT_M, _LIFTS = 0.005, 5
"""The front is looked for at least so far in front, and so often at twice the distance."""

_CAST_STEPS = 16


class Hit(NamedTuple):
    """A point on a path or at its end, in front of the surface or behind it."""

    at: Vector
    near: Near


class Secant:
    """A solid near the proxy. In a step a plane stands for it, ``p = depth + normal . Delta``, with spring and damper.

    Parameters
    ----------
    shape : of the solid. stiffness, damping, friction : K_w [N/m], B_w [Ns/m] and Coulomb's mu; if that is a function
        of the place, the attribute is what it gave for this step.
    """

    __slots__ = (
        "_along", "_asked", "_at", "_entering", "_flat", "_front", "_half", "_near", "_plane", "_rounds", "_start",
        "_varies", "damping", "depth", "friction", "normal", "push", "shape", "slope", "stiffness",
    )  # fmt: skip

    def __init__(self, shape: Shape, stiffness: float, damping: float, friction: float | Friction) -> None:
        self.shape: Shape = shape
        self.slope: float = shape.slope
        self._flat = shape.flat_m
        self.stiffness: float = stiffness
        self.damping: float = damping
        self._varies: Friction | None = None
        self.friction: float = 0.0
        if callable(friction):
            self._varies = friction
        else:
            self.friction = friction
        plane = Axis((), Face(0.0, stiffness, damping), Face(-inf, 0.0, 0.0))
        self.push: Callable[[float, float, float, float], float] = plane.force
        """The force along a plane's normal, from depth, velocity without contact, A along it, and the step's length."""
        self.depth: float = 0.0
        self.normal: Vector = (0.0, 0.0, 0.0)
        """Into the solid; of about unit length."""
        self._half = 0.5 * stiffness
        self._front: Vector | None = None  # the gradient at the last onset if that was inside, or where a step enters
        self._at: Vector | None = None  # what is known is known there
        self._near = self._start = Near(0.0, self.normal)
        self._asked: Vector | None = None  # where the shape itself was asked last, and what it answered:
        self._plane, self._along = self._near, 0.0  # distance and gradient, and gradient . place
        self._entering = False
        self._rounds = 0

    # -- where it is --------------------------------------------------------------------------------------------------

    def near(self, x: Vector) -> Near:
        """Distance and gradient at `x` [m]; of a thin solid that was entered, those of the side where it was."""
        if self._at == x:
            return self._near
        if self._flat and (asked := self._asked) is not None and (off := dist(asked, x)) <= self._flat:
            distance, gradient = self._plane
            if off < abs(distance):
                self._at = x
                self._near = Near(distance + _dot(gradient, x) - self._along, gradient)
                return self._near
        near = self.shape.near(x)
        if self._front is not None and _dot(near.gradient, self._front) < _AGAINST:
            near = self._from_the_front(x, near, self._front)
        self._at, self._near = x, near
        if self._flat:
            self._asked, self._plane, self._along = x, near, _dot(near.gradient, x)
        return near

    def farther_than(self, reach: float, x: Vector) -> bool:
        """Is the surface surely farther than `reach` [m] from `x`, as what is known nearby says at no cost?"""
        distance = self._near.distance_m
        if self._at is None or distance <= self.slope * reach:
            return False
        return distance > self.slope * (reach + dist(x, self._at))

    def _from_the_front(self, x: Vector, near: Near, front: Vector) -> Near:
        lift = _LIFT_M + 2.0 * abs(near.distance_m)
        for _ in range(_LIFTS):
            out = _along(x, front, lift)
            distance, gradient = self.shape.near(out)
            if _dot(gradient, front) > -_AGAINST:
                return Near(distance + _dot(gradient, x) - _dot(gradient, out), gradient)
            lift *= 2.0
        return near

    def friction_at(self, x: Vector) -> float:
        """Coulomb's mu at `x` [m]; 0: none, or a number of no sense."""
        mu = self.friction if self._varies is None else self._varies(x)
        return mu if mu > 0.0 else 0.0

    # -- its plane in a step ------------------------------------------------------------------------------------------

    def meets(self, x: Vector, delta: Vector, length: float) -> bool:
        """Is `x` inside, or does the straight path `delta` from there enter? Then the plane is made.

        length : of `delta` [m].
        """
        if self.farther_than(length, x):
            self._front = None
            return False
        self._start = near = self.near(x)
        self._rounds = 0
        if self._varies is not None:
            self.friction = self._varies(x)
        distance, gradient = near
        if distance <= 0.0:
            self._front = gradient
            self._entering = False
            self.depth = -distance
            a, b, c = gradient
            self.normal = (-a, -b, -c)
            return True
        self._front = None
        if distance > self.slope * length or (hit := self._hit(x, delta, length)) is None:
            return False
        self._entering = True
        self._enter(x, hit)
        return True

    def onset_J(self) -> float:
        """U at the step's onset [J]."""
        return self._half * self.depth * self.depth if self.depth > 0.0 else 0.0

    def end_J(self, delta: Vector) -> float:
        """U of the plane at the end of the displacement `delta` (3,) [m]."""
        a, b, c = self.normal
        depth = self.depth + a * delta[0] + b * delta[1] + c * delta[2]
        return self._half * depth * depth if depth > 0.0 else 0.0

    def correct(self, x: Vector, delta: Vector, end: Vector, good: float) -> bool:
        """Turn the plane to what is true at the step's end; False: it is so within `good` [m] already.

        If the surface turns much within the step, planes would alternate without an end. So round k takes the mean
        of all k: it corrects 1/k of the error.
        """
        distance, gradient = self.near(end)
        a, b, c = self.normal
        after = self.depth + a * delta[0] + b * delta[1] + c * delta[2]
        if after <= 0.0 <= distance:
            return False
        wanted = -distance if self._entering else self.depth + self._start.distance_m - distance
        if -good <= after - wanted <= good:
            return False
        self._rounds += 1
        before = self.normal
        if self._entering:
            self._enter(x, Hit(end, Near(distance, gradient)))
        else:
            a, b, c = self._start.gradient
            if distance < 0.0:
                d, e, f = gradient
                a, b, c = 0.5 * (a + d), 0.5 * (b + e), 0.5 * (c + f)
            self.normal = (-a, -b, -c)
        square = _dot(delta, delta)
        turn = (wanted - self.depth - _dot(self.normal, delta)) / square if square else 0.0
        if turn:
            turn *= min(1.0, _MOST_TURN / (abs(turn) * sqrt(square)))
            self.normal = _along(self.normal, delta, turn)
        if not self._entering and self._rounds > 1:
            a, b, c = self.normal
            self.normal = _along(before, (a - before[0], b - before[1], c - before[2]), 1.0 / self._rounds)
        return True

    def _enter(self, x: Vector, hit: Hit) -> None:
        """The tangent plane where it goes in. `x` stays in front of it, so no energy is there at the onset."""
        at, (distance, gradient) = hit
        self._front = gradient
        a, b, c = gradient
        self.normal = (-a, -b, -c)
        self.depth = min(0.0, a * (at[0] - x[0]) + b * (at[1] - x[1]) + c * (at[2] - x[2]) - distance)

    def _hit(self, x: Vector, direction: Vector, length: float) -> Hit | None:
        """Where the straight path from `x`, which is outside, in `direction` enters, roughly; None: nowhere."""
        before = self._start
        end = _along(x, direction, 1.0)
        after = self.near(end)
        recedes = _dot(after.gradient, direction) >= 0.0
        if after.distance_m < 0.0 and not recedes:
            return Hit(end, after)
        if after.distance_m >= 0.0 and not (
            recedes
            and _dot(before.gradient, direction) < 0.0
            and before.distance_m + after.distance_m <= self.slope * length
        ):
            return None
        # It may have gone through, or is past the middle: look where it went in.
        share, at, near = 0.0, x, before
        for _ in range(_CAST_STEPS):
            close = near.distance_m <= 0.01 * length
            if close and _dot(near.gradient, direction) < 0.0:
                self._at = self._asked = None  # what is known of the end is the back's
                return Hit(at, near)
            share += (1.0 / _CAST_STEPS) if close else near.distance_m / (self.slope * length)
            if share >= 1.0:
                break
            at = _along(x, direction, share)
            near = self.shape.near(at)
        return Hit(end, after) if after.distance_m < 0.0 else None


def _along(x: Vector, direction: Vector, share: float) -> Vector:
    return (x[0] + share * direction[0], x[1] + share * direction[1], x[2] + share * direction[2])


def _dot(one: Vector, other: Vector) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
