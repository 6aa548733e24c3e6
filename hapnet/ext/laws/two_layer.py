"""Two-layer energy tanks (Franken, Stramigioli, Misra, Secchi, Macchelli, IEEE T-RO 27(4), 2011).

The transparency layer computes the wanted force. Here it is the plain virtual coupling of zoh.py: K and B of `device`,
K' and B' of `world`. The passivity layer below it has a tank of energy H at each side, and reduces a force if the tank
does not suffice for it. In each sample k of a side, in this order:

    H <- H + H_received - dH       dH = tau_{k-1} . (q_k - q_{k-1}), the work of the held force, known exactly
    H_sent = beta H,  H <- H - H_sent
    tau = the wanted force, cut to |tau| <= tau_max(H)
    device: tau <- tau - d q',     d = alpha (H_D - H) if H < H_D, else 0: the tank level controller

Only the device has a level controller, so the hand fills both tanks. The shares that both sides send bring the two
levels together. Each joule is in one tank, on its way or lost, so both ports together never give out more than the
tanks held at the start. The energy travels in the channel of acknowledged nanojoules: loss costs none, and repetition
creates none.

H starts at this side's share of d^2 (`device.ceiling_J`, `world.ceiling_J`), and has no ceiling. If both tanks start at
0, no force is ever rendered, but 1 uJ is enough. The defaults of beta, alpha and H_D are hapnet's.

Derived here, so that H never falls below 0, whatever the hand and the world do:

* The authors estimate the work of the next sample with the present velocity, tau_max = H / (T |q'|). A moment later the
  device may be faster. With its declared maximum speed v (`device.greatest_speed`) in place of a smaller |q'| the limit
  is safe. It also applies to the level controller's damper, which gives out energy if the motion turns within a tick.
* The world's step is solved together with its coupling, tau = p - g vhat with g = B' + K' T/2. A step of length T takes
  (p . vhat - g vhat^2) T out of the tank, for no vhat more than p^2 T / 4g. So |p| <= sqrt(4 g H / T).
* With encoders of resolution r the true work differs from the counted work by at most
  r/2 (|tau_n| + sum |tau_k - tau_{k-1}|), axis by axis. So r |tau_k - tau_{k-1}| is taken out of the tank at each tick.
  On n axes, with c = r sqrt(n), that is at most c (|tau_k| + |tau_{k-1}|); the counted motion is at most v T + c. So
  |tau_k| <= (H - c |tau_{k-1}|) / (v T + 3 c), and c |tau_k| remains in the tank, to pay for the end of the force.
* A step of the world is longer than a tick of the servo. In the time t a side sends 1 - (1 - beta)^(t/T) of its tank; T
  is the servo's period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, DeviceLaw, WorldLaw, vector_of
from hapnet.couplings.ends import held_law, stepped_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.set_position import device_spring
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, two_springs
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring
from hapnet.param_values import NOT_NEGATIVE, POSITIVE, Range, parameter
from hapnet.params import Params
from hapnet.records.vectors import added, inner


class EnergyTank:
    """The tank of one side.

    level : H [J]. share : beta. period : T of the servo [s].

    Attributes
    ----------
    reserved : the part that is not for forces and not sent [J].
    figures : of the held force, as `Tank.figures`.
    forces, limited : the number of forces so far, and of those that the tank limited.
    """

    def __init__(self, level: float, share: float, period: float) -> None:
        self.level, self.reserved = level, 0.0
        self._log_kept, self._period = math.log1p(-share), period
        self.figures: dict[str, Any] = {}
        self.forces = self.limited = 0

    @property
    def limited_share(self) -> float | None:
        return self.limited / self.forces if self.forces else None

    @property
    def free(self) -> float:
        """The energy for forces and for the other side [J]."""
        return max(0.0, self.level - self.reserved)

    def give(self, dt: float) -> float:
        """Take the share out that is sent `dt` seconds after the last. Returns it [J]."""
        given = self.free * -math.expm1(dt / self._period * self._log_kept)
        self.level -= given
        return given

    def cut(self, force: Vector, most: float) -> Vector:
        """The transparency layer's force, no longer than `most` [N]."""
        within = _within(force, most)
        self.forces += 1
        self.limited += within is not force
        return within


def _size(vector: Sequence[float]) -> float:
    return math.sqrt(inner(vector, vector))


def _within(vector: Vector, most: float) -> Vector:
    size = _size(vector)
    return vector if size <= most else tuple([most / size * part for part in vector])


@dataclass(frozen=True)
class TwoLayerParams:
    """Two-layer energy tanks (Franken et al. 2011)."""

    share: float = parameter(0.01, "beta, the share of its tank that a side sends per tick", Range(0.0, at_most=0.5))
    desired_J: float = parameter(0.02, "H_D, the level to which the hand fills the device's tank [J]", POSITIVE)
    alpha: float = parameter(
        0.0, "damping per missing energy of the level controller [Ns/m per J]; 0: by a rule", NOT_NEGATIVE
    )


@dataclass(frozen=True)
class Tuning:
    """The parameters of both ends. speed_m_s : the maximum speed that the device is declared to have."""

    share: float
    desired_J: float
    alpha_Ns_m_J: float
    damping_cap_Ns_m: float
    speed_m_s: float


def tune(params: Params, link: Delays) -> Tuning:
    """With an empty tank the level controller damps as much as a device renders, at most m/T (see popc.py)."""
    own, device = params.of(TwoLayerParams), params.device
    for name, value in (("stiffness", params.world.stiffness), ("damping", params.world.damping)):
        if not isinstance(value, float):
            raise InvalidParameter(f"world.{name}", value, f"a number with the coupling {params.coupling}")
    cap = min(RENDERED_DAMPING, device.mass * device.servo_hz)
    return Tuning(own.share, own.desired_J, own.alpha or cap / own.desired_J, cap, device.greatest_speed)


