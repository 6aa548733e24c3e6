"""What a coupling is to the rest of hapnet: its names, its tuning by its own published rule, and its two ends.

A new law is one file with a `CouplingSpec`, and one line in registry.py; or none there: a user's own is given as
``--coupling module:NAME``. examples/own_law.py is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from typing import Any, Generic, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling, DeviceLaw, LawServo, LawSteps, WorldCoupling, WorldLaw
from hapnet.control.set_position_servo import ContinuousServo, Harvest
from hapnet.couplings.link_delays import Delays
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.wire.messages import Position, Stream

RENDERED_DAMPING = 5.0
"""Most damping that a desktop device renders stably [Ns/m]: a Phantom Omni's, in CHAI3D's device table."""


@dataclass(frozen=True)
class NoTuning:
    """Of a coupling with no rule of its own."""


T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
T_contra = TypeVar("T_contra", contravariant=True)


@dataclass(frozen=True)
class CouplingStart(Generic[T_co]):
    """What one end of a coupling is made with, when its side starts.

    tuning : what the rule chose. position : of device or mass, where it is at rest [m]. initial_energy : the side's
    share of d^2 [J]; 0 where it starts again. kinetic : kinetic energy of device or mass [J].
    """

    params: Params
    tuning: T_co
    position: Vector
    initial_energy: float
    kinetic: float = 0.0
    harvest: Harvest = "measured"


class Covers(Protocol[T_contra]):
    """The parameters, the tuning, and whether only the emulated link is between the sides (virtual time), to whether
    both ports are claimed to be passive there: if they are not, the claim was not kept."""

    def __call__(self, params: Params, tuning: T_contra, virtual: bool) -> bool: ...


@dataclass(frozen=True)
class CouplingSpec(Generic[T]):
    """One way to couple.

    name : what users call it. title, source : what it is and who published it. claim : where its source says that it
        is passive.
    device, world : make the two ends. continuous : makes a device's end that acts within a simulated device's tick;
        None: its force is held.
    tuning : a frozen dataclass, fields named with units; tune : the parameters and the link's delays, to what the
        law's own rule chooses.
    shared : fields of the tuning whose values both ends must have the same.
    device_sends, world_sends : the message that carries the ends' samples.
    set_positions : which sides take set-positions, with filters, silence and the rest of what works on these.
    limited : does it keep to a longest step, and a held force to what its account can pay for?
    scaled : is the felt force K/K' of the virtual one, as with PSPM?
    halves : does each side keep a half of Theorem 1, with a reservoir of its own?
    joint : does energy pass through the link itself? Then the energy put in at one port alone may be anything.
    covers : where is it claimed to be passive? allowance_J : the tuning, to what may come out beyond d^2 there [J].
    warn : the parameters and the tuning, to what the user should know before it runs.
    """

    name: str
    title: str
    source: str
    claim: str
    device: Callable[[CouplingStart[T]], DeviceCoupling]
    world: Callable[[CouplingStart[T]], WorldCoupling]
    tuning: type[T]
    tune: Callable[[Params, Delays], T]
    continuous: Callable[[CouplingStart[T]], ContinuousServo] | None = None
    shared: tuple[str, ...] = ()
    device_sends: type[Stream] = Position
    world_sends: type[Stream] = Position
    set_positions: frozenset[str] = frozenset()
    limited: bool = False
    scaled: bool = False
    halves: bool = False
    joint: bool = True
    covers: Covers[T] = lambda params, tuning, virtual: False
    allowance_J: Callable[[T], float] = lambda tuning: 0.0
    warn: Callable[[Params, T], tuple[str, ...]] = lambda params, tuning: ()

    def recorded(self, tuning: Mapping[str, Any] | None) -> T | None:
        """The tuning that a summary or a recording tells; None if it does not tell all of it."""
        told = tuning or {}
        return self.tuning(**told) if set(told) == set(signature(self.tuning).parameters) else None


def untuned(params: Params, link: Delays) -> NoTuning:
    """For couplings without a rule."""
    return NoTuning()


def held_law(law: Callable[[CouplingStart[T]], DeviceLaw]) -> Callable[[CouplingStart[T]], DeviceCoupling]:
    """The device's end of a law."""

    def make(start: CouplingStart[T]) -> DeviceCoupling:
        device = start.params.device
        return LawServo(
            law(start),
            period=device.pspm_period_s,
            position=start.position,
            initial_energy=start.initial_energy,
            force_limit=device.force_limit_N or math.inf,
        )

    return make


def stepped_law(law: Callable[[CouplingStart[T]], WorldLaw]) -> Callable[[CouplingStart[T]], WorldCoupling]:
    """The world's end of a law."""
    return lambda start: LawSteps(law(start), start.initial_energy)


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
