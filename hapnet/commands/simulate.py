"""`hapnet simulate`: simulates both sides in virtual time."""

from __future__ import annotations

from typing import Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.options import LinkOptions, ModelOptions, ParamsOptions, no_out_without_files
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.loading import extension
from hapnet.params import Params


def simulate(
    *,
    model: ModelOptions,
    seed: flags.Seed = 0,
    links: LinkOptions,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
    files: flags.Files = True,
    seeds: Annotated[str | None, typer.Option(metavar="A:B", help="Many seeds, A to B - 1: a table, no files.")] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes for many seeds; 0: one per core.")] = 0,
    graph: flags.Graph = None,
) -> int:
    chosen = params.over(Params(), model.named("device", "world"), links)
    if params.show_params:
        if graph is not None:
            raise InvalidParameter("--show-params", "with --graph", "", why="each pair has its own; leave --graph out")
        return params.show(chosen)
    if graph is not None:
        if seeds is not None:
            raise InvalidParameter("--seeds", seeds, "", why="--graph simulates one seed; use --seed")
        no_out_without_files(out, files)

        def over(pair: Params) -> Params:
            return params.over(pair, model.named("device", "world"), links)

        code: int = extension("graphs").simulate(
            graph, over, seed=seed, json_to=json_to, out=out, files=files, verbose=verbose
        )
        return code
    if seeds is not None:
        if out is not None:
            raise InvalidParameter(
                "--out", str(out), "", why="--seeds writes no files; leave --out out, or use --json FILE"
            )
        from hapnet.commands import batch

        return batch.main(chosen, batch.seed_range(seeds), json_to, workers)
    no_out_without_files(out, files)
    from hapnet.recording.mcap import save
    from hapnet.simulation.simulation import Simulation

    if chosen.duration_s <= 0.0:
        raise InvalidParameter("duration_s", chosen.duration_s, "above 0 in virtual time")
    words = output.console(json_to)
    simulation = Simulation(chosen, seed)
    output.show_warnings(words, simulation.setup.warnings)
    directory = output.run_directory(out, seed) if files else None
    written = output.Written()
    written.missing += simulation.setup.missing
    with Progress(output.progress_console(words), "simulating", chosen.duration_s) as progress:
        result = simulation.run(progress.update)
        if directory is not None:
            progress.stage("writing")
            with written.part():
                save(result.recording, directory / "run.mcap")
            progress.stage("drawing")
            with written.part():
                extension("pictures").save_figure(result.plot(), directory / "figure.png")
            with written.part():
                output.write_json(result.summary, str(directory / "summary.json"))
    output.show_verdict(words, result.summary, verbose=verbose)
    if not verbose:
        output.show_fact(words, result.summary, output.more_in(directory, "run.mcap", "hapnet report "))
    else:
        output.show_kernel(words, simulation.not_compiled)
        if directory is not None:
            page = f"; for a page with everything: hapnet report {directory / 'run.mcap'}"
            output.show_files(words, ("run.mcap", "figure.png", "summary.json"), directory, page)
    written.judge(result.summary, chosen, virtual=True)
    with written.part():
        output.write_json(result.summary, json_to)
    return written.code()
