"""`hapnet.report`: the recordings of a run as a page, pictures and a summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import cast

from hapnet.ext.pictures.page import ReportSource, page
from hapnet.ext.pictures.pictures import PngPicture, pictures
from hapnet.ext.pictures.run import figure, html
from hapnet.ext.pictures.style import png, save as save
from hapnet.loading import only_imported, permitting
from hapnet.recording.missing import missing
from hapnet.recording.opened import Recorded, opened
from hapnet.recording.samples import Recording
from hapnet.summary.from_samples import motion
from hapnet.summary.recorded import of_recordings
from hapnet.summary.structure import MotionFigures, Summary
from hapnet.summary.words import legible, verdict

PAGE = "report.html"


@dataclass(frozen=True)
class Report:
    """The report on a run: page, pictures and summary.

    recording : with its summary, and with texts that are safe to show. sources : the files of the recording.
    parts : the recordings in these files.
    """

    recording: Recording
    sources: tuple[ReportSource, ...] = ()
    parts: tuple[Recording, ...] = ()

    def __repr__(self) -> str:
        return f"Report({verdict(self.summary)})"

    @property
    def summary(self) -> Summary:
        """The summary, as `hapnet report --json -` prints it; `hapnet.summary.structure` lists its keys."""
        return cast("Summary", self.recording.summary)

    @cached_property
    def pictures(self) -> Mapping[str, PngPicture]:
        """Pictures by name: ``run``, ``scene`` of solids, ``link`` and ``servo`` if their histograms were recorded."""
        return pictures(self.recording)

    @property
    def page(self) -> str:
        """The page as HTML, with its pictures in it."""
        return page(self.recording, self.pictures, self.sources)

    def content(self, page: str, names: Mapping[str, str]) -> dict[str, bytes]:
        """Return the files that `write` writes, by name: the page, and the pictures for which `names` has one."""
        files = {page: self.page.encode("utf-8", errors="replace")}
        files |= {names[name]: picture.png for name, picture in self.pictures.items() if name in names}
        return files | {names["run"]: png(figure(self.recording))}  # alone it has a title

    def write(self, directory: str | PathLike[str], stem: str = "report") -> list[Path]:
        """Write ``report.html`` and ``report.png``, and the other pictures beside them. Raises RecordingError."""
        found = self.content(f"{stem}.html", names_of(stem))
        for name, data in found.items():
            save(data, Path(directory) / name, "figure" if name.endswith(".png") else "report")
        return [Path(directory) / name for name in found]

    def _repr_html_(self) -> str:
        return html(self.recording)


@permitting(only_imported)
def report(what: Recorded, directory: str | PathLike[str] | None = None) -> Report:
    """The report on a run; also written into `directory` (``report.html`` and its pictures), if given.

    ``report(simulate(), "runs")``; or the report on a file, on the device's and the world's file, or on a directory.

    Raises InvalidParameter, RecordingError: these are not the recordings of a run, or a file cannot be written.
    MissingLibrary: matplotlib is not installed (extra `report`).
    """
    found = opened(what)
    summary = found.whole.summary if not found.files else None
    if summary is None:
        summary = of_recordings(found.files, found.parts) if found.files else of_recordings([Path("run")], found.parts)
        earlier, moved = summary.get("motion"), motion(found.whole)
        if isinstance(earlier, Mapping):  # figures that these recordings do not give are kept from the report
            moved = cast("MotionFigures", {key: earlier.get(key) if one is None else one for key, one in moved.items()})
        summary["motion"] = moved
    sources = [source_of(file, recording) for file, recording in zip(found.files, found.parts, strict=False)]
    result = Report(_legible(replace(found.whole, summary=summary)), tuple(sources), found.parts)
    if directory is not None:
        result.write(directory)
    return result


def names_of(stem: str) -> dict[str, str]:
    """The file names of the pictures."""
    return {"run": f"{stem}.png", **{name: f"{stem}-{name}.png" for name in ("scene", "link", "servo")}}


def source_of(file: Path, recording: Recording) -> ReportSource:
    """Return a report's entry about the file of a recording."""
    sides = [side for side in ("device", "world") if getattr(recording, side) is not None]
    role = "both" if len(sides) == 2 else sides[0] if sides else "no samples"
    written, name = datetime.fromtimestamp(file.stat().st_mtime, UTC), legible(str(file))
    return ReportSource(Path(name), role, missing(name, recording), None, f"{written:%Y-%m-%d %H:%M:%S} UTC")


def _legible(recording: Recording) -> Recording:
    """The recording with texts that are safe to show, whatever their origin."""
    events = [event._replace(kind=legible(event.kind), text=legible(event.text)) for event in recording.events]
    return replace(recording, meta=legible(recording.meta), summary=legible(recording.summary), events=events)
