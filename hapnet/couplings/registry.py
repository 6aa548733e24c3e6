"""The couplings, by the names that a user gives them: a file of hapnet/couplings each, and one line here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from hapnet.couplings.eba import EBA
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
assert set(COUPLINGS) == set(COUPLING_NAMES)


def coupling(name: str) -> CouplingSpec[Any]:
    """The coupling of that name, or the user's own, ``module:NAME``.

    Raises
    ------
    InvalidParameter : there is none, or what is there is none.
    """
    if name in COUPLINGS:
        return COUPLINGS[name]
    allowed = f"one of {', '.join(COUPLING_NAMES)}, or module:NAME of a CouplingSpec"
    spec = load("coupling", name, allowed)
    if not isinstance(spec, CouplingSpec):
        raise InvalidParameter("coupling", name, f"{allowed} ({type(spec).__name__} is none)")
    return spec


def known(name: object) -> CouplingSpec[Any] | None:
    """hapnet's own coupling of that name; None: of a user's own nothing is known but its name."""
    return COUPLINGS.get(str(name))


def jointly_passive(name: object) -> bool:
    """Does the coupling of this name pass energy on through the link itself, so that neither side has a half to keep?

    Then the energy put in at one port alone may be anything: only the sum of both at the same time says something. So
    it is with a user's own law.
    """
    spec = known(name)
    return ":" in str(name) if spec is None else spec.joint


def ideal_stiffness(params: Params, wall: float) -> float:
    """What a hand at a wall of stiffness `wall` [N/m] would feel of the coupling's springs in series, at rest [N/m].

    With PSPM and all that has its two springs the device's spring K sees the proxy stay back by K'/(K' + K_w) of the
    way into the wall. With one spring between the two sides it is that spring and the wall, in series: the spring that
    the user asked for, also where a law's rule makes it softer.
    """
    K = scalar_stiffness(params)
    K_world = params.world.stiffness
    if not coupling(params.coupling).scaled:
        return K * wall / (K + wall)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, where an ideal stiffness is to be compared with")
    return K * wall / (K_world + wall)
