"""How truly the proxy follows in free motion, and how hard the coupling drags.

Over a transparent coupling the proxy would be where the device is, and nothing would drag (D. A. Lawrence 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.metrics.obstacles import Obstacle
from hapnet.metrics.position import position_error
from hapnet.metrics.windows import Span
from hapnet.recording.samples import Recording

DRAG_MPS = 0.067
"""The speed at which drag is told [m/s]: that of a hand that moves by 30 mm at 0.5 Hz, root mean square."""

NEAR_MPS = (0.05, 0.09)
"""Speeds at which the greatest drag is looked for [m/s]."""

_WINDOW_S = 1.0 / 3.0
"""Force and velocity are means over this time [s]: the regression sees the hand's motion, not a swing at 3 Hz or more,
during which the force and the speed are great and the drag hides."""
_LEAST_S, _LEAST_MPS = 0.3, 0.005


def following_error(recording: Recording, free: NDArray[np.bool_]) -> float | None:
    """Root mean square of the distance between device and proxy in free motion [m]; None without such motion.

    Parameters
    ----------
    free : (N,) is the device outside of all walls, at each of its samples? The proxy may well be in one: it is where
        the hand is not. (`metrics.position.motion` asks for the proxy, since a recording alone knows no walls. It
        leaves out a proxy that has run into a wall, and counts one that is late while the hand pushes in it.)
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    error, known = position_error(device, world)
    counted = error[free[known]]
    return float(np.sqrt(np.mean(counted**2))) if len(counted) else None


class FreeWindows(NamedTuple):
    """Windows of a third of a second in free motion.

    time_s : (M,) when each ends. velocity, force : (M, n) the device's mean velocity [m/s] and the mean force on it [N]
        in each. period_s : time between two windows' ends.
    """

    time_s: Array
    velocity: Array
    force: Array
    period_s: float

    def during(self, span: Span) -> FreeWindows:
        """Those that end in `span`."""
        chosen = span.holds(self.time_s)
        return FreeWindows(self.time_s[chosen], self.velocity[chosen], self.force[chosen], self.period_s)

    def drag(self) -> float | None:
        """The force that resists at `DRAG_MPS` [N], as `drag` says."""
        squared = float(np.sum(self.velocity * self.velocity))
        count = len(self.velocity)
        if count * self.period_s < _LEAST_S or squared < count * _LEAST_MPS**2:
            return None
        return -DRAG_MPS * float(np.sum(self.force * self.velocity)) / squared

    def greatest_drag(self, share: float = 0.95) -> float | None:
        """The quantile at `share` of the force against the motion, over the windows at `NEAR_MPS` [N].

        None with less than 0.3 s of such windows.
        """
        speed = np.linalg.norm(self.velocity, axis=1)
        near = (speed >= NEAR_MPS[0]) & (speed <= NEAR_MPS[1])
        if np.count_nonzero(near) * self.period_s < _LEAST_S:
            return None
        against = -np.einsum("ij,ij->i", self.force[near], self.velocity[near]) / speed[near]
        return float(np.quantile(against, share))


def drag(recording: Recording, walls: Sequence[Obstacle], settling_s: float) -> float | None:
    """The force that resists free motion at `DRAG_MPS` [N]: a linear regression of force on velocity.

    The slope is ``-sum F.v / sum v.v`` with means F and v over a third of a second. A force that only accelerates and
    brakes, such as a mass's, has none. None with less than 0.3 s of `free_windows`, or if they are slower than 5 mm/s
    (root mean square), or if there are none to be had.
    """
    found = free_windows(recording, walls, settling_s)
    return None if found is None else found.drag()


def free_windows(recording: Recording, walls: Sequence[Obstacle], settling_s: float) -> FreeWindows | None:
    """The windows of free motion. None: the two sides are not on one clock, or the run is shorter than a window.

    A window counts if neither the device nor the proxy was in a wall in it, nor during `settling_s` seconds before it.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True) or len(device["time_s"]) < 2:
        return None
    times, x = device["time_s"], device["position_m"]
    period_s = float(times[-1] - times[0]) / (len(times) - 1)
    width = max(1, round(_WINDOW_S / period_s))
    if len(times) <= width:
        return None
    latest = np.maximum(np.searchsorted(world["time_s"], times, side="right") - 1, 0)
    touching = world["penetration_m"][latest] > 0.0
    for wall in walls:
        touching |= wall.depths(x) > 0.0
    untouched_s = times - np.maximum.accumulate(np.where(touching, times, -np.inf))
    free = untouched_s[width:] > settling_s + width * period_s
    total = np.cumsum(device["force_N"], axis=0)
    velocity = ((x[width:] - x[:-width]) / (width * period_s))[free]
    return FreeWindows(times[width:][free], velocity, ((total[width:] - total[:-width]) / width)[free], period_s)
