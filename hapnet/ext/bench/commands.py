"""`hapnet bench`: measures, shows a table, and writes it as JSON and the histograms as a figure."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.progress import Progress
from hapnet.errors import HapnetError, InvalidParameter
from netem.errors import NetemError

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.ext.bench.registry import Measure
    from hapnet.ext.bench.row import Options, Row


def rows(incomplete: str) -> list[str]:
    """Rows of the benchmark, for TAB; after a comma, another row."""
    from hapnet.ext.bench.registry import ROWS

    before, comma, _ = incomplete.rpartition(",")
    return [f"{before}{comma}{row}" for row in ROWS]


Only = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[,NAME]",
        help="Rows to measure, as names or patterns: servo_*,device_tick.",
        autocompletion=rows,
    ),
]

_WIDTH = 150  # of the table
_FAILED = "not measured"


def bench(
    only: Only = None,
    seconds: Annotated[float, typer.Option(help="Length of a round, in seconds.")] = 3.0,
    rounds: Annotated[int, typer.Option(help="Number of rounds; figures are medians over them.")] = 3,
    realtime: flags.Realtime = False,
    beside: Annotated[int, typer.Option(help="Number of busy processes during servo_traffic.")] = 0,
    json_to: flags.Json = None,
    out: Annotated[Path | None, flags.out_in("runs/<UTC time>-bench")] = None,
) -> int:
    """Prints a table; writes bench.json and a figure of the histograms. The default takes some twelve minutes on two
    idle cores, and longer on busy cores; it shows how much is left, and at the end how long it took. Servo and
    world are compiled if `hapnet compile` has been run. Use --seconds 60 --rounds 5 for figures to publish.
    """
    from hapnet.ext.bench.registry import select
    from hapnet.ext.bench.row import Options
    from hapnet.processes.system import ENDING

    for name, value, low, high in (
        ("--seconds", seconds, 0.1, 3600.0),
        ("--rounds", rounds, 1, 1000),
        ("--beside", beside, 0, 64),
    ):
        if not low <= value <= high:
            raise InvalidParameter(name, value, f"{low:g} to {high:g}")
    chosen = select([word.strip() for word in only.split(",")] if only is not None else ())
    words = output.console(json_to)
    directory = output.run_directory(out or Path("runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-bench", None)
    for number in ENDING[1:]:
        signal.signal(number, signal.default_int_handler)  # ends the children too, as Ctrl-C does
    rows: list[Row] = []
    began_s = time.monotonic()
    try:
        for row in _measure(chosen, Options(seconds, rounds, realtime, beside), words):
            rows.append(row)
            output.write_json([row.as_dict() for row in rows], str(directory / "bench.json"))
    finally:
        if rows:
            _show(rows, directory, words)
            words.print(f"measured in {(time.monotonic() - began_s) / 60.0:.1f} minutes")
            output.write_json([row.as_dict() for row in rows], json_to)
    return 1 if any(row.what == _FAILED for row in rows) else 0


def _show(rows: list[Row], directory: Path, console: Console) -> None:
    from hapnet.ext.bench import report
    from hapnet.ext.pictures.style import save_figure

    console.width = max(console.width, _WIDTH)  # a narrower terminal wraps the lines, so that nothing is cut off
    console.print(report.table(rows))
    if any(report.has_histogram(row) for row in rows):
        save_figure(report.figure(rows), directory / "bench.png")
        console.print(f"bench.json and bench.png in {directory}")
    else:
        console.print(f"bench.json in {directory}")


def _measure(chosen: dict[str, Measure], options: Options, console: Console) -> Iterator[Row]:
    """Measure one row after another; show a bar on a terminal, otherwise a line for each row."""
    from hapnet.ext.bench.row import Row

    with Progress(output.progress_console(console), "measuring", len(chosen), "", background=False) as progress:
        for number, (name, measure) in enumerate(chosen.items()):
            progress.update(number, f"{number + 1}/{len(chosen)} {name}")
            try:
                yield measure(options)
            except (HapnetError, NetemError) as error:
                yield Row(name, "", _FAILED, note=f"{_FAILED}: {error}", panel=False)
