"""The couplings, by the names that a user gives them: what each is, how it is tuned, and what its two ends are made of.

A law's equations are in its own file of hapnet/control; here its published rule is given the link's delays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control import pd, popc
from hapnet.control.coupling import Modulator
from hapnet.control.eba import EnergyBounding
from hapnet.control.law import DeviceLaw, WorldLaw
from hapnet.control.pspm import SetPositionModulator, Shuffle
from hapnet.control.spring import Spring, shared_spring
from hapnet.control.tdpa import TdpaDevice, TdpaWorld
from hapnet.control.zoh import ZeroOrderHold
from hapnet.errors import InvalidParameter
from hapnet.params import COUPLINGS, DeviceParams, Params, WorldParams
from hapnet.wire.messages import Motion, Port, Position, Stream
from netem import LinkProfile

Tuning = Mapping[str, float]
"""What a rule chose, by names with units."""


class Delays(NamedTuple):
    """Of the link that a law is tuned for."""

    one_way_s: float
    """The mean of both ways."""
    round_trip_bound_s: float
    """Hardly ever exceeded; of a recorded link, whose outages nobody tunes for, a tenth of the time each way."""


RENDERED_DAMPING = 5.0
"""Most damping that a desktop device renders stably [Ns/m]: a Phantom Omni's, in CHAI3D's device table."""

_RECORDED = (0.5, 0.9)
"""What of a recorded delay is typical, and what its bound: quantiles over time."""


def delays(up: LinkProfile, down: LinkProfile) -> Delays:
    """What a designer would know of the link: its delays, and the jitter's tail."""
    typical, bound = np.sum([_one_way_s(profile) for profile in (up, down)], axis=0).tolist()
    return Delays(typical / 2.0, bound)


def _one_way_s(profile: LinkProfile) -> tuple[float, float]:
    """Typical delay and its bound [s]."""
    delay, jitter = profile.delay_ns * 1e-9, profile.jitter_ns * 1e-9
    recorded = [0.0, 0.0]
    if profile.trace is not None:
        times = profile.trace.times_ns
        recorded = [_wait_s(np.diff(times, prepend=0) * 1e-9, share) for share in _RECORDED]
    if profile.csv is not None:
        held = np.diff(profile.csv.times_ns, append=profile.csv.period_ns)
        recorded = [
            r + _quantile(profile.csv.delays_ns, held, share) * 1e-9
            for r, share in zip(recorded, _RECORDED, strict=True)
        ]
    return delay + recorded[0], delay + recorded[1] + jitter * (1.0 if profile.distribution == "uniform" else 3.0)


def _wait_s(gaps: ArrayLike, share: float) -> float:
    """How long one waits at most, this share of the time, for the next of events that are `gaps` apart [s].

    One waits longer than w for the fraction sum max(0, gap - w) / sum gap of all time.
    """
    longest = -np.sort(-np.asarray(gaps, dtype=float))
    together = np.cumsum(longest)
    beyond = (1.0 - share) * together[-1]
    count = np.searchsorted(together - np.arange(1, len(longest) + 1) * longest, beyond, side="right")
    return float((together[count - 1] - beyond) / count)


def _quantile(values: ArrayLike, weights: ArrayLike, share: float) -> float:
    """The least value that this share of the weight does not exceed."""
    values, weights = np.asarray(values, dtype=float), np.asarray(weights, dtype=float)
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, share * reached[-1])])


def _modulated(
    side: DeviceParams | WorldParams, spring: Spring, position: Vector, force_limit: float | None, energy: float
) -> Modulator:
    return SetPositionModulator(
        stiffness=side.stiffness,
        position=position,
        ceiling=side.ceiling_J,
        shuffle=cast(Shuffle, side.shuffle),
        force_limit=force_limit,
        energy=energy,
    )


def _held(
    side: DeviceParams | WorldParams, spring: Spring, position: Vector, force_limit: float | None, energy: float
) -> Modulator:
    return ZeroOrderHold(spring, position, energy)


