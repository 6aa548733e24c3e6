"""Four channels with acceleration-based control: positions and forces go both ways, and a disturbance observer makes
each robot follow an acceleration (Sakaino, Sato, Ohnishi, IEEE T-IE 58(11), 2011; Ohnishi, Shibata, Murakami 1996).

The difference of the positions and the sum of the forces are controlled to 0, each by its own gain:

    a_l - a_f = -(Kp + Kd s)(x_l - x_f),    a_l + a_f = -Cf (f_l + f_f)
    F_i = m_i a_i + d_i,                    a_i = ((Kp + Kd s)(x_j - x_i) - Cf (f_i + f_j))/2

d_i is what the disturbance observer says that the motor must overcome, friction included,
``d = g/(s + g) (F + g m v) - g m v``, and f_i the reaction force: d_i less the robot's known friction (the reaction
force observer; no force sensor). So with no delay x_l = x_f and f_l = -f_f at rest, whatever the friction.

Derived here: Cf is Kf (1/m_l + 1/m_f)/2, the same for both, as the two modes are decoupled only then. Each side sends
``x + (Kd/Kp) v - (Cf/Kp) f``, so one position carries the three terms that the other side adds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hapnet.checks import Vector
from hapnet.control.samples import CouplingSample
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import CouplingStart
from hapnet.ext.laws.parts import bilateral_port
from hapnet.ext.laws.parts.bilateral_port import (
    BilateralEnd,
    BilateralParams,
    BilateralTuning,
    between_robots,
    led,
)
from hapnet.params import Params, known_damping

_CREEP = 0.002
"""The speed below which the known Coulomb friction counts less than in full [m/s]: its sign is then uncertain."""


@dataclass(frozen=True)
class Tuning(BilateralTuning):
    """The gains: Kp [1/s^2], Kd [1/s], Cf [1/kg], g [rad/s]; and what each robot knows of itself."""

    position_gain: float
    velocity_gain: float
    force_gain: float
    cutoff_rad_s: float
    leader_mass_kg: float
    follower_mass_kg: float
    leader_friction_Ns_m: float
    follower_friction_Ns_m: float
    follower_friction_N: float


class DisturbanceObserver:
    """The force that a robot's motor must overcome, on each axis.

    mass : m [kg]. cutoff : g [rad/s].
    """

    def __init__(self, mass: float, cutoff: float, dof: int) -> None:
        self._mass, self._cutoff = mass, cutoff
        self._filtered = [0.0] * dof
        self.disturbance: Vector = (0.0,) * dof

    def look(self, dt: float, v: Vector, held: Vector) -> None:
        """Take in the velocity [m/s], and the force really held for the last `dt` seconds [N]."""
        share, gm = 1.0 - math.exp(-self._cutoff * dt), self._cutoff * self._mass
        for i, (force, speed) in enumerate(zip(held, v, strict=True)):
            self._filtered[i] += share * (force + gm * speed - self._filtered[i])
        self.disturbance = tuple([p - gm * speed for p, speed in zip(self._filtered, v, strict=True)])


class AccelerationEnd(BilateralEnd):
    """Either end. stiffness : of the port's spring [N/m]. mass : m [kg]. viscous, coulomb : known friction."""

    def __init__(self, tuning: Tuning, stiffness: float, mass: float, viscous: float, coulomb: float, dof: int) -> None:
        super().__init__(stiffness)
        self._gains, self._mass = tuning, mass
        self._viscous, self._coulomb = viscous, coulomb
        self._observer = DisturbanceObserver(mass, tuning.cutoff_rad_s, dof)

    @property
    def reaction(self) -> Vector:
        """f_i: the force with which the robot pushes what touches it [N]."""
        return tuple([
            d - self._viscous * v - self._coulomb * math.tanh(v / _CREEP)
            for d, v in zip(self._observer.disturbance, self.v, strict=True)
        ])  # fmt: skip

    def look(self, dt: float, x: Vector, v: Vector, held: Vector, sensed: Vector) -> None:
        super().look(dt, x, v, held, sensed)
        if dt > 0.0:
            self._observer.look(dt, v, held)

    def pull(self) -> Vector:
        """The whole force but for the damper ``m Kd/2``, which the port renders itself."""
        gains, half = self._gains, 0.5 * self._mass
        return tuple([
            half * (gains.position_gain * (y - x) - gains.force_gain * f) + d
            for y, x, f, d in zip(self.peer, self.x, self.reaction, self._observer.disturbance, strict=True
            )
        ])  # fmt: skip

    def content(self, level: float | None) -> CouplingSample:
        gains = self._gains
        yields = gains.force_gain / gains.position_gain
        place = tuple([x - yields * f for x, f in zip(self.x, self.reaction, strict=True)])
        return led(place, gains.velocity_gain / gains.position_gain, self.v, level)


def tune(params: Params, link: Delays) -> Tuning:
    own, robot, device = params.of(BilateralParams), params.follower, params.device
    common = bilateral_port.tune(params, link)
    Kd = own.velocity_gain or 2.0 * math.sqrt(own.position_gain)
    return Tuning(
        port=common.port,
        leader_stiffness_N_m=common.leader_stiffness_N_m,
        leader_damping_Ns_m=0.5 * device.mass * Kd,
        follower_stiffness_N_m=common.follower_stiffness_N_m,
        follower_damping_Ns_m=0.5 * robot.mass * Kd,
        position_gain=own.position_gain,
        velocity_gain=Kd,
        force_gain=0.5 * own.force_gain * (1.0 / device.mass + 1.0 / robot.mass),
        cutoff_rad_s=own.cutoff_rad_s,
        leader_mass_kg=device.mass,
        follower_mass_kg=robot.mass,
        leader_friction_Ns_m=known_damping(params),
        follower_friction_Ns_m=robot.own_damping,
        follower_friction_N=own.friction_known * robot.friction_N,
    )


def _leader(start: CouplingStart[Tuning]) -> BilateralEnd:
    own = start.tuning
    known = own.leader_mass_kg, own.leader_friction_Ns_m, 0.0
    return AccelerationEnd(own, own.leader_stiffness_N_m, *known, len(start.position))


def _follower(start: CouplingStart[Tuning]) -> BilateralEnd:
    own = start.tuning
    known = own.follower_mass_kg, own.follower_friction_Ns_m, own.follower_friction_N
    return AccelerationEnd(own, own.follower_stiffness_N_m, *known, len(start.position))


LAW = between_robots(
    "four-channel",
    "four channels, acceleration-based",
    "Sakaino, Sato, Ohnishi 2011",
    (_leader, _follower),
    Tuning,
    tune,
)
