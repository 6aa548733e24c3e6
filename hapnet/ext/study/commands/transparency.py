"""`hapnet transparency`: measures the impedance that couplings transmit, and the stiffest stable wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.checks import one_of
from hapnet.commands import complete, flags, output
from hapnet.commands.options import ModelOptions, ParamsOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.ext.study.commands import flags as own
from hapnet.laws import COUPLING_NAMES
from hapnet.params import Params, is_tool
from netem.groups import Without

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hapnet.ext.study.stable_stiffness import StiffnessCase
    from hapnet.ext.study.transparency import Curves, SearchTask
    from hapnet.ext.study.z_width import ZWidth

LINKS = ("lan", "4g")


@dataclass(frozen=True)
class TransparencyOptions:
    """Options for the measurements."""

    coupling: Annotated[
        list[str] | None,
        typer.Option(
            help="A coupling to measure; repeat it, or separate names by commas. Default: all.",
            autocompletion=complete.couplings,
        ),
    ] = None
    link: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=WORDS[|WORDS]]",
            help=f"A profile, or a name and tc-netem's syntax; may be repeated. Default: {', '.join(LINKS)}.",
            autocompletion=complete.profiles,
        ),
    ] = None
    seeds: Annotated[str, typer.Option(metavar="A:B", help="Seeds from A to B - 1.")] = "0:3"
    motion: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Motion of a tool: along-x, -y or -z, or about-x, -y or -z; repeat it, or separate names by commas. "
            "Default: along the axis into the first solid, and about the next axis.",
        ),
    ] = None
    z_width: Annotated[
        bool,
        typer.Option(
            "--z-width",
            help="Also find the stiffest wall without limit cycles, and the stiffest stable K of the device (slow).",
        ),
    ] = False
    workers: Annotated[int, typer.Option(min=0, help="Number of processes; 0: one per core.")] = 0
    dry_run: Annotated[bool, own.dry_run("Count the runs, estimate the time by a few of them, and end.")] = False


def transparency(
    *,
    options: TransparencyOptions,
    model: Annotated[
        ModelOptions,
        Without(
            "operator",
            "follower",
            "coupling",
            "deadband",
            "servo",
            "servo_hz",
            "on_silence",
            "silence_after",
            "duration",
        ),
    ],
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: Annotated[Path | None, flags.out_in("runs/<UTC time>-transparency")] = None,
) -> int:
    """Prints a table; writes a figure and all numbers as JSON. With --scene 'tool:box + plane' a tool is moved along an
    axis and turned about another: in N/m and Nm/rad, compared with the tool itself. --z-width adds the stiffest wall
    without limit cycles, and the stiffest stable spring of the device, over servo rates and own dampings, compared with
    Colgate's bound.
    """
    chosen = params.over(Params(), model.named())
    if params.show_params:
        return params.show(chosen)
    from hapnet.commands.batch import seed_range
    from hapnet.couplings.registry import coupling
    from hapnet.ext.pictures.impedance import transmitted
    from hapnet.ext.pictures.style import save_figure
    from hapnet.ext.study import stable_stiffness, transparency
    from hapnet.ext.study.commands.studies import names_of
    from hapnet.ext.study.impedance import Transmission, curve
    from hapnet.ext.study.plans import links_of
    from hapnet.ext.study.transparency import SearchTask
    from hapnet.processes.pool import dealt, usable_cores

    motions = _motions(options, chosen)
    # a tool moves on a spring in the world, which couplings by waves or velocities do not have
    usable = [name for name in COUPLING_NAMES if not any(motions) or "world" in coupling(name).set_positions]
    names = names_of(options.coupling) or usable
    for name in names:
        coupling(name)
    for name in ("coupling", "link.up", "link.down"):
        if name in chosen.given:
            why = f"here --{name.partition('.')[0]} sets it; leave it out"
            raise InvalidParameter(name, chosen.get(name), "", why=why)
    for name in ("operator", "duration_s"):
        if name in chosen.given:
            why = "the measured motion is always the same; leave it out"
            raise InvalidParameter(name, chosen.get(name), "", why=why)
    links, seeds = links_of(list(options.link or LINKS), ()), seed_range(options.seeds)
    tasks = [
        SearchTask(
            name, link, chosen.set({"coupling": name, "link.up": up, "link.down": down}), seed, hand, motion=motion
        )
        for name in dict.fromkeys(names)
        for link, (up, down) in links.items()
        for motion in motions
        for seed, hand in [*((seed, None) for seed in seeds), *((0, hand) for hand in _hands(options))]
    ]
    cases = stable_stiffness.cases(chosen) if options.z_width else []
    tasks += [SearchTask(case.coupling, "", chosen, 0, case=case) for case in cases]
    words = output.console(json_to)
    if options.dry_run:
        _show(words, tasks, options.workers)
        return 0
    workers = min(options.workers or usable_cores(), len(tasks))
    directory = output.run_directory(out, "transparency")
    with Progress(output.progress_console(words), "measuring", len(tasks), "runs") as bar:
        found = dealt(transparency.run, tasks, workers, lambda share: bar.update(share * len(tasks)))
        bar.stage("drawing")
        curves: Curves = {}
        widths: dict[tuple[str, str, str], ZWidth] = {}
        springs: dict[StiffnessCase, ZWidth] = {}
        for task, result in zip(tasks, found, strict=True):
            if task.case is not None:
                assert not isinstance(result, Transmission)
                springs[task.case] = result
            elif task.hand is not None:
                assert not isinstance(result, Transmission)
                widths[task.coupling, task.link, task.hand] = result
            elif (key := (task.coupling, task.link, task.motion)) not in curves:
                same = [
                    r
                    for t, r in zip(tasks, found, strict=True)
                    if (*t[:2], t.motion) == key and isinstance(r, Transmission)
                ]
                curves[key] = curve(same)
        for motion in motions:
            shown = {names[:2]: one for names, one in curves.items() if names[2] == motion}
            save_figure(transmitted(shown, motion), directory / _figure(motion))
        if springs:
            save_figure(stable_stiffness.drawn(springs, chosen), directory / "stable-stiffness.png")
    whole = transparency.as_dict(curves, widths)
    if springs:
        whole["stable_stiffness"] = stable_stiffness.as_dict(springs, chosen)
    output.write_json(whole, str(directory / "transparency.json"))
    words.print(_table(curves, widths))
    words.print(
        f"3 dB off: the lowest frequency, of 0.5 to 20 Hz, at which the transmitted impedance is 3 dB from the true "
        f"{'tool' if any(motions) else 'wall'}; median and quartiles over {len(seeds)} seeds. A device is moved by 2 mm"
        f"{', or turned by 2.9°,' if any(motions) else ''} about 10 mm inside the wall, "
        "or by less if its spring would saturate.",
        markup=False,
    )
    if springs:
        words.print(_springs(springs, chosen))
        words.print(f"{stable_stiffness.JUDGED}. {_HELD}", markup=False)
    figures = (*map(_figure, motions), "stable-stiffness.png", "transparency.json")
    output.show_files(words, figures, directory)
    output.write_json(whole, json_to)
    return 0


def _show(console: Console, tasks: Sequence[SearchTask], workers: int) -> None:
    """Print the number of runs, and how long they take."""
    from hapnet.ext.study import transparency
    from hapnet.ext.study.commands.studies import PartKind, estimate

    runs = [task for task in tasks if task.hand is None and task.case is None]
    walls = [task for task in tasks if task.hand is not None]
    springs = [task for task in tasks if task.case is not None]
    more = f", {len(walls)} searches for the stiffest wall" if walls else ""
    pairs = len({task[:2] for task in runs})
    console.print(f"{len(runs)} runs{more}: {pairs} pair{'s' * (pairs > 1)} of a coupling and a link")
    if springs:
        console.print(f"{len(springs)} searches for the stiffest stable spring of the device")
    named = [("run", runs), ("search of a wall", walls), ("search of a spring", springs)]
    kinds = [PartKind(name, some, len(some)) for name, some in named if some]
    estimate(console, transparency.run_one, kinds, workers)


def _motions(given: TransparencyOptions, params: Params) -> tuple[str, ...]:
    """The motions of a tool; "" alone: into a wall. Raises InvalidParameter: the flags do not fit the scene."""
    from hapnet.ext.study.commands.studies import names_of

    named = tuple(names_of(given.motion))
    if not is_tool(params.scene):
        if named:
            raise InvalidParameter("--motion", named[0], "", why="only a tool has it, as in --scene tool:box")
        return ("",)
    from hapnet.ext.study.tool_impedance import MOTIONS, motions

    if given.z_width:
        raise InvalidParameter("--z-width", f"with {params.scene}", "", why="it needs a scene with a wall, not a tool")
    for name in named:
        one_of("--motion", name, MOTIONS)
    return tuple(dict.fromkeys(named)) or motions(params)


def _figure(motion: str) -> str:
    return f"transparency{'-' * bool(motion)}{motion}.png"


def _hands(given: TransparencyOptions) -> tuple[str, ...]:
    from hapnet.ext.study.transparency import HANDS

    return tuple(HANDS) if given.z_width else ()


def _table(curves: Curves, widths: dict[tuple[str, str, str], ZWidth]) -> Table:
    from rich.table import Table

    hands = list(dict.fromkeys(hand for *_, hand in widths))
    tool = any(motion for *_, motion in curves)
    table = Table("coupling", "link", "3 dB off [Hz]", *(f"stiffest wall, {hand} [N/m]" for hand in hands))
    if tool:
        table = Table("coupling", "link", "motion", "at 0.5 Hz", "true", "3 dB off [Hz]")
    for (coupling, link, motion), found in curves.items():
        off, unit = found.off_3dB_hz, "Nm/rad" if found.turns else "N/m"
        cells = [_width(widths[coupling, link, hand]) for hand in hands]
        spread = "" if off.q1 == off.q3 else f" ({_hz(off.q1)} to {_hz(off.q3)})"
        first = [motion, *(f"{z:.3g} {unit}" for z in (found.stiffness[0].median, found.truth[0].real))] if tool else []
        table.add_row(coupling, link, *first, f"{_hz(off.median)}{spread}", *cells)
    return table


_HELD = (
    "The hand that presses is only a spring; a hand's own damping would add to the device's. The bound: with "
    "K < 2 (b - B)/T the device is passive, so that no hand makes it oscillate; B is device.damping."
)


def _springs(found: dict[StiffnessCase, ZWidth], params: Params) -> Table:
    from rich.table import Table

    from hapnet.ext.study.stable_stiffness import bound

    columns = list(dict.fromkeys(case.column for case in found))
    rows: dict[tuple[float, float], dict[str, str]] = {}
    for case, width in found.items():
        rows.setdefault((case.servo_hz, case.own_damping), {})[case.column] = _width(width)
    table = Table("servo [Hz]", "own damping [Ns/m]", "bound [N/m]", *(f"stable K, {name} [N/m]" for name in columns))
    for (hz, b), cells in rows.items():
        limit = bound(b, hz, params.device.damping)
        table.add_row(
            f"{hz:g}", f"{b:g}", f"{limit:.0f}" if limit else "none", *(cells.get(name, "-") for name in columns)
        )
    return table


def _hz(value: float) -> str:
    return "above 20" if value == inf else f"{value:g}"


def _width(found: ZWidth) -> str:
    if found.free is None:
        return f"below {found.cycles:.0f}"
    return f"{found.free:.0f}" if found.cycles is not None else f"above {found.free:.0f}"
