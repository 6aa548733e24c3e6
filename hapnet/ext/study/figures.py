"""The content of the figures of comparisons and tunings, which `hapnet.ext.pictures` draws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import Array
from hapnet.ext.metrics.contact import pressed_wall
from hapnet.ext.metrics.measured import Measured
from hapnet.ext.metrics.obstacles import normal_where_deepest
from hapnet.ext.pictures import comparison, tuning
from hapnet.ext.pictures.comparison import STIFFNESS, STORY, TRUE_ERROR, Look, Points, Traces
from hapnet.ext.study.case import simulated, was_passive
from hapnet.ext.study.compare import ComparedRun, Plan, RunMeasures, Variant, by_hand
from hapnet.ext.study.search import Search
from hapnet.ext.study.spec import value_words
from hapnet.ext.study.statistics import spreads
from hapnet.plant.worlds.walls import Wall

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN_S = 5.0


def traces(plan: Plan, cases: Sequence[ComparedRun]) -> Figure:
    """The figure of the same case for each variant, for the first 5 s.

    Drawn along the normal of the wall in which the first variant's device was deepest, or along the first axis.
    """
    runs = [simulated(case.params, case.seed) for case in cases]
    direction, surface_mm = _along(runs[0])
    about = cases[0]
    shown = min(_SHOWN_S, about.params.duration_s)
    title = (
        f"the same hand ({about.operator}) over {about.link}, seed {about.seed}: the first {shown:g} s with each "
        "coupling; the other couplings in grey"
    )
    looks = [_look(plan, case.variant) for case in cases]
    return comparison.traces(title, looks, [_traces(run, direction, shown) for run in runs], shown, surface_mm)


def tradeoff(plan: Plan, outcomes: Sequence[RunMeasures]) -> Figure:
    """The figure of true force error and rendered stiffness over the most energy that came out of both ports."""
    each = {link: [_of(outcomes, variant, link) for variant in plan.variants] for link in plan.links}
    found = {
        metric: {link: [_points(these, metric) for these in over] for link, over in each.items()}
        for metric in (TRUE_ERROR, STIFFNESS)
    }
    looks = [_look(plan, variant) for variant in plan.variants]
    most_mJ = max(_out_mJ(outcomes), default=0.0)
    return comparison.tradeoff(story(plan, outcomes), looks, list(plan.links), found, _bound_mJ(outcomes), most_mJ)


def story(plan: Plan, outcomes: Sequence[RunMeasures]) -> str:
    """Describe all cases in one or two lines: which couplings were passive, and the smallest force error among them."""
    lost: dict[str, list[str]] = {}
    errors: dict[str, list[float]] = {}
    for variant in plan.variants:
        for link in plan.links:
            these = _of(outcomes, variant, link)
            if not _passive(these):
                lost.setdefault(str(variant), []).append(link)
            found = dict(spreads(by_hand(these))).get(TRUE_ERROR)
            if found is not None:
                errors.setdefault(str(variant), []).append(found.median)
    kept = {name: values for name, values in errors.items() if name not in lost}
    who, lines = "", ["every coupling was passive in all cases"]
    if lost:
        who = "of the others "
        lines = [f"not passive in all cases: {', '.join(f'{name} ({_some(links)})' for name, links in lost.items())}"]
    if kept:
        best = min(kept, key=lambda name: max(kept[name]))
        low, high = min(kept[best]), max(kept[best])
        spread = f"{low:.2g} %" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g} %"
        lines.append(f"{who}{best} has the smallest force error: {spread} (a link's median)")
    return "\n".join(fill(line, STORY) for line in lines)


def tuned(search: Search) -> Figure:
    """The figure of the objective over the trials, and over each searched parameter. There must be a trial."""
    spec, verdicts, scores = search.spec, search.verdicts(), search.scores
    objective = np.array([v.objective if math.isfinite(v.objective) else math.nan for v in verdicts])
    default = math.inf if scores is None else scores[0].verdicts(spec)[0].objective
    title = f"{spec.name}: {' + '.join(map(str, spec.goal.terms))}"
    if search.best is not None and math.isfinite(default):
        title += f": {objective[search.best]:.3g} with the chosen values, {default:.3g} with the defaults"
    slices = [
        tuning.Slice(
            one.name,
            np.array([float(one.plain(trial.values[one.name])) for trial in search.trials]),
            float(one.plain(one.default)) if one.default in one else None,
            one.low,
            one.high,
            one.log,
            one.whole,
            [value_words(one.name, choice) for choice in one.choices],
        )
        for one in spec.space
    ]
    allowed = np.array([verdict.allowed for verdict in verdicts], dtype=bool)
    return tuning.draw(title, tuning.Trials(objective, allowed, search.best, default), slices)


def _of(outcomes: Sequence[RunMeasures], variant: Variant, link: str) -> list[RunMeasures]:
    return [one for one in outcomes if (one.case.variant, one.case.link) == (variant, link)]


def _passive(outcomes: Sequence[RunMeasures]) -> bool:
    return all(was_passive(one.measures) for one in outcomes if one.measures)


def _some(links: Sequence[str]) -> str:
    return ", ".join(links) if len(links) <= 3 else f"{len(links)} links"


def _points(outcomes: Sequence[RunMeasures], metric: str) -> Points | None:
    """A variant's cases over a link; None: no case has an energy and a value."""
    pairs = [
        (1e3 * out, value, was_passive(m))
        for one in outcomes
        if (m := one.measures) and (out := m["energy_out_J"]) is not None and (value := m[metric]) is not None
    ]
    if not pairs:
        return None
    spread = dict(spreads(by_hand(outcomes)))[metric]
    return Points(pairs, spread.median, spread.low, spread.high, _passive(outcomes), max(_out_mJ(outcomes)))


def _out_mJ(outcomes: Sequence[RunMeasures]) -> list[float]:
    """The most energy that came out [mJ], for each case in which it is known."""
    return [1e3 * out for one in outcomes if one.measures and (out := one.measures["energy_out_J"]) is not None]


def _bound_mJ(outcomes: Sequence[RunMeasures]) -> float:
    """The bound d^2 [mJ], which is the same for all cases."""
    known = (one.measures for one in outcomes if one.measures)
    bounds = [
        1e3 * (margin + out)
        for m in known
        if (margin := m["margin_J"]) is not None and (out := m["energy_out_J"]) is not None
    ]
    return max(bounds, default=0.0)


def _look(plan: Plan, variant: Variant) -> Look:
    return Look(str(variant), plan.couplings.index(variant.coupling), bool(variant.deadband))


def _along(run: Measured) -> tuple[Array, float | None]:
    """The direction along which to draw (n,), and the position of the wall's surface on it [mm]."""
    device = run.recording.device
    assert device is not None
    wall = pressed_wall(device, run.walls or ())
    if wall is None:
        return np.eye(device["position_m"].shape[1])[0], None
    normal = normal_where_deepest(wall, device["position_m"])
    return np.array(normal), 1e3 * wall.offset if isinstance(wall, Wall) else None


def _traces(run: Measured, direction: Array, until_s: float) -> Traces:
    device, world = run.recording.device, run.recording.world
    assert device is not None
    assert world is not None
    felt, moved = device["time_s"] <= until_s, world["time_s"] <= until_s
    return Traces(
        (device["time_s"][felt], 1e3 * (device["position_m"][felt] @ direction)),
        (world["time_s"][moved], 1e3 * (world["position_m"][moved] @ direction)),
        (device["time_s"][felt], -(device["force_N"][felt] @ direction)),
    )
