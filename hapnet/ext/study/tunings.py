"""The tuning of each coupling of a comparison over each link, by the coupling's own rule."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rich.table import Table

from hapnet.assembly.build import prepare
from hapnet.assembly.choices import choosing
from hapnet.assembly.springs import spring
from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.ext.study.compare import Plan, Variant
from hapnet.params import Params
from hapnet.summary.words import number

_SPRINGS = ("device.stiffness", "device.damping", "world.stiffness", "world.damping", "world.mass")


def tuning(params: Params) -> dict[str, Any]:
    """Return a coupling's rendering parameters: springs, dampers, its rule's choice, and the ideal stiffness."""
    params = choosing(params, spring)
    scalar = all(isinstance(side.stiffness, float) for side in (params.device, params.world))
    ideal = ideal_stiffness(params, params.world.wall.stiffness) if scalar else None
    springs = {name: params.get(name) for name in _SPRINGS}
    return {**springs, **prepare(params).tuned, "ideal_stiffness_N_per_m": ideal}


def tunings(plan: Plan, coupling: str) -> dict[str, dict[str, Any]]:
    """The tuning of one coupling over each link that it can run over."""
    operator, seed = plan.operators[0], plan.seeds[0]
    found = {}
    for link in plan.links:
        with suppress(InvalidParameter):  # the case itself reports the error
            found[link] = tuning(plan.case(Variant(coupling), link, operator, seed).params)
    return found


def table(plan: Plan) -> Table:
    """The rules' choices: a row for each number, a column for each link; equal values are shown once."""
    result = Table(
        title="tuned by each law's own rule (shown once if all links have the same value)",
        title_justify="left",
        title_style="bold",
        padding=(0, 0),
    )
    result.add_column("coupling")
    result.add_column("", overflow="fold")
    for link in plan.links:
        result.add_column(link, justify="right", overflow="fold")
    for coupling in plan.couplings:
        over = tunings(plan, coupling)
        names = [name for name in next(iter(over.values()), {}) if name not in (*_SPRINGS, "ideal_stiffness_N_per_m")]
        for first, name in enumerate(names):
            values = [number(over[link][name]) if link in over else "–" for link in plan.links]
            if len(set(values)) == 1:
                values[1:] = [""] * (len(values) - 1)
            result.add_row("" if first else coupling, name, *values)
    return result
