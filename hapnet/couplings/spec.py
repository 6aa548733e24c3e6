"""The description of a coupling for the rest of hapnet: its names, its tuning by the published rule, its two ends.

A user's own law is a file with a `CouplingSpec`, given as ``--coupling module:NAME``: see examples/own_law.py.
A law of the library is a file of hapnet/ext/laws with ``LAW = CouplingSpec(...)``: "Add to it" in hapnet/README.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from inspect import Parameter, signature
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.coupling import DeviceCoupling, WorldCoupling
from hapnet.control.held_steps import FollowerServo
from hapnet.control.law import DeviceEnd, WorldEnd
from hapnet.control.set_position_servo import Harvest
from hapnet.couplings.link_delays import Delays
from hapnet.errors import InvalidParameter
from hapnet.param_sections import Matrix
from hapnet.params import Params
from hapnet.wire.messages import Motion, Position, Proxy, Role, Stream

RENDERED_DAMPING = 5.0
"""The largest damping that a desktop device renders stably [Ns/m]: the Phantom Omni's in CHAI3D's device table."""


class Between(NamedTuple):
    """A range of a parameter, for a search."""

    low: float
    high: float
    log: bool = False


_SECTIONS = {one.name for one in fields(Params)}
_FUNCTIONS = ("device", "world", "tune", "covers", "allowance_J", "warn", "springs")

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
T_contra = TypeVar("T_contra", contravariant=True)


@dataclass(frozen=True)
class CouplingStart(Generic[T_co]):
    """The values from which one end of a coupling is made when its side starts.

    tuning : the values chosen by the law's rule. position : of device or mass at rest [m]. initial_energy : the side's
    share of d^2 [J]; 0 after a restart. kinetic : kinetic energy of device or mass [J].
    """

    params: Params
    tuning: T_co
    position: Vector
    initial_energy: float
    kinetic: float = 0.0
    harvest: Harvest = "measured"


class Covers(Protocol[T_contra]):
    """True if the coupling claims both ports to be passive with these parameters and this tuning. A run that is not
    passive then breaks the claim. `virtual`: only the emulated link is between the sides (virtual time)."""

    def __call__(self, params: Params, tuning: T_contra, virtual: bool) -> bool: ...


@dataclass(frozen=True)
class Untuned:
    """The tuning of a law without values to choose."""


@dataclass(frozen=True)
class CouplingSpec(Generic[T]):
    """A coupling law.

    More than twenty attributes: the rest of hapnet reads every property of a law here; all but six have a default.

    name : the name in `--coupling`. title : the full name. source : the publication. claim : when the law is passive,
        according to its source.
    device, world : make the two ends. continuous : makes a device's end that acts within a simulated device's tick;
        None: its force is held.
    follower : makes the servo of a robot in the virtual mass's place, from parameters with the robot as `device`;
        None: only a robot with a coupling that acts within its step can follow.
    tuning : a frozen dataclass with units in its field names. tune : applies the law's own rule to the parameters and
        the link's delays. A law without both has no values to choose.
    parameters : a frozen dataclass of `hapnet.param_values.parameter`s, which `Params.of` finds by its class; None: the
        law has none of its own. section : their section of `Params`; "": the section has the law's name.
    shared : fields of the tuning that must have the same value at both ends.
    device_sends, world_sends : the messages that carry the ends' samples.
    sends_planes : with ``rendering = "auto"``, whether the world sends its proxy with the planes around it, and the
        stages precede the law.
    set_positions : the sides that receive set-positions, and so have filters, a silence policy and step limits.
    scaled : whether the felt force is K/K' of the virtual force, as with PSPM.
    springs : the springs through which a wall is felt at rest [N/m]: K and K', as with PSPM, or a single spring K.
        None: unknown, so the felt stiffness of a wall is unknown too.
    halves : whether each side keeps a half of Theorem 1, with its own reservoir.
    joint : whether energy passes through the link itself. Then the energy put in at one port alone proves nothing.
    senses : whether a follower sends the force at its contact, so that a robot with a driver must measure it.
    between_robots : whether both ends are robots', and the law itself determines what the leader feels.
    covers : see `Covers`. allowance_J : energy that may come out beyond d^2 within the claim [J].
    warn : warnings for the user before the start.
    compiled : the records of its two ends, if hapnet compiles the law (None: a set-position end); never a user's law.
    searched : parameters that a tuning of the law may change, each with its range or its choices. Ranges end at what a
        desktop device renders stably, and parameters that a claim depends on are excluded.
    """

    name: str
    title: str
    source: str
    claim: str
    device: Callable[[CouplingStart[T]], DeviceCoupling]
    world: Callable[[CouplingStart[T]], WorldCoupling]
    tuning: type[T] = Untuned  # type: ignore[assignment]
    tune: Callable[[Params, Delays], T] = lambda params, link: Untuned()  # type: ignore[assignment,return-value]
    parameters: type[Any] | None = None
    section: str = ""
    continuous: Callable[[CouplingStart[T]], ContinuousServo] | None = None
    follower: Callable[[CouplingStart[T]], FollowerServo] | None = None
    shared: tuple[str, ...] = ()
    device_sends: type[Stream] = Position
    world_sends: type[Stream] = Position
    sends_planes: bool = False
    set_positions: frozenset[str] = frozenset()
    scaled: bool = False
    springs: Callable[[Params, T], Sequence[Matrix] | None] = lambda params, tuning: None
    halves: bool = False
    joint: bool = True
    senses: bool = False
    between_robots: bool = False
    covers: Covers[T] = lambda params, tuning, virtual: False
    allowance_J: Callable[[T], float] = lambda tuning: 0.0
    warn: Callable[[Params, T], tuple[str, ...]] = lambda params, tuning: ()
    compiled: tuple[type[DeviceEnd] | None, type[WorldEnd] | None] | None = None
    searched: Mapping[str, Between | tuple[Any, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "section", self.section or self.name.replace("-", "_"))
        chosen = signature(self.tuning).parameters if is_dataclass(self.tuning) else None
        own = {} if self.parameters is None else dict(self.parameters.__dataclass_fields__)
        for part, value, right, allowed in (
            *((name, getattr(self, name), callable(getattr(self, name)), "a function") for name in _FUNCTIONS),
            ("tuning", self.tuning, chosen is not None, "a dataclass"),
            ("shared", self.shared, set(self.shared) <= set(chosen or ()), "fields of its tuning"),
            ("set_positions", {*self.set_positions}, self.set_positions <= {"device", "world"}, "of device and world"),
            ("section", self.section, not own or self.section.isidentifier(), "a name such as mine"),
            ("section", self.section, not own or self.section not in _SECTIONS, "a name that no other section has"),
            *((f"parameter {name}", one.default, "doc" in one.metadata, "hapnet.param_values.parameter(...)")
              for name, one in own.items()),
        ):  # fmt: skip
            if not right:
                raise InvalidParameter(f"{part} of the coupling {self.name}", value, allowed)

    def sends(self, role: Role, params: Params) -> type[Stream]:
        """The message that carries the samples of this side."""
        if role == "device":
            return self.device_sends
        return Proxy if self.staged(params) else self.world_sends

    @property
    def guards(self) -> bool:
        """Whether its device's servo has the guard of a held torque: that of set-positions has it."""
        return "device" in self.set_positions

    @property
    def takes_positions(self) -> bool:
        """Whether both ends take set-positions, so that the stages can choose them."""
        return {self.device_sends, self.world_sends} <= {Position, Motion}

    def staged(self, params: Params) -> bool:
        """Whether the stages precede the law."""
        return params.rendering == "hapnet" or (params.rendering == "auto" and self.sends_planes)

    def recorded(self, tuning: Mapping[str, Any] | None) -> T | None:
        """The tuning read from a summary or a recording; None if a field without a default is missing, or unknown."""
        found, fields = tuning or {}, signature(self.tuning).parameters
        needed = {name for name, one in fields.items() if one.default is Parameter.empty}
        return self.tuning(**found) if needed <= set(found) <= set(fields) else None


def two_springs(params: Params, tuning: object) -> tuple[Matrix, Matrix]:
    """K of the device and K' of the world, for `CouplingSpec.springs`."""
    return params.device.stiffness, params.world.stiffness


def scalar_stiffness(params: Params) -> float:
    """K [N/m] of the device's side, for laws with a single number as stiffness.

    Raises InvalidParameter: K has one number per axis, or is a matrix.
    """
    K = params.device.stiffness
    if not isinstance(K, float):
        raise InvalidParameter("device.stiffness", K, f"a number with the coupling {params.coupling}")
    return K
