"""How y follows a change of the planes: its jump is compensated, and the compensation fades.

A wall is one plane, and stays where it is; a few planes stand for a tool among edges, and each answer has others. A new
plane may be centimetres in front of the device. Full strength at once would throw the device back, onto planes that are
as wrong: the spring would give out energy at each change. So the changes of a tool's planes put no more energy into the
spring than earlier ones took out of it.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from hapnet.records.record import Floats, Reals, equation
from hapnet.records.vectors import dot, length, times
from hapnet.units import POSE_AXES

TIMES_SLOWER = 40.0
"""A change of a tool's planes takes effect in this many times `fade_s`: most changes are large."""

LENT_J = 0.002
"""The most energy that changes of a tool's planes may put into the spring beyond what they took out before [J]."""


@equation
def follow_change(model: Any, n: int, dt: float, x: Reals, y: Floats) -> None:
    """Add the remaining compensation of a change of planes to y, for a device at x [m]."""
    if n == POSE_AXES:
        fade_at_no_cost(model, n, dt, x, y)
    else:
        fade(model, n, dt, y)


@equation
def fade(model: Any, n: int, dt: float, y: Floats) -> None:
    """Add the compensation to y, less by a part in each tick."""
    if length(n, model.fading) == 0.0:
        return
    share = model.fade_s / (model.fade_s + dt)
    for i in range(n):
        model.fading[i] = share * model.fading[i]
        y[i] = y[i] + model.fading[i]
    if not length(n, model.fading) > 1e-9:
        for i in range(n):
            model.fading[i] = 0.0


@equation
def fade_at_no_cost(model: Any, n: int, dt: float, x: Reals, y: Floats) -> None:
    """As `fade`, for the planes of a tool: their changes put no energy into the spring that they have not taken out.

    The spring's strain ``e = x - y`` approaches the strain that the new planes imply, but where phi(e) and `lent_J` do
    not suffice it only turns. Further motion into the planes meets their full stiffness.
    """
    if length(n, model.fading) == 0.0:
        return
    span = TIMES_SLOWER * model.fade_s
    share = span / (span + dt)
    strain = model.before
    for i in range(n):
        strain[i] = x[i] - y[i] - model.fading[i]
    before = strained_J(model, n, strain)
    for i in range(n):
        strain[i] = x[i] - y[i] - share * model.fading[i]
    after, allowed = strained_J(model, n, strain), before + model.lent_J
    if after > allowed:
        part = sqrt(allowed / after)
        for i in range(n):
            strain[i] = part * strain[i]
        after = allowed
    model.lent_J = min(LENT_J, allowed - after)
    for i in range(n):
        model.fading[i] = x[i] - y[i] - strain[i]
        y[i] = x[i] - strain[i]
    if not length(n, model.fading) > 1e-9:
        for i in range(n):
            model.fading[i] = 0.0


@equation
def strained_J(model: Any, n: int, strain: Reals) -> float:
    """phi of the device's spring, if it does not saturate [J]."""
    times(n, model.added.stiffness, strain, model.leading)
    return 0.5 * dot(n, strain, model.leading)