@dataclass(frozen=True)
class Kind:
    """One way to couple.

    title, source : what it is and who published it. claim : where its source says that it is passive.
    tune : the parameters and the link's delays, to what the law's own rule chooses.
    device, world : make the law's two ends at rest at a position; None: spring and damper (2) to a set-position.
    modulator : makes what stands between a received set-position and that spring: (side's parameters, spring, position,
        force limit, energy at the start). limited : does the set-position keep to a longest step?
    device_sends, world_sends : the message that carries the ends' data.
    shared : names in the tuning whose values both ends must have the same.
    scaled : is the felt force K/K' of the virtual one, as with PSPM?
    warn : the parameters and the tuning, to what the user should know before it runs.
    """

    title: str
    source: str
    claim: str
    tune: Callable[[Params, Delays], Tuning] = lambda params, link: {}
    device: Callable[[Params, Tuning, Vector], DeviceLaw] | None = None
    world: Callable[[Params, Tuning, Vector], WorldLaw] | None = None
    device_sends: type[Stream] = Position
    world_sends: type[Stream] = Position
    modulator: Callable[[DeviceParams | WorldParams, Spring, Vector, float | None, float], Modulator] = _held
    limited: bool = False
    shared: tuple[str, ...] = ()
    scaled: bool = False
    warn: Callable[[Params, Tuning], tuple[str, ...]] = lambda params, tuning: ()


def _spring(params: Params, position: Vector) -> tuple[Spring, Vector]:
    """The device's spring and damper, as PSPM and the plain virtual coupling have them."""
    device, dof = params.device, len(position)
    limit = device.force_limit_N * device.spring_share or None
    return shared_spring(device.stiffness, dof, limit), checks.diagonal("device.damping", device.damping, dof)


def _tune_popc(params: Params, link: Delays) -> Tuning:
    device = params.device
    by_rule = popc.damping_cap(device.mass, 1.0 / device.servo_hz, RENDERED_DAMPING)
    return {
        "damping_cap_Ns_m": params.popc.damping_cap or by_rule,
        "velocity_floor_m_s": params.popc.velocity_floor,
    }


