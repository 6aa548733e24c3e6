"""`hapnet simulate`: both sides in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.commands import output
from hapnet.errors import InvalidParameter
from hapnet.params import Params

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.runtime.virtual import Result, Simulation


def main(params: Params, seed: int, json_to: str | None, out: Path | None, *, files: bool) -> int:
    """Simulate, write recording, figure and summary, print the summary."""
    from hapnet.mcap_file import save
    from hapnet.runtime.virtual import Simulation

    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    words = output.console(json_to)
    simulation = Simulation(params, seed)
    output.show_warnings(words, simulation.setup.warnings)
    directory = output.run_directory(out, seed) if files else None
    result = with_progress(simulation, words, "simulating")
    written = output.Written()
    if directory is not None:
        with written.part():
            save(result.recording, directory / "run.mcap")
        with written.part():
            output.save_figure(result.recording, directory / "figure.png")
        with written.part():
            output.write_json(result.summary, str(directory / "summary.json"))
    output.show_summary(words, result.summary)
    if directory is not None and not written.missing:
        file = directory / "run.mcap"
        words.print(
            f"recording, figure and summary in {directory}; a page of it all: hapnet report {file}", markup=False
        )
    with written.part():
        output.write_json(result.summary, json_to)
    return written.code()


def with_progress(simulation: Simulation, words: Console, doing: str) -> Result:
    """Run it under a bar."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(doing), BarColumn(), TextColumn("{task.completed:.1f} of {task.total:g} s"))
    with Progress(*columns, TimeRemainingColumn(), console=words, disable=not words.is_terminal) as bar:
        task = bar.add_task("", total=simulation.setup.params.duration_s)
        return simulation.run(lambda done: bar.update(task, completed=done))
