"""`hapnet export`: writes one or two recordings as CSV and Parquet; recordings of two hosts are aligned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands import complete, flags, output
from hapnet.commands.progress import Progress
from hapnet.errors import OutputError, RecordingError
from hapnet.loading import only_imported, permitting


@permitting(only_imported)
def export(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help=flags.RECORDINGS)],
    table: Annotated[
        str,
        typer.Option(
            "--format",
            help="csv, parquet, both; auto: both if pyarrow is there; rosbag2: for `ros2 bag`.",
            autocompletion=complete.words("auto", "csv", "parquet", "both", "rosbag2"),
        ),
    ] = "auto",
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the tables.", show_default="beside FILE")] = None,
) -> int:
    """Writes a table for each side and a table of the events. A vector has a column for each axis; an unknown value is
    empty. With --format rosbag2 it writes a bag that `ros2 bag` plays; this needs the extra ros2, but no ROS.
    """
    from hapnet.recording import alignment
    from hapnet.recording.export import ROSBAG, export as exported, formats
    from hapnet.recording.missing import all_missing
    from hapnet.recording.opened import fitting, opened

    if table != ROSBAG:
        formats(table, ROSBAG)
    words, written = output.console(json_to), output.Written()
    with Progress(output.progress_console(words), "reading"):
        found = opened(files)
    whole = found.whole
    written.missing += all_missing(found.files, found.parts)
    if len(found.files) == 2:
        words.print(f"clocks: {alignment.words(whole.meta)}")
    directory = found.files[0].parent if out is None else output.run_directory(out, None)
    try:
        with Progress(output.progress_console(words), "writing"), fitting(files[0]):
            paths = exported(found, directory, format=table)
    except RecordingError as error:
        raise OutputError(str(error)) from None
    output.show_files(words, [path.name for path in paths], directory)
    output.write_json(
        {
            "files": [str(path) for path in paths],
            "samples": {side: None if (columns := getattr(whole, side)) is None else len(columns["time_ns"])
                        for side in ("device", "world")},
            "events": len(whole.events),
            "aligned": whole.meta.get("aligned"),
            "clock_difference": whole.meta.get("clock_difference"),
        },
        json_to,
    )  # fmt: skip
    return written.code()
