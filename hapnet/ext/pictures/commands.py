"""`hapnet report` makes a page and pictures of recordings; `hapnet reproduce` draws the paper's Figures 4, 5 and 6.

The printed paper lacks digits, which the defaults of `hapnet.params` restore (`LOST`). The paper does not state the law
of Figure 6's filter: here it is a first-order low-pass with a time constant of 15 ms, run every 5 ms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import complete, flags, output
from hapnet.commands.options import ParamsOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.installing import require
from hapnet.loading import extension, only_imported, permitting
from hapnet.param_sources import COMMAND
from hapnet.param_values import flatten
from hapnet.params import Params

if TYPE_CHECKING:
    from hapnet.recording.samples import Recording


FIGURES = ("fig4", "fig5", "fig6")
Figure = Annotated[str, typer.Argument(help="fig4, fig5 or fig6.", autocompletion=complete.words(*FIGURES))]
SECTION_4: dict[str, object] = {
    "rendering": "paper", "scene": "wall", "operator": "press", "link.up": "", "link.down": "",
    "record_hz": 1000.0, "operator_model.start_periods": 0.0, "operator_model.end_hold_s": 0.0,
    "device.stiffness": 100.0, "device.ceiling_J": 0.05,
}  # fmt: skip
"""One computer: device and virtual world on the same machine, without a link between them. The hand is as it was when
the figures were made: an operator `sine` has its full amplitude from the start."""
SMOOTHING_S = 0.015
"""Time constant of Figure 6's filter [s]."""


@permitting(only_imported)
def report(
    files: flags.Recorded,
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for output files.", show_default="beside FILE")] = None,
    verbose: flags.Verbose = False,
) -> int:
    from hapnet.commands.outcome import write
    from hapnet.ext.pictures.report import names_of, report as report_on
    from hapnet.recording.mcap import repair
    from hapnet.recording.opened import fitting

    require("report", "hapnet report")
    if len(files) == 1 and (of_graph := extension("reports on graphs").run_in(files[0])) is not None:
        code: int = extension("reports on graphs").report(of_graph, json_to, out, verbose=verbose)
        return code
    words = output.console(json_to)
    written = output.Written()
    with Progress(output.progress_console(words), "reading"), fitting(files[0]):
        found = report_on(files)
    sources = []
    for source in found.sources:
        if source.missing is not None:
            with written.part():
                source = replace(source, repaired=repair(source.path))
            copy = f"; repaired and indexed copy: {source.repaired}" if source.repaired else ""
            written.missing.append(f"{source.missing}{copy}")
        sources.append(source)
    found = replace(found, sources=tuple(sources))
    first = found.sources[0].path
    directory = first.parent if out is None else output.run_directory(out, None)
    stem = "-".join(source.path.stem for source in found.sources)
    with fitting(first):
        there = write(found, directory, f"{stem}.html", names_of(stem), written)
        output.show_verdict(words, found.summary, verbose=verbose)
        virtual = found.recording.meta.get("clock") == "virtual"
        written.judge(found.summary, asked(found.parts), virtual=virtual, ran=False)
    if verbose:
        output.show_files(words, there, directory)
    else:
        output.show_fact(words, found.summary, output.more_in(directory, f"{stem}.html"))
    with written.part():
        output.write_json(found.summary, json_to)
    return written.code()


def asked(recordings: Sequence[Recording]) -> Params | None:
    """The parameters of the run, preferably the device's; None if this version cannot read them."""
    for recording in sorted(recordings, key=lambda one: one.device is None):
        tree = recording.meta.get("params")
        if isinstance(tree, Mapping):
            names = set(Params().flat())
            with suppress(InvalidParameter):
                flat = {name: value for name, value in flatten(tree) if name in names}
                return Params.recorded(flat, recording.meta.get("sources"))
    return None


def reproduce(
    *,
    figure: Figure,
    duration: flags.Duration = None,
    seed: flags.Seed = 0,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
) -> int:
    base = Params().set(SECTION_4, COMMAND)
    if figure == "fig6":
        base = base.set({"device.smoothing_s": SMOOTHING_S}, COMMAND)
    chosen = params.over(base, {"duration_s": duration})
    if params.show_params:
        return params.show(chosen)
    require("report", "hapnet reproduce")
    from hapnet.ext.pictures.paper import LOST, profiles, timesteps
    from hapnet.ext.pictures.style import save_figure
    from hapnet.recording.mcap import save
    from hapnet.simulation.simulation import Simulation

    if figure not in FIGURES:
        raise InvalidParameter("figure", figure, "one of " + ", ".join(FIGURES), FIGURES)
    words = output.console(json_to)
    simulation = Simulation(chosen, seed)
    with Progress(output.progress_console(words), "simulating", chosen.duration_s) as progress:
        result = simulation.run(progress.update)
        directory = output.run_directory(out, seed)
        recording = result.recording
        unfiltered = None
        if figure == "fig6":
            progress.stage("simulating without the filter", chosen.duration_s)
            unfiltered = Simulation(chosen.set({"device.smoothing_s": 0.0}), seed).run(progress.update).recording
        progress.stage("drawing")
        drawn = timesteps(recording) if figure == "fig4" else profiles(recording, chosen, unfiltered)
        save_figure(drawn, directory / f"{figure}.png")
        progress.stage("writing")
        save(recording, directory / f"{figure}.mcap")
    result.summary["reconstructed"] = True
    output.write_json(result.summary, str(directory / f"{figure}.json"))
    output.show_warnings(words, result.warnings)
    output.show_verdict(words, result.summary, verbose=verbose)
    if not verbose:
        output.show_fact(words, result.summary, output.more_in(directory, f"{figure}.png"))
    else:
        output.show_files(words, (f"{figure}.png", f"{figure}.mcap", f"{figure}.json"), directory)
    written = output.Written()
    written.judge(result.summary, chosen, virtual=True)
    words.print(LOST, markup=False)
    output.write_json(result.summary, json_to)
    return written.code()
