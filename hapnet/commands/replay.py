"""`hapnet replay`: repeats a recorded run in virtual time, unchanged or through another link or coupling."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import LinkOptions, ModelOptions, ParamsOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.loading import Permits, extension, permitting
from hapnet.params import Params
from hapnet.units import within
from netem.groups import Without

if TYPE_CHECKING:
    from rich.table import Table


def replay(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="One recording, or the device's and the world's.")
    ],
    *,
    model: Annotated[
        ModelOptions, Without("operator", "hardware", "servo", "servo_hz", "dof", "on_silence", "silence_after")
    ],
    seed: flags.ReplaySeed = None,
    links: LinkOptions,
    params: Annotated[ParamsOptions, Without("show_params", "schema")],
    trust: flags.Trust = False,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
) -> int:
    """Parameters and seed are taken from the recording, unless given here. Writes recording, figures and summary.
    A recording may name a module as its scene, coupling or operator: it is imported if you agree, or with --trust.
    """
    file = () if params.params_file is None else Params().load(params.params_file).flat().values()
    typed = [*model.named().values(), *(params.assign or ()), *file]
    with permitting(permits(" and ".join(map(str, files)), typed, trust=trust)):
        return _replay(files, model, seed, links, params, json_to, out, verbose=verbose)


def _replay(
    files: list[Path],
    model: ModelOptions,
    seed: int | None,
    links: LinkOptions,
    params: ParamsOptions,
    json_to: str | None,
    out: Path | None,
    *,
    verbose: bool,
) -> int:
    from dataclasses import replace as changed

    from hapnet.assembly.scenes import for_its_scene
    from hapnet.recording.mcap import save
    from hapnet.simulation.replay import compare, read_original
    from hapnet.simulation.simulation import Simulation

    original = read_original(files)
    base = original.params
    chosen = params.over(links.for_all_of(base), model.named(), links)
    base = for_its_scene(base.set({"scene": chosen.scene}, chosen.source("scene")))
    chosen = params.over(links.for_all_of(base), model.named(), links)
    if chosen.duration_s <= 0.0:
        raise InvalidParameter("duration_s", chosen.duration_s, "above 0 in virtual time")
    if chosen.operator != original.params.operator:
        original = changed(original, hand=f"{chosen.operator}, as asked")
    seed = original.seed if seed is None else seed
    simulation = Simulation(chosen, seed)
    words = output.console(json_to)
    directory = output.run_directory(out, seed)
    target = directory / "run.mcap"
    if any(target.resolve() == file.resolve() for file in files):
        raise InvalidParameter("--out", str(directory), "a directory other than the recording's, which must not change")
    output.show_warnings(words, simulation.setup.warnings)
    if verbose:
        words.print(f"hand: {original.hand}", markup=False)
    for line in original.notes:
        words.print(f"note: {line}", markup=False)
    with Progress(output.progress_console(words), "replaying", chosen.duration_s) as progress:
        result = simulation.run(progress.update)
    summary = result.summary
    compared = summary["replay"] = compare(original, result.recording, summary)
    recording = changed(result.recording, summary=summary)
    written, pictures = output.Written(), extension("pictures")
    written.missing += original.incomplete
    with written.part():
        save(recording, target)
    with written.part():
        pictures.save_figure(pictures.figure(recording), directory / "figure.png")
    with written.part():
        pictures.save_figure(pictures.replay_figure(original.recording, recording), directory / "replay.png")
    with written.part():
        output.write_json(summary, str(directory / "summary.json"))
    output.show_verdict(words, summary, verbose=verbose)
    difference = verdict(compared, summary["units"])
    if verbose:
        words.print(table(compared, summary["units"]))
        words.print(difference)
        output.show_files(words, (target.name, "figure.png", "replay.png", "summary.json"), directory)
    else:
        fact = f"{difference[0].upper()}{difference[1:]}."
        output.show_fact(words, summary, output.more_in(directory, target.name, "hapnet report "), fact)
    written.judge(summary, chosen, virtual=True)
    with written.part():
        output.write_json(summary, json_to)
    return written.code()


def table(compared: dict[str, Any], units: str | None = None) -> Table:
    """The table of original and replay side by side, for axes in `units`; "-" for an unknown value."""
    from rich import box
    from rich.table import Table

    result = Table("", "original", "replay", title="replay", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for label, of_metres, key, scale in (
        ("energy that came out, most", "mJ", "energy_out_J", 1e3),
        ("margin at the end", "mJ", "margin_end_J", 1e3),
        ("device's half, minimum margin", "mJ", "device_margin_J", 1e3),
        ("world's half, minimum margin", "mJ", "world_margin_J", 1e3),
        ("force, largest", "N", "peak_force_N", 1.0),
        ("position error, free (rms)", "mm", "free_rms_m", 1e3),
        ("position error, in contact (rms)", "mm", "contact_rms_m", 1e3),
        ("penetration, largest", "mm", "peak_penetration_m", 1e3),
        ("contacts", "", "contacts", None),
    ):
        unit = within(units, of_metres)
        values = [compared[run][key] for run in ("original", "replay")]
        shown = ["-" if v is None else str(v) if scale is None else f"{v * scale:.4g}" for v in values]
        result.add_row(f"{label} \\[{unit}]" if unit else label, *shown)
    for column in result.columns[1:]:
        column.justify = "right"
    return result


def verdict(compared: dict[str, Any], units: str | None = None) -> str:
    """One line that compares the replay with the original."""
    if compared["identical"]:
        return "the replay is identical to the original: every value of every sample that both have"
    most, rms = compared["max_position_difference_m"], compared["rms_position_difference_m"]
    if most is None:
        return "the replay differs from the original; their paths cannot be compared"
    errors = [f"{1e3 * error:.3g} {within(units, 'mm')}" for error in (most, rms)]
    return f"the replay differs from the original: the device by {errors[0]} at most, {errors[1]} rms"


def permits(files: str, typed: Iterable[object], *, trust: bool, ask: Callable[[str], bool] | None = None) -> Permits:
    """For `loading.permitting`: permits names that the user typed or agrees to; with `trust`, all names.

    files : as text. typed : the values of the command line. ask : asks the user; None: on a terminal.
    """
    answers: dict[str, bool] = {}
    texts = [str(value) for value in typed]

    def permit(parameter: str, name: str) -> None:
        if trust or any(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.:])", text) for text in texts):
            return
        if name not in answers:
            question = f"{files} names {name} ({parameter}): code that runs with your rights. Import it?"
            answers[name] = (ask or _asked)(question)
        if not answers[name]:
            why = f"{files} names it, and importing it would run its code; add --trust if you know who wrote it"
            raise InvalidParameter(parameter, name, "", why=why)

    return permit


def _asked(question: str) -> bool:
    """The user's answer; False if there is no terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    return typer.confirm(question, default=False, err=True)
