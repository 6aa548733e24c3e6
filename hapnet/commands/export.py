"""`hapnet export`: declarations only; exporting.py does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands import complete, flags
from hapnet.commands.options import json_target

_FILES = "One recording, or the device's and the world's."


def export(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help=_FILES)],
    table: Annotated[
        str,
        typer.Option(
            "--format",
            help="csv, parquet, both; auto: both if pyarrow is there.",
            autocompletion=complete.words("auto", "csv", "parquet", "both"),
        ),
    ] = "auto",
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the tables.", show_default="beside FILE")] = None,
) -> int:
    """Write one or two recordings as tables: CSV, and Parquet. Those of two hosts are put on one clock.

    One table for each side and one of the events. A vector is a column for each axis; an unknown value is empty.
    """
    json_target(json_to)
    from hapnet.commands import exporting

    return exporting.main(files, table, json_to, out)
