"""Describes the missing parts of a recording that is damaged or has no end, in one line."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from os import PathLike, fspath

from hapnet.recording.samples import Lost, Recording

SHOWN = 3
"""The most damaged parts that a line lists."""


def missing(file: str | PathLike[str], recording: Recording) -> str | None:
    """One line about what is missing in the recording of this file; None: it is whole."""
    parts = list(_parts(recording))
    return f"{fspath(file)} {', and '.join(parts)}" if parts else None


def all_missing(files: Iterable[str | PathLike[str]], recordings: Iterable[Recording]) -> list[str]:
    """The lines of several recordings."""
    lines = (missing(file, recording) for file, recording in zip(files, recordings, strict=False))
    return [line for line in lines if line is not None]


def _parts(recording: Recording) -> Iterator[str]:
    origin_ns = int(recording.meta.get("origin_ns", 0))
    if lost := recording.lost:
        spans = [_span(one, origin_ns, recording) for one in lost]
        total_s = sum(max(0.0, end - begin) for begin, end in spans)
        listed = [f"{begin:.3f} s to {end:.3f} s" for begin, end in spans[:SHOWN]]
        more = f" and {len(spans) - SHOWN} more parts" if len(spans) > SHOWN else ""
        of_s = max([total_s, *_ends(recording)])
        times = f"{', '.join(listed)}{more}"
        yield f"is damaged: up to {total_s:.3f} s of {of_s:.3f} s are missing ({times}), the rest was read"
    if recording.torn:
        if recording.summary is not None:
            yield "is damaged at its end, after all samples"
        else:
            end_s = max(_ends(recording), default=None)
            where = "has no samples" if end_s is None else f"ends at {end_s:.3f} s"
            yield f"is incomplete: it {where}, because the process that wrote it was killed or the file was cut off"


def _span(lost: Lost, origin_ns: int, recording: Recording) -> tuple[float, float]:
    """Begin and end of a damaged part, in seconds of the recording."""
    begin_s = 0.0 if lost.begin_ns is None else (lost.begin_ns - origin_ns) / 1e9
    end_s = max([begin_s, *_ends(recording)]) if lost.end_ns is None else (lost.end_ns - origin_ns) / 1e9
    return begin_s, end_s


def _ends(recording: Recording) -> Iterator[float]:
    for side in (recording.device, recording.world):
        if side is not None:
            yield float(side["time_s"][-1])
