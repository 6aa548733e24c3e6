"""Simulated hands: an impedance that follows a motion.

The hand holds the device: ``f = K_h (x_d(t) - x) + B_h (x_d' - x') - M_h x''``. The default impedance is the arm fit of
Sci. Rep. srep18004 (M 0.554 kg, B 6.45 Ns/m, K 135 N/m). The motion x_d is sampled once a tick and joined by straight
lines. Whatever the motion, the human port's account counts exactly the work that the hand did.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.params import OperatorParams

_HAND = OperatorParams()


@dataclass(frozen=True)
class Impedance:
    """The hand's mass [kg], damping [Ns/m] and stiffness [N/m], the same on each axis."""

    mass: float = _HAND.mass
    damping: float = _HAND.damping
    stiffness: float = _HAND.stiffness

    def __post_init__(self) -> None:
        checks.non_negative("operator.mass", self.mass)
        checks.non_negative("operator.damping", self.damping)
        checks.non_negative("operator.stiffness", self.stiffness)


class Operator(Protocol):
    """A hand: its impedance, and the reference motion that it follows."""

    @property
    def impedance(self) -> Impedance: ...

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` seconds after the start, shape (n,); t never decreases from call to call."""


class Rest:
    """A hand that holds still."""

    def __init__(self, dof: int, impedance: Impedance, position: Vector | None = None) -> None:
        self.impedance = impedance
        self._position = position or (0.0,) * dof

    def reference(self, t: float) -> Vector:
        return self._position

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]."""
        return np.tile(self._position, (len(times), 1))


class Sine:
    """A sine on each axis, ``centre + amplitude sin(2 pi f t + i pi / 2)``: a circle in two axes.

    It grows from rest at the centre: during the first `start_s` seconds the amplitude is multiplied by Flash and
    Hogan's minimum-jerk share (J. Neuroscience, 1985), so that speed and acceleration start at zero. With 0 it is full
    from the start, at full speed.

    amplitude : [m]; frequency : [Hz]; centre : [m], shape (n,); start_s : [s].
    """

    def __init__(
        self,
        dof: int,
        impedance: Impedance,
        amplitude: float = 0.03,
        frequency: float = 0.5,
        centre: Vector | None = None,
        start_s: float = 0.0,
    ) -> None:
        self.impedance = impedance
        self._start = checks.non_negative("start_s", start_s)
        self._amplitude = checks.non_negative("operator.amplitude", amplitude)
        self._omega = 2.0 * math.pi * checks.non_negative("operator.frequency", frequency)
        self._axes = [(middle, axis * math.pi / 2.0) for axis, middle in enumerate(centre or (0.0,) * dof)]

    def reference(self, t: float) -> Vector:
        phase, amplitude, sin = self._omega * t, self._amplitude, math.sin
        if t < self._start:
            amplitude *= minimum_jerk(t / self._start)
        return tuple([middle + amplitude * sin(phase + ahead) for middle, ahead in self._axes])

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]. Numpy's sine may differ in its last bit."""
        phases, amplitude = self._omega * times, np.full(len(times), self._amplitude)
        if self._start:
            amplitude = np.where(times < self._start, amplitude * minimum_jerks(times / self._start), amplitude)
        sines = [[math.sin(phase) for phase in (phases + ahead).tolist()] for _, ahead in self._axes]
        axes = zip(self._axes, sines, strict=True)
        return np.stack([middle + amplitude * np.array(sine) for (middle, _), sine in axes], axis=1)


class Press:
    """Minimum-jerk press and hold, then withdraw, repeated.

    start, goal : where the hand waits and where it presses to [m], shape (n,).
    reach : duration of the motion in, and of that out [s]. hold : time at the goal [s]. wait : time at the start [s].
    """

    def __init__(
        self,
        start: Vector,
        goal: Vector,
        impedance: Impedance,
        *,
        reach: float = 1.0,
        hold: float = 1.5,
        wait: float = 0.5,
    ) -> None:
        self.impedance = impedance
        self._axes = [(a, b - a) for a, b in zip(start, goal, strict=True)]
        self._reach = checks.positive("operator.reach_s", reach)
        self._hold = checks.non_negative("operator.hold_s", hold)
        self._wait = checks.non_negative("operator.wait_s", wait)
        self._cycle = 2.0 * reach + hold + wait
        self._share, self._point = 0.0, tuple([a + 0.0 * offset for a, offset in self._axes])

    def reference(self, t: float) -> Vector:
        phase = t % self._cycle - self._wait
        if phase > self._reach + self._hold:
            phase = 2.0 * self._reach + self._hold - phase  # the motion out is the motion in, mirrored in time
        share = 0.0 if phase <= 0.0 else 1.0 if phase >= self._reach else minimum_jerk(phase / self._reach)
        if share != self._share:
            self._share = share
            if len(self._axes) == 1:
                a, offset = self._axes[0]
                self._point = (a + share * offset,)
            else:
                self._point = tuple([a + share * offset for a, offset in self._axes])
        return self._point

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]."""
        phase = times % self._cycle - self._wait
        back = 2.0 * self._reach + self._hold - phase
        share = minimum_jerks(np.where(phase > self._reach + self._hold, back, phase) / self._reach)
        return np.stack([a + share * offset for a, offset in self._axes], axis=1)


class HeldAtEnd:
    """A hand that ends its motion: it goes to rest in a minimum-jerk blend, and holds still from then on.

    hand : the hand before the blend. from_s : start of the blend [s]. over_s : its duration [s].
    at : the hand's place of rest after it [m], shape (n,); None: its place when the blend began.
    """

    def __init__(self, hand: Operator, from_s: float, over_s: float, at: Vector | None = None) -> None:
        self.impedance: Impedance = hand.impedance
        self._hand, self._from, self._over = hand, from_s, checks.positive("over_s", over_s)
        self._at = at

    def reference(self, t: float) -> Vector:
        if t <= self._from:
            return self._hand.reference(t)
        if self._at is None:
            self._at = self._hand.reference(self._from)
        if t >= self._from + self._over:
            return self._at
        share = minimum_jerk((t - self._from) / self._over)
        return tuple([x + share * (rest - x) for x, rest in zip(self._hand.reference(t), self._at, strict=True)])


class Recorded:
    """A recorded motion, replayed in a loop: at its end the hand returns to the start in a minimum-jerk move.

    path : (N, n) positions [m] on an even grid of `step` seconds.
    """

    _RETURN_S = 1.0

    def __init__(self, path: Array, step: float, impedance: Impedance) -> None:
        self.impedance = impedance
        back_steps = max(2, round(self._RETURN_S / step))
        share = np.array([minimum_jerk(i / back_steps) for i in range(1, back_steps)])[:, None]
        whole = np.vstack([path, path[-1] + share * (path[0] - path[-1]), path[:1]])
        self._points: list[Vector] = [tuple(point) for point in whole.tolist()]
        self._step = step
        self._period = (len(self._points) - 1) * step

    @property
    def duration(self) -> float:
        """Duration of one loop, including the return [s]."""
        return self._period

    def reference(self, t: float) -> Vector:
        index, share = divmod((t % self._period) / self._step, 1.0)
        first = self._points[min(int(index), len(self._points) - 2)]
        second = self._points[min(int(index), len(self._points) - 2) + 1]
        return tuple([a + share * (b - a) for a, b in zip(first, second, strict=True)])


class Followed:
    """A recorded motion, followed once on cubic curves through its points; at rest before the first and after the last.

    The slope at a point is that of the parabola through it and its neighbours. So on an even grid of step h the error
    for a smooth motion is at most ``h^3/24 max|d^3x/dt^3|`` plus the fourth-order term of Hermite's formula.

    times : (N,) seconds since the start, increasing. path : (N, n) positions at these times [m]. missing : what is
    missing of the motion, as a line; None: nothing.
    """

    def __init__(self, times: Array, path: Array, impedance: Impedance, missing: str | None = None) -> None:
        self.impedance = impedance
        self.missing = missing
        slope = np.gradient(path, times, axis=0)
        h = np.diff(times)[:, None]
        mean = np.diff(path, axis=0) / h
        a, b = slope[:-1], slope[1:]
        curves = np.stack([path[:-1], a, (3.0 * mean - 2.0 * a - b) / h, (a + b - 2.0 * mean) / h**2], axis=-1)
        self._curves: list[list[tuple[float, float, float, float]]] = curves.tolist()
        self._times: list[float] = times.tolist()
        self._ends: tuple[Vector, Vector] = tuple(path[0].tolist()), tuple(path[-1].tolist())

    def reference(self, t: float) -> Vector:
        at = bisect_right(self._times, t) - 1
        if at < 0:
            return self._ends[0]
        if at >= len(self._curves):
            return self._ends[1]
        s = t - self._times[at]
        return tuple([p0 + s * (p1 + s * (p2 + s * p3)) for p0, p1, p2, p3 in self._curves[at]])


def minimum_jerk(s: float) -> float:
    """Flash and Hogan's ``10 s^3 - 15 s^4 + 6 s^5`` for s from 0 to 1, constant outside."""
    if s <= 0.0:
        return 0.0
    if s >= 1.0:
        return 1.0
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def minimum_jerks(s: Array) -> Array:
    """`minimum_jerk` of many numbers."""
    inside = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    return np.where(s <= 0.0, 0.0, np.where(s >= 1.0, 1.0, inside))


def hand_path(operator: Operator, times: Array) -> Array:
    """The hand's reference at these increasing times [s], (N, n) [m]: the same values as `reference`, bit by bit.

    A hand that can compute many points at once has a method `path`, with the same arguments and result.
    """
    many: Callable[[Array], Array] | None = getattr(operator, "path", None)
    if many is not None:
        return many(times)
    return np.array([operator.reference(t) for t in times.tolist()])
