"""`hapnet report`: turns one or two recordings into a page, pictures and a summary; a torn one gets a repaired copy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import flags, output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.installing import require
from hapnet.loading import only_imported, permitting
from hapnet.param_values import flatten
from hapnet.params import Params

if TYPE_CHECKING:
    from hapnet.ext.pictures.report import Report
    from hapnet.recording.samples import Recording


@permitting(only_imported)
def report(
    files: flags.Recorded,
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for output files.", show_default="beside FILE")] = None,
    verbose: flags.Verbose = False,
) -> int:
    from hapnet.ext.pictures.report import names_of, report as reported
    from hapnet.recording.mcap import repair
    from hapnet.recording.opened import fitting

    require("report", "hapnet report")
    words = output.console(json_to)
    written = output.Written()
    with Progress(output.progress_console(), "reading"), fitting(files[0]):
        found = reported(files)
    sources = []
    for source in found.sources:
        if source.torn:
            with written.part():
                source = replace(source, repaired=repair(source.path))
            copy = f": repaired and indexed copy in {source.repaired}" if source.repaired else ""
            words.print(f"{source.path} is torn (its writer was killed){copy}", markup=False)
        sources.append(source)
    found = replace(found, sources=tuple(sources))
    first = found.sources[0].path
    directory = first.parent if out is None else output.run_directory(out, None)
    stem = "-".join(source.path.stem for source in found.sources)
    with fitting(first):
        there = write(found, directory, f"{stem}.html", names_of(stem), written)
        output.show_summary(words, found.summary, verbose=verbose)
        virtual = found.recording.meta.get("clock") == "virtual"
        written.judge(found.summary, asked(found.parts), virtual=virtual, ran=False)
    output.show_files(words, there, directory)
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


def write(found: Report, directory: Path, page: str, names: Mapping[str, str], written: output.Written) -> list[str]:
    """Write the page, and the pictures for which `names` has a file name; returns the names of the written files.

    written : collects what cannot be written.
    """
    from hapnet.ext.pictures.style import save

    there = []
    for name, data in found.content(page, names).items():
        with written.part():
            save(data, directory / name, "figure" if name.endswith(".png") else "report")
            there.append(name)
    return there
