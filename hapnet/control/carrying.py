"""Carries the proxy through free space (ours): where nothing touches it, it moves with its set-position.

A spring that pulls the proxy after a hand of speed v is stretched by B'v/K' and by the jump of ybar in each step. This
energy is only lent, but a fast hand needs more than the reservoir has: 0.2 J at 0.5 m/s with steps of 50 ms. In free
space no force acts on the proxy, so moving it does no work, and the spring keeps its length if ybar moves by the same
distance. So no energy changes at either port, and PSPM has nothing to pay for.

At the onset of a step, `plan` finds a free way from the proxy to the place where the device will be at the step's end.
It goes forward by the distance in which nothing can touch the proxy (`Surroundings.clearance`), again and again, and
ends `GAP_M` in front of an obstacle. If it is free to its end, or covers enough of the distance to y, y becomes the
proxy's own position, so that the spring is at rest, and `carry` moves both at the step's end.

Along a flat wall without friction the same holds: the proxy is carried along the wall, and the spring acts across it.
Without that a hand that sweeps over a wall at 0.5 m/s takes 3.5 W of the world's reservoir. Otherwise the spring moves
the proxy: along curved surfaces, and wherever there is friction.
"""

from __future__ import annotations

from typing import Any

from hapnet.control import prediction as motion
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.mechanics.sliding import clearance, slide
from hapnet.records.record import Floats, Reals, equation
from hapnet.records.vectors import copy, distance

GAP_M = 0.001
"""The proxy is carried up to this distance from an obstacle [m]."""

LEAST_SHARE = 0.5
"""A way that is not free to its end covers this share of the distance to y; a spring covers 0.8 in a step of 50 ms."""

MOST_PARTS = 8
"""The most parts of a way; each is as long as the clearance at its start."""


@equation
def plan(coupling: SetPositionCoupling, predicted: PredictedDevice, contacts: Any, n: int, x: Reals) -> None:
    """Choose the displacement of the proxy at x [m] in the coming step, after y was chosen. If it is carried, y becomes
    x, so that the spring is at rest."""
    way, p, goal = coupling.carried, predicted.predictor, predicted.goal
    for i in range(n):
        way[i] = 0.0
    if not p.count:
        return
    ahead = motion.predict(p, n, predicted.age + predicted.mean_step, goal)
    far = distance(n, goal, x)
    if far == 0.0:
        return
    free = _free(contacts, n, x, goal, far, predicted.place)
    if free == 0.0:
        _plan_along(coupling, contacts, n, x, goal, predicted.place)
        return
    if free < far and free < LEAST_SHARE * distance(n, coupling.y, x):
        return
    for i in range(n):
        way[i] = free / far * (goal[i] - x[i])
    copy(n, x, coupling.y)
    if predicted.share < 1.0:  # y was predicted less far than the proxy goes
        predicted.aimed_s = p.times[p.start + p.count - 1] + ahead + predicted.lag - predicted.mean_step / 2.0


@equation
def _plan_along(coupling: SetPositionCoupling, contacts: Any, n: int, x: Reals, goal: Reals, place: Floats) -> None:
    """Choose a displacement along the walls that are close to the proxy at x [m]; there y becomes x. place : temporary
    memory."""
    way, y = coupling.carried, coupling.y
    for i in range(n):
        way[i], place[i] = goal[i] - x[i], y[i] - x[i]
    slides = slide(contacts, x, GAP_M, way, place)
    for i in range(n):
        way[i] = way[i] if slides else 0.0
        y[i] -= place[i] if slides else 0.0


@equation
def _free(contacts: Any, n: int, x: Reals, goal: Reals, far: float, place: Floats) -> float:
    """The length of the free way from x towards the goal, which is `far` [m] away. place : temporary memory."""
    free = 0.0
    for _ in range(MOST_PARTS):
        for i in range(n):
            place[i] = x[i] + free / far * (goal[i] - x[i])
        part = clearance(contacts, place) - GAP_M
        if part <= 0.0:
            break
        free = min(far, free + part)
        if free == far:
            break
    return free


@equation
def carry(coupling: SetPositionCoupling, mass: Any, contacts: Any, n: int, dt: float) -> bool:
    """Carry the mass and ybar as planned, at the end of a step of `dt` seconds; return whether they were carried.

    They stay if something touched the mass in the step, or would touch it at its new place.
    """
    way = coupling.carried
    if not displace(mass, way, dt, contacts):
        return False
    for i in range(n):
        coupling.modulator.ybar[i] += way[i]
        coupling.place[i] += way[i]
    return True


def displace(mass: Any, way: Floats, dt: float, contacts: Any) -> bool:
    """Call the mass's `displace`. A compiled version is `hapnet.plant.integrator.displace`."""
    moved: bool = mass.displace(way, dt, contacts)
    return moved
