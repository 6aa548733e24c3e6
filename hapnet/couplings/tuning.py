"""How each law is tuned by its own published rule, and how its two ends are made: what registry.py lists.

A law's equations are in its own file of hapnet/control; here they are given the parameters and the link's delays. What
the user gives overrides the rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control import pd, popc
from hapnet.control.coupling import DeviceLaw, WorldLaw
from hapnet.control.deadband import LONGEST_S
from hapnet.control.digital_wave import Replay
from hapnet.control.eba import EnergyBounding
from hapnet.control.tdpa import TdpaDevice, TdpaWorld
from hapnet.control.wave import DelayLine
from hapnet.control.wave_filter import WaveFilter
from hapnet.control.wave_port import Line, WaveDevice, WaveWorld
from hapnet.couplings.link_delays import Delays
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring, shared_spring
from hapnet.params import Params
from netem import LinkProfile

Tuning = Mapping[str, float]
"""What a rule chose, by names with units."""

RENDERED_DAMPING = 5.0
"""Most damping that a desktop device renders stably [Ns/m]: a Phantom Omni's, in CHAI3D's device table."""

_LONGEST_JITTER_S = 0.25
"""Waves that wait for longer do more harm than those that are dropped: so measured on a recorded LTE link."""


def covers_pspm(params: Params, tuning: Tuning, virtual: bool) -> bool:
    """Any link; but the range harvest of a held force counts on the device's own damping, as the start has warned."""
    device = params.device
    sampled = device.servo == "sampled" or (device.servo == "auto" and not virtual)
    return not (sampled and device.harvest == "range")


def _spring(params: Params, position: Vector) -> tuple[Spring, Vector]:
    """The device's spring and damper, as PSPM and the plain virtual coupling have them."""
    device, dof = params.device, len(position)
    limit = device.force_limit_N * device.spring_share or None
    return shared_spring(device.stiffness, dof, limit), checks.diagonal("device.damping", device.damping, dof)


def tune_popc(params: Params, link: Delays) -> Tuning:
    device = params.device
    by_rule = popc.damping_cap(device.mass, 1.0 / device.servo_hz, RENDERED_DAMPING)
    return {
        "damping_cap_Ns_m": params.popc.damping_cap or by_rule,
        "velocity_floor_m_s": params.popc.velocity_floor,
    }


