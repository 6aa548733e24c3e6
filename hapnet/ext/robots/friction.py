"""Coulomb friction of a simulated robot, as a drag for a step of its mass.

A step of length T solves (2M/T + g) vhat = 2M/T v + p + f with the mean velocity vhat (`hapnet.plant.integrator`), and
ends with the velocity 2 vhat - v. Any drag g >= 0 dissipates, g |vhat|^2 T, whatever the contacts do in the step; so
friction is a drag that is chosen before the step, such that the friction force is F while the robot slides, and at
most F where that stops it within the step. p is known; f, the contacts' force, is that of the step before.
"""

from __future__ import annotations

import math

from hapnet.checks import Vector
from hapnet.records.vectors import inner

_STUCK = 1e9
"""The drag of a robot that sticks [Ns/m]."""


def friction_drag(friction: float, mass: float, drag: float, dt: float, v: Vector, force: Vector) -> float:
    """The drag of the next step [Ns/m] that acts as Coulomb friction.

    friction : F [N]. mass : M [kg]. drag : of everything else [Ns/m]. dt : T [s]. v : at the step's start [m/s].
    force : p + f (n,) [N].
    """
    if friction == 0.0:
        return 0.0
    square = inner(v, v)
    if square == 0.0 and math.hypot(*force) <= friction:
        return _STUCK
    if square > 0.0:
        along = mass / dt * square + inner(force, v) - 0.5 * drag * square  # of what stops it in this step, along v
        needed = [mass / dt * one + f - 0.5 * drag * one for one, f in zip(v, force, strict=True)]
        if along >= 0.0 and math.hypot(*needed) <= friction:
            return 2.0 * along / square
    pushes = math.hypot(*[2.0 * mass / dt * one + f for one, f in zip(v, force, strict=True)])
    if pushes <= friction:
        return 0.0  # it turns round in this step, and sticks in the next
    return friction * (2.0 * mass / dt + drag) / (pushes - friction)
