"""What `hapnet compare` compares, from its flags: a plan, or one for each section of the full set."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.study.sections import FULL, QUICK, Section
from netem.presets import ALIASES, PRESETS
from netem.units import format_path

if TYPE_CHECKING:
    from hapnet.commands.compare import CompareOptions
    from hapnet.study.compare import Case, Plan

BASE = Params().set({"device.servo": "sampled", "operator_hand.end_hold_s": 3.0})
"""All cases have the sampled servo of real hardware, at 1 kHz. The hand holds still at the end, which shows a swing."""

NOTICED = 0.1
"""The first coupling of the quick set is also tried with this Weber fraction: people notice about a tenth."""

_OWN = {
    "coupling": "--coupling",
    "operator": "--operator",
    "link.up": "--link",
    "link.down": "--link",
    "wire.deadband": "--deadband",
}
"""Parameters that a comparison varies, and their flags."""


def plans_of(params: Params, given: CompareOptions) -> dict[str, Plan]:
    """The plans that the flags describe, by their sections' names; that of the quick set has none.

    What a flag or a parameter says counts for all sections, in place of what they have by themselves.

    Raises
    ------
    InvalidParameter, netem.NetemError : in one line, what is wrong and what is allowed.
    """
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    for name, flag in _OWN.items():
        if params.get(name) != BASE.get(name):
            raise InvalidParameter(name, params.get(name), f"its default: in a comparison {flag} sets it")
    names = [name.strip() for name in given.bench.split(",")]
    if names == ["quick"]:
        return {"": _plan(params, given, QUICK, noticed=not given.coupling and given.deadband is None)}
    names = list(FULL) if names == ["full"] else names
    for name in names:
        if name not in FULL:
            allowed = f"quick, full, or of its sections {', '.join(FULL)}"
            raise InvalidParameter("--bench", name, allowed, ("quick", "full", *FULL))
    if given.case is not None and len(names) > 1:
        raise InvalidParameter("--case", given.case, "one comparison: --bench quick, or one section")
    return {name: _plan(params, given, FULL[name]) for name in dict.fromkeys(names)}


def _plan(params: Params, given: CompareOptions, section: Section, *, noticed: bool = False) -> Plan:
    """One plan; each of its links and operators is checked once. `noticed`: with a deadband, too."""
    from hapnet.commands.batch import seed_range
    from hapnet.simulation.simulation import Simulation
    from hapnet.study.compare import Plan, Variant

    own = {name: value for name, value in section.changes.items() if params.get(name) == BASE.get(name)}
    couplings = tuple(dict.fromkeys(names_of(given.coupling) or section.couplings))
    plan = Plan(
        params.set(own),
        couplings,
        links_of(given.link or section.links, given.trace or ()),
        tuple(dict.fromkeys(given.operator or section.operators)),
        tuple(seed_range(given.seeds or section.seeds)),
        (0.0,) if given.deadband is None else tuple(dict.fromkeys(deadbands(given.deadband))),
        (Variant(couplings[0], NOTICED),) if noticed else (),
    )
    _check_words(plan)
    first = plan.cases()[0]
    for link in plan.links:
        Simulation(plan.case(first.variant, link, first.operator, first.seed).params, first.seed)
    for operator in plan.operators:
        Simulation(plan.case(first.variant, first.link, operator, first.seed).params, first.seed)
    return plan


def _check_words(plan: Plan) -> None:
    """Raises InvalidParameter where a coupling's or an operator's words set what they may not."""
    from hapnet.couplings.registry import coupling
    from hapnet.study.compare import hand, parted

    taken: dict[str, str] = dict(_OWN)
    for flag, words, parts in (
        ("--coupling", plan.couplings, parted),
        ("--operator", plan.operators, hand),
    ):
        found: dict[str, str] = {}
        for word in words:
            name, own = parts(word)
            if flag == "--coupling":
                coupling(name)
            for parameter in plan.params.typed(own):
                if parameter in taken:
                    raise InvalidParameter(flag, word, f"other parameters: {taken[parameter]} sets {parameter}")
                found[parameter] = flag
        taken |= found


def names_of(given: Sequence[str] | None) -> list[str]:
    """The names given by a flag that may be repeated, and may name several with commas between them."""
    return [name.strip() for names in given or () for name in names.split(",")]


def links_of(given: Sequence[str], traces: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Links by name, each with its words for the uplink and for the downlink."""
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


def deadbands(text: str) -> list[float]:
    """The Weber fractions of ``0,0.1``."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0.0 <= fraction <= 1.0 for fraction in found):
        raise InvalidParameter("--deadband", text, "Weber fractions from 0 (none) to 1, such as 0,0.1")
    return found


def drawn_case(plan: Plan, text: str | None) -> Case:
    """The case that ``LINK[,OPERATOR[,SEED]]`` names, with the first variant."""
    from hapnet.assembly.build import link_profile

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
