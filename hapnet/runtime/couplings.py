"""The couplings, by the names that a user gives them: what each is, how it is tuned, and what its two ends are made of.

A law's equations are in its own file of hapnet/control; here its published rule is given the link's delays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, cast

from hapnet.checks import Vector
from hapnet.control.coupling import Modulator
from hapnet.control.law import DeviceLaw, WorldLaw
from hapnet.control.pspm import SetPositionModulator, Shuffle
from hapnet.control.spring import Spring
from hapnet.control.zoh import ZeroOrderHold
from hapnet.errors import InvalidParameter
from hapnet.params import COUPLINGS, DeviceParams, Params, WorldParams
from hapnet.wire.messages import Position, Stream
from netem import LinkProfile

Tuning = Mapping[str, float]
"""What a rule chose, by names with units."""


class Delays(NamedTuple):
    """Of the link that a law is tuned for."""

    one_way_s: float
    """The mean of both ways."""
    round_trip_bound_s: float
    """Hardly ever exceeded."""


def delays(up: LinkProfile, down: LinkProfile) -> Delays:
    """What a designer would know of the link: its delays, and the jitter's tail."""
    typical = [profile.delay_ns * 1e-9 for profile in (up, down)]
    tail = [_tail_s(profile) for profile in (up, down)]
    return Delays(sum(typical) / 2.0, sum(typical) + sum(tail))


def _tail_s(profile: LinkProfile) -> float:
    return profile.jitter_ns * 1e-9 * (1.0 if profile.distribution == "uniform" else 3.0)


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
    }
)
assert set(KINDS) <= set(COUPLINGS)


def ideal_stiffness(params: Params, wall: float) -> float:
    """What a hand at a wall of stiffness `wall` [N/m] would feel of the coupling's springs in series, at rest [N/m].

    With PSPM and all that has its two springs the device's spring K sees the proxy stay back by K'/(K' + K_w) of the
    way into the wall. With one spring between the two sides it is that spring and the wall, in series.
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
