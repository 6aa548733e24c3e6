"""The types with which parts of hapnet choose and refuse values while a run is resolved.

Each part returns only its choices. `choosing` puts them into parameters; `hapnet.assembly.resolve` sets the order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hapnet.couplings.spec import CouplingSpec
from hapnet.errors import InvalidParameter
from hapnet.loading import extension
from hapnet.param_sources import RULE
from hapnet.params import Params, follows, is_arm
from hapnet.plant.worlds.protocol import World
from hapnet.units import POSE


@dataclass(frozen=True)
class Choice:
    """Values by their parameters' names, and the source of all of them, or of each: one of `hapnet.param_sources`."""

    values: Mapping[str, object] = field(default_factory=dict)
    source: str | Mapping[str, str] = RULE


Part = Callable[[Params], Choice]
"""Chooses values from the parameters with all earlier choices. Raises InvalidParameter: it refuses a value."""


def choosing(params: Params, *parts: Part) -> Params:
    """Return the parameters with the choices of these parts, made in this order."""
    for part in parts:
        choice = part(params)
        if choice.values:
            params = params.set(choice.values, choice.source)
    return params


class Refusal(NamedTuple):
    """A value that cannot be used if `applies`, and the text on allowed values."""

    applies: bool
    name: str
    value: object
    allowed: str


def refuse(refusals: Iterable[Refusal]) -> None:
    """Raise InvalidParameter for the first of these refusals that applies."""
    for one in refusals:
        if one.applies:
            raise InvalidParameter(one.name, one.value, one.allowed)


def _fits(params: Params, spec: CouplingSpec[Any], scene: World) -> None:
    """Accept everything."""


def _as_it_is(params: Params, spec: CouplingSpec[Any], scene: World) -> World:
    return scene


@dataclass(frozen=True)
class Contribution:
    """An extension's part in resolving: `CONTRIBUTION` of the module that `hapnet.loading.extension` finds.

    before_scene : its choices before there is a scene. in_scene : its choices when the units are known.
    check : raises InvalidParameter if the final parameters do not fit the extension.
    place : returns the scene with the objects that the extension adds.
    sampled_only : whether only a sampled servo can drive the extension's device.
    """

    before_scene: tuple[Part, ...] = ()
    in_scene: tuple[Part, ...] = ()
    check: Callable[[Params, CouplingSpec[Any], World], None] = _fits
    place: Callable[[Params, CouplingSpec[Any], World], World] = _as_it_is
    sampled_only: bool = False


RESOLVING: tuple[tuple[str, Callable[[Params], bool]], ...] = (
    ("arms", lambda params: is_arm(params.hardware)),
    ("tools", lambda params: params.units == POSE),
    ("robots", follows),
)
"""The extensions that contribute, in this order, and which parameters need each."""


def contributions(params: Params) -> tuple[Contribution, ...]:
    """The contributions of the extensions that a run with these parameters needs, in the order of their table."""
    return tuple(extension(name).CONTRIBUTION for name, needed in RESOLVING if needed(params))


def before_scene(params: Params) -> Iterator[Part]:
    """Yield the extensions' parts that choose before there is a scene, for example the mass of an arm."""
    for one in contributions(params):
        yield from one.before_scene
