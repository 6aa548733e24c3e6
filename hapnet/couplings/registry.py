"""The couplings, by the names that a user gives them: what each is, how it is tuned, and what its two ends are made of.

The equations of each are in its own file of hapnet/control, its tuning by its published rule in tuning.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import cast

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceLaw, WorldLaw
from hapnet.control.pspm import SetPositionModulator, Shuffle
from hapnet.control.set_position_coupling import Modulator
from hapnet.control.zoh import ZeroOrderHold
from hapnet.couplings import tuning
from hapnet.couplings.held_torque import RESERVED_SHARE
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.tuning import Tuning, scalar_stiffness
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring
from hapnet.params import COUPLING_NAMES, DeviceParams, Params, WorldParams
from hapnet.wire.messages import Motion, Port, Position, Stream, Wave


def _modulated(
    side: DeviceParams | WorldParams,
    spring: Spring,
    position: Vector,
    force_limit: float | None,
    energy: float,
    reserve: float,
) -> Modulator:
    return SetPositionModulator(
        stiffness=side.stiffness,
        position=position,
        ceiling=side.ceiling_J,
        shuffle=cast(Shuffle, side.shuffle),
        force_limit=force_limit,
        energy=energy,
        reserve=min(reserve, side.ceiling_J * RESERVED_SHARE),
    )


def _held(
    side: DeviceParams | WorldParams,
    spring: Spring,
    position: Vector,
    force_limit: float | None,
    energy: float,
    reserve: float,
) -> Modulator:
    return ZeroOrderHold(spring, position, energy)


@dataclass(frozen=True)
class CouplingSpec:
    """One way to couple.

    title, source : what it is and who published it. claim : where its source says that it is passive.
    tune : the parameters and the link's delays, to what the law's own rule chooses.
    device, world : make the law's two ends at rest at a position; None: spring and damper (2) to a set-position.
    modulator : makes what stands between a received set-position and that spring: (side's parameters, spring, position,
        force limit, energy at the start, reserve). limited : does it keep to a longest step, and a held torque to what
        its account can pay for?
    device_sends, world_sends : the message that carries the ends' data.
    shared : names in the tuning whose values both ends must have the same.
    scaled : is the felt force K/K' of the virtual one, as with PSPM?
    halves : does each side keep a half of Theorem 1, with a reservoir of its own?
    warn : the parameters and the tuning, to what the user should know before it runs.
    covers : the parameters, the tuning, and whether only the emulated link is between the sides (virtual time), to
        whether both ports are claimed to be passive there: if they are not, the claim was not kept.
    allowance_J : the tuning, to what may come out beyond d^2 by the claim [J].
    """

    title: str
    source: str
    claim: str
    tune: Callable[[Params, Delays], Tuning] = lambda params, link: {}
    device: Callable[[Params, Tuning, Vector], DeviceLaw] | None = None
    world: Callable[[Params, Tuning, Vector], WorldLaw] | None = None
    device_sends: type[Stream] = Position
    world_sends: type[Stream] = Position
    modulator: Callable[[DeviceParams | WorldParams, Spring, Vector, float | None, float, float], Modulator] = _held
    limited: bool = False
    shared: tuple[str, ...] = ()
    scaled: bool = False
    halves: bool = False
    covers: Callable[[Params, Tuning, bool], bool] = lambda params, tuning, virtual: False
    allowance_J: Callable[[Tuning], float] = lambda tuning: 0.0
    warn: Callable[[Params, Tuning], tuple[str, ...]] = lambda params, tuning: ()


COUPLINGS: Mapping[str, CouplingSpec] = MappingProxyType(
    {
        "pspm": CouplingSpec(
            "passive set-position modulation",
            "Lee, Huang 2009",
            "passive at both ports, whatever the link does",
            modulator=_modulated,
            limited=True,
            scaled=True,
            halves=True,
            covers=tuning.covers_pspm,
        ),
        "zoh": CouplingSpec(
            "virtual coupling, held",
            "Colgate, Stanley, Brown 1995",
            "passive without delay, positions fresh every tick, if the device damps by more than K T/2 + B",
            scaled=True,
        ),
        "popc": CouplingSpec(
            "passivity observer and controller",
            "Hannaford, Ryu 2002",
            "passive at the hand's port, but for what the controller's limits leave",
            tune=tuning.tune_popc,
            device=tuning.popc_device,
            scaled=True,
        ),
        "eba": CouplingSpec(
            "energy bounding",
            "Kim, Ryu 2004",
            "passive at the hand's port, if the device damps as much as is trusted",
            tune=tuning.tune_eba,
            device=tuning.eba_device,
            scaled=True,
        ),
        "pd": CouplingSpec(
            "PD over a constant delay",
            "Lee, Spong 2006",
            "passive at both ports, if K_d is K_p times half the round trip or more and nothing is lost",
            tune=tuning.tune_pd,
            device=tuning.pd_device,
            world=tuning.pd_world,
            device_sends=Motion,
            world_sends=Motion,
            shared=("stiffness_N_m", "damping_Ns_m", "coordination_Ns_m"),
            warn=tuning.warn_pd,
            covers=tuning.covers_pd,
        ),
        "tdpa": CouplingSpec(
            "two-port time-domain passivity",
            "Ryu, Artigas, Preusche 2010, with drift compensation",
            "passive at both ports, whatever the link does, but for a bounded debt; without compensation it drifts",
            tune=tuning.tune_tdpa,
            device=tuning.tdpa_device,
            world=tuning.tdpa_world,
            device_sends=Port,
            world_sends=Port,
            covers=lambda params, tuning, virtual: True,
            allowance_J=lambda tuning: 2.0 * tuning.get("debt_limit_J", 0.0),
        ),
        "wave": CouplingSpec(
            "wave variables",
            "Niemeyer, Slotine 2004",
            "passive at both ports for any constant delay; with zero for what is missing, on any link",
            tune=tuning.tune_wave,
            device=tuning.wave_device,
            world=tuning.wave_world,
            device_sends=Wave,
            world_sends=Wave,
            shared=("impedance_Ns_m",),
            covers=lambda params, tuning, virtual: params.wave.missing == "zero",
        ),
        "digital-wave": CouplingSpec(
            "digital waves",
            "Berestesky, Chopra, Spong 2004",
            "passive at both ports, whatever the link does",
            tune=tuning.tune_digital_wave,
            device=tuning.wave_device,
            world=tuning.wave_world,
            device_sends=Wave,
            world_sends=Wave,
            shared=("impedance_Ns_m",),
            covers=lambda params, tuning, virtual: True,
        ),
    }
)
assert set(COUPLINGS) == set(COUPLING_NAMES)


def jointly_passive(coupling: object) -> bool:
    """Does the coupling of this name pass energy on through the link itself, so that neither side has a half to keep?

    Then the energy put in at one port alone may be anything: only the sum of both at the same time says something.
    """
    kind = COUPLINGS.get(str(coupling))
    return kind is not None and kind.device is not None


def ideal_stiffness(params: Params, wall: float) -> float:
    """What a hand at a wall of stiffness `wall` [N/m] would feel of the coupling's springs in series, at rest [N/m].

    With PSPM and all that has its two springs the device's spring K sees the proxy stay back by K'/(K' + K_w) of the
    way into the wall. With one spring between the two sides it is that spring and the wall, in series: the spring that
    the user asked for, also where a law's rule makes it softer.
    """
    K = scalar_stiffness(params)
    K_world = params.world.stiffness
    if not COUPLINGS[params.coupling].scaled:
        return K * wall / (K + wall)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, where an ideal stiffness is to be compared with")
    return K * wall / (K_world + wall)
