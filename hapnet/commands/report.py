"""`hapnet report`: turns one or two recordings into a page, pictures and a summary; a torn one gets a repaired copy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from hapnet.commands import flags, output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter, RecordingError
from hapnet.extras import require
from hapnet.param_values import flatten
from hapnet.params import Params

if TYPE_CHECKING:
    from hapnet.recording.samples import Recording
    from hapnet.reports import Source
    from hapnet.summary.structure import Motion


def report(
    files: flags.Recorded,
    json_to: flags.Json = None,
    out: Annotated[Path | None, typer.Option(help="Directory for output files.", show_default="beside FILE")] = None,
    verbose: flags.Verbose = False,
) -> int:
    """Turn one or two recordings into a page (HTML), figures and a summary. A torn one gets a repaired copy."""
    from hapnet.recording.mcap import read_recording, repair
    from hapnet.recording.samples import join
    from hapnet.summary.from_samples import motion
    from hapnet.summary.recorded import of_recordings

    files = [file for named in files for file in (_recordings_in(named) if named.is_dir() else [named])]
    if not 1 <= len(files) <= 2:
        raise InvalidParameter("FILE", [str(file) for file in files], "one recording, or the device's and the world's")
    require("report", "hapnet report")
    words = output.console(json_to)
    written = output.Written()
    with Progress(output.progress_console(), "reading"):
        recordings = [read_recording(file) for file in files]
    summary = of_recordings(files, recordings)
    whole = recordings[0] if len(files) == 1 else join(*recordings)
    reported, moved = summary.get("motion"), motion(whole)
    if isinstance(reported, Mapping):  # the other side's report of its own stays
        moved = cast("Motion", {name: reported.get(name) if value is None else value for name, value in moved.items()})
    summary["motion"] = moved
    sources = []
    for file, recording in zip(files, recordings, strict=True):
        source = source_of(file, recording)
        if source.torn:
            with written.part():
                source = replace(source, repaired=repair(file))
            copy = f": repaired and indexed copy in {source.repaired}" if source.repaired else ""
            words.print(f"{file} is torn (its writer was killed){copy}", markup=False)
        sources.append(source)
    directory = files[0].parent if out is None else output.run_directory(out, None)
    stem = "-".join(file.stem for file in files)
    shown = _legible(replace(whole, summary=summary))
    names = {
        "run": f"{stem}.png",
        "scene": f"{stem}-scene.png",
        "link": f"{stem}-link.png",
        "servo": f"{stem}-servo.png",
    }
    there = write(shown, sources, directory, f"{stem}.html", names, written)
    output.show_summary(words, shown.summary or {}, verbose=verbose)
    written.judge(summary, asked(recordings), virtual=whole.meta.get("clock") == "virtual", ran=False)
    output.show_files(words, there, directory)
    with written.part():
        output.write_json(summary, json_to)
    return written.code()


def _recordings_in(named: Path) -> list[Path]:
    """The recordings in a run's directory. One that was cut off before its first samples counts if it is alone."""
    from hapnet.recording.mcap import read_recording
    from hapnet.summary.structure import SIDES

    there = [file for side in SIDES if (file := named / f"{side}.mcap").exists()]
    found = []
    for file in there:
        with suppress(RecordingError):
            recording = read_recording(file)
            if recording.device is not None or recording.world is not None:
                found.append(file)
    if not there:
        raise InvalidParameter("FILE", str(named), "a recording, or a directory with device.mcap or world.mcap")
    return found or there[:1]


def asked(recordings: Sequence[Recording]) -> Params | None:
    """The parameters of the run, preferably the device's; None if this version cannot read them."""
    for recording in sorted(recordings, key=lambda one: one.device is None):
        tree = recording.meta.get("params")
        if isinstance(tree, Mapping):
            names = set(Params().flat())
            with suppress(InvalidParameter):
                return Params.recorded({name: value for name, value in flatten(tree) if name in names})
    return None


def write(
    recording: Recording,
    sources: Sequence[Source],
    directory: Path,
    page: str,
    names: Mapping[str, str],
    written: output.Written,
) -> list[str]:
    """Write the page, and the pictures for which `names` has a file name; returns the names of the written files.

    names : the pictures' file names. written : collects what cannot be written.
    """
    from hapnet import reports

    drawn = reports.pictures(recording)
    files = {page: reports.page(recording, drawn, sources).encode("utf-8", errors="replace")}
    files |= {names[name]: picture.png for name, picture in drawn.items() if name in names}
    there = []
    for name, data in files.items():
        with written.part():
            reports.save(data, directory / name, "figure" if name.endswith(".png") else "report")
            there.append(name)
    return there


def source_of(file: Path, recording: Recording) -> Source:
    """What a report says about the file of a recording."""
    from hapnet.reports import Source, legible

    sides = [side for side in ("device", "world") if getattr(recording, side) is not None]
    role = "both" if len(sides) == 2 else sides[0] if sides else "no samples"
    written = datetime.fromtimestamp(file.stat().st_mtime, UTC)
    return Source(Path(legible(str(file))), role, recording.torn, None, f"{written:%Y-%m-%d %H:%M:%S} UTC")


def _legible(recording: Recording) -> Recording:
    """A recording whose texts are safe to show, whoever wrote them."""
    from hapnet.reports import legible

    events = [event._replace(kind=legible(event.kind), text=legible(event.text)) for event in recording.events]
    return replace(recording, meta=legible(recording.meta), summary=legible(recording.summary), events=events)
