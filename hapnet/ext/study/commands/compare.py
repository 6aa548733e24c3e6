"""`hapnet compare`: compares couplings over the same links, hands and seeds, in tables, JSON and figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import complete, flags, output
from hapnet.commands.options import ModelOptions, ParamsOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.ext.study.commands import flags as own
from hapnet.ext.study.sections import FULL, QUICK
from hapnet.installing import require
from hapnet.params import Params
from netem.command_help import MORE
from netem.groups import Without

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.ext.study.compare import ComparedRun, Plan, RunMeasures
    from hapnet.ext.study.comparison import Comparison
    from hapnet.ext.study.spec import Case as SpecCase

_LINKS = "What is compared"
_MORE = f"Options{MORE}"

PAGE = "compare.md"
"""The tables of a comparison as Markdown; the directory above the sections has the tables of all sections."""

_SHORT_S, _AT_ONCE_S = 5.0, 300.0
"""The longest run of a case for the estimate of its time, and the total simulated time without an estimate [s]."""


def _anchors() -> list[str]:
    """The names of the anchors, for TAB."""
    from hapnet.ext.study.anchors import ANCHORS

    return ["list", *ANCHORS]


@dataclass(frozen=True)
class CompareOptions:
    """Options for the choice of what to compare and what to show."""

    bench: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="quick, full, or sections of full."
            f"\n\nquick: {QUICK.about}. full: {', '.join(FULL)}; or some of these sections. Couplings, links, "
            "operators, seeds and parameters that you give apply to all of them.",
            rich_help_panel=_LINKS,
            autocompletion=complete.words("quick", "full", *FULL),
        ),
    ] = "quick"
    coupling: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Couplings, such as pspm,zoh; by default all."
            "\n\nParameters of its own after colons; repeat it, or separate by commas: pspm,pspm:rendering=paper,zoh. "
            "Default of --bench full: see --dry-run.",
            rich_help_panel=_LINKS,
            autocompletion=complete.couplings,
        ),
    ] = None
    link: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=TEXT]",
            help="A profile, or a name and tc-netem's syntax; may be repeated."
            "\n\nTEXT is up|down if they differ. "
            f"Default: {', '.join(QUICK.links)}.",
            rich_help_panel=_LINKS,
            autocompletion=complete.profiles,
        ),
    ] = None
    trace: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]PATH",
            help="A further link: the delivery opportunities (mahimahi's format) in PATH.up and PATH.down.",
            rich_help_panel=_LINKS + MORE,
        ),
    ] = None
    operator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Operators: rest, sine, press, hand-1, recordings."
            "\n\nMay be repeated. NAME@light: relaxed. hand-N, strokes-N and writing-N are generated. "
            f"Parameters of its own after colons. Default: {QUICK.operators[0]}; without any list, all of "
            f"{', '.join(QUICK.operators)}.",
            rich_help_panel=_LINKS,
            autocompletion=complete.operators,
        ),
    ] = None
    seeds: Annotated[
        str | None,
        typer.Option(metavar="A:B", help="Seeds from A to B - 1.", rich_help_panel=_LINKS, show_default="0:1"),
    ] = None
    deadband: Annotated[
        str | None,
        typer.Option(
            metavar="W[,W]",
            help="Perceptual deadbands, as Weber fractions, each tried with each coupling. 0: none.",
            rich_help_panel=_LINKS + MORE,
            show_default="0; without any list the first coupling with 0.1 too",
        ),
    ] = None
    workers: Annotated[int, typer.Option(metavar="N", min=0, help="Number of processes; 0: one per core.")] = 0
    case: Annotated[
        str | None,
        typer.Option(
            metavar="LINK[,OPERATOR[,SEED]]",
            help="Draw the traces of this case.",
            rich_help_panel=_MORE,
            show_default="the slowest link, the last operator, the first seed",
        ),
    ] = None
    files: Annotated[
        bool,
        typer.Option(
            "--files/--no-files",
            help="Write output files, or none."
            "\n\nThey are compare.json, compare.csv (medians and intervals), compare.md, figures and a journal.",
        ),
    ] = True
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard an earlier comparison in --out, and start again.")] = (
        False
    )
    anchor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Run a published setting instead; list: all of them."
            "\n\nPrints the published figures, ours, and why they differ.",
            rich_help_panel=_LINKS,
            autocompletion=_anchors,
        ),
    ] = None
    dry_run: Annotated[bool, own.dry_run("List the cases, estimate the time by a few of them, and end.")] = False
    metrics: Annotated[bool, typer.Option("--metrics", help="Print the definition of each metric and end.")] = False


def compare(
    *,
    options: CompareOptions,
    model: Annotated[
        ModelOptions,
        Without("operator", "coupling", "deadband", "servo", "servo_hz", "on_silence", "silence_after"),
    ],
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: Annotated[Path | None, flags.out_in("runs/<UTC time>-compare")] = None,
) -> int:
    """Prints first how many cases there are. `hapnet compare` alone runs a default set; if you give couplings, links,
    operators, seeds or deadbands, it runs only these. Prints a table for each link. Writes all cases as JSON, the
    traces of one case and a figure of all cases.
    """
    from hapnet.ext.study.plans import BASE, drawn_case

    chosen = params.over(BASE, model.named())
    if params.show_params:
        return params.show(chosen)
    from hapnet.ext.pictures.style import save
    from hapnet.ext.study import tables

    console = output.console(json_to)
    if options.metrics:
        console.print(tables.definitions())
        return 0
    if options.anchor is not None:
        from hapnet.ext.study.commands import anchors

        return anchors.show(console, options, chosen, json_to)
    plans = _plans(chosen, options)
    drawn = {name: drawn_case(plan, options.case) for name, plan in plans.items()}
    if not options.dry_run:
        require("report", "hapnet compare")
    _announce(console, plans, options)
    if options.dry_run:
        return 0
    written = output.Written()
    whole: dict[str, dict[str, Any]] = {}
    with ExitStack() as stack:
        if options.files:
            directory = output.run_directory(out, "compare")
        else:
            directory = Path(stack.enter_context(TemporaryDirectory(prefix="hapnet-compare-")))
        for name, plan in plans.items():
            title = f"{name}: {FULL[name].about}" if name else QUICK.about
            if name:
                console.print(f"\n{title}", style="bold", markup=False)
            its = output.run_directory(directory / name, None)
            code = _compare(console, plan, drawn[name], its, title, options, written, whole.setdefault(name, {}))
            if code:
                return code
        pages = [file for name in plans if name and (file := directory / name / PAGE).exists()]
        if pages:
            with written.part():
                save("\n".join(file.read_text("utf-8") for file in pages).encode(), directory / PAGE, "the tables")
    with written.part():
        output.write_json(whole.get("", {"sections": whole}), json_to)
    return written.code()


def _compare(
    console: Console,
    plan: Plan,
    drawn: ComparedRun,
    directory: Path,
    title: str,
    given: CompareOptions,
    written: output.Written,
    whole: dict[str, Any],
) -> int:
    """Run a plan, show the result and add it to `whole`. Returns the exit code if the run was stopped, else 0."""
    from hapnet.ext.study import tables, tunings
    from hapnet.ext.study.backend import local_workers
    from hapnet.ext.study.commands import studies
    from hapnet.ext.study.comparison import Comparison
    from hapnet.ext.study.run import journal_in
    from hapnet.processes.pool import usable_cores

    spec = plan.spec
    workers = given.workers or usable_cores()
    with journal_in(directory, spec, spec.cases(), fresh=given.fresh) as journal:
        ran = studies.run_missing(console, journal, "comparing", lambda cases: local_workers(min(workers, cases)))
        if ran.stopped is not None:
            top = directory if given.bench == "quick" else directory.parent
            again = f"with --out {top} the same command continues" if given.files else "no results are kept"
            return studies.stop(ran, again)
        found = Comparison.of(plan, journal)
    whole |= found.as_dict()
    whole["wall_clock"] = {"cases": len(found), "seconds": ran.lasted_s, "workers": workers}
    names = []
    if given.files:
        with Progress(output.progress_console(console), "drawing"):
            names = _write(directory, title, found, drawn, whole, written)
    for table in tables.tables(plan, found.groups, console.width):
        console.print(table, soft_wrap=False)
    for line in found.headline:
        console.print(line, style="bold", markup=False, soft_wrap=False)
    console.print(tables.note(plan), markup=False, soft_wrap=False)
    if (chosen := tunings.table(plan)).row_count:
        console.print(chosen, soft_wrap=False)
    for line in tables.failures(found.outcomes):
        console.print(line, style="red", markup=False)
    before = f", {ran.before} of them from an earlier run" if ran.before else ""
    console.print(f"{len(found)} cases{before}, in {ran.lasted_s:.0f} s")
    if names:
        console.print(f"{', '.join(names)} in {directory}", markup=False)
    written.broken += [f"{case}: the coupling claims to be passive, and was not" for case in found.broken]
    return 0


def _plans(params: Params, given: CompareOptions) -> dict[str, Plan]:
    """The plans that the flags describe, by their sections' names."""
    from hapnet.commands.batch import seed_range
    from hapnet.ext.study.commands.studies import deadbands, names_of
    from hapnet.ext.study.plans import plans

    found = plans(
        params,
        bench=given.bench,
        couplings=names_of(given.coupling) or None,
        links=given.link,
        traces=given.trace or (),
        operators=given.operator,
        seeds=None if given.seeds is None else seed_range(given.seeds),
        deadbands=None if given.deadband is None else deadbands(given.deadband),
    )
    if given.case is not None and len(found) > 1:
        raise InvalidParameter("--case", given.case, "", why="it needs one comparison: --bench quick, or one section")
    return found


