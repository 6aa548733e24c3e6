"""The couplings, by the names in `--coupling`. Each is loaded on first use."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hapnet.control.deadband import MAX_S, MAX_WAVE_S, Deadband
from hapnet.couplings.spec import CouplingSpec, scalar_stiffness
from hapnet.couplings.stiffness import through
from hapnet.errors import InvalidParameter
from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES, GROUP, built_in, sections
from hapnet.loading import load, published
from hapnet.params import Params
from hapnet.wire.messages import Role, Wave


class _BuiltIn(Mapping[str, CouplingSpec[Any]]):
    def __getitem__(self, name: str) -> CouplingSpec[Any]:
        if name not in COUPLING_NAMES:
            raise KeyError(name)
        spec: CouplingSpec[Any] = built_in(name)
        return spec

    def __contains__(self, name: object) -> bool:
        return name in COUPLING_NAMES

    def __iter__(self) -> Iterator[str]:
        return iter(COUPLING_NAMES)

    def __len__(self) -> int:
        return len(COUPLING_NAMES)


COUPLINGS: Mapping[str, CouplingSpec[Any]] = _BuiltIn()
"""hapnet's own couplings that move a virtual mass; those of `BILATERAL_NAMES` need a follower."""


def coupling(name: str) -> CouplingSpec[Any]:
    """The coupling of that name: hapnet's own, a published one's name, or a user's own as ``module:NAME``.

    Raises InvalidParameter: there is no coupling of that name, the object is not a `CouplingSpec`, or its section has
    the name of another section.
    """
    if (own := known(name)) is not None:
        return own
    names = (*COUPLING_NAMES, *BILATERAL_NAMES, *published(GROUP))
    allowed = f"one of {', '.join(names)}, or module:NAME of a CouplingSpec"
    target, _ = published(GROUP).get(name, (name, ""))
    spec = load("coupling", target, allowed, names)
    if not isinstance(spec, CouplingSpec):
        raise InvalidParameter("coupling", name, f"{allowed} (this is a {type(spec).__name__})")
    if spec.parameters is not None and sections().get(spec.section, spec.parameters) is not spec.parameters:
        raise InvalidParameter(
            f"section of the coupling {name}", spec.section, "a name that no other law's section uses"
        )
    return spec


def known(name: object) -> CouplingSpec[Any] | None:
    """hapnet's own coupling of that name; None for a user's own coupling, which is not loaded here."""
    if name in BILATERAL_NAMES:
        law: CouplingSpec[Any] = built_in(str(name))
        return law
    return COUPLINGS.get(str(name))


def jointly_passive(name: object) -> bool:
    """Whether the coupling of this name passes energy through the link itself, so that no side keeps its own half.

    Then the energy put in at one port alone proves nothing; only the sum over both ports at the same time does. True
    for a user's own law.
    """
    spec = known(name)
    return name is not None if spec is None else spec.joint


def ideal_stiffness(params: Params, wall: float) -> float:
    """The stiffness that a hand would feel at a wall of stiffness `wall` [N/m], over an ideal link, at rest [N/m].

    With two springs, as in PSPM: the device's spring K is stretched by the part K_w/(K' + K_w) of the penetration,
    because the proxy follows by the part K'/(K' + K_w). With one spring: this spring and the wall are in series, with
    the stiffness that the user set, even if the law's rule makes it softer.
    """
    K = scalar_stiffness(params)
    K_world = params.world.stiffness
    if not coupling(params.coupling).scaled:
        return through((K,), wall)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, to compute the ideal stiffness at a wall")
    return through((K, K_world), wall)


SENT_A_SILENCE = 5
"""With a deadband, a side sends at least this many samples in the time after which a peer counts as silent."""


def deadband(params: Params, role: Role) -> Deadband | None:
    """The deadband that decides which samples this side sends; None: it sends every sample."""
    if params.wire.deadband == 0.0:
        return None
    spec = coupling(params.coupling)
    sends = spec.sends(role, params)
    silence_s = min(params.device.silence_after_s, params.world.silence_after_s)
    return Deadband(
        params.wire.deadband,
        longest_s=min(MAX_WAVE_S if sends is Wave else MAX_S, silence_s / SENT_A_SILENCE),
        port="position" if role == "device" else "force",
    )