def _popc(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    return popc.PassivityController(
        *_spring(params, position),
        position,
        velocity_floor=tuning["velocity_floor_m_s"],
        damping_cap=tuning["damping_cap_Ns_m"],
    )


def _tune_eba(params: Params, link: Delays) -> Tuning:
    damping = params.eba.damping or params.device.own_damping
    if damping == 0.0:
        allowed = "above 0 with the coupling eba (or eba.damping is), which may render no force without"
        raise InvalidParameter("device.own_damping", 0.0, allowed)
    return {"damping_Ns_m": damping}


def _eba(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    return EnergyBounding(
        *_spring(params, position),
        position,
        own_damping=tuning["damping_Ns_m"],
        period=1.0 / params.device.servo_hz,
        resolution=params.device.resolution_m,
    )


def _tune_pd(params: Params, link: Delays) -> Tuning:
    """K_p no larger than lets K_d, by its rule, be rendered; a K_d of the user's own leaves K_p alone."""
    device, own = params.device, params.pd
    K = scalar_stiffness(params)
    trip = pd.round_trip(link.round_trip_bound_s, device.pspm_period_s, params.world.step_max_s, 1.0 / device.servo_hz)
    K_p, K_d, *_ = pd.Gains(K, own.damping) if own.damping else pd.tuned(K, trip, RENDERED_DAMPING)
    return {
        "stiffness_N_m": K_p,
        "damping_Ns_m": K_d,
        "coordination_Ns_m": own.coordination,
        "extra_damping_Ns_m": own.extra_damping,
    }


def _pd_gains(tuning: Tuning) -> pd.Gains:
    return pd.Gains(
        tuning["stiffness_N_m"], tuning["damping_Ns_m"], tuning["coordination_Ns_m"], tuning["extra_damping_Ns_m"]
    )


def _warn_pd(params: Params, tuning: Tuning) -> tuple[str, ...]:
    gains, device = _pd_gains(tuning), params.device
    need = gains.stiffness / device.servo_hz / 2.0 + gains.drag
    if device.own_damping > need:
        return ()
    return (
        f"the coupling pd holds its force: with the device's own damping of {device.own_damping:g} Ns/m it is not "
        f"passive for motions as fast as a tick; above {need:.3g} Ns/m it would be",
    )


def _tune_tdpa(params: Params, link: Delays) -> Tuning:
    """The coupling damps the virtual mass critically. alpha is at most what the device renders, and what stops it
    within a tick, m/T: a held damper that is stronger drives it. The link's delays do not matter.
    """
    chosen, device = params.tdpa, params.device
    K = chosen.stiffness or scalar_stiffness(params)
    mass = np.linalg.norm(np.atleast_2d(params.world.mass), 2 if np.ndim(params.world.mass) == 2 else np.inf)
    return {
        "stiffness_N_m": K,
        "damping_Ns_m": chosen.damping or min(2.0 * math.sqrt(K * float(mass)), RENDERED_DAMPING),
        "velocity_floor_m_s": chosen.velocity_floor,
        "force_floor_N": chosen.force_floor,
        "damping_cap_Ns_m": chosen.damping_cap or min(RENDERED_DAMPING, device.mass * device.servo_hz),
        "speed_limit_m_s": chosen.speed_limit,
        "debt_limit_J": chosen.debt_limit_J,
        "recovery_s": chosen.recovery_s,
    }


def _tdpa_device(params: Params, tuning: Tuning, position: Vector) -> TdpaDevice:
    return TdpaDevice(
        position=position,
        velocity_floor=tuning["velocity_floor_m_s"],
        damping_cap=tuning["damping_cap_Ns_m"],
        debt_limit=tuning["debt_limit_J"],
    )


def _tdpa_world(params: Params, tuning: Tuning, position: Vector) -> TdpaWorld:
    return TdpaWorld(
        position=position,
        stiffness=tuning["stiffness_N_m"],
        damping=tuning["damping_Ns_m"],
        force_floor=tuning["force_floor_N"],
        speed_limit=tuning["speed_limit_m_s"],
        debt_limit=tuning["debt_limit_J"],
        recovery=tuning["recovery_s"],
    )


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "pspm": Kind(
            "passive set-position modulation",
            "Lee, Huang 2009",
            "passive at both ports, whatever the link does",
            modulator=_modulated,
            limited=True,
            scaled=True,
        ),
        "zoh": Kind(
            "virtual coupling, held",
            "Colgate, Stanley, Brown 1995",
            "passive without delay, if the device damps by more than K T/2 + B",
            scaled=True,
        ),
        "popc": Kind(
            "passivity observer and controller",
            "Hannaford, Ryu 2002",
            "passive at the hand's port, but for what the controller's limits leave",
            tune=_tune_popc,
            device=_popc,
            scaled=True,
        ),
        "eba": Kind(
            "energy bounding",
            "Kim, Ryu 2004",
            "passive at the hand's port, if the device damps as much as is trusted",
            tune=_tune_eba,
            device=_eba,
            scaled=True,
        ),
        "pd": Kind(
            "PD over a constant delay",
            "Lee, Spong 2006",
            "passive at both ports, if K_d is K_p times half the round trip or more and nothing is lost",
            tune=_tune_pd,
            device=lambda params, tuning, position: pd.DevicePD(_pd_gains(tuning), position),
            world=lambda params, tuning, position: pd.WorldPD(_pd_gains(tuning), position),
            device_sends=Motion,
            world_sends=Motion,
            shared=("stiffness_N_m", "damping_Ns_m", "coordination_Ns_m"),
            warn=_warn_pd,
        ),
        "tdpa": Kind(
            "two-port time-domain passivity",
            "Ryu, Artigas, Preusche 2010",
            "passive at both ports, whatever the link does, but for a bounded debt; it drifts",
            tune=_tune_tdpa,
            device=_tdpa_device,
            world=_tdpa_world,
            device_sends=Port,
            world_sends=Port,
        ),
    }
)
assert set(KINDS) <= set(COUPLINGS)


def ideal_stiffness(params: Params, wall: float) -> float:
    """What a hand at a wall of stiffness `wall` [N/m] would feel of the coupling's springs in series, at rest [N/m].

    With PSPM and all that has its two springs the device's spring K sees the proxy stay back by K'/(K' + K_w) of the
    way into the wall. With one spring between the two sides it is that spring and the wall, in series: the spring that
    the user asked for, also where a law's rule makes it softer.
    """
    K = scalar_stiffness(params)
    K_world = params.world.stiffness
    if not KINDS[params.coupling].scaled:
        return K * wall / (K + wall)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, where an ideal stiffness is to be compared with")
    return K * wall / (K_world + wall)


def scalar_stiffness(params: Params) -> float:
    """K [N/m] of the device's side, for laws that know one number.

    Raises
    ------
    InvalidParameter : it is a matrix.
    """
    K = params.device.stiffness
    if not isinstance(K, float):
        raise InvalidParameter("device.stiffness", K, f"a number with the coupling {params.coupling}")
    return K