def _announce(console: Console, plans: Mapping[str, Plan], given: CompareOptions) -> None:
    """Print how many cases there are and, unless they take only seconds, how long they take."""
    from hapnet.ext.study.commands.studies import check_cases

    cases = {name: plan.spec.cases() for name, plan in plans.items()}
    for name, plan in plans.items():
        parts = [(plan.variants, "coupling"), (plan.links, "link"), (plan.operators, "operator"), (plan.seeds, "seed")]
        counts = [f"{len(values)} {part}{'s' * (len(values) != 1)}" for values, part in parts]
        counts += [f"and {len(plan.operators) * len(plan.seeds)} of the local wall"] if plan.local else []
        console.print(f"{name}{': ' * bool(name)}{len(cases[name])} cases: {', '.join(counts)}", markup=False)
        if given.dry_run:
            for values, part in parts:
                console.print(f"  {part}: {'; '.join(map(str, values))}", markup=False)
            cases[name] = check_cases(console, plan.spec, cases[name])
    simulated_s = sum(len(cases[name]) * plan.params.duration_s for name, plan in plans.items())
    if given.dry_run or simulated_s > _AT_ONCE_S:
        _report_time(console, plans, cases, given.workers)


def _report_time(
    console: Console, plans: Mapping[str, Plan], cases: Mapping[str, Sequence[SpecCase]], workers: int
) -> None:
    """Print how long these cases take, by the first seconds of a few of each plan."""
    from hapnet.ext.study.commands.studies import PartKind, estimate
    from hapnet.ext.study.spec import params_of
    from hapnet.ext.study.task import run_case

    kinds: list[PartKind[tuple[Plan, SpecCase]]] = []
    failed: list[str] = []

    def params(part: tuple[Plan, SpecCase]) -> Params:
        return params_of(part[0].spec.fixed, part[1].given)

    def run(part: tuple[Plan, SpecCase]) -> None:
        plan, case = part
        short = replace(case, values={**case.values, "duration_s": min(_SHORT_S, params(part).duration_s)})
        if (error := run_case(plan.spec.fixed, short).error) is not None:
            failed.append(error)

    for name, plan in plans.items():
        parts = [(plan, case) for case in cases[name]]
        longer = max(1.0, plan.params.duration_s / _SHORT_S)
        shared = (len(plan.links) + 1) / (2 * len(plan.links))  # one reference run for all links, not one for each
        kinds.append(PartKind(f"case{' of ' * bool(name)}{name}", parts, len(parts), longer * shared))
    estimate(console, run, kinds, workers)
    if failed:
        output.show_warnings(console, (f"the estimate may be wrong, as cases failed; the first: {failed[0]}",))