class DeviceTank:
    """The device's end.

    spring, damping : the transparency layer's. position : x(0) [m]. tank : of this side.
    period : T of the servo [s]. resolution : r of the encoders [m].
    """

    def __init__(
        self,
        spring: Spring,
        damping: Vector,
        position: Vector,
        tank: EnergyTank,
        tuning: Tuning,
        *,
        period: float,
        resolution: float = 0.0,
    ) -> None:
        self.set_position = self._x = position
        self.tank, self._speed_max = tank, 0.0
        self._spring, self._damping, self._tuning = spring, damping, tuning
        self._resolution, self._blur = resolution, resolution * math.sqrt(len(position))
        self._period = period
        self._before: Vector = (0.0,) * len(position)

    def receive(self, sample: CouplingSample) -> None:
        self.set_position = vector_of(sample)

    def on_peer_changed(self) -> None:
        """Do nothing: positions are not counted."""

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """The force to hold [N]. The work of the force held before is already in the tank."""
        self._settle(dt, x, held)
        tank, tuning = self.tank, self._tuning
        most = tank.free / (self._period * max(tuning.speed_m_s, _size(v)) + 3.0 * self._blur)
        pull = self._spring.force(self.set_position, x)
        wanted = tank.cut(tuple([f - b * u for f, b, u in zip(pull, self._damping, v, strict=True)]), most)
        d = min(tuning.damping_cap_Ns_m, tuning.alpha_Ns_m_J * max(0.0, tuning.desired_J - tank.level))
        force = _within(tuple([f - d * u for f, u in zip(wanted, v, strict=True)]), most)
        tank.reserved += 2.0 * self._blur * _size(force)
        return force

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        return x

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Tie the spring to x until a sample arrives."""
        self._settle(dt, x, held)
        self.set_position = x

    def _settle(self, dt: float, x: Vector, held: Vector) -> None:
        """Measure the speed of the last `dt` seconds, which ended at x [m], and charge the tank for the encoders.

        held : the force in that time [N]; its true work may differ from the work that was counted.
        """
        speed = (_size([now - before for now, before in zip(x, self._x, strict=True)]) - self._blur) / dt if dt else 0.0
        self._x, self._speed_max = x, max(self._speed_max, speed)
        self.tank.figures |= {"speed_max_mps": self._speed_max, "speed_limit_mps": self._tuning.speed_m_s}
        if self._resolution:
            self.tank.level -= self._resolution * added([abs(f - g) for f, g in zip(held, self._before, strict=True)])
            self._before, self.tank.reserved = held, self._blur * _size(held)


class WorldTank:
    """The world's end. stiffness, damping : K' [N/m] and B' [Ns/m]. position : x(0) [m]. tank : of this side."""

    def __init__(self, stiffness: float, damping: float, position: Vector, tank: EnergyTank) -> None:
        self.set_position = self._x = self._at = position
        self.tank = tank
        self._stiffness, self._damping = stiffness, damping

    def receive(self, sample: CouplingSample) -> None:
        self.set_position = vector_of(sample)

    def on_peer_changed(self) -> None:
        """Do nothing: positions are not counted."""

    def begin(self) -> None:
        """Begin a step with the newest position that has arrived."""
        self._at = self.set_position

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """g = B' + K' T/2 [Ns/m], and p = K' (y - x), as far as the tank suffices [N]."""
        drag = self._damping + 0.5 * self._stiffness * dt
        push = tuple([self._stiffness * (y - x) for y, x in zip(self._at, self._x, strict=True)])
        return drag, self.tank.cut(push, math.sqrt(4.0 * drag * self.tank.free / dt))

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        self._x = x

    def next_sample(self) -> CouplingSample:
        return self._x


def _tank(start: CouplingStart[Tuning]) -> EnergyTank:
    return EnergyTank(start.initial_energy, start.tuning.share, 1.0 / start.params.device.servo_hz)


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    spring, damping = device_spring(start.params, len(start.position))
    device = start.params.device
    return DeviceTank(
        spring,
        damping,
        start.position,
        _tank(start),
        start.tuning,
        period=1.0 / device.servo_hz,
        resolution=device.resolution_m,
    )


def _world(start: CouplingStart[Tuning]) -> WorldLaw:
    world = start.params.world
    assert isinstance(world.stiffness, float), "refused by `tune`"
    assert isinstance(world.damping, float), "refused by `tune`"
    return WorldTank(world.stiffness, world.damping, start.position, _tank(start))


LAW = CouplingSpec(
    name="two-layer",
    title="two-layer energy tanks",
    source="Franken et al. 2011",
    claim="passive at both ports, whatever the link does, if the device is never faster than declared",
    device=held_law(_device),
    world=stepped_law(_world),
    tuning=Tuning,
    tune=tune,
    parameters=TwoLayerParams,
    set_positions=frozenset({"device", "world"}),
    scaled=True,
    springs=two_springs,
    halves=True,
    joint=False,
    covers=lambda params, tuning, virtual: True,
    searched={
        "device.damping": Between(0.05, RENDERED_DAMPING, log=True),
        "two_layer.share": Between(0.001, 0.1, log=True),
        "two_layer.desired_J": Between(0.005, 0.2, log=True),
        "two_layer.alpha": Between(1.0, 1000.0, log=True),
    },
)
