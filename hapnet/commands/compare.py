"""`hapnet compare`: every coupling over the same links, with the same hands and seeds: tables, JSON and figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import complete, output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import COUPLING_NAMES, Params
from netem.presets import PRESETS
from netem.units import format_path

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.study.compare import Case, Group, Outcome, Plan
    from hapnet.study.journal import Journal

LINKS = {"ideal": "ideal", "lan": "lan", "4g": "4g", "intercontinental": "wan-intercontinental"}
"""The default links, each with its profile; `--link` takes these names too."""

OPERATORS = ("press", "sine", "press@light", "sine@light")

BASE = Params().set({"device.servo": "sampled", "operator_hand.end_hold_s": 3.0})
"""All cases have the sampled servo of real hardware, at 1 kHz. The hand holds still at the end, which shows a swing."""

NOTICED = 0.1
"""The first coupling is also tried with this Weber fraction: people notice about a tenth."""

_OWN = {
    "coupling": "--coupling",
    "operator": "--operator",
    "link.up": "--link",
    "link.down": "--link",
    "wire.deadband": "--deadband",
}
"""Parameters that a comparison varies, and their flags."""

_LINKS = "What is compared"


@dataclass(frozen=True)
class CompareOptions:
    """What is compared, and what is shown."""

    coupling: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:PARAM=VALUE...]",
            help="A coupling to compare, parameters of its own after colons; repeat it, or separate by commas: "
            "pspm,pspm:feel=paper,zoh. Default: all.",
            rich_help_panel=_LINKS,
            autocompletion=complete.words(*COUPLING_NAMES),
        ),
    ] = None
    link: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=WORDS[|WORDS]]",
            help="A profile, or a name and tc-netem's words (up|down if they differ); may be repeated. "
            f"Default: {', '.join(LINKS)}.",
            rich_help_panel=_LINKS,
            autocompletion=complete.profiles,
        ),
    ] = None
    trace: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]PATH",
            help="A further link: the delivery opportunities (mahimahi's format) in PATH.up and PATH.down.",
            rich_help_panel=_LINKS,
        ),
    ] = None
    operator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[@light]",
            help="rest, sine, press, hand-N (generated) or a recording's path; may be repeated. @light: relaxed. "
            f"Default: {', '.join(OPERATORS)}.",
            rich_help_panel=_LINKS,
            autocompletion=complete.operators,
        ),
    ] = None
    seeds: Annotated[str, typer.Option(metavar="A:B", help="Seeds from A to B - 1.", rich_help_panel=_LINKS)] = "0:3"
    deadband: Annotated[
        str | None,
        typer.Option(
            metavar="W[,W]",
            help="Perceptual deadbands, as Weber fractions; each coupling is tried with each. 0: none.",
            rich_help_panel=_LINKS,
            show_default="0, and the first coupling with 0.1 too",
        ),
    ] = None
    workers: Annotated[int, typer.Option(min=0, help="Number of processes; 0: one per core.")] = 0
    case: Annotated[
        str | None,
        typer.Option(
            metavar="LINK[,OPERATOR[,SEED]]",
            help="Draw the traces of this case.",
            show_default="the slowest link, the last operator, the first seed",
        ),
    ] = None
    files: Annotated[
        bool,
        typer.Option(
            "--files/--no-files", help="Write compare.json, compare.csv (medians and quartiles), figures and a journal."
        ),
    ] = True
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard an earlier comparison in --out, and start again.")] = (
        False
    )
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be compared, estimate the time by a few cases, and end.")
    ] = False
    metrics: Annotated[bool, typer.Option("--metrics", help="Print what each metric means and end.")] = False


def main(params: Params, given: CompareOptions, json_to: str | None, out: Path | None) -> int:
    """Compare, and show the result. Returns 0 even if cases failed (the tables show them), 4 if a claim was broken."""
    from hapnet.study import tables
    from hapnet.study.journal import Journal

    words = output.console(json_to)
    if given.metrics:
        words.print(tables.definitions())
        return 0
    plan = plan_of(params, given)
    drawn = drawn_case(plan, given.case)
    spec = plan.spec
    if given.dry_run:
        _show(words, plan, given.workers)
        return 0
    with ExitStack() as stack:
        if given.files:
            directory = output.run_directory(out, "compare")
        else:
            directory = Path(stack.enter_context(TemporaryDirectory(prefix="hapnet-compare-")))
        journal = Journal.create_or_resume(directory, spec, spec.cases(), fresh=given.fresh)
        stack.callback(journal.close)
        return _compare(words, plan, drawn, journal, directory, given, json_to)


def _compare(
    words: Console,
    plan: Plan,
    drawn: Case,
    journal: Journal,
    directory: Path,
    given: CompareOptions,
    json_to: str | None,
) -> int:
    from hapnet.commands.studies import run_missing
    from hapnet.simulation.processes import usable_cores
    from hapnet.study import compare, tables, tunings
    from hapnet.study.backend import local_workers
    from hapnet.study.case import kept

    journal.forget_failed()
    workers = given.workers or usable_cores()
    ran = run_missing(words, journal, "comparing", lambda cases: local_workers(min(workers, cases)))
    if ran.stopped is not None:
        return ran.stop(f"with --out {directory} the same command goes on" if given.files else "nothing is kept")
    outcomes = plan.outcomes(journal.rows())
    if all(one.error is not None for one in outcomes):
        raise InvalidParameter("--coupling", list(plan.couplings), f"cases that run; none did: {outcomes[0].error}")
    found = compare.groups(plan, outcomes)
    whole = tables.as_dict(plan, outcomes, found)
    whole["wall_clock"] = {"cases": len(outcomes), "seconds": ran.lasted_s, "workers": workers}
    written = output.Written()
    there = []
    if given.files:
        with Progress(output.progress_console(), "drawing"):
            there = _write(directory, plan, drawn, outcomes, found, whole, written)
    for table in tables.tables(plan, found, words.width):
        words.print(table, soft_wrap=False)
    words.print(tables.note(plan), markup=False, soft_wrap=False)
    if (chosen := tunings.table(plan)).row_count:
        words.print(chosen, soft_wrap=False)
    for line in tables.failures(outcomes):
        words.print(line, style="red", markup=False)
    before = f", {ran.before} of them before" if ran.before else ""
    words.print(f"{len(outcomes)} cases{before}, in {ran.lasted_s:.0f} s")
    if there:
        words.print(f"{', '.join(there)} in {directory}", markup=False)
    for one in outcomes:
        if one.measures is not None and not kept(one.measures):
            written.broken.append(f"{one.case}: the coupling claims to be passive, and was not")
    with written.part():
        output.write_json(whole, json_to)
    return written.code()


def _show(words: Console, plan: Plan, workers: int) -> None:
    """Say what would be compared, and how long it takes."""
    from hapnet.commands.studies import check_cases, estimate_cases

    cases = plan.spec.cases()
    parts = [(plan.variants, "coupling"), (plan.links, "link"), (plan.operators, "operator"), (plan.seeds, "seed")]
    told = [f"{len(values)} {name}{'s' * (len(values) != 1)}" for values, name in parts]
    words.print(f"{len(cases)} cases: {', '.join(told)}")
    for values, name in parts:
        words.print(f"  {name}: {'; '.join(map(str, values))}", markup=False)
    can_run = check_cases(words, plan.spec, cases)
    estimate_cases(words, plan.spec.fixed, can_run, len(can_run), workers)


def _write(
    directory: Path,
    plan: Plan,
    drawn: Case,
    outcomes: Sequence[Outcome],
    found: Sequence[Group],
    whole: dict[str, Any],
    written: output.Written,
) -> list[str]:
    """Write compare.json, compare.csv and the figures; returns what was written, in words."""
    from hapnet.report.files import save_figure
    from hapnet.study import figures, tables

    there = []
    with written.part():
        output.write_json(whole, str(directory / "compare.json"))
        there.append("compare.json")
    with written.part():
        output.write_csv(tables.as_rows(found), directory / "compare.csv")
        there.append("compare.csv")
    same = _same(drawn, outcomes)
    if same:
        with written.part():
            save_figure(figures.traces(plan, same), directory / "traces.png")
            there.append(f"traces.png ({drawn.operator} over {drawn.link}, seed {drawn.seed})")
    with written.part():
        save_figure(figures.tradeoff(plan, outcomes), directory / "tradeoff.png")
        there.append("tradeoff.png")
    return there


def plan_of(params: Params, given: CompareOptions) -> Plan:
    """The plan that the flags describe; each of its links and operators is checked once.

    Raises
    ------
    InvalidParameter, netem.NetemError : in one line, what is wrong and what is allowed.
    """
    from hapnet.commands.batch import seed_range
    from hapnet.couplings.registry import coupling
    from hapnet.simulation.simulation import Simulation
    from hapnet.study.compare import Plan, Variant, parted

    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    for name, flag in _OWN.items():
        if params.get(name) != BASE.get(name):
            raise InvalidParameter(name, params.get(name), f"its default: in a comparison {flag} sets it")
    chosen = names_of(given.coupling)
    for words in chosen:
        name, own = parted(words)
        coupling(name)
        for parameter in params.typed(own):
            if parameter in _OWN:
                raise InvalidParameter("--coupling", words, f"other parameters: {_OWN[parameter]} sets {parameter}")
    plan = Plan(
        params,
        tuple(dict.fromkeys(chosen or COUPLING_NAMES)),
        links_of(given.link, given.trace or ()),
        tuple(dict.fromkeys(given.operator or OPERATORS)),
        tuple(seed_range(given.seeds)),
        (0.0,) if given.deadband is None else tuple(dict.fromkeys(deadbands(given.deadband))),
        (Variant((chosen or COUPLING_NAMES)[0], NOTICED),) if given.deadband is None else (),
    )
    first = plan.cases()[0]
    for link in plan.links:
        Simulation(plan.case(first.variant, link, first.operator, first.seed).params, first.seed)
    for operator in plan.operators:
        Simulation(plan.case(first.variant, first.link, operator, first.seed).params, first.seed)
    return plan


def names_of(given: Sequence[str] | None) -> list[str]:
    """The names given by a flag that may be repeated, and may name several with commas between them."""
    return [name.strip() for names in given or () for name in names.split(",")]


def links_of(given: Sequence[str] | None, traces: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Links by name, each with its words for the uplink and for the downlink."""
    links: dict[str, tuple[str, str]] = {}

    def add(flag: str, name: str, up: str, down: str) -> None:
        if name in links:
            raise InvalidParameter(flag, name, "a different name for each link")
        links[name] = up, down

    for text in LINKS if given is None else given:
        name, equals, words = (part.strip() for part in text.partition("="))
        if equals and name:
            up, bar, down = (part.strip() for part in words.partition("|"))
            add("--link", name, up, down if bar else up)
        elif (profile := LINKS.get(name, name)) in PRESETS and not equals:
            add("--link", name, profile, profile)
        else:
            allowed = f"{', '.join(dict.fromkeys((*LINKS, *PRESETS)))}, or NAME=WORDS such as 'slow=delay 80ms loss 1%'"
            raise InvalidParameter("--link", text, allowed)
    for text in traces:
        name, _, path = text.rpartition("=")
        up, down = (f"trace {format_path(f'{path}.{way}')}" for way in ("up", "down"))
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


def _same(case: Case, outcomes: Iterable[Outcome]) -> list[Case]:
    """This case with every variant for which it did not fail."""
    wanted = (case.link, case.operator, case.seed)
    return [one.case for one in outcomes
            if one.error is None and (one.case.link, one.case.operator, one.case.seed) == wanted]  # fmt: skip
