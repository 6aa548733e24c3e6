"""Bounds of a pair of robots: of a spring that is held from tick to tick, and of the loop over the link.

All are those of linear models: a robot is a mass m with a damping b, its servo a spring K and a damper B.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hapnet.checks import Array

MARGIN = 1.5
"""A setting that is advised leaves this factor to the loop's limit."""

_ROUNDS = 60
_MOST_HZ = 20_000.0
_STEPS = 60_000
"""The most frequencies at which a loop is computed."""
_SMALL = 0.3
"""A gain that leads round nothing, even if it is larger by `MARGIN`."""


@dataclass(frozen=True)
class LinearRobot:
    """A robot with its servo: m [kg], b [Ns/m], K [N/m], B [Ns/m], and its rate 1/T [Hz]; infinite: it is continuous.

    hand_kg, hand_Ns_m, hand_N_m : of the hand that holds it loosely, in a loop over the link.
    """

    mass: float
    damping: float
    stiffness: float
    servo_damping: float
    servo_hz: float
    hand_kg: float = 0.0
    hand_Ns_m: float = 0.0
    hand_N_m: float = 0.0


def held_loop(robot: LinearRobot) -> tuple[float, float]:
    """The growth in a tick of a free robot on its held spring and damper, and its frequency [Hz].

    The robot's motion in a tick is solved exactly: ``m x'' = -b x' - K x_k - B v_k`` with the force held. With a growth
    above 1 it vibrates by itself, without any link.
    """
    m, b, T = robot.mass, robot.damping, 1.0 / robot.servo_hz
    if T == 0.0:
        return 0.0, 0.0
    decay = math.exp(-b * T / m)
    moved = (1.0 - decay) * m / b if b else T
    by_force = (T - moved) / b if b else T * T / (2.0 * m)
    free = np.array([[1.0, moved], [0.0, decay]])
    forced = np.array([by_force, moved / m])
    roots = np.linalg.eigvals(free - np.outer(forced, [robot.stiffness, robot.servo_damping]))
    root = roots[int(np.argmax(np.abs(roots)))]
    return float(abs(root)), abs(math.atan2(root.imag, root.real)) / (2.0 * math.pi * T)


def largest_stiffness(robot: LinearRobot) -> float:
    """The largest K with which the held loop does not grow [N/m]; 0: there is none."""
    return _largest(lambda K: held_loop(replace(robot, stiffness=K))[0] < 1.0, robot.stiffness)


def smallest_rate(robot: LinearRobot) -> float:
    """The lowest rate with which the held loop does not grow, with K larger by `MARGIN` [Hz]; infinite: none does."""
    stiffer = replace(robot, stiffness=MARGIN * robot.stiffness)
    low, high = robot.servo_hz, _MOST_HZ
    if held_loop(replace(stiffer, servo_hz=high))[0] >= 1.0:
        return math.inf
    for _ in range(_ROUNDS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if held_loop(replace(stiffer, servo_hz=middle))[0] < 1.0 else (middle, high)
    return high


@dataclass(frozen=True)
class Loop:
    """Leader and follower over a link with the round trip R [s].

    reflects : whether the leader renders the contact's force, not a spring to the follower. contact_N_m : stiffness of
    what the follower touches [N/m]; 0: nothing. follows_velocity : whether the dampers act on the difference of the
    velocities.
    """

    leader: LinearRobot
    follower: LinearRobot
    round_trip_s: float
    reflects: bool = False
    contact_N_m: float = 0.0
    follows_velocity: bool = True

    def gain(self, w: Array, stiffness: float | None = None, damping: float | None = None) -> Array:
        """L(jw), with another K or B of the leader if given: the pair is unstable if L goes round 1 (Nyquist)."""
        one, other, s = self.leader, self.follower, 1j * w
        K = one.stiffness if stiffness is None else stiffness
        B = one.servo_damping if damping is None else damping
        hand = one.hand_kg * s * s + one.hand_Ns_m * s + one.hand_N_m
        leads = one.mass * s * s + (one.damping + B) * s + hand
        follows = other.mass * s * s + (other.damping + other.servo_damping) * s + other.stiffness + self.contact_N_m
        follower = other.stiffness + (other.servo_damping * s if self.follows_velocity else 0.0)
        back = -self.contact_N_m if self.reflects else K + (B * s if self.follows_velocity else 0.0)
        whole: Array = (
            follower * back * np.exp(-s * self.round_trip_s) / ((leads + (0.0 if self.reflects else K)) * follows)
        )
        return whole

    def unstable(self, factor: float = 1.0, stiffness: float | None = None, damping: float | None = None) -> bool:
        """Whether the loop with `factor` times its gain has a growing motion: its argument winds around 1."""
        w = self._frequencies()
        around = np.unwrap(np.angle(1.0 - factor * self.gain(w, stiffness, damping)))
        return bool(abs(around[-1] - around[0]) > math.pi)

    def hz(self) -> float:
        """The frequency at which the loop's gain is largest with the phase of a growing motion [Hz]; 0: none."""
        w = self._frequencies()
        gain = self.gain(w)
        at = np.nonzero((np.diff(np.sign(gain.imag)) != 0) & (gain.real[1:] > 1.0))[0]
        return 0.0 if len(at) == 0 else float(w[at[np.argmax(gain.real[at])]]) / (2.0 * math.pi)

    def _frequencies(self) -> Array:
        """From almost 0 to where the loop's gain stays small, fine enough for the delay's phase."""
        one, other = self.leader, self.follower
        own = max((r.stiffness + self.contact_N_m + r.servo_damping**2 / r.mass) / r.mass for r in (one, other))
        coarse = np.geomspace(1e-3, 10.0 * math.sqrt(own) + 100.0, _STEPS // 10)
        large = np.nonzero(np.abs(self.gain(coarse)) > _SMALL)[0]
        most = float(coarse[min(large[-1] + 1, len(coarse) - 1)]) if len(large) else 1.0
        steps = max(_STEPS // 10, min(_STEPS, math.ceil(most * self.round_trip_s / 0.05)))
        return np.linspace(1e-3, most, steps)

    def largest_stiffness(self) -> float:
        """The largest K of the leader that leaves `MARGIN` to the limit [N/m]; 0: there is none."""
        return _largest(lambda K: not self.unstable(MARGIN, stiffness=K), self.leader.stiffness)

    def smallest_damping(self, most: float) -> float:
        """The smallest B of the leader that leaves `MARGIN` to the limit, up to `most` [Ns/m]; infinite: none does."""
        if self.unstable(MARGIN, damping=most):
            return math.inf
        return most - _largest(lambda less: not self.unstable(MARGIN, damping=most - less), most)


def _largest(fits: Callable[[float], bool], most: float) -> float:
    """The largest value up to `most` that fits, if all smaller ones do."""
    if fits(most):
        return most
    low, high = 0.0, most
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