def _write(
    directory: Path, title: str, found: Comparison, drawn: ComparedRun, whole: dict[str, Any], written: output.Written
) -> list[str]:
    """Write compare.json, compare.csv, compare.md and the figures; returns a description of each written file."""
    from hapnet.ext.pictures.style import save, save_figure
    from hapnet.ext.study import figures, markdown

    there = []
    with written.part():
        output.write_json(whole, str(directory / "compare.json"))
        there.append("compare.json")
    with written.part():
        output.write_csv(found.medians(), directory / "compare.csv")
        there.append("compare.csv")
    with written.part():
        save(markdown.page(found.plan, found.groups, title).encode(), directory / PAGE, "the tables")
        there.append(PAGE)
    same = _same(drawn, found.outcomes)
    if same:
        with written.part():
            save_figure(figures.traces(found.plan, same), directory / "traces.png")
            there.append(f"traces.png ({drawn.operator} over {drawn.link}, seed {drawn.seed})")
    with written.part():
        save_figure(found.plot(), directory / "tradeoff.png")
        there.append("tradeoff.png")
    return there


def _same(case: ComparedRun, outcomes: Iterable[RunMeasures]) -> list[ComparedRun]:
    """This case with every variant for which it did not fail."""
    from hapnet.ext.study.compare import LOCAL

    wanted = (case.link, case.operator, case.seed)
    runs = [one.case for one in outcomes if one.error is None and one.case.variant != LOCAL]
    return [one for one in runs if (one.link, one.operator, one.seed) == wanted]
