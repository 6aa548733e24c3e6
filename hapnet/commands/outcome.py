"""The results of a run, whatever ended it: one summary of both sides' reports and recordings, and the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hapnet.assembly.build import Setup
from hapnet.assembly.memory import bytes_a_second, require_room
from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter, RecordingError
from hapnet.loading import extension
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Recording, join
from hapnet.summary.from_samples import motion
from hapnet.summary.recorded import of_parts
from hapnet.summary.run import Summary

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("device.mcap", "world.mcap", "report.html", "figure.png", "summary.json", "log.jsonl")


class Outcome(NamedTuple):
    """A run's summary, its joined recording (None: nothing was recorded), and each recorded file with its content."""

    summary: Summary
    recording: Recording | None
    sources: list[tuple[Path, Recording]]


def of_pair(
    reported: Mapping[str, Summary],
    files: Mapping[str, Path],
    failed: Mapping[str, str],
    setup: Setup,
    seed: int,
    written: output.Written,
) -> Outcome:
    """Join the results of a run of both sides on this machine.

    reported : by role, the summary that a process wrote at its end; for a killed process the samples are used. files :
    by role, the existing recordings. failed : by role, the reason why a side ended early. setup, seed : of the run.
    written : collects a line for each missing part.
    """
    recordings: dict[str, Recording] = {}
    seconds = max((side["duration_s"] or 0.0 for side in reported.values()), default=0.0)
    try:
        require_room("duration_s", seconds, seconds, bytes_a_second(setup.params, setup.dof), "recorded seconds")
    except InvalidParameter as error:  # a run of days is longer than what fits into memory
        written.missing.append(f"no report: {error}")
        files = {}
    for role, file in files.items():
        try:
            recordings[role] = read_recording(file)
        except RecordingError as error:
            written.missing.append(f"not in the report: {error}")
    whole: Recording | None = None
    try:
        held = [each for each in recordings.values() if each.device is not None or each.world is not None]
        whole = join(*held) if len(held) == 2 else held[0] if held else None
    except RecordingError as error:
        written.missing.append(f"no report: {error}")
    summary = of_parts(reported, recordings, whole, failed, coupling=setup.params.coupling, seed=seed)
    if whole is None:
        return Outcome(summary, None, [])
    summary["motion"] = motion(whole)
    meta = {**whole.meta, "seed": seed, "links": {"up": str(setup.up), "down": str(setup.down)}}
    sources = [(files[role], recording) for role, recording in recordings.items()]
    return Outcome(summary, replace(whole, meta=meta, summary=summary), sources)


def of_side(summary: Summary, file: Path, written: output.Written) -> Outcome:
    """Join the summary of one side that has ended with its recording, if it wrote one."""
    if not file.exists():
        return Outcome(summary, None, [])
    try:
        recording = read_recording(file)
    except RecordingError as error:
        written.missing.append(f"no report: {error}")
        return Outcome(summary, None, [])
    return Outcome(summary, replace(recording, summary=summary), [(file, recording)])


def write_files(found: Outcome, directory: Path, written: output.Written, words: Console | None) -> None:
    """Write the summary into `directory` and, if there is a recording, the page and the figure."""
    with written.part():
        output.write_json(found.summary, str(directory / "summary.json"))
    if found.recording is not None:
        reports = extension("reports")
        with Progress(output.progress_console(words), "drawing"):
            sources = tuple(reports.source_of(*source) for source in found.sources)
            report = reports.Report(found.recording, sources)
            write(report, directory, reports.PAGE, {"run": "figure.png"}, written)


def write(report: Any, directory: Path, page: str, names: Mapping[str, str], written: output.Written) -> list[str]:
    """Write the page of a `Report`, and the pictures for which `names` has a file name; returns the written names.

    written : collects the errors.
    """
    names_written = []
    for name, data in report.content(page, names).items():
        with written.part():
            extension("reports").save(data, directory / name, "figure" if name.endswith(".png") else "report")
            names_written.append(name)
    return names_written