def popc_device(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    return popc.PassivityController(
        *_spring(params, position),
        position,
        velocity_floor=tuning["velocity_floor_m_s"],
        damping_cap=tuning["damping_cap_Ns_m"],
    )


def tune_eba(params: Params, link: Delays) -> Tuning:
    damping = params.eba.damping or params.device.own_damping
    if damping == 0.0:
        allowed = "above 0 with the coupling eba (or eba.damping is), which may render no force without"
        raise InvalidParameter("device.own_damping", 0.0, allowed)
    return {"damping_Ns_m": damping}


def eba_device(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    return EnergyBounding(
        *_spring(params, position),
        position,
        own_damping=tuning["damping_Ns_m"],
        period=1.0 / params.device.servo_hz,
        resolution=params.device.resolution_m,
    )


def tune_pd(params: Params, link: Delays) -> Tuning:
    """K_p no larger than lets K_d, by its rule, be rendered; a K_d of the user's own leaves K_p alone."""
    device, own = params.device, params.pd
    K = scalar_stiffness(params)
    held_back = 2.0 * LONGEST_S if params.wire.deadband else 0.0
    trip = pd.round_trip(
        link.round_trip_bound_s + held_back, device.pspm_period_s, params.world.step_max_s, 1.0 / device.servo_hz
    )
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


def pd_device(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    return pd.DevicePD(_pd_gains(tuning), position)


def pd_world(params: Params, tuning: Tuning, position: Vector) -> WorldLaw:
    return pd.WorldPD(_pd_gains(tuning), position)


def warn_pd(params: Params, tuning: Tuning) -> tuple[str, ...]:
    gains, device = _pd_gains(tuning), params.device
    need = gains.stiffness / device.servo_hz / 2.0 + gains.drag
    if device.own_damping > need:
        return ()
    return (
        f"the coupling pd holds its force: with the device's own damping of {device.own_damping:g} Ns/m it is not "
        f"passive for motions as fast as a tick; above {need:.3g} Ns/m it would be",
    )


def covers_pd(params: Params, tuning: Tuning, virtual: bool) -> bool:
    """One known delay both ways, gains by the rule, and a device that damps what its held force leaks."""
    link = params.link
    profiles = [LinkProfile.named(words) for words in (link.up, link.down)]
    known = all(profile == LinkProfile(delay_ns=profile.delay_ns) for profile in profiles)
    by_rule = not params.pd.damping and not params.pd.coordination
    still = not (link.up_timeline or link.down_timeline)
    return virtual and known and still and by_rule and bool(tuning) and not warn_pd(params, tuning)


def tune_tdpa(params: Params, link: Delays) -> Tuning:
    """The coupling damps the virtual mass critically, its heaviest axis. alpha is at most what the device renders, and
    what stops it within a tick, m/T: a held damper that is stronger drives it. The link's delays do not matter.
    """
    chosen, device = params.tdpa, params.device
    K = chosen.stiffness or scalar_stiffness(params)
    mass = np.asarray(params.world.mass)
    heaviest = float(np.linalg.norm(mass, 2) if mass.ndim == 2 else mass.max())
    return {
        "stiffness_N_m": K,
        "damping_Ns_m": chosen.damping or min(2.0 * math.sqrt(K * heaviest), RENDERED_DAMPING),
        "velocity_floor_m_s": chosen.velocity_floor,
        "force_floor_N": chosen.force_floor,
        "damping_cap_Ns_m": chosen.damping_cap or min(RENDERED_DAMPING, device.mass * device.servo_hz),
        "speed_limit_m_s": chosen.speed_limit,
        "debt_limit_J": chosen.debt_limit_J,
        "recovery_s": chosen.recovery_s,
    }


def tdpa_device(params: Params, tuning: Tuning, position: Vector) -> TdpaDevice:
    return TdpaDevice(
        position=position,
        velocity_floor=tuning["velocity_floor_m_s"],
        damping_cap=tuning["damping_cap_Ns_m"],
        debt_limit=tuning["debt_limit_J"],
        stiffness=tuning["stiffness_N_m"],
    )


def tdpa_world(params: Params, tuning: Tuning, position: Vector) -> TdpaWorld:
    return TdpaWorld(
        position=position,
        stiffness=tuning["stiffness_N_m"],
        damping=tuning["damping_Ns_m"],
        force_floor=tuning["force_floor_N"],
        speed_limit=tuning["speed_limit_m_s"],
        debt_limit=tuning["debt_limit_J"],
        recovery=tuning["recovery_s"],
    )


def tune_wave(params: Params, link: Delays) -> Tuning:
    """The wave impedance b as large as a device can render it.

    In free motion a line of delay d is an inertia b d, in contact a spring b/d (Niemeyer, Slotine 2004): with a
    virtual world's slow steps on the way d is so long that the spring is what is lacking. The virtual coupling is to
    be as stiff as makes device.stiffness of both in series; where the line alone is softer, ten times that stiffness.
    Its damper is b, so that high frequencies are not reflected by a wall.
    """
    wave, K = params.wave, scalar_stiffness(params)
    impedance = wave.impedance or RENDERED_DAMPING
    delay = link.one_way_s + params.world.step_max_s + _jitter_s(link)
    compliance = 1.0 / K - delay / impedance
    return {
        "impedance_Ns_m": impedance,
        "stiffness_N_m": wave.stiffness or 1.0 / max(compliance, 0.1 / K),
        "damping_Ns_m": wave.damping or impedance,
        "smoothing_s": wave.smoothing_s,
        "longest_wait_s": params.world.step_max_s + _LONGEST_JITTER_S,
    }


def tune_digital_wave(params: Params, link: Delays) -> Tuning:
    """As the wave line; what arrives is spread over the longest time between two arrivals."""
    tuning = dict(tune_wave(params, link))
    del tuning["longest_wait_s"]
    return {**tuning, "spread_s": params.world.step_max_s + _jitter_s(link)}


def _jitter_s(link: Delays) -> float:
    """How much later than the fastest message another comes, hardly ever exceeded."""
    return min(link.round_trip_bound_s - 2.0 * link.one_way_s, _LONGEST_JITTER_S)


def _wave_line(params: Params, tuning: Tuning, dof: int) -> Line:
    if params.coupling == "digital-wave":
        return Replay(dof, tuning["spread_s"])
    return DelayLine(dof, tuning["longest_wait_s"], hold=params.wave.missing == "hold")


def wave_device(params: Params, tuning: Tuning, position: Vector) -> DeviceLaw:
    line = WaveFilter(_wave_line(params, tuning, len(position)), len(position), tuning["smoothing_s"])
    return WaveDevice(tuning["impedance_Ns_m"], position, line)


def wave_world(params: Params, tuning: Tuning, position: Vector) -> WorldLaw:
    return WaveWorld(
        tuning["impedance_Ns_m"],
        tuning["stiffness_N_m"],
        tuning["damping_Ns_m"],
        position,
        _wave_line(params, tuning, len(position)),
    )


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
