"""y for a world that cannot send planes: its position, plus the device's own motion since the time of that position.

    y = y_w + sigma (x(t) - x(t - R)),      sigma = max(0, 1 - |y_w - x(t - R)| / distance)

sigma is near 1 while the proxy follows (free motion), and goes to 0 in contact. Both parts are low-passed.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from typing import Any

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.added_damping import damp_swings
from hapnet.control.plane_changes import fade
from hapnet.control.smoothing import low_pass
from hapnet.records.record import Floats, OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy


class SelfMotion(Record):
    """Computes y from the world's positions and the device's own positions.

    distance : at which sigma becomes 0 [m]. smoothing : time constant [s]. history : maximum of R [s].

    Attributes
    ----------
    base, sigma : y_w - sigma x(t - R) [m] and sigma, low-passed. goal, goal_sigma : the same of the newest answer.
    """

    smoothing: float
    base: OfAxes
    sigma: float
    goal: OfAxes
    goal_sigma: float

    def __init__(self, *, distance: float = 0.015, smoothing: float = 0.02, history: float = 2.0) -> None:
        self.distance: float = checks.positive("distance", distance)
        self.smoothing = checks.positive("smoothing", smoothing)
        self.history: float = checks.positive("history", history)
        self.reset(())

    def reset(self, position: Vector) -> None:
        """Start again at `position` [m]."""
        self._past: deque[tuple[float, Vector]] = deque()
        self._now = 0.0
        self.base, self.goal = list(position), list(position)
        self.sigma = self.goal_sigma = 0.0

    def observe(self, dt: float, x: Vector) -> None:
        """Store the device's position x [m], `dt` seconds after the last call."""
        self._now += dt
        past = self._past
        past.append((self._now, x))
        while past[0][0] < self._now - self.history:
            past.popleft()

    def receive(self, position: Vector, age_s: float) -> None:
        """Take in the world's position [m], which holds for the own position `age_s` ago."""
        then = self.own(age_s)
        self.goal_sigma = sigma = max(0.0, 1.0 - math.dist(position, then) / self.distance)
        self.goal = [y - sigma * x for y, x in zip(position, then, strict=True)]

    def own(self, ago: float) -> Vector:
        """The own position `ago` seconds ago [m], or the oldest that is stored."""
        past = self._past
        since = bisect_left(past, self._now - ago, key=lambda one: one[0])
        return past[min(since, len(past) - 1)][1]


@equation
def place(own: SelfMotion, n: int, x: Reals, y: Floats) -> None:
    """y [m] for the own position x (n,) [m] now."""
    for i in range(n):
        y[i] = own.base[i] + own.sigma * x[i]


@equation
def approach(own: SelfMotion, n: int, dt: float) -> None:
    """Let both parts approach those of the newest answer, `dt` seconds after the last step."""
    low_pass(n, dt, own.smoothing, own.base, own.goal)
    own.sigma = own.sigma + dt / (own.smoothing + dt) * (own.goal_sigma - own.sigma)


@equation
def soften(share: float, n: int, x: Reals, y: Floats) -> None:
    """Move y towards x, for a world without planes: a stiff spring to its late answer would ring."""
    if share != 1.0:
        for i in range(n):
            y[i] = x[i] + share * (y[i] - x[i])


@equation
def respond_without_planes(model: Any, n: int, dt: float, x: Reals, y: Floats) -> None:
    """Compute y of a `ContactModel` for a world without planes; the lead is added, weighted by sigma."""
    own, share = model.own, model.share_without_planes
    copy(n, x, model.rubbing.place)
    approach(own, n, dt)
    for i in range(n):
        y[i] = own.base[i] + own.sigma * (x[i] + model.leading[i] / share)
    soften(share, n, x, y)
    fade(model, n, dt, y)
    copy(n, x, model.made_x)
    copy(n, x, model.made_s)
    copy(n, y, model.made_before)
    for i in range(n):
        model.made_fading[i] = 0.0
    damp_swings(model.added, n, dt, x, y, model.age)
    copy(n, y, model.made_y)
