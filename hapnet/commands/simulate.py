"""`hapnet simulate`: both sides in virtual time."""

from __future__ import annotations

from pathlib import Path

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import Params


def main(params: Params, seed: int, json_to: str | None, out: Path | None, *, files: bool, verbose: bool) -> int:
    """Simulate; write recording, figure and summary; print the summary."""
    from hapnet.recording.mcap import save
    from hapnet.simulation.simulation import Simulation

    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    words = output.console(json_to)
    simulation = Simulation(params, seed)
    output.show_warnings(words, simulation.setup.warnings)
    directory = output.run_directory(out, seed) if files else None
    written = output.Written()
    with Progress(output.progress_console(), "simulating", params.duration_s) as progress:
        result = simulation.run(progress.update)
        if directory is not None:
            progress.stage("writing")
            with written.part():
                save(result.recording, directory / "run.mcap")
            progress.stage("drawing")
            with written.part():
                output.save_figure(result.recording, directory / "figure.png")
            with written.part():
                output.write_json(result.summary, str(directory / "summary.json"))
    output.show_summary(words, result.summary, verbose=verbose)
    if verbose:
        output.show_kernel(words, simulation.not_compiled)
    written.judge(result.summary, params, virtual=True)
    if directory is not None and not written.missing:
        page = f"; for a page with everything: hapnet report {directory / 'run.mcap'}"
        output.show_files(words, ("run.mcap", "figure.png", "summary.json"), directory, page)
    with written.part():
        output.write_json(result.summary, json_to)
    return written.code()
