"""The couplings, by the names that a user gives them: a file of hapnet/couplings each.

The names stand in hapnet/params.py too, as commands and their completion need them without loading the laws.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from hapnet.couplings.eba import EBA
from hapnet.couplings.felt import through
from hapnet.couplings.pd import PD
from hapnet.couplings.popc import POPC
from hapnet.couplings.set_position import PSPM, ZOH
from hapnet.couplings.spec import CouplingSpec, scalar_stiffness
from hapnet.couplings.tdpa import TDPA
from hapnet.couplings.wave import DIGITAL_WAVE, WAVE
from hapnet.errors import InvalidParameter
from hapnet.loading import load
from hapnet.params import COUPLING_NAMES, Params

_SPECS: tuple[CouplingSpec[Any], ...] = (PSPM, ZOH, POPC, EBA, PD, TDPA, WAVE, DIGITAL_WAVE)

COUPLINGS: Mapping[str, CouplingSpec[Any]] = MappingProxyType({spec.name: spec for spec in _SPECS})
assert set(COUPLINGS) == set(COUPLING_NAMES), "COUPLING_NAMES of hapnet/params.py must have the names of _SPECS"


def coupling(name: str) -> CouplingSpec[Any]:
    """The coupling of that name, or a user's own, given as ``module:NAME``.

    Raises
    ------
    InvalidParameter : there is no coupling of that name, or the object is not a `CouplingSpec`.
    """
    if name in COUPLINGS:
        return COUPLINGS[name]
    allowed = f"one of {', '.join(COUPLING_NAMES)}, or module:NAME of a CouplingSpec"
    spec = load("coupling", name, allowed, COUPLINGS)
    if not isinstance(spec, CouplingSpec):
        raise InvalidParameter("coupling", name, f"{allowed} (this is a {type(spec).__name__})")
    return spec


def known(name: object) -> CouplingSpec[Any] | None:
    """hapnet's own coupling of that name; None for a user's own, of which only the name is known."""
    return COUPLINGS.get(str(name))


def limited(name: object) -> bool:
    """Does the coupling of this name limit the set-position's step, as PSPM does? False for a user's own."""
    spec = known(name)
    return spec is not None and spec.limited


def jointly_passive(name: object) -> bool:
    """Does energy pass through the link itself with the coupling of this name, so that neither side keeps a half?

    Then the energy put in at one port alone means nothing; only the sum of both ports at the same time does. The answer
    is yes for a user's own law.
    """
    spec = known(name)
    return ":" in str(name) if spec is None else spec.joint


def ideal_stiffness(params: Params, wall: float) -> float:
    """The stiffness that a hand would feel at a wall of stiffness `wall` [N/m], over an ideal link, at rest [N/m].

    PSPM and others with two springs: the device's spring K is stretched by the part K_w/(K' + K_w) of the penetration,
    because the proxy follows by K'/(K' + K_w) of it. Couplings with one spring: that spring and the wall in series,
    with the stiffness that the user asked for, even if the law's rule makes it softer.
    """
    K = scalar_stiffness(params)
    K_world = params.world.stiffness
    if not coupling(params.coupling).scaled:
        return through((K,), wall)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, to compute the ideal stiffness at a wall")
    return through((K, K_world), wall)
