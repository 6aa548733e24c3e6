"""The plans of comparisons: a single plan from the given options, or a plan for each section of the full set."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from hapnet.errors import InvalidParameter
from hapnet.ext.study.compare import ComparedRun, Plan, Variant, hand, local_wall, parted
from hapnet.ext.study.sections import FULL, QUICK, StudySection
from hapnet.param_sources import COMMAND
from hapnet.params import Params
from netem.presets import ALIASES, PRESETS
from netem.units import format_path

BASE = Params().set({"device.servo": "sampled", "operator_model.end_hold_s": 3.0}, COMMAND)
"""The base of all cases: the sampled servo of real hardware, at 1 kHz. At the end the hand holds still, so that
oscillations show."""

NOTICED = 0.1
"""The Weber fraction with which the quick set also tries its first coupling: people notice about a tenth."""

Links = Mapping[str, tuple[str, str]]
"""Links by name, each with the text of the uplink and of the downlink."""

_OWN = {
    "coupling": "--coupling",
    "operator": "--operator",
    "link.up": "--link",
    "link.down": "--link",
    "wire.deadband": "--deadband",
}
"""Parameters that a comparison varies, and their flags."""


def plans(
    params: Params = BASE,
    *,
    bench: str = "quick",
    couplings: Sequence[str] | None = None,
    links: Links | Sequence[str] | None = None,
    traces: Sequence[str] = (),
    operators: Sequence[str] | None = None,
    seeds: Sequence[int] | None = None,
    deadbands: Sequence[float] | None = None,
) -> dict[str, Plan]:
    """The plans of a bench (quick, full, or some of its sections) by their sections' names; quick has the name "".

    Given values replace those of all sections. If any is given, the quick set is limited to the given couplings and
    links (all of the set if none is given), with its first hand and seed 0 unless others are given.

    couplings, operators : as in `Plan`. links, traces : as `links_of` reads them, or links by name.

    Raises InvalidParameter, netem.NetemError: one line that names the value and what is allowed.
    """
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    for name, flag in _OWN.items():
        if params.get(name) != BASE.get(name):
            raise InvalidParameter(name, params.get(name), "", why=f"in a comparison {flag} sets it; leave it out")
    names = [name.strip() for name in bench.split(",")]
    given = [part for part in (couplings, links, traces or None, operators, seeds, deadbands) if part is not None]
    quick = replace(QUICK, operators=QUICK.operators[:1]) if given else QUICK

    def plan(section: StudySection, extra: tuple[Variant, ...] = ()) -> Plan:
        own = {name: value for name, value in section.changes.items() if params.get(name) == BASE.get(name)}
        whole = params.set(own)
        return _checked(
            Plan(
                whole,
                tuple(dict.fromkeys(section.couplings if couplings is None else couplings)),
                links if isinstance(links, Mapping) else links_of(links or section.links, traces),
                tuple(dict.fromkeys(section.operators if operators is None else operators)),
                tuple(section.seeds if seeds is None else seeds),
                (0.0,) if deadbands is None else tuple(dict.fromkeys(deadbands)),
                extra,
                local_wall(whole),
            )
        )

    if names == ["quick"]:
        return {"": plan(quick, () if given else (Variant(quick.couplings[0], NOTICED),))}
    names = list(FULL) if names == ["full"] else names
    for name in names:
        if name not in FULL:
            allowed = f"quick, full, or of its sections {', '.join(FULL)}"
            raise InvalidParameter("--bench", name, allowed, ("quick", "full", *FULL))
    return {name: plan(FULL[name]) for name in dict.fromkeys(names)}


def _checked(plan: Plan) -> Plan:
    """Return the plan after a check that each of its links and operators can be run."""
    from hapnet.simulation.simulation import Simulation

    _check_words(plan)
    first = plan.cases()[0]
    for link in plan.links:
        Simulation(plan.case(first.variant, link, first.operator, first.seed).params, first.seed)
    for operator in plan.operators:
        Simulation(plan.case(first.variant, first.link, operator, first.seed).params, first.seed)
    return plan if not plan.local or _runs(plan.local_cases()[0]) else replace(plan, local="")


def _runs(case: ComparedRun) -> bool:
    """Whether the parameters of a case make a run."""
    from hapnet.simulation.simulation import Simulation

    try:
        Simulation(case.params, case.seed)
    except InvalidParameter:
        return False
    return True


def _check_words(plan: Plan) -> None:
    """Raise InvalidParameter if a coupling's or an operator's text sets a parameter that it may not set."""
    from hapnet.couplings.registry import coupling

    taken: dict[str, str] = dict(_OWN)
    for flag, words, parts in (("--coupling", plan.couplings, parted), ("--operator", plan.operators, hand)):
        found: dict[str, str] = {}
        for word in words:
            name, own = parts(word)
            if flag == "--coupling":
                coupling(name)
            for parameter in plan.params.typed(own):
                if parameter in taken:
                    raise InvalidParameter(flag, word, "", why=f"{taken[parameter]} sets {parameter} already")
                found[parameter] = flag
        taken |= found


def links_of(given: Sequence[str], traces: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Links by name: profiles, ``NAME=WORDS`` or ``NAME=WORDS|WORDS`` (up|down), and recorded links.

    traces : each ``[NAME=]PATH`` of the delivery opportunities in PATH.up and PATH.down.
    """
    links: dict[str, tuple[str, str]] = {}

    def add(flag: str, name: str, up: str, down: str) -> None:
        if name in links:
            raise InvalidParameter(flag, name, "a different name for each link")
        links[name] = up, down

    for text in given:
        name, equals, words = (part.strip() for part in text.partition("="))
        if equals and name:
            up, bar, down = (part.strip() for part in words.partition("|"))
            add("--link", name, up, down if bar else up)
        elif (profile := ALIASES.get(name, name)) in PRESETS and not equals:
            add("--link", name, profile, profile)
        else:
            allowed = f"{', '.join(PRESETS)}, or NAME=WORDS such as 'slow=delay 80ms loss 1%'"
            raise InvalidParameter("--link", text, allowed, (*PRESETS, *ALIASES))
    for text in traces:
        name, _, path = text.rpartition("=")
        up, down = (f"trace {format_path(f'{path}.{direction}')}" for direction in ("up", "down"))
        add("--trace", name or Path(path).name, up, down)
    return links


def drawn_case(plan: Plan, text: str | None) -> ComparedRun:
    """The case that ``LINK[,OPERATOR[,SEED]]`` names, with the first variant."""
    from hapnet.assembly.links import link_profile

    def delay_ns(link: str) -> int:
        return sum(link_profile("--link", words).delay_ns for words in plan.links[link])

    link, operator, seed = max(plan.links, key=delay_ns), plan.operators[-1], str(plan.seeds[0])
    given = [word.strip() for word in (text or "").split(",")]
    link, operator, seed = (word or default for word, default in zip([*given, "", ""], (link, operator, seed),
                                                                     strict=False))  # fmt: skip
    numbers = {str(number): number for number in plan.seeds}
    if len(given) > 3 or link not in plan.links or operator not in plan.operators or seed not in numbers:
        allowed = f"{'|'.join(plan.links)}[,{'|'.join(plan.operators)}[,{'|'.join(numbers)}]]"
        raise InvalidParameter("--case", text, allowed)
    return plan.case(plan.variants[0], link, operator, numbers[seed])
