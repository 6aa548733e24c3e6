"""The catalogue of all that can be compiled: kinds of whole scenarios, and the ends of a side."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.compiled import real_time
from hapnet.ext.compiled.names import ARM, HANDLE, SERVO, WORLD, Kind, named
from hapnet.records.record import AXES

_MANY_AXES = 12
"""The room in axes of a tool's end, and of the end of an arm with more than `AXES` joints."""


def of_coupling(name: str) -> dict[str, Kind]:
    """A coupling's kinds of scenarios among walls and among solids, by name; empty if it cannot be compiled."""
    compiled = COUPLINGS[name].compiled
    kinds = [] if compiled is None else [Kind(*compiled, solid) for solid in (False, True)]
    return {kind.name: kind for kind in kinds}


def ends() -> list[str]:
    """The names of the ends of a side of set-positions, of a simulated arm and of a tool's handle."""
    sides = (SERVO, WORLD)
    return [*(named(end, axes) for axes in (AXES, _MANY_AXES) for end in sides), ARM, HANDLE]


def labels() -> dict[str, str]:
    """Labels for users, by name: the couplings of a kind and the mass's surroundings, or the end."""
    laws: dict[Kind, list[str]] = {}
    for law in COUPLINGS:
        for kind in of_coupling(law).values():
            laws.setdefault(kind, []).append(law)
    around = {False: "walls", True: "solids"}
    found = {kind.name: f"{', '.join(names)} among {around[kind.solid]}" for kind, names in laws.items()}
    for axes, room in ((AXES, ""), (_MANY_AXES, f" with up to {_MANY_AXES} axes")):
        found |= {named(end, axes): f"{end} in real time{room}" for end in (SERVO, WORLD)}
    return found | {ARM: "simulated arm", HANDLE: "simulated handle of a tool"}


def makers() -> dict[str, Callable[[], object]]:
    """Return for each name the function that compiles it now, or loads its machine code."""
    from hapnet.ext.compiled.whole_runs.run import make_ready  # here, since it loads numba

    kinds = {name: kind for law in COUPLINGS for name, kind in of_coupling(law).items()}
    found: dict[str, Callable[[], object]] = {name: partial(make_ready, kind) for name, kind in kinds.items()}
    return found | {name: partial(real_time.make_ready, name) for name in ends()}
